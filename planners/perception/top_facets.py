"""Top facets: the level places above the table that a camera sees, each with its edge (paper A, V.A)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array
from planners.perception.depth_view import DepthView
from planners.perception.perception_settings import PerceptionSettings
from planners.perception.table_plane import TablePlane

ImageMask = NDArray[np.bool_]
_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
_SQUARE = np.ones((3, 3), np.uint8)
_STEPS = ((0, 1), (0, -1), (1, 0), (-1, 0))
NOISE_REACH = 5.0
"""Depths that differ by more of their standard deviations do not belong to one top [1]."""

EDGE_REACH = 2.5
"""... where a top may end: what is seen of its sides begins at its own height [1]."""


@dataclass(frozen=True, eq=False)
class Relief:
    """A view as heights above the table."""

    view: DepthView
    table: TablePlane
    points: Array
    """(h, w, 3) in the table's frame; NaN where nothing was measured [m]."""
    heights: Array
    """(h, w) without single pixels that stand out; NaN where nothing was measured [m]."""
    smooth: Array
    """(h, w) medians of 3 x 3 [m]; 0 where nothing was measured."""
    known: ImageMask
    """What belongs to bodies that are known."""
    noise: float
    """Standard deviation of one height [m]."""
    pitch: float
    """Distance of neighbouring pixels on the table, in the middle of the image [m]."""

    @classmethod
    def of(cls, view: DepthView, table: TablePlane, known: ImageMask, settings: PerceptionSettings) -> Relief:
        """Measure a view from a table."""
        points = table.in_table(view.points())
        raw = points[..., 2]
        smooth = _median(raw)
        noise = max(settings.depth_noise, table.deviation)
        alike = NOISE_REACH * noise
        heights = np.where(_stands_alone(raw, alike), smooth, raw)
        return cls(view, table, points, heights, smooth, known, noise, pitch_at_table(view, table))

    def on_plane(self, rays: Array, height: float) -> Array:
        """Return (n, 2), in the table's frame, where (n, 2) rays of the camera meet the plane at `height` [m]."""
        R, eye = self.view.T_world_camera[:3, :3], self.table.in_table(self.view.eye)
        directions = np.column_stack([rays, np.ones(len(rays))]) @ R.T @ self.table.T_world_table[:3, :3]
        ways = (height - eye[2]) / directions[:, 2]
        return eye[:2] + ways[:, None] * directions[:, :2]


@dataclass(frozen=True, eq=False)
class TopFacet:
    """A level place above the table."""

    pixels: ImageMask
    """(h, w) what belongs to it."""
    height: float
    """Above the table [m]."""
    edge: Array
    """(m, 2) where it ends, halfway from pixels inside to those outside: on its plane, in the table's frame [m]."""
    hidden: ImageMask
    """(m,) where it does not end but something nearer to the camera begins."""
    beside: ImageMask
    """(m,) where something higher stands at its edge: perhaps beside it, perhaps on it."""
    pitch: float
    """Distance of neighbouring pixels on it [m]."""
    cut: bool
    """Whether it goes on where the image does not."""
    grid: Array
    """(2,) unit direction, in the table's frame, of the image's rows."""

    @property
    def size(self) -> int:
        """Number of its pixels."""
        return int(self.pixels.sum())


