"""Forms with files in them (RFC 7578)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from email.message import Message
from email.parser import BytesHeaderParser

from app.errors import BadUpload

FORM = "multipart/form-data"
MOST_PARTS = 32
"""Of a form; what is taken in has six at most."""
LONGEST_HEAD = 2000
"""Of a part [bytes], and of a Content-Type [characters]: parameters are parsed in time that grows with the square."""


@dataclass(frozen=True)
class FormPart:
    """One part of a form."""

    name: str
    media_type: str
    filename: str
    content: bytes


def content_type(declared: str | None) -> Message:
    """Parse a Content-Type header; one that is far too long declares nothing."""
    header = Message()
    header["content-type"] = declared if declared is not None and len(declared) <= LONGEST_HEAD else ""
    return header


def form_parts(content: bytes, header: Message) -> list[FormPart]:
    """Return the parts of a form that have names. Forms are large: this is no work for an event loop.

    Raises:
        BadUpload: It has no boundary or does not end with it, more than `MOST_PARTS` parts, or a part whose head is
            longer than `LONGEST_HEAD`.
    """
    boundary = header.get_param("boundary")
    if not isinstance(boundary, str) or not boundary:
        raise BadUpload("the form has no boundary")
    places: list[tuple[int, int]] = []
    for place in _between(content, b"--" + boundary.encode()):
        # The last place is the end of the form.
        if len(places) > MOST_PARTS:
            raise BadUpload(f"the form has more than {MOST_PARTS} parts")
        places.append(place)
    if not places or not content.startswith(b"--", places[-1][0]):
        raise BadUpload("the form does not end with its boundary")
    parts = (_part(content, begin, end) for begin, end in places[:-1])
    return [part for part in parts if part is not None]


def _part(content: bytes, begin: int, end: int) -> FormPart | None:
    """Return the part at a place, or None if it has no name."""
    split = content.find(b"\r\n\r\n", begin, end)
    if split < 0:
        return None
    if split - begin > LONGEST_HEAD:
        raise BadUpload(f"a part of the form has a head of more than {LONGEST_HEAD} bytes")
    head = BytesHeaderParser().parsebytes(content[begin:split].lstrip(b" \t\r\n") + b"\r\n\r\n")
    name = head.get_param("name", header="content-disposition")
    if not isinstance(name, str):
        return None
    return FormPart(name, head.get_content_type(), head.get_filename() or "", content[split + 4 : end])


def _between(content: bytes, boundary: bytes) -> Iterator[tuple[int, int]]:
    """Yield where each piece behind a boundary begins and ends; what comes before the first one is none.

    A boundary begins a line, be it the first. Nothing is copied: forms have files of many megabytes.
    """
    line = b"\r\n" + boundary
    found = 0 if content.startswith(boundary) else content.find(line)
    begin = -1 if found < 0 else found + (len(boundary) if found == 0 and content.startswith(boundary) else len(line))
    while begin >= 0:
        end = content.find(line, begin)
        yield begin, len(content) if end < 0 else end
        begin = -1 if end < 0 else end + len(line)
