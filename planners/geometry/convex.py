"""Convex shapes, and the bodies that are made of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from planners.geometry.enclosing_ball import enclosing_ball
from planners.geometry.pose import Array, Transform


@dataclass(frozen=True, eq=False)
class ConvexShape:
    """The convex hull of `vertices`, grown by a ball of `radius`: spheres, capsules, boxes and hulls alike."""

    vertices: Array
    """(n, 3), in the frame of the body [m]."""
    radius: float = 0.0
    """[m]"""

    @cached_property
    def face_normals(self) -> Array:
        """(n, 3) outward normals of the faces of the hull; none for a flat or thin one."""
        try:
            planes = ConvexHull(self.vertices).equations[:, :3]
        except (QhullError, ValueError):
            return np.empty((0, 3))
        # Triangles of one face share a normal.
        _, first = np.unique(planes.round(6), axis=0, return_index=True)
        return planes[first]

    @cached_property
    def ball(self) -> Array:
        """(4,) centre and radius of a ball around the vertices [m]."""
        return enclosing_ball(np.ascontiguousarray(self.vertices, dtype=float))

    def placed(self, T_body_shape: Transform) -> ConvexShape:
        """Return the shape, given in its own frame, in the frame of a body; what is known of it goes along."""
        R, p = T_body_shape[:3, :3], T_body_shape[:3, 3]
        moved = ConvexShape(self.vertices @ R.T + p, self.radius)
        # Hulls take long, and fingers are placed anew for every opening.
        moved.__dict__["face_normals"] = self.face_normals @ R.T
        moved.__dict__["ball"] = np.append(R @ self.ball[:3] + p, self.ball[3])
        return moved


@dataclass(frozen=True, eq=False)
class CollisionBody:
    """A named rigid body for collision queries."""

    name: str
    group: str
    """Who it belongs to: an arm ("left", "right"), or "cell", "plate", "cup", "cable", "support", "obstacle"."""
    frame: str
    """"world", "left/0" (base) to "left/6" (flange; frame after joint i), or the name of a movable frame."""
    shapes: tuple[ConvexShape, ...]
    """Convex parts, in `frame`."""
