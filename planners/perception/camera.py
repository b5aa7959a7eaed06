"""Pinhole cameras, in OpenCV's convention: z forward, x right, y down; whole numbers are the centres of pixels."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from planners.geometry.pose import Array, Transform


@dataclass(frozen=True, eq=False)
class Camera:
    """A calibrated camera where it was when it looked."""

    fx: float
    """Focal length in pixels across [px]."""
    fy: float
    """Focal length in pixels down [px]."""
    cx: float
    """Principal point across [px]."""
    cy: float
    """Principal point down [px]."""
    T_world_camera: Transform
    distortion: tuple[float, ...] = ()
    """OpenCV's k1, k2, p1, p2[, k3[, k4, k5, k6]]; empty: none [1]."""

    @property
    def matrix(self) -> Array:
        """(3, 3) from rays with z = 1 to pixels, before distortion."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def distortion_array(self) -> Array:
        """(5,) to (8,) coefficients of distortion, as OpenCV takes them [1]."""
        return np.array(self.distortion or (0.0,) * 5)

    def thinned(self, step: int) -> Camera:
        """Return the camera of every `step`-th pixel of every `step`-th row."""
        fx, fy, cx, cy = (each / step for each in (self.fx, self.fy, self.cx, self.cy))
        return Camera(fx, fy, cx, cy, self.T_world_camera, self.distortion)

    def rays(self, width: int, height: int) -> Array:
        """Return (height, width, 2) x and y, in the camera frame, of the ray with z = 1 through every pixel."""
        columns, rows = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
        if not any(self.distortion):
            return np.stack([(columns - self.cx) / self.fx, (rows - self.cy) / self.fy], axis=-1)
        pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2)
        rays = cv2.undistortPoints(pixels, self.matrix, self.distortion_array)
        return np.asarray(rays, dtype=float).reshape(height, width, 2)

    def pixels(self, points: Array) -> Array:
        """Return the (n, 2) pixels of (n, 3) points in the world, all of them in front of the camera."""
        R, p = self.T_world_camera[:3, :3], self.T_world_camera[:3, 3]
        seen = (np.asarray(points, dtype=float) - p) @ R
        projected, _ = cv2.projectPoints(
            seen.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), self.matrix, self.distortion_array
        )
        return np.asarray(projected, dtype=float).reshape(-1, 2)
