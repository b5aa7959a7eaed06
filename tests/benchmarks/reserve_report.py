"""What RESULTS.md tells of the reserve."""

from __future__ import annotations

from collections.abc import Sequence

from tests.benchmarks.bench_reserve import LIFTED, ReserveFigures, ReserveRun
from tests.benchmarks.markdown import Cell, table
from tests.benchmarks.part import Limit
from tests.benchmarks.reserve_draws import COM, CUP, FRICTION, LIFTER, MASS, MULTIPLES

DEFAULT = 0.1
"""What a task asks for unless it says otherwise [1]."""
LIFTED_SHARE = 0.95
"""Of the runs within the stated tolerances that a plan with it is to survive [1]."""
_WORDS = {"cup_lost": "cup lost"}


def limits(figures: Sequence[ReserveFigures]) -> list[Limit]:
    """Return what was aimed at beside what was reached."""
    within = {each.task: each.drawn_from(1) for each in figures if each.reserve == DEFAULT}
    shares = {task: _share(runs) for task, runs in within.items() if runs}
    if not shares:
        return []
    worst = min(shares, key=shares.__getitem__)
    return [
        Limit(
            f"lifted within the tolerances, of plans with reserve {DEFAULT:g}, worst task",
            f"≥ {100 * LIFTED_SHARE:g} %", f"{_told(within[worst])} ({worst})", shares[worst] >= LIFTED_SHARE,
        )
    ]  # fmt: skip


def sections(figures: Sequence[ReserveFigures]) -> list[str]:
    """Return the sections of this part."""
    runs = max((len(each.runs) for each in figures), default=0)
    head = ("task, reserve asked for", "of the plan", "lifted", *(f"at {each} ×" for each in MULTIPLES), "otherwise")
    reserves = sorted({each.reserve for each in figures})
    together = [
        ReserveFigures("all", reserve, [run for each in figures if each.reserve == reserve for run in each.runs])
        for reserve in reserves
    ]
    return [
        "\n\n".join(
            [
                "### What the reserve is worth",
                f"Each task is planned with each reserve; each plan is executed in physics and lifted {runs} times, "
                "seeds from 0. What is real differs from what plan and controller were told, evenly within ± "
                f"{100 * MASS:g} % of the mass, {1e3 * COM:g} mm of the centre of mass along either axis, "
                f"{100 * FRICTION:g} % of the friction of each contact, {100 * CUP:g} % of the force that the cup "
                f"bears and {100 * LIFTER:g} % of the lifter's speed; in turns within "
                f"{', '.join(map(str, MULTIPLES))} times as much. Friction is that of the task, with nothing on top of "
                "it. A seed deviates in the same way with every reserve; where two reserves give the same plan, its "
                "runs count for both. *Of the plan* is what its document says that it keeps back.",
                table(head, [_row(each) for each in (*figures, *together)]),
            ]
        )
    ]


def _row(figures: ReserveFigures) -> list[Cell]:
    others = ", ".join(
        f"{count} {_WORDS.get(outcome, outcome)}"
        for outcome, count in figures.outcomes.most_common()
        if outcome != LIFTED
    )
    return [
        f"{figures.task}, {figures.reserve:g}", figures.kept if figures.task != "all" else None, _told(figures.runs),
        *(_told(figures.drawn_from(multiple)) for multiple in MULTIPLES), others or None,
    ]  # fmt: skip


def _told(runs: Sequence[ReserveRun]) -> str | None:
    return f"{sum(run.lifted for run in runs)} of {len(runs)}" if runs else None


def _share(runs: Sequence[ReserveRun]) -> float:
    return sum(run.lifted for run in runs) / len(runs)
