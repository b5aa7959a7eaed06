"""Paper A's Table II: what each tool offers for handovers, and what the database of them costs, cold and warm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from numpy.typing import NDArray

from planners.collision.model import Placement, Riding
from planners.contract.task_spec import SuctionToolTask, read_task
from planners.geometry.pose import Transform, inverse
from planners.regrasp.grasps.grasp_reach import GraspReach, GraspSurroundings
from planners.regrasp.grasps.handovers import HandoverDatabase, find_handovers
from planners.regrasp.suction.suction_poses import SuctionLoad, suction_poses
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.regrasp.tool_workcell import ToolWorkcell
from planners.scene.tool_scene import SuctionToolScene, build_tool_scene
from tests.benchmarks.tasks import Note, task_body
from workers.stores.handover_store import HandoverStore

TISSUE_TASKS = ("tissue_pile", "tissue_pile_short_tool")
"""The objects of Table II, with either tool."""
_SETTINGS = ToolPlannerSettings()


@dataclass(frozen=True)
class HandoverFigures:
    """One tool. Seconds."""

    tool: str
    candidates: int
    """Grasps that were looked at."""
    grasps: int
    orientations: int
    """Of the tool at the handover place."""
    pairs: int
    """A grasp of the left hand and one of the right that pass the tool on, in any orientation."""
    oriented_pairs: int
    """The same, every orientation counted."""
    laden_pairs: int
    """Pairs that are left with the object on the cup."""
    cold: float
    """Computing the database, kernels loaded."""
    cold_cpu: float
    warm: float
    """Reading it from the disk."""
    kilobytes: float
    """Of the file."""


def measure(note: Note, databases: Path, tasks: Sequence[str] = TISSUE_TASKS) -> list[HandoverFigures]:
    """Compute the handovers of every task's tool, keep them in a store's folder, and read them again."""
    scenes = [_scene(name) for name in tasks]
    note("handovers: loading kernels")
    smallest = min(scenes, key=lambda scene: len(scene.tool.body.solid.surface()[0]))
    find_handovers(smallest.cell, smallest.tool, _SETTINGS.handovers)
    return [_measure(scene, HandoverStore(databases), databases, note) for scene in scenes]


def _measure(scene: SuctionToolScene, store: HandoverStore, databases: Path, note: Note) -> HandoverFigures:
    note(f"handovers: {scene.tool.name}")
    begun = perf_counter(), process_time()
    database = find_handovers(scene.cell, scene.tool, _SETTINGS.handovers)
    cold = perf_counter() - begun[0], process_time() - begun[1]
    store.save(database)
    begun = perf_counter(), process_time()
    store.load(database.key)
    warm = perf_counter() - begun[0]
    (file,) = databases.glob(f"{database.key}.*")
    return HandoverFigures(
        tool=scene.tool.name,
        candidates=len(database.grasps) + len(database.grasps.fallen),
        grasps=len(database.grasps),
        orientations=len(database.T_world_tool),
        pairs=int(database.partners.sum()),
        oriented_pairs=int(database.compatible.sum()),
        laden_pairs=int(_laden(scene, database).any(axis=0).sum()),
        cold=cold[0],
        cold_cpu=cold[1],
        warm=warm,
        kilobytes=file.stat().st_size / 1e3,
    )


def _laden(scene: SuctionToolScene, database: HandoverDatabase) -> NDArray[np.bool_]:
    """Return the pairs (o, n, n) both of whose arms keep off the object on the cup, on the branches of the database."""
    workcell = ToolWorkcell.of(scene, _SETTINGS.handovers.clearance)
    objects: dict[str, Placement | None] = {each.name: None for each in scene.objects}
    objects[scene.objects[0].name] = Riding("tool", inverse(_first_suction(scene)))
    reaches = {
        arm: GraspReach(
            workcell,
            arm,
            database.grasps,
            GraspSurroundings(objects, None, scene.start_widths[workcell.other(arm)]),
            _SETTINGS.handovers.grasps,
        )
        for arm in ("left", "right")
    }
    laden = np.zeros_like(database.compatible)
    for o, T_world_tool in enumerate(database.T_world_tool):
        left, right = (reaches[arm].branches(T_world_tool) for arm in ("left", "right"))
        code = np.maximum(database.codes[o].astype(int) - 1, 0)
        keeps = (left[:, None] >> code // 8) & (right[None, :] >> code % 8) & 1
        laden[o] = database.compatible[o] & (keeps == 1)
    return laden


def _first_suction(scene: SuctionToolScene) -> Transform:
    """Return `T_object_tool` of the suction pose that is tried first for the first object."""
    target = scene.objects[0]
    body = target.body
    assert body.mass is not None
    load = SuctionLoad(body.mass, body.com, body.T_world_body, scene.cell.gravity, target.goals)
    return suction_poses(body.solid.surface(), load, scene.tool.cup, _SETTINGS.suction).poses[0].T_object_tool


def _scene(name: str) -> SuctionToolScene:
    task = read_task(task_body(name))
    assert isinstance(task, SuctionToolTask)
    return build_tool_scene(task)