def find_top_facets(relief: Relief, settings: PerceptionSettings) -> list[TopFacet]:
    """Return the top facets of a view, the largest ones first."""
    labels, count = _labels(relief, settings)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    kept = [int(i) + 1 for i in np.argsort(-sizes, kind="stable") if sizes[i] >= settings.fewest_pixels // 2]
    taken = np.zeros(labels.shape, dtype=bool)
    facets = []
    for label in kept[: settings.most_tops]:
        pixels = _grown(labels == label, taken, relief)
        if pixels.sum() < settings.fewest_pixels:
            continue
        taken |= pixels
        facets.append(make_facet(pixels, relief))
    return facets


def pitch_at_table(view: DepthView, table: TablePlane) -> float:
    """Return how far neighbouring pixels are apart on the table, in the middle of the image [m]."""
    height, width = view.shape
    middle = view.rays[height // 2, width // 2]
    steps = [view.rays[height // 2, width // 2 + 1] - middle, view.rays[height // 2 + 1, width // 2] - middle]
    away = float(abs((view.eye - table.T_world_table[:3, 3]) @ table.normal))
    return away * float(np.mean([np.linalg.norm(step) for step in steps]))


def _median(heights: Array) -> Array:
    filled = np.nan_to_num(heights).astype(np.float32)
    known = np.isfinite(heights).astype(np.float32)
    total, count = cv2.blur(filled, (3, 3)), cv2.blur(known, (3, 3))
    filled = np.where(np.isfinite(heights), filled, np.where(count > 0.0, total / np.maximum(count, 1e-6), 0.0))
    return cv2.medianBlur(filled.astype(np.float32), 3).astype(float)


def _stands_alone(heights: Array, alike: float) -> ImageMask:
    """Tell which pixels (h, w) have fewer than two neighbours within `alike` [m] of their height."""
    similar = np.zeros(heights.shape, dtype=np.int64)
    padded = np.pad(heights, 1, constant_values=np.nan)
    h, w = heights.shape
    with np.errstate(invalid="ignore"):
        for dr in range(3):
            for dc in range(3):
                if (dr, dc) != (1, 1):
                    similar += np.abs(padded[dr : dr + h, dc : dc + w] - heights) < alike
    return (similar < 2) & np.isfinite(heights)


def _labels(relief: Relief, settings: PerceptionSettings) -> tuple[NDArray[np.int32], int]:
    """Number the pieces of what is level and above the table."""
    smooth = relief.smooth.astype(np.float32)
    steepness = cv2.dilate(smooth, _SQUARE) - cv2.erode(smooth, _SQUARE)
    level = steepness < 2.0 * relief.pitch * settings.level_slope + relief.noise
    above = (smooth > settings.lowest_top) & (smooth < settings.highest_top)
    with np.errstate(invalid="ignore"):
        sound = ~np.isfinite(relief.heights) | (np.abs(relief.heights - smooth) < NOISE_REACH * relief.noise)
    seeds = (level & above & sound & ~relief.known).astype(np.uint8)
    count, labels = cv2.connectedComponents(seeds, connectivity=4)
    return labels.astype(np.int32), count - 1


def _grown(core: ImageMask, taken: ImageMask, relief: Relief) -> ImageMask:
    """Give a top back the pixels that its edge's steepness cost, and fill its holes of single pixels."""
    height = float(np.median(relief.smooth[core]))
    reach = NOISE_REACH * relief.noise
    with np.errstate(invalid="ignore"):
        off = np.abs(relief.heights - height)
    alike = (off < EDGE_REACH * relief.noise) | (
        (np.abs(relief.smooth - height) < relief.noise) & (off < NOISE_REACH * relief.noise)
    )
    fits = alike & ~taken & ~relief.known
    grown = core & ~taken
    for _ in range(3):
        grown = grown | ((cv2.dilate(grown.astype(np.uint8), _CROSS) > 0) & fits)
    unmeasured = ~np.isfinite(relief.heights) & (np.abs(relief.smooth - height) < reach)
    around = cv2.filter2D(grown.astype(np.float32), -1, _SQUARE.astype(np.float32), borderType=cv2.BORDER_CONSTANT)
    return grown | (unmeasured & (around >= 5.0) & ~taken)


def make_facet(pixels: ImageMask, relief: Relief) -> TopFacet:
    """Return the top facet that some pixels (h, w) are, with its edge."""
    measured = pixels & np.isfinite(relief.heights)
    height = float(np.median(relief.heights[measured])) if measured.any() else 0.0
    rays = relief.view.rays
    h, w = pixels.shape
    rows, columns = np.nonzero(pixels)
    places, hidden, beside, cut, pitches = [], [], [], False, []
    grid = np.array([1.0, 0.0])
    for dr, dc in _STEPS:
        r, c = rows + dr, columns + dc
        inside = (r >= 0) & (r < h) & (c >= 0) & (c < w)
        cut = cut or bool((~inside).any())
        i, j, r, c = rows[inside], columns[inside], r[inside], c[inside]
        ends = ~pixels[r, c]
        i, j, r, c = i[ends], j[ends], r[ends], c[ends]
        here, there = relief.on_plane(rays[i, j], height), relief.on_plane(rays[r, c], height)
        step = there - here
        pitches.append(np.linalg.norm(step, axis=1))
        if (dr, dc) == (0, 1) and len(step):
            grid = step.mean(axis=0) / np.linalg.norm(step.mean(axis=0))
        places.append(0.5 * (here + there))
        higher, away = _higher(relief, r, c, here, height)
        hidden.append(higher & away)
        beside.append(higher & ~away)
        if not relief.view.framed:
            cut = cut or bool(_unseen(relief, r, c, dr, dc).mean() > 0.1) if len(r) else cut
    pitch = float(np.median(np.concatenate(pitches)))
    edge = np.vstack(places)
    return TopFacet(pixels, height, edge, np.concatenate(hidden), np.concatenate(beside), pitch, cut, grid)


def _higher(
    relief: Relief, rows: NDArray[np.intp], columns: NDArray[np.intp], beside: Array, height: float
) -> tuple[ImageMask, ImageMask]:
    """Tell which pixels show something higher, and which stand away from the top's edge, and so hide some of the top.

    Args:
        relief: the view.
        rows: of the pixels.
        columns: of the pixels.
        beside: (n, 2) the places of the top beside them, in the table's frame [m].
        height: of the top [m].
    """
    seen = relief.points[rows, columns]
    with np.errstate(invalid="ignore"):
        higher = seen[:, 2] > height + NOISE_REACH * relief.noise
        away = np.linalg.norm(seen[:, :2] - beside, axis=1) > 3.0 * relief.pitch
    return higher, away


def _unseen(relief: Relief, rows: NDArray[np.intp], columns: NDArray[np.intp], dr: int, dc: int) -> ImageMask:
    """Tell which pixels have nothing measured beyond them in a direction: shadows end, a cloud's border does not."""
    measured = np.isfinite(relief.heights)
    lines, along, across = (measured, columns, rows) if dc else (measured.T, rows, columns)
    forward = dr + dc > 0
    last = np.argmax(lines[:, ::-1] if forward else lines, axis=1)
    last = lines.shape[1] - 1 - last if forward else last
    beyond = (along > last[across]) if forward else (along < last[across])
    return beyond | ~np.asarray(np.any(lines, axis=1))[across]
