"""The way of what a plan moves, as lines: where it was on its way, for somebody who changes the task."""

from __future__ import annotations

import numpy as np

from app.viewer.drawing.body_drawing import sharp_edges, surface_of
from planners.geometry.pose import Array, from_pose7s
from planners.plan.plan import Plan

STAGES = 9
"""Of a plate: so many of its poses are drawn [1]."""
SAMPLES = 120
"""Of an object's way [1]."""
LEAST = 1e-4
"""What moves less stands still [m]."""


def lines_of(plan: Plan | None) -> Array:
    """Return lines (n, 2, 3) in the world [m]: a plate's edges at some of its poses, and the ways of centres."""
    if plan is None or not plan.segments:
        return np.zeros((0, 2, 3))
    times = np.linspace(0.0, plan.duration, SAMPLES)
    moments = [plan.at(float(time)) for time in times]
    found = []
    for name, body in plan.bodies.items():
        if body.role not in ("plate", "object"):
            continue
        poses = np.array([moment.body_poses[name] for moment in moments])
        way = poses[:, :3]
        found.append(np.stack([way[:-1], way[1:]], axis=1)[np.linalg.norm(np.diff(way, axis=0), axis=1) > LEAST])
        vertices, faces, _ = surface_of(body.role, body.shape)
        edges = sharp_edges(vertices, faces)
        shown = poses[-1:]
        if body.role == "plate":
            # All edges of all stages would hide what is dragged: those of the top face tell how it tilts.
            edges, shown = edges[np.all(edges[:, :, 2] > 0.0, axis=1)], _stages(poses)
        for T in from_pose7s(shown):
            found.append((edges.reshape(-1, 3) @ T[:3, :3].T + T[:3, 3]).reshape(-1, 2, 3))
    return np.concatenate(found) if found else np.zeros((0, 2, 3))


def _stages(poses: Array) -> Array:
    """Return some of many poses (n, 7), evenly along what changes in them: none twice where nothing moves."""
    change = np.linalg.norm(np.diff(poses, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(change)])
    if along[-1] < LEAST:
        return poses[:1]
    return poses[np.unique(np.searchsorted(along, np.linspace(0.0, along[-1], STAGES)).clip(max=len(poses) - 1))]
