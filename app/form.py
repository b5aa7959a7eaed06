"""Forms with files in them (RFC 7578)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from email.message import Message
from email.parser import BytesHeaderParser

from app.errors import BadUpload

FORM = "multipart/form-data"


@dataclass(frozen=True)
class FormPart:
    """One part of a form."""

    name: str
    media_type: str
    filename: str
    content: bytes


def content_type(declared: str | None) -> Message:
    """Parse a Content-Type header."""
    header = Message()
    header["content-type"] = declared or ""
    return header


def form_parts(content: bytes, header: Message) -> list[FormPart]:
    """Return the parts of a form that have names.

    Raises:
        BadUpload: It has no boundary, or does not end with it.
    """
    boundary = header.get_param("boundary")
    if not isinstance(boundary, str) or not boundary:
        raise BadUpload("the form has no boundary")
    places = list(_between(content, b"--" + boundary.encode()))
    if not places or not content.startswith(b"--", places[-1][0]):
        raise BadUpload("the form does not end with its boundary")
    parts = []
    for begin, end in places[:-1]:
        split = content.find(b"\r\n\r\n", begin, end)
        part = BytesHeaderParser().parsebytes(content[begin : max(begin, split)].lstrip(b" \t\r\n") + b"\r\n\r\n")
        name = part.get_param("name", header="content-disposition")
        if split >= 0 and isinstance(name, str):
            body = content[split + 4 : end]
            parts.append(FormPart(name, part.get_content_type(), part.get_filename() or "", body))
    return parts


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
