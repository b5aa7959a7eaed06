"""Fig. 12 and 13 of paper B for a simulated lift: what the hands bear, and how fast they are told to rise."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from planners.plan.simulation import SimulatedLift
    from tests.benchmarks.bench_simulation import SimulationFigures

HAND_COLOUR, SPEED_COLOUR, LIFTER_COLOUR, CUP_COLOUR = "#4c78a8", "#f58518", "#b8b8b8", "#9d755d"
LIMIT_COLOUR, GOAL_COLOUR = "#d62728", "#8c8c8c"


def draw_lift(figures: SimulationFigures, folder: Path) -> str | None:
    """Draw the lift of one task and return the file's name; None where the manipulation failed before it."""
    if figures.drawn.lift is None:
        return None
    # The same figures give the same file.
    with mpl.rc_context({"svg.hashsalt": "liftwright", "font.size": 9.0}):
        figure = Figure(figsize=(7.5, 6.0), layout="constrained")
        rows = figure.subplots(4, 1, sharex=True, height_ratios=(1.5, 1.0, 1.2, 1.0))
        _LiftPlot(figures, figures.drawn.lift).draw(*rows)
        for axes in rows:
            axes.spines[["top", "right"]].set_visible(False)
            axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1.6)
        rows[-1].set_xlim(0.0, figures.drawn.time - figures.drawn.lift.begin)
        rows[-1].set_xlabel("time since the lift began [s]")
        figure.align_ylabels()
        name = f"lift_{figures.task}.svg"
        figure.savefig(folder / name, metadata={"Date": None})
    return name


class _LiftPlot:
    def __init__(self, figures: SimulationFigures, lift: SimulatedLift) -> None:
        self._lift, self._least, self._cup_force = lift, figures.drawn.minimum_total_force, figures.cup_force
        self._curves = {curve.name: curve for curve in figures.drawn.force_curves}

    def draw(self, hands: Axes, speeds: Axes, total: Axes, cup: Axes) -> None:
        """Draw Fig. 12 into two axes, Fig. 13 into one, and the cup below them."""
        self._line(hands, "pushing hand", color=HAND_COLOUR)
        self._line(hands, "gripping hand", color=HAND_COLOUR, linestyle=(0, (3, 1.5)))
        hands.axhline(
            self._lift.goal_force, color=GOAL_COLOUR, linewidth=0.8, linestyle=":", label="goal of the\npushing hand"
        )
        hands.set_ylabel("upward force [N]")
        self._line(speeds, "lifter velocity", "lifter", scale=1e3, color=LIFTER_COLOUR)
        self._line(speeds, "commanded velocity", "both hands,\ncommanded", scale=1e3, color=SPEED_COLOUR)
        speeds.set_ylabel("velocity [mm/s]")
        self._line(total, "both hands", "sum of both hands", color=HAND_COLOUR)
        least = self._least or 0.0
        total.axhline(least, color=LIMIT_COLOUR, linewidth=1.0, label=r"minimum $m g - f_{cup}$")
        total.set_ylim(bottom=min(0.0, least - 2.0))
        total.set_ylabel("upward force [N]")
        self._line(cup, "suction load", "pull on the cup", color=CUP_COLOUR)
        cup.axhline(self._cup_force, color=LIMIT_COLOUR, linewidth=1.0, label="the cup's limit")
        cup.set_ylim(bottom=0.0)
        cup.set_ylabel("pull [N]")

    def _line(self, axes: Axes, curve: str, label: str | None = None, *, scale: float = 1.0, **style: Any) -> None:
        time = self._curves[curve].time - self._lift.begin
        lift = time >= 0.0
        values = scale * self._curves[curve].value
        axes.plot(time[lift], values[lift], linewidth=1.0, label=label or curve, **style)
