"""What bodies rest on at the start.

A task may place a body up to 1 mm and 0.1 degrees off the surface it lies on; it is settled onto that surface, so
that everything later can take a resting body to touch what carries it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planners.geometry import polygon
from planners.geometry.pose import Array, Transform, rotation_from_vector, to_pose7
from planners.scene.solid import FlatFace, Solid

REST_GAP = 1e-3
"""Every corner of a resting face is at most this far from the surface's height [m]."""
REST_TILT = math.radians(0.1)
"""[rad]"""
EDGE_SLACK = 1e-6
"""A face may stick out this far over the edge of its surface: rounding, not intention [m]."""
_SCALAR = 1e-3
"""A quaternion's component counts as 0 below this [1]: written with few digits."""
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Surface:
    """A level, convex face that bodies can rest on."""

    name: str
    height: float
    """z in the world [m]."""
    outline: Array
    """(n, 2) in the world, counter-clockwise [m]."""


def lowest_face(solid: Solid, T_world_body: Transform) -> FlatFace:
    """Return the flat face that looks most nearly down, in the solid's frame."""
    down = -T_world_body[2, :3]
    return max(solid.flat_faces(), key=lambda face: float(face.normal @ down))


def face_tilt(face: FlatFace, T_world_body: Transform) -> float:
    """Return the angle between a face's outward normal and straight down [rad]."""
    normal = T_world_body[:3, :3] @ face.normal
    return math.atan2(math.hypot(normal[0], normal[1]), -normal[2])


def scalar_last_hint(T_world_body: Transform) -> str:
    """Return a question to end a refusal with, if a body that does not stand upright would with w last; else nothing.

    With w first, a yaw written as x, y, z, w turns the body over about an axis across its x axis.
    """
    w, x, *_ = to_pose7(T_world_body)[3:]
    upright = T_world_body[2, 2] >= math.cos(REST_TILT)
    if upright or abs(w) > _SCALAR or abs(x) > _SCALAR:
        return ""
    return "; a quaternion's w comes first: was x, y, z, w written?"


def gaps(face: FlatFace, T_world_body: Transform, height: float) -> Array:
    """Return the (k,) heights of the face's corners above `height` [m]."""
    return face.corners @ T_world_body[2, :3] + T_world_body[2, 3] - height


def rests_level(face: FlatFace, T_world_body: Transform, height: float) -> bool:
    """Tell whether a face lies on the plane at `height`, within `REST_GAP` and `REST_TILT`."""
    gap = float(np.abs(gaps(face, T_world_body, height)).max())
    return gap <= REST_GAP + _ROUNDING and face_tilt(face, T_world_body) <= REST_TILT + _ROUNDING


def settled(face: FlatFace, T_world_body: Transform, height: float) -> Transform:
    """Return the pose of a body after its face was turned level, the shortest way, and put at `height` exactly."""
    normal = T_world_body[:3, :3] @ face.normal
    axis = np.cross(normal, [0.0, 0.0, -1.0])
    sine = float(np.linalg.norm(axis))
    T = T_world_body.copy()
    if sine > 0.0:
        T[:3, :3] = rotation_from_vector(axis / sine * math.atan2(sine, -normal[2])) @ T[:3, :3]
    T[2, 3] -= float(gaps(face, T, height).mean())
    return T


def footprint(face: FlatFace, T_world_body: Transform) -> Array:
    """Return the (k, 2) corners of a downward face seen from above, in the world, counter-clockwise [m]."""
    return (face.corners @ T_world_body[:2, :3].T + T_world_body[:2, 3])[::-1]


def overhang(corners: Array, surface: Surface) -> float:
    """Return how far the farthest of (k, 2) points lies outside a surface [m]; 0 when none does."""
    outside = -float(polygon.depth_inside(surface.outline, corners).min())
    return outside if outside > EDGE_SLACK else 0.0


def upper_surface(name: str, solid: Solid, T_world_body: Transform) -> Surface | None:
    """Return the top of a settled body as a surface: its highest flat face; None where that is not level."""
    face = max(solid.flat_faces(), key=lambda face: float(T_world_body[2, :3] @ face.normal))
    corners = face.corners @ T_world_body[:3, :3].T + T_world_body[:3, 3]
    if float(np.ptp(corners[:, 2])) > EDGE_SLACK:
        return None
    return Surface(name, float(corners[:, 2].mean()), corners[:, :2])
