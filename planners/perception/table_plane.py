"""The table: the plane that most points lie on, about level, and about where the cell has it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planners.geometry.pose import Array, Transform, frame_from_z, transform
from planners.perception.perception_settings import PerceptionSettings
from planners.perception.scan_files import ScanRefused

SAMPLE = 20_000
"""So many points decide which plane it is [1]."""
MEDIAN_TO_DEVIATION = 1.4826
"""Of a normal distribution."""


@dataclass(frozen=True, eq=False)
class TablePlane:
    """The table's top as it was seen."""

    T_world_table: Transform
    """z up, off the table; x as near the world's as can be; the origin in the middle of what was seen."""
    deviation: float
    """Standard deviation of single points from the plane [m]."""
    points: int
    """How many lie on it."""

    @property
    def normal(self) -> Array:
        """(3,) unit, up."""
        return self.T_world_table[:3, 2]

    @property
    def tilt(self) -> float:
        """Angle between the normal and the vertical [rad]."""
        return math.acos(min(1.0, float(self.normal[2])))

    def in_table(self, points: Array) -> Array:
        """Take (…, 3) points from the world to the table's frame."""
        return (points - self.T_world_table[:3, 3]) @ self.T_world_table[:3, :3]

    def height_at(self, x: float, y: float) -> float:
        """Return z, in the world, of the plane at a place in the world [m]."""
        n, o = self.normal, self.T_world_table[:3, 3]
        return float(o[2] - (n[0] * (x - o[0]) + n[1] * (y - o[1])) / n[2])


def find_table(
    points: Array, eye: Array, expected_height: float | None, settings: PerceptionSettings, rng: np.random.Generator
) -> TablePlane:
    """Find the table among (n, 3) points in the world.

    Args:
        points: finite.
        eye: (3,) where the camera was.
        expected_height: z of the table's top in the world, None where nothing is known [m].
        settings: what counts as table.
        rng: draws the planes that are tried.

    Raises:
        ScanRefused: No plane that is level, is where the table should be and is seen from above.
    """
    near = points
    if expected_height is not None:
        # At a range of 2 m the tilt that is allowed takes points this far away from the height of the table.
        reach = settings.table_band + 2.0 * math.tan(settings.table_tilt)
        near = points[np.abs(points[:, 2] - expected_height) <= reach]
    plane = _most_agreed(_thinned(near), settings, rng) if len(near) >= settings.fewest_table_points else None
    if plane is None:
        raise ScanRefused("depth", _why_none(points, eye, expected_height))
    normal, offset = _refined(near, *plane, settings.table_inlier)
    from_plane = near @ normal - offset
    on_plane = np.abs(from_plane) <= settings.table_inlier
    if float(eye @ normal) <= offset:
        raise ScanRefused("depth", "the table is seen from below: the pose of the camera is upside down")
    if math.acos(min(1.0, float(normal[2]))) > settings.table_tilt:
        raise ScanRefused("depth", "the table is tilted: the pose of the camera does not fit the image")
    origin = near[on_plane].mean(axis=0)
    origin = origin - normal * (float(origin @ normal) - offset)
    if expected_height is not None and abs(origin[2] - expected_height) > settings.table_band:
        raise ScanRefused("depth", _why_none(points, eye, expected_height))
    deviation = MEDIAN_TO_DEVIATION * float(np.median(np.abs(from_plane[on_plane])))
    T_world_table = transform(frame_from_z(normal, [1.0, 0.0, 0.0]), origin)
    return TablePlane(T_world_table, deviation, int(on_plane.sum()))


def _thinned(points: Array) -> Array:
    return points[:: max(1, len(points) // SAMPLE)]


def _most_agreed(points: Array, settings: PerceptionSettings, rng: np.random.Generator) -> tuple[Array, float] | None:
    best, most = None, 0
    for _ in range(settings.table_trials):
        a, b, c = points[rng.integers(0, len(points), 3)]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if length < 1e-4 or abs(normal[2]) < math.cos(2.0 * settings.table_tilt) * length:
            continue
        normal = normal / math.copysign(length, float(normal[2]))
        offset = float(normal @ a)
        count = int((np.abs(points @ normal - offset) <= settings.table_inlier).sum())
        if count > most:
            best, most = (normal, offset), count
    share = settings.fewest_table_points / max(1.0, len(points))
    return best if most >= min(0.1, share) * len(points) else None


def _refined(points: Array, normal: Array, offset: float, inlier: float) -> tuple[Array, float]:
    """Fit the plane n·x = d to the points (n, 3) within `inlier` [m] of it by least squares, four times."""
    for _ in range(4):
        on_plane = points[np.abs(points @ normal - offset) <= inlier]
        center = on_plane.mean(axis=0)
        fitted = np.linalg.eigh(np.cov((on_plane - center).T))[1][:, 0]
        normal = fitted if fitted[2] > 0.0 else -fitted
        offset = float(normal @ center)
    return normal, offset


def _why_none(points: Array, eye: Array, expected_height: float | None) -> str:
    where = "" if expected_height is None else f" near the table's height of {expected_height:.3f} m"
    middle = float(np.median(points[:, 2])) if len(points) else math.nan
    seen = f"; half of the points are above z = {middle:.3f} m, the camera is at {eye[2]:.3f} m"
    advice = ": look at the camera's pose and at the unit of the depth"
    return f"no level plane is seen{where}{seen}{advice}"
