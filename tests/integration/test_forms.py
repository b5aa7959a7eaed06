"""Forms: parts of any content are found, and a form that is made to hurt is given up early."""

from __future__ import annotations

import pytest

import app.uploads.form
from app.errors import BadUpload
from app.uploads.form import LONGEST_HEAD, MOST_PARTS, ContentType, form_parts

BOUNDARY = b"a"


def form(parts: list[bytes], head: bytes = b'Content-Disposition: form-data; name="file"') -> bytes:
    return b"".join(b"--a\r\n" + head + b"\r\n\r\n" + part + b"\r\n" for part in parts) + b"--a--\r\n"


@pytest.fixture
def parsed(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The lengths of the headers that were parsed."""
    lengths: list[int] = []
    parse = app.uploads.form.parse_options_header

    def noted(header: bytes) -> tuple[bytes, dict[bytes, bytes]]:
        lengths.append(len(header))
        return parse(header)

    monkeypatch.setattr(app.uploads.form, "parse_options_header", noted)
    return lengths


@pytest.mark.parametrize("count", [1, 2, MOST_PARTS])
def test_the_parts_of_a_form_are_what_was_put_in(count: int, parsed: list[int]) -> None:
    contents = [b"\r\n--b" * number + b"\0\r\n-" for number in range(count)]
    assert [part.content for part in form_parts(form(contents), BOUNDARY)] == contents
    assert len(parsed) == count


@pytest.mark.parametrize("count", [MOST_PARTS + 1, 100_000])
def test_a_form_of_too_many_parts_is_refused_before_any_is_parsed(count: int, parsed: list[int]) -> None:
    with pytest.raises(BadUpload, match="parts"):
        form_parts(form([b""] * count), BOUNDARY)
    assert parsed == []


@pytest.mark.parametrize("body", [b"\r\n--a" * 200_000, b"--a\r\n" * 200_000, b"--a" + b"\r\n--a\r\n\r\n" * 100_000])
def test_a_body_of_boundaries_is_refused_before_anything_is_parsed(body: bytes, parsed: list[int]) -> None:
    with pytest.raises(BadUpload):
        form_parts(body, BOUNDARY)
    assert parsed == []


def test_a_body_is_split_no_further_than_it_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    begun = 0
    begin = app.uploads.form._Reader.begin_part

    def noted(reader: app.uploads.form._Reader) -> None:
        nonlocal begun
        begun += 1
        begin(reader)

    monkeypatch.setattr(app.uploads.form._Reader, "begin_part", noted)
    with pytest.raises(BadUpload):
        form_parts(form([b""] * 10_000), BOUNDARY)
    assert begun == MOST_PARTS + 1


def test_a_part_keeps_its_type_and_its_bytes_with_or_without_a_filename() -> None:
    every_byte = bytes(range(256))
    for name in (b"", b'; filename="a b.STL"'):
        head = b'Content-Disposition: form-data; name="file"' + name + b"\r\nContent-Type: model/stl; x=1"
        (part,) = form_parts(form([every_byte], head), BOUNDARY)
        assert (part.name, part.media_type, part.content) == ("file", "model/stl", every_byte)
        assert part.filename == ("a b.STL" if name else "")


def test_parts_without_a_name_are_passed_over_and_a_form_may_be_followed_by_anything() -> None:
    body = b"--a\r\n\r\nno head\r\n" + form([b"abc"]) + b"whatever\r\n--a\r\n"
    assert [part.content for part in form_parts(body, BOUNDARY)] == [b"abc"]


@pytest.mark.parametrize("cut", range(1, 11))
def test_a_form_that_breaks_off_is_refused(cut: int) -> None:
    with pytest.raises(BadUpload):
        form_parts(form([b"abc"]).removesuffix(b"\r\n")[:-cut], BOUNDARY)


@pytest.mark.parametrize("character", [b";", b'";', b"\r\na: b", b"x"])
def test_a_head_that_is_too_long_is_never_parsed(character: bytes, parsed: list[int]) -> None:
    head = b"Content-Disposition: form-data; name=file" + character * LONGEST_HEAD
    with pytest.raises(BadUpload, match="head"):
        form_parts(form([b"abc"], head), BOUNDARY)
    assert parsed == []


def test_a_content_type_that_is_too_long_declares_nothing() -> None:
    assert ContentType.of("multipart/form-data; boundary=a") == ContentType("multipart/form-data", b"a")
    assert ContentType.of("multipart/form-data; boundary=a" + ";" * LONGEST_HEAD) == ContentType("", b"")


def test_a_form_without_a_boundary_is_refused() -> None:
    with pytest.raises(BadUpload, match="boundary"):
        form_parts(form([b"abc"]), b"")
