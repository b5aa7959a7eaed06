"""What a depth camera saw: one point of the world behind every pixel that has one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array, Transform, inverse
from planners.perception.camera import Camera
from planners.perception.scan_files import ScanRefused

FEWEST_POINTS = 200
"""Fewer show no table [1]."""
NEAREST, FARTHEST = 0.05, 8.0
"""Depths outside are no measurements [m]."""
LARGEST_IMAGE = 2_100_000
"""A view has no more pixels, or every second, third, … of them: Full HD [1]."""
LARGEST_FIT_ERROR = 0.5
"""An organised cloud whose rows and columns are farther off a pinhole camera's is taken as a heap of points [px]."""
STEEPEST_RAY = 5.0
"""No camera looks farther aside [1]: x or y over z."""
POINTS_A_PIXEL = 1.6
"""Of a heap of points, on average where there are any [1]."""


@dataclass(frozen=True, eq=False)
class DepthView:
    """A depth image with its camera."""

    depth: Array
    """(h, w) distance along the camera's z; NaN where nothing was measured [m]."""
    rays: Array
    """(h, w, 2) x and y, in the camera frame, of the ray with z = 1 through every pixel."""
    T_world_camera: Transform
    framed: bool = True
    """Whether the image's border is where the camera stopped seeing; else the border of what was measured is."""

    @classmethod
    def from_depth(cls, depth: Array, camera: Camera) -> Self:
        """Take a depth image (h, w) [m].

        Raises:
            ScanRefused: Too few of its pixels are measurements.
        """
        step = _step_of(depth.shape)
        if step > 1:
            depth, camera = depth[::step, ::step], camera.thinned(step)
        height, width = depth.shape
        return cls(_measured(depth), camera.rays(width, height), camera.T_world_camera)._not_empty()

    @classmethod
    def from_organised(cls, points: Array, T_world_camera: Transform) -> Self:
        """Take an image (h, w, 3) of points in the camera frame; its camera is found by fitting one.

        Raises:
            ScanRefused: Too few points are measurements.
        """
        step = _step_of(points.shape)
        points = points[::step, ::step]
        depth = _measured(points[..., 2])
        rows, columns = np.nonzero(np.isfinite(depth) & np.isfinite(points).all(axis=2))
        if len(rows) < FEWEST_POINTS:
            raise _too_few(len(rows))
        seen = points[rows, columns]
        lines = [_line(seen[:, i] / seen[:, 2], pixel) for i, pixel in enumerate((columns, rows))]
        if any(line is None or line[2] > LARGEST_FIT_ERROR for line in lines):
            return cls.from_points(seen, T_world_camera)
        (fx, cx, _), (fy, cy, _) = (line for line in lines if line is not None)
        return cls.from_depth(depth, Camera(fx, fy, cx, cy, T_world_camera))

    @classmethod
    def from_points(cls, points: Array, T_world_camera: Transform) -> Self:
        """Take a heap of points (n, 3) in the frame of the camera that saw them, as a camera there would see them.

        Raises:
            ScanRefused: Too few points are measurements in front of the camera.
        """
        depth = _measured(points[:, 2])
        with np.errstate(invalid="ignore"):
            seen_aside = np.abs(points[:, :2]).max(axis=1) > STEEPEST_RAY * points[:, 2]
        kept = np.isfinite(points).all(axis=1) & np.isfinite(depth) & ~seen_aside
        seen = points[kept]
        if len(seen) < FEWEST_POINTS:
            raise _too_few(len(seen))
        rays = seen[:, :2] / seen[:, 2:]
        # What is far aside is not worth an image that contains it.
        low, high = np.quantile(rays, [0.001, 0.999], axis=0)
        low, high = low - 0.02, high + 0.02
        inside = np.all((rays >= low) & (rays <= high), axis=1)
        seen, rays = seen[inside], rays[inside]
        pitch = _pitch(rays, high - low)
        width, height = (int(n) + 3 for n in (high - low) / pitch)
        at = np.rint((rays - low) / pitch).astype(np.int64) + 1
        depths = np.full(width * height, np.inf)
        np.minimum.at(depths, at[:, 1] * width + at[:, 0], seen[:, 2])
        depth = np.where(np.isfinite(depths), depths, np.nan).reshape(height, width)
        cx, cy = 1.0 - low / pitch
        camera = Camera(1.0 / pitch, 1.0 / pitch, cx, cy, T_world_camera)
        return cls(_without_pinholes(depth), camera.rays(width, height), T_world_camera, framed=False)._not_empty()

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        height, width = self.depth.shape
        return height, width

    @property
    def eye(self) -> Array:
        """(3,) where the camera is in the world [m]."""
        return self.T_world_camera[:3, 3]

    def points(self) -> Array:
        """Return the (h, w, 3) points in the world, NaN where nothing was measured."""
        seen = np.dstack([self.rays * self.depth[..., None], self.depth])
        return seen @ self.T_world_camera[:3, :3].T + self.eye

    def thinned(self, step: int) -> DepthView:
        """Return every `step`-th pixel of every `step`-th row."""
        if step <= 1:
            return self
        return DepthView(self.depth[::step, ::step], self.rays[::step, ::step], self.T_world_camera, self.framed)

    def pixels(self, points: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the nearest rows and columns of (n, 3) points in the world, clipped into the image."""
        T = inverse(self.T_world_camera)
        seen = points @ T[:3, :3].T + T[:3, 3]
        rays = seen[:, :2] / np.maximum(seen[:, 2:], 1e-6)
        height, width = self.shape
        middle = self.rays[height // 2, width // 2]
        pitch_x = (self.rays[height // 2, -1, 0] - self.rays[height // 2, 0, 0]) / (width - 1)
        pitch_y = (self.rays[-1, width // 2, 1] - self.rays[0, width // 2, 1]) / (height - 1)
        columns = np.rint((rays[:, 0] - middle[0]) / pitch_x).astype(np.int64) + width // 2
        rows = np.rint((rays[:, 1] - middle[1]) / pitch_y).astype(np.int64) + height // 2
        return np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)

    def _not_empty(self) -> Self:
        count = int(np.isfinite(self.depth).sum())
        if count < FEWEST_POINTS:
            raise _too_few(count)
        return self


def _step_of(shape: tuple[int, ...]) -> int:
    """Return the stride at which an image of a shape is thinned to `LARGEST_IMAGE` [px]."""
    return max(1, math.ceil(math.sqrt(shape[0] * shape[1] / LARGEST_IMAGE)))


def _measured(depth: Array) -> Array:
    with np.errstate(invalid="ignore"):
        return np.where((depth >= NEAREST) & (depth <= FARTHEST), depth, np.nan)


def _too_few(count: int) -> ScanRefused:
    detail = f"{count} points between {NEAREST:g} and {FARTHEST:g} m before the camera; {FEWEST_POINTS} are needed"
    return ScanRefused("depth", detail)


def _line(rays: Array, pixels: NDArray[np.int64]) -> tuple[float, float, float] | None:
    """Return focal length, principal point and median error [px] of pixels = f ray + c; None if there is no such."""
    if float(np.ptp(rays)) == 0.0 or np.ptp(pixels) == 0:
        return None
    f, c = np.polyfit(rays, pixels, 1)
    if f <= 0.0:
        return None
    return float(f), float(c), float(np.median(np.abs(f * rays + c - pixels)))


def _pitch(rays: Array, span: Array) -> float:
    """Return the pitch of pixels, in x over z, at which nearly every pixel among points has one of its own [1]."""
    cells = 96
    counts, _, _ = np.histogram2d(rays[:, 0], rays[:, 1], bins=cells)
    filled = counts[counts > 0]
    a_cell = float(np.median(filled))
    area = float(np.prod(span)) / cells**2
    pitch = math.sqrt(POINTS_A_PIXEL * area / a_cell)
    return max(pitch, math.sqrt(float(np.prod(span)) / LARGEST_IMAGE))


def _without_pinholes(depth: Array) -> Array:
    """Fill pixels that no point fell into with the largest depth round them, where most of them have one."""
    known = np.isfinite(depth)
    kernel = np.ones((3, 3), np.uint8)
    around = cv2.filter2D(known.astype(np.float32), -1, kernel.astype(np.float32), borderType=cv2.BORDER_CONSTANT)
    farthest = cv2.dilate(np.where(known, depth, 0.0), kernel)
    return np.where(~known & (around >= 5.0), farthest, depth)
