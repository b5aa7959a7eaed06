"""Collision shapes of PyBullet."""

from __future__ import annotations

from typing import Any

import numpy as np

from planners.geometry.pose import Array
from planners.scene.body import Body
from workers.simulation.physics import bullet


def box_shape(size: Array, client: int, at: Array | None = None) -> int:
    """Return a box of full lengths (3,) whose centre is at (3,) `at` of the body's frame [m]."""
    return bullet.createCollisionShape(
        bullet.GEOM_BOX, halfExtents=0.5 * size, collisionFramePosition=[0.0, 0.0, 0.0] if at is None else at,
        physicsClientId=client,
    )  # fmt: skip


def hull_shape(vertices: Array, client: int) -> int:
    """Return the convex hull of vertices (n, 3) in the body's frame [m]."""
    options: dict[str, Any] = {"vertices": vertices.tolist()}
    return bullet.createCollisionShape(bullet.GEOM_MESH, physicsClientId=client, **options)


def convex_shape(body: Body, at: Array, client: int) -> int:
    """Return the shape of a convex body whose own frame is at (3,) `at`, its axes those of the shape."""
    if body.shape.type == "box":
        return box_shape(np.array(body.shape.size), client, at)
    (part,) = body.solid.convex_parts
    return hull_shape(part.vertices + at, client)
