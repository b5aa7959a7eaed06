"""The picture of planning with the suction tool: how planning time is spread over random layouts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from tests.benchmarks.bench_piles import PileFigures

FILE = "pile_planning.svg"
COLOURS = ("#4c78a8", "#f58518", "#54a24b", "#b279a2")
LIMIT_COLOUR, AIM_COLOUR = "#d62728", "#8c8c8c"


def draw_planning(piles: Sequence[PileFigures], limit: float, aim: float, folder: Path) -> str:
    """Draw which share of the layouts of each pile is planned in how many CPU seconds an object; return the file."""
    # The same figures give the same file.
    with mpl.rc_context({"svg.hashsalt": "liftwright", "font.size": 9.0}):
        figure = Figure(figsize=(7.5, 3.2), layout="constrained")
        axes = figure.subplots()
        for pile, colour in zip(piles, COLOURS, strict=False):
            seconds = np.sort(pile.cpu_per_object)
            share = np.arange(1, len(seconds) + 1) / len(seconds)
            axes.step([seconds[0], *seconds], [0.0, *share], where="post", color=colour, label=pile.pile.name)
            failed = [attempt.planning_cpu / pile.pile.objects for attempt in pile.failed]
            axes.plot(failed, [share[np.searchsorted(seconds, each)] for each in failed], "x", color=colour)
        axes.axvline(limit, color=LIMIT_COLOUR, linewidth=1.0, label="limit")
        axes.axvline(aim, color=AIM_COLOUR, linewidth=1.0, linestyle=":", label="aim")
        axes.plot([], [], "kx", label="not solved")
        axes.set_xscale("log")
        axes.set_xlabel("planning, CPU seconds per object")
        axes.set_ylabel("share of the layouts")
        axes.set_ylim(0.0, 1.02)
        axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
        axes.spines[["top", "right"]].set_visible(False)
        figure.savefig(folder / FILE, metadata={"Date": None})
    return FILE
