"""One word, one meaning: what the glossary says is code stands in the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CODE = "\n".join(
    path.read_text() for folder in ("app", "workers", "planners") for path in (ROOT / folder).rglob("*.py")
)
TERMS = re.findall(r"^\| (.+?) \|", (ROOT / "GLOSSARY.md").read_text(), re.MULTILINE)[2:]
NAMES = sorted({name for term in TERMS for name in re.findall(r"`(\w+)`", term)})


def test_the_glossary_has_terms_and_they_are_in_order() -> None:
    assert len(TERMS) > 20
    words = [re.sub(r"[^a-z ]", "", term.lower()) for term in TERMS]
    assert words == sorted(words)


@pytest.mark.parametrize("name", NAMES)
def test_a_term_that_is_set_as_code_is_in_the_code(name: str) -> None:
    assert re.search(rf"\b{name}\b", CODE), name
