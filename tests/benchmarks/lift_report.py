"""The part of RESULTS.md that tells of simulated lifts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from statistics import median

from tests.benchmarks.bench_simulation import DRAWN, SimulationFigures
from tests.benchmarks.markdown import Cell, table
from tests.benchmarks.part import Limit

LIFTED_SHARE = 0.95
"""Of all lifters, at least [1]."""
LEAST_HEIGHT = 0.15
"""Above the pose where the plan ends [m]."""
_OUTCOMES = {"slipped": "slipped", "cup_lost": "cup lost", "overload": "overload"}


def lift_limits(tasks: Sequence[SimulationFigures]) -> Iterator[Limit]:
    """Yield what was aimed at beside the worst that was reached, with its task."""
    if not tasks:
        return
    count = len(tasks[0].lifts)
    worst = min(tasks, key=lambda task: task.lifted)
    least = LIFTED_SHARE * count
    yield Limit(
        f"lifts that end well behind {count} random lifters, worst task", f"≥ {least:g}",
        f"{worst.lifted} ({worst.task})", worst.lifted >= least,
    )  # fmt: skip
    blind = max(tasks, key=lambda task: task.blind_outcomes["lifted"])
    lifted = blind.blind_outcomes["lifted"]
    yield Limit(
        "the same without the controller, best task", f"< {0.5 * count:g}", f"{lifted} ({blind.task})",
        lifted < 0.5 * count,
    )  # fmt: skip
    low = min(tasks, key=lambda task: task.height)
    yield Limit(
        "height of the lift [m], lowest task", f"≥ {LEAST_HEIGHT:g}", f"{low.height:.3f} ({low.task})",
        low.height >= LEAST_HEIGHT,
    )  # fmt: skip
    far = max(tasks, key=lambda task: task.difference_of_tolerance)
    yield Limit(
        "simulated less planned force at a node, over its tolerance, largest", "≤ 1",
        f"{far.difference_of_tolerance:.2f} ({far.task})", far.difference_of_tolerance <= 1.0,
    )  # fmt: skip
    slow = max(tasks, key=lambda task: task.cpu_of_motion[1])
    yield Limit(
        "CPU time of the simulation over the motion's own duration, slowest", "≤ 1",
        f"{slow.cpu_of_motion[1]:.2f} ({slow.task})", slow.cpu_of_motion[1] <= 1.0,
    )  # fmt: skip


def lift_sections(tasks: Sequence[SimulationFigures], pictures: Mapping[str, str]) -> list[str]:
    """Return the section on the lifts and the one with their pictures."""
    count = max((len(task.lifts) for task in tasks), default=0)
    lifts = [
        "### What the controller is worth",
        f"Each task is planned once; its plan is executed in physics and lifted behind {count} random lifters, seeds 0 "
        f"to {count - 1}: switch-like, uneven, and unknown to the robot. Without the controller the hands rise at the "
        "lifters' usual speed, from the moment the lift begins.",
        table(("task", "lifted", "otherwise", "lifted without controller", "otherwise"), [*map(_outcomes, tasks)]),
        *_causes(tasks),
        "As high as both arms reach: the lifter is stopped 15 mm below. Heights count from the pose where the plan "
        "ends, the lowest of all lifts. The reserve is what F_goal keeps back of the cup's largest force.",
        table(("task", "height [m]", "reachable [m]", "which ends because", "cup's reserve"), [*map(_heights, tasks)]),
        "Simulated forces less planned ones at the ends of the plate's motions: the worst of hands, cup and support, "
        "over all nodes and lifters. Its tolerance is a tenth of the bearer's own planned force, and what the model is "
        "told to do wrong: three standard deviations of the lifter's error and of the sensors' noise, and the force "
        "that the stick keeps where the plan lets it press less ([node_tolerance.py]"
        "(../simulation/node_tolerance.py)). A dip is a time in which both hands together bear less than the minimum "
        "m g − f_cup; a plate that hangs askew also rests on the cup's friction, so that the cup may still hold.",
        table(
            ("task", "median [N]", "largest [N]", "of its tolerance", "dips a lift", "seconds a lift", "longest [s]",
             "CPU ÷ motion", "slowest"),
            [*map(_forces, tasks)],
        ),
        *_unexplained(tasks),
    ]  # fmt: skip
    drawn = [
        "### Fig. 12 and 13: forces while lifting",
        f"The lift of each task behind lifter {DRAWN}. From above: vertical force of each hand on the plate and the "
        "velocity that eq. (11) commands (Fig. 12), the sum of both forces against the minimum (Fig. 13), and the "
        "pull on the cup against its limit.",
        *(
            f"#### {task.task}: {_OUTCOMES.get(task.drawn.outcome, task.drawn.outcome)}\n\n{_picture(task, pictures)}"
            for task in tasks
        ),
    ]
    return ["\n\n".join(lifts), "\n\n".join(drawn)]


def _outcomes(task: SimulationFigures) -> list[Cell]:
    count = len(task.lifts)
    cells: list[Cell] = [task.task]
    for outcomes in (task.outcomes, task.blind_outcomes):
        others = ", ".join(f"{outcomes[name]} {words}" for name, words in _OUTCOMES.items() if outcomes[name])
        cells += [f"{outcomes['lifted']} of {count}", others or None]
    return cells


def _causes(tasks: Sequence[SimulationFigures]) -> list[str]:
    """Tell of every controlled lift that failed."""
    lines = [
        f"- {task.task}, lifter {lift.seed}, at {lift.controlled.time:.1f} s: {lift.controlled.cause}"
        for task in tasks
        for lift in task.lifts
        if lift.controlled.outcome != "lifted"
    ]
    return ["Controlled lifts that failed:", "\n".join(lines)] if lines else []


def _heights(task: SimulationFigures) -> list[Cell]:
    return [task.task, f"{task.height:.3f}", f"{task.reachable:.3f}", task.end_of_reach, f"{100 * task.reserve:.0f} %"]


def _forces(task: SimulationFigures) -> list[Cell]:
    count, seconds, longest = task.dips
    usual, slowest = task.cpu_of_motion
    differences = task.differences or [0.0]
    return [
        task.task, f"{median(differences):.1f}", f"{max(differences):.1f}", f"{task.difference_of_tolerance:.2f}",
        f"{count:.1f}", f"{seconds:.2f}", f"{longest:.2f}", f"{usual:.2f}", f"{slowest:.2f}",
    ]  # fmt: skip


def _unexplained(tasks: Sequence[SimulationFigures]) -> list[str]:
    """Name the tasks whose forces the model's errors do not explain."""
    beyond = [task.task for task in tasks if task.difference_of_tolerance > 1.0]
    return [f"**Beyond the tolerance, unexplained: {', '.join(beyond)}.**"] if beyond else []


def _picture(task: SimulationFigures, pictures: Mapping[str, str]) -> str:
    file = pictures.get(task.task)
    return f"![Forces while {task.task} is lifted]({file})" if file else "It did not come to the lift."
