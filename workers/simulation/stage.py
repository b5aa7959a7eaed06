"""The stage "simulate" of a job, for plans of either kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from planners.plan.simulation import Simulation
from planners.progress import Progress
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.tool_scene import SuctionToolScene
from workers.simulation.simulate import simulate
from workers.simulation.tool_simulate import simulate_tool


def simulate_plan(
    document: Mapping[str, Any], scene: PlateLiftScene | SuctionToolScene, progress: Progress, seed: int
) -> Simulation:
    """Execute a solved plan in physics, as fits its scene; `seed` is for what is random, in lifts only."""
    if isinstance(scene, SuctionToolScene):
        return simulate_tool(document, scene, progress)
    return simulate(document, scene, progress, seed)
