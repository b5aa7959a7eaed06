"""Tables of numbers as markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

Cell = str | int | float | None
"""Numbers are written with three significant digits or in full where they are whole; None is a dash."""


def table(head: Sequence[str], rows: Iterable[Sequence[Cell]]) -> str:
    """Return a table, the first column to the left, the others to the right."""
    marks = [":--", *["--:"] * (len(head) - 1)]
    lines = [list(head), marks, *([cell(value) for value in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def cell(value: Cell) -> str:
    """Write one value."""
    if value is None:
        return "–"
    if isinstance(value, str):
        return value
    if isinstance(value, int):
        return f"{value:,}"
    if abs(value) >= 1000.0 or value.is_integer():
        return f"{value:,.0f}"
    return f"{value:#.3g}".removesuffix(".")
