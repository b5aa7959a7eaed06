"""A board's pose to a hundredth of a pixel: its whole print is laid over the picture, not its corners alone.

Lucas and Kanade's alignment: the pose for which the picture, where the print is projected to, is most nearly a linear
function of the print's brightness. Every edge of every cell counts, along all of its length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array
from planners.perception.camera import Camera

CELLS_AROUND = 0.5
"""So much of the white round a marker is looked at, in cells of its print [1]."""
SAMPLES = 6
"""In each direction of a cell [1]: closer together than pixels are, with a marker of up to 36 pixels."""
BLUR = 0.5
"""Standard deviation of how far a pixel smears the print [px]."""
FINE = 16
"""Pixels of a cell in the drawing of the print [1]."""
MOST_STEPS = 12
SMALLEST_STEP = 1e-7
"""A step that moves the board less is the last one [m]."""
FARTHEST = 1.5
"""An alignment that moves corners farther from where they were seen has lost its way [px]."""
LEAST_CONTRAST = 8.0
"""Between black and white of a marker [grey levels]."""


@dataclass(frozen=True, eq=False)
class _Print:
    """Places of a board's print, with what is printed there."""

    points: Array
    """(n, 3) in the board's frame [m]."""
    values: Array
    """(n,) 0: black, 1: white, between them at edges."""
    marker: NDArray[np.intp]
    """(n,) to which marker they belong, from 0."""


def align_board(
    image: NDArray[np.uint8],
    camera: Camera,
    dictionary: int,
    corners: Sequence[tuple[int, Array]],
    turn: Array,
    move: Array,
) -> tuple[Array, Array] | None:
    """Return a better pose of a board, its rotation vector and position in the camera's frame; None if there is none.

    Args:
        image: (h, w) grey or (h, w, 3) blue, green, red.
        camera: that took it.
        dictionary: OpenCV's number of the family of markers.
        corners: id and (4, 3) corners, in the board's frame, of each marker that is seen whole [m].
        turn: (3, 1) rotation vector, from the corners [rad].
        move: (3, 1) position, from the corners [m].
    """
    grey = (cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image).astype(np.float32)
    flat = np.vstack([places for _, places in corners])
    begin = _projected(flat, turn, move, camera)
    printed = _print_of(dictionary, corners, _side(begin))
    slopes = [np.asarray(cv2.Sobel(grey, cv2.CV_32F, *axis, ksize=3, scale=0.125)) for axis in ((1, 0), (0, 1))]
    for _ in range(MOST_STEPS):
        step, contrast = _step(printed, grey, slopes, camera, turn, move, len(corners))
        if contrast < LEAST_CONTRAST:
            return None
        turn, move = turn + step[:3, None], move + step[3:, None]
        if float(np.abs(_projected(flat, turn, move, camera) - begin).max()) > FARTHEST:
            return None
        if float(np.abs(step[3:]).max()) < SMALLEST_STEP:
            break
    return turn, move


def _step(
    printed: _Print,
    grey: NDArray[np.float32],
    slopes: Sequence[NDArray[Any]],
    camera: Camera,
    turn: Array,
    move: Array,
    markers: int,
) -> tuple[Array, float]:
    """Return the change (6,) of rotation vector and position that fits best, and the least contrast of a marker.

    Each marker has a brightness and a contrast of its own: light falls unevenly.
    """
    projected, jacobian = cv2.projectPoints(printed.points, turn, move, camera.matrix, camera.distortion_array)
    x, y = (projected.reshape(-1, 2)[:, axis].astype(np.float32) for axis in (0, 1))
    seen, along_x, along_y = (
        cv2.remap(each, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).ravel().astype(float)
        for each in (grey, *slopes)
    )
    by_pose = along_x[:, None] * jacobian[0::2, :6] + along_y[:, None] * jacobian[1::2, :6]
    own = (printed.marker[:, None] == np.arange(markers)).astype(float)
    unknowns = np.hstack([by_pose, -own * printed.values[:, None], -own])
    # Radians and metres differ little in what they move; the least-squares problem is well conditioned.
    solved: Array = np.asarray(np.linalg.lstsq(unknowns.T @ unknowns, -unknowns.T @ seen, rcond=None)[0], dtype=float)
    return solved[:6], float(solved[6 : 6 + markers].min())


def _print_of(dictionary: int, corners: Sequence[tuple[int, Array]], side: float) -> _Print:
    """Return the print of markers whose sides are so long in the picture [px]."""
    family = cv2.aruco.getPredefinedDictionary(dictionary)
    cells = family.markerSize + 2
    pixels_a_cell = max(1.0, side / cells)
    rim = 2
    places = np.arange(-CELLS_AROUND + 0.5 / SAMPLES, cells + CELLS_AROUND, 1.0 / SAMPLES)
    columns, rows = np.meshgrid(places, places)
    on_drawing = [((each + rim) * FINE - 0.5).astype(np.float32) for each in (columns, rows)]
    points, values = [], []
    for marker, (top_left, top_right, _, bottom_left) in corners:
        bits = cv2.aruco.generateImageMarker(family, marker, cells).astype(float) / 255.0
        drawing = np.kron(np.pad(bits, rim, constant_values=1.0), np.ones((FINE, FINE)))
        smeared = cv2.GaussianBlur(drawing, (0, 0), BLUR * FINE / pixels_a_cell)
        values.append(cv2.remap(smeared, on_drawing[0], on_drawing[1], cv2.INTER_LINEAR).ravel())
        right, down = (top_right - top_left) / cells, (bottom_left - top_left) / cells
        points.append((top_left + columns[..., None] * right + rows[..., None] * down).reshape(-1, 3))
    marker_of = np.repeat(np.arange(len(corners)), columns.size)
    return _Print(np.vstack(points), np.concatenate(values).astype(float), marker_of)


def _side(pixels: Array) -> float:
    """Return how long a marker's side is in the picture, from the (4 n, 2) corners of all of them [px]."""
    return float(np.linalg.norm(np.diff(pixels.reshape(-1, 4, 2), axis=1), axis=2).mean())


def _projected(points: Array, turn: Array, move: Array, camera: Camera) -> Array:
    projected, _ = cv2.projectPoints(points, turn, move, camera.matrix, camera.distortion_array)
    return np.asarray(projected, dtype=float).reshape(-1, 2)
