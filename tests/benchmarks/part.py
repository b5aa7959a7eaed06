"""A part of the benchmarks that can be measured by itself, and what it found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.benchmarks.effort import Effort
from tests.benchmarks.markdown import Cell, cell, table
from tests.benchmarks.tasks import Note


@dataclass(frozen=True)
class Limit:
    """What was aimed at beside what was reached."""

    what: str
    limit: str
    reached: Cell
    kept: bool
    aim: str | None = None
    aim_kept: bool | None = None

    @classmethod
    def at_most(cls, what: str, values: dict[str, float], limit: float, aim: float | None = None) -> Limit:
        """Return the limit of the largest of values that have names."""
        worst = max(values, key=values.__getitem__)
        reached = values[worst]
        return cls(
            what, f"≤ {limit:g}", f"{cell(reached)} ({worst})", reached <= limit,
            None if aim is None else f"≤ {aim:g}", None if aim is None else reached <= aim,
        )  # fmt: skip


@dataclass(frozen=True)
class Findings:
    """What a part found."""

    limits: Sequence[Limit]
    sections: Sequence[str]
    """Markdown, each under a heading of the third level."""


@dataclass(frozen=True)
class Part:
    """A part of the benchmarks."""

    name: str
    title: str
    measure: Callable[[Effort, Note, Path], Findings]
    """Draws its pictures into the folder."""


def write_part(part: Part, findings: Findings, circumstances: str) -> str:
    """Return the text of a part: its heading, where and when it was measured, limits and sections."""
    return "\n\n".join([f"## {part.title}", circumstances, _limits(findings.limits), *findings.sections])


def _limits(limits: Sequence[Limit]) -> str:
    def verdict(kept: bool | None) -> str | None:
        return None if kept is None else "yes" if kept else "**no**"

    rows = [
        (each.what, each.limit, each.aim, each.reached, verdict(each.kept), verdict(each.aim_kept)) for each in limits
    ]
    return "### Aimed at and reached\n\n" + table(("", "limit", "aim", "reached", "limit kept", "aim kept"), rows)
