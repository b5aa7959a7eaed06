"""What the tests of the plate lift measure with: pinocchio's kinematics, python-fcl's distances, tasks to plan."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import fcl
import numpy as np

from planners.cell.cell import Cell
from planners.contract.task_spec import PlateLiftTask, read_task
from planners.geometry.convex import CollisionBody
from planners.manipulation.planner import PlateLiftPlanner
from planners.manipulation.reach.lift_workcell import LiftWorkcell
from planners.planning import lift_settings
from planners.scene.scene import build_scene
from tests.cell.cell_probe import fcl_distance, fcl_object
from tests.kinematics.arm_oracle import PinocchioArm

ROOT = Path(__file__).parents[2]
TURN = 2.0 * np.pi


def task_body(name: str, **options: Any) -> dict[str, Any]:
    """Return a shipped task with other options; nothing is kept back unless they say so.

    One sampling of poses and holds has no plan for most tasks that keeps back what a task keeps back by default.
    """
    body = json.loads((ROOT / f"assets/tasks/{name}.json").read_text())
    return {**body, "options": {"reserve": 0.0, **options}}


def planner_of(body: dict[str, Any], cells: dict[str, Cell] | None = None) -> PlateLiftPlanner:
    """Return a planner that has sampled poses and holds, and no more."""
    task = read_task(body)
    assert isinstance(task, PlateLiftTask)
    return PlateLiftPlanner(build_scene(task, cells), lift_settings(task.options), lambda *_: None)


class FclCell:
    """All bodies of a workcell, the gripper at one opening, with kinematics and distances of other libraries."""

    def __init__(self, workcell: LiftWorkcell, *, holding: bool) -> None:
        model = workcell.holding if holding else workcell.open
        self.workcell, self.bodies = workcell, {body.name: body for body in model.bodies}
        self.excluded = workcell.scene.cell.excluded_pairs
        self.chains = {
            name: [PinocchioArm(arm.dh[:links]) for links in range(1, 7)]
            for name, arm in workcell.scene.cell.arms.items()
        }

    def frames(self, q: np.ndarray, T_world_plate: np.ndarray) -> dict[str, np.ndarray]:
        """Return T_world_frame of all frames at twelve joint positions and a plate pose."""
        cable = np.eye(4)
        cable[:3, 3] = T_world_plate[:3, :3] @ self.workcell.scene.cup.cable_anchor + T_world_plate[:3, 3]
        frames = {"world": np.eye(4), "plate": T_world_plate, self.workcell.cable_frame: cable}
        for name, chain in self.chains.items():
            T_world_base = self.workcell.arm(name).T_world_base
            own = q[self.workcell.joints(name)]
            frames[f"{name}/0"] = T_world_base
            for links, arm in enumerate(chain, start=1):
                frames[f"{name}/{links}"] = T_world_base @ arm.flange_pose(own[:links])
        return frames

    def pairs(self, only: Any) -> Iterator[tuple[CollisionBody, CollisionBody]]:
        """Yield the pairs that could meet: in different frames, not built to touch, and chosen by `only`."""
        bodies = list(self.bodies.values())
        for i, a in enumerate(bodies):
            for b in bodies[:i]:
                apart = a.frame != b.frame and tuple(sorted((a.name, b.name))) not in self.excluded
                if apart and only(a, b):
                    yield a, b

    def least_slack(
        self, q: np.ndarray, T_world_plate: np.ndarray, only: Any, hands: Iterable[str], margin: float
    ) -> float:
        """Return by how much the closest pair is farther apart than it has to be [m]."""
        touching, fingers = self.touching(hands)
        frames, slack = self.frames(q, T_world_plate), 1.0
        objects: dict[str, fcl.CollisionObject] = {}
        for a, b in self.pairs(only):
            names = frozenset((a.name, b.name))
            if names in touching:
                continue
            for body in (a, b):
                if body.name not in objects:
                    objects[body.name] = fcl_object(body, frames[body.frame])
            needed = 0.0 if "plate" in names and names & fingers else margin
            slack = min(slack, fcl_distance(objects[a.name], objects[b.name]) - needed)
        return slack

    def touching(self, hands: Iterable[str]) -> tuple[set[frozenset[str]], set[str]]:
        """Return the pairs that hands on the plate bring into touch, and the finger parts that may be close to it."""
        touching, fingers = {frozenset(("plate", "cup"))}, set()
        for arm in hands:
            names = [name for name in self.bodies if name.startswith(f"{arm}_")]
            touching |= {frozenset((n, "plate")) for n in names if n.endswith("_tip") or "_pad_" in n}
            fingers |= {n for n in names if "_finger_" in n}
        return touching, fingers
