"""What a resting body stands on, and how its weight is shared out among the corners of the contact."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from planners.geometry import polygon
from planners.geometry.pose import Array, Transform
from planners.scene.rest import REST_GAP, REST_TILT, SAME_HEIGHT
from planners.scene.solid import FlatFace

_LEVEL = math.cos(REST_TILT) - 1e-9
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class RestingPoints:
    """Corners of the overlap of a body's lower faces with upper faces of what is below."""

    points: Array
    """(k, 3) in the world [m]."""
    by: tuple[str, ...]
    """The body below each point."""

    def forces(self, weight: float, com: Array) -> Array | None:
        """Return upward forces (k,) that carry a weight at (3,) `com` [N]; None where the body would tip over.

        As even as can be; where that would pull somewhere, on as few points as can be.
        """
        if not len(self.points):
            return None
        rows = np.vstack([np.ones(len(self.points)), (self.points[:, :2] - com[:2]).T])
        needed = np.array([weight, 0.0, 0.0])
        even: Array = np.linalg.lstsq(rows, needed, rcond=None)[0].astype(np.float64)
        if even.min() >= 0.0 and np.allclose(rows @ even, needed, atol=_ROUNDING * weight):
            return even
        sparse, missing = nnls(rows, needed)
        return sparse if missing <= 1e-6 * weight else None


def resting_points(
    faces: Sequence[FlatFace], T_world_body: Transform, below: Mapping[str, tuple[Sequence[FlatFace], Transform]]
) -> RestingPoints:
    """Return where level faces of a body that look down meet level faces of others that look up.

    They are at most `REST_GAP` apart, and no farther than the nearest: a place that is lower is not touched.

    Args:
        faces: of the body, in its frame.
        T_world_body: where it is.
        below: faces of other bodies in their frames, and where these are.
    """
    lower = _level_faces(faces, T_world_body, -1.0)
    met: list[tuple[float, str, Array]] = []
    for name, (others, T_world_other) in below.items():
        for upper in _level_faces(others, T_world_other, 1.0):
            for face in lower:
                gap = float(face[:, 2].mean() - upper[:, 2].mean())
                if abs(gap) > REST_GAP + _ROUNDING:
                    continue
                corners = polygon.overlap(face[:, :2], upper[:, :2])
                if len(corners) < 3:
                    continue
                height = float(upper[:, 2].mean()) + 0.5 * gap
                met.append((gap, name, np.column_stack([corners, np.full(len(corners), height)])))
    least = min((gap for gap, _, _ in met), default=0.0)
    touching = [(name, corners) for gap, name, corners in met if gap <= least + SAME_HEIGHT]
    points = [corners for _, corners in touching]
    by = tuple(name for name, corners in touching for _ in corners)
    return RestingPoints(np.concatenate(points) if points else np.empty((0, 3)), by)


def _level_faces(faces: Sequence[FlatFace], T: Transform, up: float) -> list[Array]:
    """Return corners in the world, counter-clockwise seen from above, of faces whose normal is straight up or down."""
    found = []
    for face in faces:
        if up * float(T[2, :3] @ face.normal) >= _LEVEL:
            corners = face.corners @ T[:3, :3].T + T[:3, 3]
            found.append(corners if up > 0.0 else corners[::-1])
    return found
