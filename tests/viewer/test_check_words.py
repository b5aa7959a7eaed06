"""Every check that a certificate can have is told in a sentence, and no sentence is of a check that is none."""

from __future__ import annotations

import ast
from pathlib import Path

import planners.certify
from app.check_words import CHECK_WORDS
from tests.support.syntax import syntax_tree


def literals() -> set[str]:
    """Return all words that the certificate's sources write out."""
    sources = Path(planners.certify.__file__).parent.rglob("*.py")
    nodes = (node for path in sources for node in ast.walk(syntax_tree(path.read_text(encoding="utf-8"))))
    return {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}


def findings() -> set[str]:
    """Return the names of checks that the certificate's sources begin."""
    sources = Path(planners.certify.__file__).parent.rglob("*.py")
    calls = (node for path in sources for node in ast.walk(syntax_tree(path.read_text(encoding="utf-8"))))
    return {
        node.args[0].value
        for node in calls
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Finding" and node.args
        if isinstance(node.args[0], ast.Constant) and isinstance(node.args[0].value, str)
    }


def test_every_check_has_its_sentence() -> None:
    assert len(findings()) > 40
    assert findings() - set(CHECK_WORDS) == set()


def test_no_sentence_is_of_a_check_that_there_is_not() -> None:
    assert set(CHECK_WORDS) - literals() == set()


def test_sentences_are_sentences_and_differ() -> None:
    assert len(set(CHECK_WORDS.values())) == len(CHECK_WORDS)
    assert all(words[0].isupper() and words.endswith(".") for words in CHECK_WORDS.values())
