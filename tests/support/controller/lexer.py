"""Words of the URScript subset that programs are emitted in."""

from __future__ import annotations

import re
from typing import NamedTuple

KEYWORDS = frozenset("def end while if elif else return break continue global local True False and or not pass".split())
_WORD = re.compile(
    r"""(?P<blank>[ \t\r]+|\#[^\n]*)
      | (?P<newline>\n)
      | (?P<number>(?:\d+\.\d*|\.\d+|\d+)(?:[eE][+-]?\d+)?)
      | (?P<string>"[^"\n]*")
      | (?P<name>[A-Za-z_][A-Za-z0-9_]*)
      | (?P<sign>==|!=|<=|>=|[-+*/%<>=()\[\],:])""",
    re.VERBOSE,
)


class ScriptRefused(Exception):
    """A script is not in the subset; says where."""

    def __init__(self, what: str, line: int, column: int) -> None:
        self.line, self.column = line, column
        super().__init__(f"line {line}, column {column}: {what}")


class Word(NamedTuple):
    """One word: its kind (number, string, name, keyword, sign, newline, end) and where it begins, from 1."""

    kind: str
    text: str
    line: int
    column: int

    def refuse(self, what: str) -> ScriptRefused:
        return ScriptRefused(what, self.line, self.column)


def words_of(script: str) -> list[Word]:
    """Cut a script into words; blank lines and comments are gone, the last word is of the kind `end`."""
    words: list[Word] = []
    at, line, line_begin = 0, 1, 0
    while at < len(script):
        found = _WORD.match(script, at)
        column = at - line_begin + 1
        if found is None:
            raise ScriptRefused(f"{script[at]!r} is no word of the subset", line, column)
        kind, text = str(found.lastgroup), found.group()
        at = found.end()
        if kind == "newline":
            if words and words[-1].kind != "newline":
                words.append(Word(kind, text, line, column))
            line, line_begin = line + 1, at
        elif kind != "blank":
            words.append(Word("keyword" if text in KEYWORDS else kind, text, line, column))
    if words and words[-1].kind != "newline":
        words.append(Word("newline", "\n", line, at - line_begin + 1))
    words.append(Word("end", "", line, at - line_begin + 1))
    return words
