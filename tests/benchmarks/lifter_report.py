"""What RESULTS.md tells of lifters of all speeds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from tests.benchmarks.bench_lifters import KINDS, LIFTED, SPEEDS, SUDDEN_STOP, LifterFigures, LifterKind
from tests.benchmarks.markdown import Cell, table
from tests.benchmarks.part import Limit
from workers.simulation.settings import WinchSettings

LIFTED_SHARE = 0.95
"""Of the lifters of each speed that are to be followed, at least [1]."""
_WORDS = {"cup_lost": "cup lost"}


def limits(figures: Sequence[LifterFigures]) -> list[Limit]:
    """Return what was aimed at beside the worst that was reached, for each speed."""
    found = []
    for speed in SPEEDS:
        same = [each for each in figures if each.kind == LifterKind(speed)]
        if not same:
            continue
        worst = min(same, key=lambda each: each.lifted)
        least = LIFTED_SHARE * len(worst.runs)
        found.append(
            Limit(
                f"lifts that end well behind {len(worst.runs)} lifters of {speed:g} times the usual speed, worst task",
                f"≥ {least:g}", f"{worst.lifted} ({worst.task})", worst.lifted >= least,
            )
        )  # fmt: skip
    return found


def sections(figures: Sequence[LifterFigures]) -> list[str]:
    """Return the section of this part."""
    tasks = list(dict.fromkeys(each.task for each in figures))
    count = max((len(each.runs) for each in figures), default=0)
    winch = WinchSettings()
    low, high = winch.speed
    return [
        "\n\n".join(
            [
                "### Lifters that can be followed",
                f"Each task is planned once and its plan executed once, until the plate hangs still; from there it is "
                f"lifted behind {count} lifters of each kind, seeds from 0. The usual lifter moves at "
                f"{1e3 * low:g} to {1e3 * high:g} mm/s, gains speed with {winch.acceleration:g} m/s² and loses it with "
                f"{winch.deceleration:g} m/s², and the others so many times as fast, with the same motor. One that "
                f"stops suddenly does so after each of its moves, with {SUDDEN_STOP:g} m/s². Neither plan nor "
                "controller know which it is.",
                table(
                    ("lifter", "mean speed [mm/s]", *tasks, "off F_goal [N]", "otherwise"),
                    [_row(kind, tasks, figures) for kind in KINDS],
                ),
                "*Off F_goal* is how much more or less both hands together bore than they should while the lifter "
                "rose, mean of each lift, the worst of those that ended well.",
                _ends(tasks, figures),
            ]
        )
    ]


def _row(kind: LifterKind, tasks: Sequence[str], figures: Sequence[LifterFigures]) -> list[Cell]:
    same = {each.task: each for each in figures if each.kind == kind}
    others = sum((each.outcomes for each in same.values()), Counter[str]())
    del others[LIFTED]
    words = ", ".join(f"{count} {_WORDS.get(outcome, outcome)}" for outcome, count in others.most_common())
    off = [run.off_goal for each in same.values() for run in each.runs if run.lifted]
    return [
        f"{kind.speed:g} ×{', sudden stops' if kind.sudden else ''}",
        f"{1e3 * kind.winch().usual_speed:.0f}",
        *(f"{same[task].lifted} of {len(same[task].runs)}" if task in same else None for task in tasks),
        f"{max(off, key=abs):+.2f}" if off else None,
        words or None,
    ]


def _ends(tasks: Sequence[str], figures: Sequence[LifterFigures]) -> str:
    """Tell up to which speed each task is lifted, and what gives way first beyond."""
    lines = []
    for task in tasks:
        for sudden, words in ((False, ""), (True, ", with sudden stops")):
            row = [each for each in figures if each.task == task and each.kind.sudden is sudden]
            beyond = next((each for each in row if each.lifted < LIFTED_SHARE * len(each.runs)), None)
            if beyond is None:
                lines.append(f"- {task}{words}: followed at every speed that was tried.")
            else:
                (outcome, often), *_ = Counter(run.outcome for run in beyond.runs if not run.lifted).most_common()
                cause = next(run.cause for run in beyond.runs if run.outcome == outcome)
                lines.append(
                    f"- {task}{words}: less than {100 * LIFTED_SHARE:g} % from {beyond.kind.speed:g} times the speed "
                    f"on; {often} times {_WORDS.get(outcome, outcome)}, the first because {cause}."
                )
    return "\n".join(lines)
