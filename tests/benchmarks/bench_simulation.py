"""What the leader-follower controller is worth: every task lifted after random lifters, with and without it.

Run as `python -m tests.benchmarks.bench_simulation [folder] [lifters]`: prints a table and draws Fig. 12 and 13 of
paper B for every task into the folder.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any

import matplotlib

from planners.contract.task_spec import PlateLiftTask, read_task
from planners.plan import plan
from planners.progress import silent
from planners.scene.scene import PlateLiftScene, build_scene
from tests.benchmarks.tasks import SOLVABLE, Note, task_body
from workers.simulation.settings import SimulationSettings
from workers.simulation.simulate import simulate

matplotlib.use("Agg")
from matplotlib import pyplot

LIFTERS = 20


@dataclass(frozen=True)
class SimulationFigures:
    """One task over all lifters."""

    task: str
    controlled: Mapping[str, int]
    blind: Mapping[str, int]
    """Outcomes and how often they were."""
    height: float
    reachable: float
    """How far up the plate came at least, and could have come [m]."""
    difference: float
    difference_of_weight: float
    """Largest difference of simulated and planned forces at the nodes [N], and over the plate's weight [1]."""
    dips: float
    dip_seconds: float
    """Of the sum of both hands below the minimum, mean of all lifts [1], [s]."""
    cpu_of_motion: float
    """CPU time over the simulated time, median [1]."""


def measure(note: Note, tasks: Sequence[str] = SOLVABLE, lifters: int = LIFTERS) -> list[SimulationFigures]:
    """Simulate all tasks with many lifters."""
    return [_measure(name, note, lifters) for name in tasks]


def planned(name: str) -> tuple[dict[str, Any], PlateLiftScene]:
    """Plan a shipped task."""
    task = read_task(task_body(name))
    assert isinstance(task, PlateLiftTask)
    scene = build_scene(task)
    return plan(task, scene, silent, process_time), scene


def _measure(name: str, note: Note, lifters: int) -> SimulationFigures:
    document, scene = planned(name)
    blind = replace(SimulationSettings(), controlled=False)
    runs, costs, without = [], [], Counter[str]()
    for seed in range(lifters):
        note(f"simulation: {name}, lifter {seed + 1} of {lifters}")
        begun = process_time()
        run = simulate(document, scene, silent, seed)
        costs.append((process_time() - begun) / run["time"])
        runs.append(run)
        without[simulate(document, scene, silent, seed, blind)["outcome"]] += 1
    lifts = [run["lift"] for run in runs if run["lift"] is not None]
    return SimulationFigures(
        task=name,
        controlled=Counter(run["outcome"] for run in runs),
        blind=without,
        height=min((lift["height"] for lift in lifts), default=0.0),
        reachable=min((lift["reachable_height"] for lift in lifts), default=0.0),
        difference=max(run["manipulation"]["largest_difference"] for run in runs),
        difference_of_weight=max(run["manipulation"]["largest_difference_of_weight"] for run in runs),
        dips=sum(run["dips"]["count"] for run in runs) / lifters,
        dip_seconds=sum(run["dips"]["seconds"] for run in runs) / lifters,
        cpu_of_motion=median(costs),
    )


def draw(name: str, simulation: Mapping[str, Any], folder: Path) -> Path:
    """Draw Fig. 12 (forces of both hands, commanded velocity) and Fig. 13 (their sum against the minimum)."""
    curves = {curve["name"]: curve for curve in simulation["force_curves"]}
    begin = simulation["lift"]["begin"]
    figure, (hands, total, cup) = pyplot.subplots(3, 1, figsize=(8.0, 8.0), sharex=True, layout="constrained")
    speeds = hands.twinx()

    def line(axis: Any, curve: str, **style: Any) -> None:
        points = [
            (t - begin, v) for t, v in zip(curves[curve]["time"], curves[curve]["value"], strict=True) if t >= begin
        ]
        axis.plot([t for t, _ in points], [v for _, v in points], label=curve, **style)

    line(hands, "pushing hand", color="tab:blue")
    line(hands, "gripping hand", color="tab:blue", linestyle="--")
    hands.axhline(simulation["lift"]["goal_force"], color="grey", linewidth=0.7, label="goal of the pushing hand")
    line(speeds, "commanded velocity", color="tab:orange")
    line(speeds, "lifter velocity", color="tab:green", linewidth=0.7)
    line(total, "both hands", color="tab:blue")
    total.axhline(simulation["minimum_total_force"], color="tab:red", label="minimum m g - f_cup")
    line(cup, "suction load", color="tab:purple")
    for axis, unit in ((hands, "vertical force [N]"), (speeds, "velocity [m/s]"), (total, "sum [N]"), (cup, "cup [N]")):
        axis.set_ylabel(unit)
    hands.legend(loc="lower left", fontsize=7)
    speeds.legend(loc="lower right", fontsize=7)
    total.legend(loc="lower left", fontsize=7)
    cup.set_xlabel("time since the lift began [s]")
    hands.set_title(f"{name}: {simulation['outcome']}")
    path = folder / f"lift_{name}.png"
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
    return path


def table(figures: Sequence[SimulationFigures]) -> str:
    """Return a Markdown table."""
    head = (
        "| task | lifted of all | without controller | height / reach [m] | largest force difference "
        "| dips a lift | CPU / motion |"
    )
    rows = [head, "|---|---|---|---|---|---|---|"]
    for f in figures:
        count = sum(f.controlled.values())
        rows.append(
            f"| {f.task} | {f.controlled.get('lifted', 0)}/{count} {_others(f.controlled)} "
            f"| {f.blind.get('lifted', 0)}/{count} {_others(f.blind)} | {f.height:.3f} / {f.reachable:.3f} "
            f"| {f.difference:.1f} N, {100.0 * f.difference_of_weight:.0f} % of the weight "
            f"| {f.dips:.1f}, {f.dip_seconds:.2f} s | {f.cpu_of_motion:.2f} |"
        )
    return "\n".join(rows)


def _others(outcomes: Mapping[str, int]) -> str:
    rest = [f"{count} {name}" for name, count in outcomes.items() if name != "lifted"]
    return f"({', '.join(rest)})" if rest else ""


def main(folder: Path, lifters: int) -> None:
    """Print the table and draw the pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    print(table(measure(print, lifters=lifters)))
    for name in SOLVABLE:
        document, scene = planned(name)
        simulation = simulate(document, scene, silent, 0)
        if simulation["lift"] is not None:
            print(draw(name, simulation, folder))


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "figures"), int(sys.argv[2]) if len(sys.argv) > 2 else LIFTERS)
