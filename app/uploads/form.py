"""Forms with files in them (RFC 7578)."""

from __future__ import annotations

from dataclasses import dataclass, field

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from app.errors import BadUpload

FORM = "multipart/form-data"
MOST_PARTS = 32
"""Of a form; what is taken in has six at most."""
LONGEST_HEAD = 2000
"""Of a part [bytes], and of a Content-Type [characters]: what is longer is never looked into."""


@dataclass(frozen=True)
class ContentType:
    """What a request or a part of a form is declared as."""

    media_type: str
    boundary: bytes
    """Between the parts of a form; empty: there is none."""

    @classmethod
    def of(cls, declared: str | bytes | None) -> ContentType:
        """Read a Content-Type header; one that is far too long declares nothing."""
        if declared is None or len(declared) > LONGEST_HEAD:
            return cls("", b"")
        media_type, parameters = parse_options_header(declared)
        return cls(media_type.decode("latin-1").strip().lower(), parameters.get(b"boundary", b""))


@dataclass(frozen=True)
class FormPart:
    """One part of a form."""

    name: str
    media_type: str
    filename: str
    content: bytes


def form_parts(content: bytes, boundary: bytes) -> list[FormPart]:
    """Return the parts of a form that have names. Forms are large: this is no work for an event loop.

    Raises:
        BadUpload: It has no boundary or does not end with it, more than `MOST_PARTS` parts, or a part whose head is
            longer than `LONGEST_HEAD`, or is no form at all.
    """
    if not boundary:
        raise BadUpload("the form has no boundary")
    reader = _Reader()
    try:
        MultipartParser(
            boundary,
            {
                "on_part_begin": reader.begin_part,
                "on_header_field": reader.read_header_name,
                "on_header_value": reader.read_header_value,
                "on_part_data": reader.read_content,
                "on_end": reader.end,
            },
            max_header_count=LONGEST_HEAD,
            max_header_size=LONGEST_HEAD,
        ).write(content)
    except FormParserError as error:
        raise BadUpload(f"the form cannot be read: {error}") from error
    if not reader.ended:
        raise BadUpload("the form does not end with its boundary")
    parts = (_named(part) for part in reader.parts)
    return [part for part in parts if part is not None]


@dataclass
class _RawPart:
    """A part of which nothing is understood yet."""

    headers: list[tuple[bytes, bytes]] = field(default_factory=list)
    content: bytes = b""


class _Reader:
    """What the parser calls: it is given all of a form at once, so each header and each content comes in one piece."""

    def __init__(self) -> None:
        self.parts: list[_RawPart] = []
        self.ended = False
        self._head_bytes = 0
        self._header_name = b""

    def begin_part(self) -> None:
        if len(self.parts) == MOST_PARTS:
            raise BadUpload(f"the form has more than {MOST_PARTS} parts")
        self.parts.append(_RawPart())
        self._head_bytes = 0

    def read_header_name(self, data: bytes, start: int, end: int) -> None:
        self._count_head(end - start)
        self._header_name = data[start:end].lower()

    def read_header_value(self, data: bytes, start: int, end: int) -> None:
        self._count_head(end - start)
        self.parts[-1].headers.append((self._header_name, data[start:end]))

    def read_content(self, data: bytes, start: int, end: int) -> None:
        self.parts[-1].content = data[start:end]

    def end(self) -> None:
        self.ended = True

    def _count_head(self, size: int) -> None:
        self._head_bytes += size
        if self._head_bytes > LONGEST_HEAD:
            raise BadUpload(f"a part of the form has a head of more than {LONGEST_HEAD} bytes")


def _named(part: _RawPart) -> FormPart | None:
    """Return what a part says of itself, or None if it has no name."""
    headers = dict(part.headers)
    _, parameters = parse_options_header(headers.get(b"content-disposition"))
    if b"name" not in parameters:
        return None
    name, filename = (parameters.get(each, b"").decode(errors="replace") for each in (b"name", b"filename"))
    return FormPart(name, ContentType.of(headers.get(b"content-type")).media_type, filename, part.content)
