"""Where an arm stands while the other works: out of the way of everything at the start and at the goals."""

from __future__ import annotations

import itertools

import numpy as np

from planners.collision.model import CollisionQuery, Fixed, Placement
from planners.geometry.pose import Array
from planners.regrasp.tool_workcell import TOOL_FRAME, ToolWorkcell
from planners.scene.tool_scene import SuctionToolScene

CLEARANCE = 0.02
"""Least distance of a parked arm from everything that stands about, in a cell of size 1 [m]."""
_STEPS = (0.0, 0.35, -0.35, 0.7, -0.7)
"""Turns of the shoulder and the elbow that are tried [rad]."""


def start_clash(scene: SuctionToolScene, workcell: ToolWorkcell) -> tuple[str, str] | None:
    """Return the names of two bodies that touch at the start, one of them an arm's; None if there are none."""
    placements: dict[str, Placement] = {TOOL_FRAME: Fixed(scene.tool.T_world_tool)}
    placements |= {each.name: Fixed(each.body.T_world_body) for each in scene.objects}
    arms = workcell.cell.arms
    model = workcell.model(scene.start_widths)
    query = model.scene(placements, only=lambda a, b: a.group in arms or b.group in arms)
    pair = int(query.first_collision(scene.start_positions)[0])
    return None if pair < 0 else query.pair_names(pair)


def park_poses(scene: SuctionToolScene, workcell: ToolWorkcell) -> dict[str, Array]:
    """Choose joint positions (6,) for each arm: where it starts, at home, or near home with the shoulder turned [rad].

    The first that keeps clear of everything at the start and of all goals is taken; where none does, the start.
    """
    placements: list[dict[str, Placement]] = [
        {each.name: Fixed(each.body.T_world_body) for each in scene.objects},
        {each.name: Fixed(each.T_world_goal) for each in scene.objects},
    ]
    tool = {TOOL_FRAME: Fixed(scene.tool.T_world_tool)}
    parked = {}
    for arm in workcell.cell.arms:
        model = workcell.model(scene.start_widths)
        margin, chosen = max(workcell.cell.size * CLEARANCE, workcell.settings.margin), workcell.with_arm(arm)
        queries = [model.scene({**tool, **objects}, margin=margin, only=chosen) for objects in placements]
        parked[arm] = _first_free(scene, workcell, arm, queries)
    return parked


def _first_free(scene: SuctionToolScene, workcell: ToolWorkcell, arm: str, queries: list[CollisionQuery]) -> Array:
    data, joints = workcell.arm(arm), workcell.joints(arm)
    start = scene.start_positions[joints]
    turns = [np.array([pan, lift, elbow, 0.0, 0.0, 0.0]) for pan, lift, elbow in itertools.product(_STEPS, repeat=3)]
    turns.sort(key=lambda turn: float(np.abs(turn).sum()))
    candidates = np.array([start, *(data.home + turn for turn in turns)])
    within = ((candidates >= data.position_min) & (candidates <= data.position_max)).all(axis=1)
    Q = np.repeat(scene.start_positions[None], len(candidates), axis=0)
    for other in workcell.cell.arms:
        Q[:, workcell.joints(other)] = workcell.arm(other).home
    Q[:, joints] = candidates
    free = within & np.all([query.first_collision(Q) < 0 for query in queries], axis=0)
    return candidates[int(np.argmax(free))] if free.any() else start
