"""The pictures of planning plate lifts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
from matplotlib.figure import Figure

from tests.benchmarks.paper_tables import PAPER

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from tests.benchmarks.planning_part import PlanningFigures

STAGE_COLOURS = {
    "scene and document": "#b8b8b8",
    "sample": "#8c8c8c",
    "reach": "#4c78a8",
    "merge": "#72b7b2",
    "examine": "#9d755d",
    "search": "#f58518",
    "motion": "#e45756",
    "certify": "#54a24b",
}
PAPER_COLOUR, EXTRAPOLATED_COLOUR, OUR_COLOUR = "#8c8c8c", "#4c78a8", "#f58518"


def draw(results: PlanningFigures, folder: Path) -> dict[str, str]:
    """Draw all pictures; return the file name of each, by name."""
    pictures = {"stages": _stages, "comparison": _comparison, "scaling": _scaling}
    # The same figures give the same file.
    with mpl.rc_context({"svg.hashsalt": "liftwright", "font.size": 9.0}):
        for name, drawn in pictures.items():
            figure = Figure(figsize=(7.5, 3.2), layout="constrained")
            drawn(results, figure.subplots())
            figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
    return {name: f"{name}.svg" for name in pictures}


def _stages(results: PlanningFigures, axes: Axes) -> None:
    tasks = [task for task in results.tasks if task.outcome == "solved"] or results.tasks
    names = [task.name for task in tasks]
    left = [0.0] * len(tasks)
    for stage, colour in STAGE_COLOURS.items():
        seconds = [task.certificate if stage == "certify" else task.stages.get(stage, 0.0) for task in tasks]
        if not any(seconds):
            continue
        axes.barh(names, seconds, left=left, color=colour, label=stage)
        left = [a + b for a, b in zip(left, seconds, strict=True)]
    axes.invert_yaxis()
    axes.set_xlabel("seconds, spec to certified plan, warm process")
    axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    _tidy(axes)


def _comparison(results: PlanningFigures, axes: Axes) -> None:
    names = [figures.name for figures in results.paper_method]
    ours = {task.name: task.planning_cpu for task in results.tasks}
    series = (
        ("paper, its own machine", PAPER_COLOUR, [PAPER[name].total_seconds for name in names]),
        ("paper's method here, extrapolated", EXTRAPOLATED_COLOUR, [each.total for each in results.paper_method]),
        ("Liftwright, motion included", OUR_COLOUR, [ours[name] for name in names]),
    )
    for place, (label, colour, seconds) in enumerate(series):
        axes.bar([k + 0.27 * (place - 1) for k in range(len(names))], seconds, 0.25, color=colour, label=label)
    axes.set_yscale("log")
    axes.set_xticks(range(len(names)), names)
    axes.set_ylabel("seconds (here: CPU)")
    axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    _tidy(axes)


def _scaling(results: PlanningFigures, axes: Axes) -> None:
    for name in dict.fromkeys(figures.name for figures in results.scaling):
        rows = sorted((each for each in results.scaling if each.name == name), key=lambda each: each.nodes)
        axes.plot([row.nodes for row in rows], [row.planning for row in rows], "o-", label=name)
        for row in rows:
            label = f"{row.contact_density:g}·{row.hold_density:g}"
            axes.annotate(label, (row.nodes, row.planning), xytext=(5, -9), textcoords="offset points", fontsize=7)
    axes.set_xlabel("nodes that each hand reaches; labels: density of contacts · of holds")
    axes.set_ylabel("planning [s]")
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.15)
    if results.scaling:
        axes.legend(frameon=False)
    _tidy(axes)


def _tidy(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
