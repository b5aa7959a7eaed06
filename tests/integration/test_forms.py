"""Forms: parts of any content are found, and a form that is made to hurt is given up early."""

from __future__ import annotations

from collections.abc import Iterator
from email.message import Message
from email.parser import BytesHeaderParser
from types import SimpleNamespace

import pytest

import app.form
from app.errors import BadUpload
from app.form import LONGEST_HEAD, MOST_PARTS, content_type, form_parts

HEADER = content_type("multipart/form-data; boundary=a")


def form(parts: list[bytes], head: bytes = b'Content-Disposition: form-data; name="file"') -> bytes:
    return b"".join(b"--a\r\n" + head + b"\r\n\r\n" + part + b"\r\n" for part in parts) + b"--a--\r\n"


@pytest.fixture
def parsed(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The lengths of the heads that were parsed."""
    lengths: list[int] = []

    def parser() -> SimpleNamespace:
        return SimpleNamespace(parsebytes=parsebytes)

    def parsebytes(head: bytes) -> Message:
        lengths.append(len(head))
        return BytesHeaderParser().parsebytes(head)

    monkeypatch.setattr(app.form, "BytesHeaderParser", parser)
    return lengths


@pytest.mark.parametrize("count", [1, 2, MOST_PARTS])
def test_the_parts_of_a_form_are_what_was_put_in(count: int, parsed: list[int]) -> None:
    contents = [b"\r\n--b" * number + b"\0\r\n-" for number in range(count)]
    assert [part.content for part in form_parts(form(contents), HEADER)] == contents
    assert len(parsed) == count


@pytest.mark.parametrize("count", [MOST_PARTS + 1, 100_000])
def test_a_form_of_too_many_parts_is_refused_before_any_is_parsed(count: int, parsed: list[int]) -> None:
    with pytest.raises(BadUpload, match="parts"):
        form_parts(form([b""] * count), HEADER)
    assert parsed == []


@pytest.mark.parametrize("body", [b"\r\n--a" * 200_000, b"--a\r\n" * 200_000, b"--a" + b"\r\n--a\r\n\r\n" * 100_000])
def test_a_body_of_boundaries_is_refused_before_anything_is_parsed(body: bytes, parsed: list[int]) -> None:
    with pytest.raises(BadUpload):
        form_parts(body, HEADER)
    assert parsed == []


def test_a_body_is_split_no_further_than_it_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    places: list[tuple[int, int]] = []
    between = app.form._between

    def noted(content: bytes, boundary: bytes) -> Iterator[tuple[int, int]]:
        for place in between(content, boundary):
            places.append(place)
            yield place

    monkeypatch.setattr(app.form, "_between", noted)
    with pytest.raises(BadUpload):
        form_parts(b"\r\n--a" * 10_000, HEADER)
    assert len(places) <= MOST_PARTS + 2


@pytest.mark.parametrize("character", [b";", b'";', b"\r\na: b", b"x"])
def test_a_head_that_is_too_long_is_never_parsed(character: bytes, parsed: list[int]) -> None:
    head = b"Content-Disposition: form-data; name=file" + character * LONGEST_HEAD
    with pytest.raises(BadUpload, match="head"):
        form_parts(form([b"abc"], head), HEADER)
    assert parsed == []


def test_a_content_type_that_is_too_long_declares_no_boundary() -> None:
    header = content_type("multipart/form-data; boundary=a" + ";" * LONGEST_HEAD)
    assert header.get_param("boundary") is None
