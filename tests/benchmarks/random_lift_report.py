"""What RESULTS.md tells of random plate lifts."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from statistics import median

import numpy as np

from tests.benchmarks.bench_random_lifts import RandomLiftFigures
from tests.benchmarks.lift_attempt import DENSITIES, INFEASIBLE, NOT_FOUND, LiftAttempt
from tests.benchmarks.markdown import Cell, table
from tests.benchmarks.part import Limit

WRONG_SHARE = 0.02
"""Of the lifts that are not found, at most, for which a denser search finds a plan [1]."""
HELPED_SHARE, HELPED_SECONDS = 0.8, 30.0
"""Of the lifts without a plan, at least, that are told what to change [1], and how long that may take [s]."""
RESERVE = 0.1
"""What tasks ask for by default [1]."""


def limits(figures: RandomLiftFigures) -> list[Limit]:
    """Return what was aimed at beside what was reached."""
    wrong, looks = len(figures.wrongly_not_found), len(figures.second_looks)
    broken = len(figures.broken)
    asked = _asked(figures)
    helped, slowest = sum(map(bool, (each.remedies for each in asked))), _slowest(asked)
    return [
        Limit("random lifts that fail their certificate or end with an error", "0", broken, broken == 0),
        Limit(
            "lifts not found for which a denser search finds a plan, of all not found", f"≤ {100 * WRONG_SHARE:g} %",
            f"{100 * figures.wrong_share:.1f} % ({wrong} of {looks})", figures.wrong_share <= WRONG_SHARE,
        ),
        Limit(
            "lifts without a plan that are told a certified change", f"≥ {100 * HELPED_SHARE:g} %",
            f"{helped} of {len(asked)}", helped >= HELPED_SHARE * len(asked),
        ),
        Limit(
            "looking for such changes, 90 % of these lifts", f"≤ {HELPED_SECONDS:g} s",
            f"{slowest:.1f} s", slowest <= HELPED_SECONDS,
        ),
    ]  # fmt: skip


def sections(figures: RandomLiftFigures) -> list[str]:
    """Return the sections of this part."""
    return [_outcomes(figures), _remedies(figures), _second_looks(figures), _unsolved(figures)]


def _asked(figures: RandomLiftFigures) -> list[LiftAttempt]:
    return [attempt for attempt in figures.attempts if attempt.remedies is not None]


def _slowest(asked: Sequence[LiftAttempt]) -> float:
    return float(np.percentile([each.remedies_seconds for each in asked], 90)) if asked else 0.0


def _remedies(figures: RandomLiftFigures) -> str:
    asked = _asked(figures)
    counts = Counter(each.remedies for each in asked)
    rows = [(str(count), lifts) for count, lifts in sorted(counts.items(), key=lambda pair: pair[0] or 0)]
    helpless = ", ".join(str(each.seed) for each in asked if not each.remedies)
    return "\n\n".join(
        [
            "### What helps where there is no plan",
            "Remedies are changes of the task that were planned and certified before they are told. The 90 % of the "
            f"seconds that looking for them took is {_slowest(asked):.1f}.",
            *([table(("remedies", "lifts without a plan"), rows)] if rows else ["All lifts have a plan."]),
            *([f"Without any: seeds {helpless}."] if helpless else []),
        ]
    )


def _outcomes(figures: RandomLiftFigures) -> str:
    planned = len(figures.attempts)
    counts = [len(figures.solved), *(len(figures.ended(each)) for each in (INFEASIBLE, NOT_FOUND))]
    counts.append(planned - sum(counts))
    return "\n\n".join(
        [
            "### Random lifts",
            "Plates, boards under them, masses, centres of mass, places, yaws, cups and their places, drawn by seed "
            "around the papers' five; `tests/benchmarks/random_lifts.py` says from what. A draw counts if the service "
            "accepts the task. Nothing is known beforehand about whether a lift can be solved.",
            table(
                ("draws", "refused", "planned", "solved and certified", "infeasible", "not found", "neither"),
                [[str(figures.draws), figures.refused.total(), planned, *(share(each, planned) for each in counts)]],
            ),
            "Seconds: planning from the parsed body to the finished document, motion included, with kernels loaded; "
            "then the certificate.",
            table(
                ("lifts", "planning, median", "90 %", "most", "CPU median", "CPU 90 %", "CPU most",
                 "certificate, CPU median", "most"),
                [
                    _seconds(name, attempts)
                    for name, attempts in (
                        ("all", figures.attempts),
                        ("solved", figures.solved),
                        ("not found", figures.ended(NOT_FOUND)),
                    )
                    if attempts
                ],
            ),
            *_plans(figures.solved),
            "Draws that are refused:" if figures.refused else "No draw was refused.",
            *([table(("why", "draws"), figures.refused.most_common())] if figures.refused else []),
        ]
    )  # fmt: skip


def share(count: int, of: int) -> str:
    return f"{count} ({100 * count / of:.0f} %)"


def _seconds(name: str, attempts: Sequence[LiftAttempt]) -> list[Cell]:
    certificates = [attempt.certificate_cpu for attempt in attempts]
    return [
        name, *_spread([attempt.planning for attempt in attempts]),
        *_spread([attempt.planning_cpu for attempt in attempts]), median(certificates), max(certificates),
    ]  # fmt: skip


def _spread(values: Sequence[float]) -> tuple[float, float, float]:
    return median(values), float(np.percentile(values, 90)), max(values)


def _plans(solved: Sequence[LiftAttempt]) -> Iterator[str]:
    """Tell how long plans are, and what they keep back of their limits."""
    if not solved:
        return
    told: list[tuple[str, Sequence[float | None]]] = [
        ("nodes of the sequence", [each.length for each in solved]),
        ("contact changes", [each.contact_changes for each in solved]),
        ("reserve", [each.reserve for each in solved]),
    ]
    rows = []
    for name, values in told:
        known = [float(value) for value in values if value is not None]
        rows.append([name, len(known), *((min(known), *_spread(known)) if known else [None] * 4)])
    yield table(("plans", "that say so", "least", "median", "90 %", "most"), rows)
    reserves = [each.reserve for each in solved if each.reserve is not None]
    if reserves:
        kept = sum(reserve >= RESERVE - 1e-9 for reserve in reserves)
        yield f"{kept} of {len(reserves)} plans keep back {RESERVE:g} of every limit of force, or more."


def _second_looks(figures: RandomLiftFigures) -> str:
    looks = figures.second_looks
    by_density: dict[float, Counter[str]] = {density: Counter() for density in (*DENSITIES, 0.0)}
    for look in looks:
        by_density[look.density][look.outcome] += 1
    rows = [
        (f"×{density:g}" if density else "none fits", outcomes.total(), outcomes["solved"], outcomes[NOT_FOUND],
         outcomes.total() - outcomes["solved"] - outcomes[NOT_FOUND])
        for density, outcomes in by_density.items() if outcomes
    ]  # fmt: skip
    wrong = len(figures.wrongly_not_found)
    largest, lower = f"{DENSITIES[0]:g}", ", ".join(f"{density:g}" for density in DENSITIES[1:])
    return "\n\n".join(
        [
            "### Not found, and wrongly so",
            f"Every lift that was not found is planned once more with {largest} times as many poses, grips and pushes; "
            f"with {lower} times as many where the graph would not fit into memory otherwise. {wrong} of {len(looks)} "
            f"have a certified plan then: {100 * figures.wrong_share:.1f} % of those not found, "
            f"{100 * wrong / max(1, len(figures.attempts)):.1f} % of all lifts.",
            *([table(("density", "lifts", "solved and certified", "not found", "otherwise"), rows)] if rows else []),
            *_lines(
                f"- seed {look.seed}, ×{look.density:g}: {look.outcome} in {look.planning_cpu:.1f} s. {look.summary}"
                for look in figures.wrongly_not_found
            ),
        ]
    )


def _unsolved(figures: RandomLiftFigures) -> str:
    dense = {look.seed: look for look in figures.second_looks}
    unsolved = [attempt for attempt in figures.attempts if not attempt.solved]
    answers = (NOT_FOUND, INFEASIBLE)
    reasons = Counter(
        without_figures(each.summary) if each.outcome in answers else f"**{each.outcome}**" for each in unsolved
    )
    return "\n\n".join(
        [
            "### Lifts that are not solved",
            *([table(("why", "lifts"), reasons.most_common())] if reasons else ["All were solved."]),
            *_lines(
                f"- seed {each.seed}, {each.outcome}{_again(dense.get(each.seed))}: "
                f"{each.summary if each.outcome in answers else each.reason}"
                for each in unsolved
            ),
            *_lines(f"- seed {each.seed}, ×{each.density:g}, {each.outcome}: {each.reason}"
                    for each in figures.broken if each.dense),
        ]
    )  # fmt: skip


def _again(look: LiftAttempt | None) -> str:
    if look is None:
        return ""
    return f" (×{look.density:g}: {look.outcome})" if look.density else " (denser graphs do not fit into memory)"


def without_figures(summary: str) -> str:
    """Leave numbers and names of edges out, so that equal reasons are counted together."""
    return re.sub(r"\d+(\.\d+)?", "…", re.sub(r"\((edge|vertex|face|no contact)[^)]*\)", r"(\1)", summary))


def _lines(lines: Iterator[str]) -> list[str]:
    text = "\n".join(lines)
    return [text] if text else []
