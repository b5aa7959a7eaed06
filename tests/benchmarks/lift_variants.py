"""The planner that people run, and the same with what is ours and not the paper's left out, one thing at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from planners.cell.cell import Cell, load_cell
from planners.contract.task_spec import PlateLiftTask, read_task
from planners.geometry.polyhedron import ConvexPrism
from planners.manipulation.contacts.dense_contact_states import ContactSampling, DenseContactStateGraph
from planners.manipulation.graph.node_examiner import Objective
from planners.manipulation.lift_attempts import plan_lift
from planners.manipulation.lift_settings import LiftSettings
from planners.manipulation.planner import PlateLiftPlanner
from planners.manipulation.statics.reserves import STEPS
from planners.planning import lift_settings
from planners.progress import silent
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.scene import build_scene
from tests.benchmarks.paper_tables import PAPER
from tests.benchmarks.tasks import task_body

Change = Callable[[PlateLiftScene, LiftSettings], LiftSettings]
STRONG = 1e4
"""What a hand may bear where its limits are left out [N]."""


@dataclass(frozen=True)
class Variant:
    """A planner that leaves out what the paper does not have."""

    name: str
    settings: tuple[Change, ...] = ()
    """What is changed of the settings that the planner has for a task's options."""
    strong: bool = False
    """Whether hands bear whatever they are asked to: limits of the task and the arms' payload are left out."""
    options: Mapping[str, Any] | None = None
    """Of the task, before any others."""
    free_fingers: bool = False
    """Whether the gripper's fingers press as they like, as the paper's do, instead of with a squeeze."""
    exact: bool = False
    """Whether the plate is exactly as stated: no tolerances of its mass and its centre of mass."""

    def planner(self, name: str, **options: Any) -> PlateLiftPlanner:
        """Return the planner of a shipped task, which has sampled poses and holds and nothing more."""
        body = task_body(name, **{**options, **(self.options or {})})
        if self.free_fingers:
            body["contact_model"] = "paper"
        if self.exact:
            body["plate"].update(mass_tolerance=0.0, com_tolerance=0.0)
        if self.strong:
            body["hand_force_limit"] = {"normal": STRONG, "net": STRONG}
        task = read_task(body)
        assert isinstance(task, PlateLiftTask)
        scene = build_scene(task, {task.cell: _strong(load_cell(task.cell))} if self.strong else None)
        settings = lift_settings(task.options)
        for change in self.settings:
            settings = change(scene, settings)
        return PlateLiftPlanner(scene, settings, silent)


@cache
def kept_reserve(name: str, minimise: Objective) -> float:
    """Return the share of every limit that the plan of a shipped task keeps back [1]: all that is asked for, if it can.

    A whole multiple of the step in which the planner looks for reserves.
    """
    task = read_task(task_body(name, minimise=minimise))
    assert isinstance(task, PlateLiftTask)
    settings = lift_settings(task.options)
    reserve = plan_lift(build_scene(task), settings, silent).reserve
    assert reserve is not None, f"{name} has no plan"
    return min(settings.reserve, math.floor(reserve.value * STEPS + 1e-6) / STEPS)


def _strong(cell: Cell) -> Cell:
    """Return a cell whose arms have any payload."""
    arms = {name: replace(arm, robot=replace(arm.robot, payload=STRONG)) for name, arm in cell.arms.items()}
    return replace(cell, arms=arms)


def _no_rise(_scene: PlateLiftScene, settings: LiftSettings) -> LiftSettings:
    """Let any pose off the support be a goal, wherever the hands can go from there."""
    return replace(settings, rises=(), cup_reserve=0.0)


def _no_rotation_rule(_scene: PlateLiftScene, settings: LiftSettings) -> LiftSettings:
    """Join poses by the displacement of the centre of mass alone, with our threshold."""
    return replace(settings, sampling=replace(settings.sampling, rotation_threshold=math.pi))


def _paper_threshold(scene: PlateLiftScene, settings: LiftSettings) -> LiftSettings:
    """Join poses by the displacement of the centre of mass alone, with a threshold that gives the paper's edges."""
    wanted = PAPER["ab1"].dcsg_edges
    prism = ConvexPrism.from_outline(scene.plate.outline, scene.plate.height)

    def sampling(thousandths: int) -> ContactSampling:
        return replace(settings.sampling, rotation_threshold=math.pi, com_threshold_per_size=1e-3 * thousandths)

    def miss(thousandths: int) -> int:
        poses = DenseContactStateGraph.build(prism, scene.plate.com, scene.T_world_plate, sampling(thousandths))
        return abs(len(poses.edges) - wanted)

    return replace(settings, sampling=sampling(min(range(90, 160), key=miss)))


OURS = Variant("ours")
VARIANTS = (
    OURS,
    Variant("ours without reserve", options={"reserve": 0.0}),
    Variant("ours without the rise", (_no_rise,)),
    Variant("ours without limits of hands", strong=True),
    Variant("ours with free fingers", free_fingers=True),
    Variant("ours without tolerances", exact=True),
    Variant("ours without the rotation rule", (_no_rotation_rule,)),
    Variant("ours, the paper's number of DCSG edges", (_paper_threshold,)),
    Variant(
        "all of these",
        (_no_rise, _paper_threshold),
        strong=True,
        options={"reserve": 0.0},
        free_fingers=True,
        exact=True,
    ),
)
"""What each leaves out of ours; the last is as near to the paper as our planner goes."""
