"""What RESULTS.md tells of the suction tool."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from math import degrees
from statistics import fmean, median
from typing import TYPE_CHECKING

import numpy as np

from planners.regrasp.graph.object_progress import ObjectStage
from tests.benchmarks.bench_handovers import HandoverFigures
from tests.benchmarks.bench_piles import PileFigures
from tests.benchmarks.bench_tool_motion import EMPTY, LADEN, TOOL, FreeMotion, TaskMotion
from tests.benchmarks.certified_plan import UNCERTIFIED
from tests.benchmarks.markdown import Cell, table
from tests.benchmarks.part import Limit
from tests.benchmarks.pile_attempt import PileAttempt
from tests.benchmarks.random_piles import LONG, X, Y
from tests.benchmarks.suction_tables import TABLE_I, PaperObject

if TYPE_CHECKING:
    from tests.benchmarks.suction_part import SuctionFigures

SOLVED_SHARE = 0.97
"""Of all layouts of a pile with the long tool, at least [1]."""
PLANNING_LIMIT, PLANNING_AIM = 1.0, 0.3
"""Per object [s]."""
SLOW, TURNED = 2.0, np.pi
"""Free motion that takes more times the straight line's duration or goes so many times farther than to the nearest end
[1], or that turns a wrist farther [rad], is listed."""
_STAGES = (
    "suction", ObjectStage.FIRST_REGRASP.value, ObjectStage.FIRST_MOTION.value, ObjectStage.SECOND_REGRASP.value,
    ObjectStage.SECOND_MOTION.value, ObjectStage.GRAPH.value,
)  # fmt: skip
_ORDINALS = ("1st", "2nd", "3rd")


def limits(figures: SuctionFigures) -> list[Limit]:
    """Return what was aimed at beside what was reached."""
    return [
        *_solved_limit([pile for pile in figures.piles if pile.pile.tool == LONG]),
        _uncertified_limit(figures.piles),
        *_planning_limits(figures.piles),
    ]


def sections(figures: SuctionFigures, picture: str) -> list[str]:
    """Return the sections; `picture` is the file of the planning times."""
    return [
        _layouts(figures.piles, picture),
        _table_1(figures.piles),
        _table_2(figures.handovers, figures.piles),
        _databases(figures.handovers),
        _motion(figures.motion),
    ]


def _solved_limit(piles: Sequence[PileFigures]) -> Iterator[Limit]:
    if piles:
        worst = min(piles, key=lambda pile: len(pile.solved) / len(pile.attempts))
        solved, count = len(worst.solved), len(worst.attempts)
        yield Limit(
            "layouts solved and certified, long tool, worst pile", f"≥ {100 * SOLVED_SHARE:g} %",
            f"{solved} of {count} ({worst.pile.name})", solved >= SOLVED_SHARE * count,
        )  # fmt: skip


def _uncertified_limit(piles: Iterable[PileFigures]) -> Limit:
    failed = sum(attempt.outcome == UNCERTIFIED for pile in piles for attempt in pile.attempts)
    return Limit("plans that failed their certificate, all piles", "0", failed, failed == 0)


def _planning_limits(piles: Sequence[PileFigures]) -> Iterator[Limit]:
    for share in (50, 90, 100):
        seconds = {pile.pile.name: float(np.percentile(pile.cpu_per_object, share)) for pile in piles}
        what = f"planning an object [CPU s], {share} % of the layouts, slowest pile"
        yield Limit.at_most(what, seconds, PLANNING_LIMIT, PLANNING_AIM)


def _layouts(piles: Sequence[PileFigures], picture: str) -> str:
    region = f"x {X[0]:g}…{X[1]:g} m, y {Y[0]:g}…{Y[1]:g} m"
    head = ("pile", "seeds", "refused", "planned", "solved and certified")
    times = ("pile", "median", "90 %", "most", "CPU median", "CPU 90 %", "CPU most", "certificate, CPU median", "most")
    moved = ("pile", "handovers an object", "objects put aside", "motion, median [s]", "longest [s]", "most hose turns")
    return "\n\n".join(
        [
            "### Random layouts",
            f"The shipped piles, each object strewn anywhere in {region}, turned any way about the vertical, by seed; "
            "the tool in its rest. A layout counts if every check that the service makes of a task accepts it. Where "
            "an object stands on the place of others that go before it, it has to be put aside first. Both tools get "
            "the same layouts.",
            table(head, [_counts(pile) for pile in piles]),
            "Planning, seconds per object: from the parsed body to the finished document, motion included, with the "
            "tool's handovers at hand and kernels loaded, two processes at a time; the certificate: seconds per plan.",
            table(times, [_seconds(pile) for pile in piles]),
            table(moved, [_moves(pile) for pile in piles]),
            f"![Planning time over the layouts of each pile]({picture})",
            "Layouts that were planned and not solved:" if any(pile.failed for pile in piles) else "All were solved.",
            *_lines(_failures(piles)),
            "Seeds that give no layout:",
            table(("pile", "why", "seeds"), [row for pile in piles for row in _refusals(pile)]),
        ]
    )


def _counts(pile: PileFigures) -> list[Cell]:
    planned = len(pile.attempts)
    return [pile.pile.name, pile.seeds, pile.refused.total(), planned, f"{len(pile.solved)} of {planned}"]


def _seconds(pile: PileFigures) -> list[Cell]:
    certificates = [attempt.certificate_cpu for attempt in pile.solved] or [0.0]
    return [
        pile.pile.name, *_spread(pile.planning_per_object), *_spread(pile.cpu_per_object), median(certificates),
        max(certificates),
    ]  # fmt: skip


def _spread(values: Sequence[float]) -> tuple[float, float, float]:
    return median(values), float(np.percentile(values, 90)), max(values)


def _moves(pile: PileFigures) -> list[Cell]:
    solved = pile.solved
    if not solved:
        return [pile.pile.name, *[None] * 5]
    durations = [attempt.duration for attempt in solved]
    handovers = sum(attempt.handovers for attempt in solved) / (len(solved) * pile.pile.objects)
    return [
        pile.pile.name, handovers, sum(attempt.put_aside for attempt in solved), median(durations), max(durations),
        max(attempt.hose_turns for attempt in solved),
    ]  # fmt: skip


def _failures(piles: Iterable[PileFigures]) -> Iterator[str]:
    for pile in piles:
        for attempt in pile.failed:
            yield f"- {pile.pile.name}, seed {attempt.seed}, {attempt.outcome}: {attempt.reason}"


def _refusals(pile: PileFigures) -> list[list[Cell]]:
    return [[pile.pile.name, reason, count] for reason, count in pile.refused.most_common()]


def _table_1(piles: Sequence[PileFigures]) -> str:
    head = ("object", "suction poses", "first regrasp", "first motion", "second regrasp", "second motion",
            "graph of both rounds", "all", "paper ÷ ours")  # fmt: skip
    compared = [pile for pile in piles if pile.pile.paper in TABLE_I and pile.pile.tool == LONG]
    besides = [_besides(pile) for pile in compared if pile.straightforward]
    return "\n\n".join(
        [
            "### Table I: planning by object and round",
            "Seconds an object, objects as they are moved. The paper: means of ten, on an Intel Core i9-9900K. Ours: "
            "means over the layouts that were solved with nothing put aside, CPU time. A regrasp component is finding "
            "the grasps that reach a pose: in the first round those at the tool's place and at the suction pose, in "
            "the second those at the goals. The paper decides the rounds one after the other; ours searches one graph "
            "for both.",
            table(head, [row for pile in compared for row in _objects(pile)]),
            "What is done once for all objects of a task, CPU seconds:",
            table(("pile", "scene", "workcell", "forces in the contacts", "document"), besides),
        ]
    )


def _objects(pile: PileFigures) -> Iterator[list[Cell]]:
    for number, paper in enumerate(TABLE_I[pile.pile.paper]):
        name = f"{pile.pile.paper}, {_ORDINALS[number]}"
        yield [f"{name}, paper", *_printed(paper), None]
        if pile.straightforward:
            spent = [fmean(_spent(attempt, stage, number) for attempt in pile.straightforward) for stage in _STAGES]
            yield [f"{name}, ours", *spent, sum(spent), paper.total / sum(spent)]


def _printed(paper: PaperObject) -> list[Cell]:
    return [
        paper.suction, paper.first_regrasp, paper.first_motion, paper.second_regrasp, paper.second_motion, None,
        paper.total,
    ]  # fmt: skip


def _spent(attempt: PileAttempt, stage: str, number: int) -> float:
    return attempt.stages.get(f"{stage} {attempt.order[number]}", 0.0)


def _besides(pile: PileFigures) -> list[Cell]:
    rows = []
    for attempt in pile.straightforward:
        stages = {name: spent for name, spent in attempt.stages.items() if name != "certify"}
        document = attempt.planning_cpu - sum(stages.values())
        rows.append([stages["scene"], stages.get("sample", 0.0), stages["forces"], document])
    return [pile.pile.name, *(fmean(column) for column in zip(*rows, strict=True))]


def _table_2(tools: Sequence[HandoverFigures], piles: Sequence[PileFigures]) -> str:
    tissue = {pile.pile.tool: pile for pile in piles if pile.pile.paper == "tissue"}
    rows: list[list[Cell]] = []
    for figures in tools:
        pile = tissue.get(figures.tool)
        solved = None if pile is None else f"{len(pile.solved)} of {len(pile.attempts)}"
        rows.append(
            [figures.tool, figures.candidates, figures.grasps, figures.pairs, figures.oriented_pairs,
             figures.laden_pairs, solved]
        )  # fmt: skip
    orientations = tools[0].orientations if tools else 0
    return "\n\n".join(
        [
            "### Table II: the long tool and the short one",
            "The paper gives success rates of ten runs with three tissue boxes, in a figure; its text says that the "
            "long tool's is much higher, for having more grasps and handovers. A pair is a grasp of the left hand "
            f"and one of the right that pass the tool on, in any of {orientations} orientations at the handover place; "
            "the last pairs are those left with a tissue box on the cup.",
            table(
                ("tool", "grasps looked at", "grasps", "handover pairs", "pairs × orientations", "pairs, box on cup",
                 "tissue layouts solved"),
                rows,
            ),
        ]
    )  # fmt: skip


def _databases(tools: Iterable[HandoverFigures]) -> str:
    rows = [[each.tool, each.cold, each.cold_cpu, 1e3 * each.warm, each.kilobytes] for each in tools]
    return "\n\n".join(
        [
            "### Handover databases, cold and warm",
            "Cold: grasps, handover place and all pairs computed, kernels loaded. Warm: read from the disk, as every "
            "job but a tool's first does.",
            table(("tool", "cold [s]", "of it CPU [s]", "warm [ms]", "file [kB]"), rows),
        ]
    )


def _motion(tasks: Sequence[TaskMotion]) -> str:
    head = ("task, what moves", "motions", "straight", "length ÷ straight, median", "most", "end ÷ nearest end, most",
            "duration ÷ straight, median", "most", "largest wrist turn [°]", "searched: length ÷ OMPL's, median",
            "most")  # fmt: skip
    rows = [
        row
        for task in tasks
        for carried in (EMPTY, TOOL, LADEN)
        if (row := _quality(task, [motion for motion in task.motions if motion.carried == carried], carried))
    ]
    return "\n\n".join(
        [
            "### Quality of motion",
            "Free motion of the shipped tasks, approaches and lifts excluded. Lengths count each joint by the time it "
            "needs; straight is the line between the ends of a motion, whether it is free or not, and its duration is "
            "the least that the joints' limits allow, with nothing on the cup. A motion may end in any branch of the "
            "inverse kinematics and any turn of the joints; the nearest of these ends is the one it would rather "
            "reach. Where a motion had to be searched, one raw path of RRT-Connect is shortened by us and by OMPL's "
            "simplifier.",
            table(head, rows),
            *_lines(_conspicuous(tasks)),
            "Turns of the tool about its own axis, which wind up the vacuum hose:",
            table(
                ("task", "motion [s]", "turns at the end", "most at any time"),
                [
                    (task.task, task.duration, f"{task.hose_turns:+.2f}", f"{task.most_hose_turns:.2f}")
                    for task in tasks
                ],
            ),
        ]
    )


def _quality(task: TaskMotion, motions: Sequence[FreeMotion], carried: str) -> list[Cell] | None:
    if not motions:
        return None
    lengths, slowness = [each.length for each in motions], [each.slowness for each in motions]
    of_ompl = [each.of_ompl for each in motions if each.of_ompl is not None]
    return [
        f"{task.task}, {carried}", len(motions), sum(not each.searched for each in motions), median(lengths),
        max(lengths), max(each.detour for each in motions), median(slowness), max(slowness),
        f"{degrees(max(each.wrist_turn for each in motions)):.0f}", median(of_ompl) if of_ompl else None,
        max(of_ompl, default=None),
    ]  # fmt: skip


def _conspicuous(tasks: Iterable[TaskMotion]) -> Iterator[str]:
    for task in tasks:
        for number, motion in enumerate(task.motions, start=1):
            if max(motion.slowness, motion.detour) > SLOW or motion.wrist_turn > TURNED:
                yield (
                    f"- {task.task}, free motion {number}, {motion.carried}: {motion.duration:.1f} s, "
                    f"{motion.slowness:.1f} times the straight line's duration and {motion.length:.2f} times its "
                    f"length, its end {motion.detour:.1f} times as far as the nearest, wrist turned by "
                    f"{degrees(motion.wrist_turn):.0f}°."
                )


def _lines(lines: Iterable[str]) -> list[str]:
    text = "\n".join(lines)
    return [text] if text else []
