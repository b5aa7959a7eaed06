"""Forms with files in them (RFC 7578)."""

from __future__ import annotations

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
    # Every part lies between two lines with the boundary; what comes before the first and after the last is no part.
    pieces = (b"\r\n" + content).split(b"\r\n--" + boundary.encode())[1:]
    if not pieces or not pieces[-1].startswith(b"--"):
        raise BadUpload("the form does not end with its boundary")
    parts = []
    for piece in pieces[:-1]:
        head, separator, body = piece.partition(b"\r\n\r\n")
        part = BytesHeaderParser().parsebytes(head.lstrip(b" \t\r\n") + b"\r\n\r\n")
        name = part.get_param("name", header="content-disposition")
        if separator and isinstance(name, str):
            parts.append(FormPart(name, part.get_content_type(), part.get_filename() or "", body))
    return parts
