"""A picture of what was perceived: the camera's picture and the heights above the table, with the models drawn in."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array, Transform
from planners.perception.camera import Camera
from planners.perception.depth_view import DepthView
from planners.perception.marker_board import SeenBoard
from planners.perception.object_finder import SeenTable
from planners.perception.perceived_object import PerceivedObject

Picture = NDArray[np.uint8]
HEIGHT = 720
"""Of the preview [px]."""
WIDEST = 2 * HEIGHT
"""Of either half [px]: one that would be wider is drawn lower."""
HIGHEST = 0.25
"""Height above the table that is drawn brightest [m]."""
FOUND, LOST, BOARD = (80, 220, 80), (60, 60, 255), (255, 200, 0)
AXES = ((60, 60, 255), (80, 220, 80), (255, 120, 60))
AXIS = 0.05
"""Length of the tool's axes [m]."""


def draw_preview(
    picture: Picture | None,
    camera: Camera | None,
    board: SeenBoard | None,
    T_world_tool: Transform | None,
    seen: SeenTable | None,
) -> bytes:
    """Return a PNG picture with everything that was found drawn in: `HEIGHT` high, at most twice `WIDEST` wide."""
    halves = []
    if picture is not None and camera is not None:
        halves.append(_drawn_on_picture(picture.copy(), camera, board, T_world_tool, seen))
    if seen is not None:
        halves.append(_drawn_on_heights(seen))
    written, content = cv2.imencode(".png", np.hstack([_fitted(half) for half in halves]))
    if not written:
        raise RuntimeError("the preview was not written as a PNG")
    return content.tobytes()


def _fitted(half: Picture) -> Picture:
    """Scale a half to the preview's height; a wide one to the greatest width, with nothing above and below it."""
    height, width = half.shape[:2]
    scale = min(HEIGHT / height, WIDEST / width)
    size = (max(1, round(scale * width)), max(1, round(scale * height)))
    scaled = cv2.resize(half, size, interpolation=cv2.INTER_AREA)
    above = (HEIGHT - size[1]) // 2
    return np.pad(scaled, ((above, HEIGHT - size[1] - above), (0, 0), (0, 0))).astype(np.uint8, copy=False)


def _drawn_on_picture(
    image: Picture, camera: Camera, board: SeenBoard | None, T_world_tool: Transform | None, seen: SeenTable | None
) -> Picture:
    for each in () if seen is None else seen.findings.objects:
        bottom, top = _rings(each)
        if _in_front(camera, np.vstack([bottom, top])):
            for ring in (bottom, top):
                _outline(image, camera.pixels(ring), FOUND)
    if board is not None and T_world_tool is not None:
        for corner in board.corners:
            cv2.circle(image, _pixel(corner), 4, BOARD, 2, cv2.LINE_AA)
        T = board.T_world_board
        ends = np.vstack([T[:3, 3], *(T[:3, 3] + AXIS * T[:3, k] for k in range(3))])
        if _in_front(camera, ends):
            origin, *tips = camera.pixels(ends)
            for tip, colour in zip(tips, AXES, strict=True):
                cv2.line(image, _pixel(origin), _pixel(tip), colour, 2, cv2.LINE_AA)
    return image


def _drawn_on_heights(seen: SeenTable) -> Picture:
    heights = seen.plane.in_table(seen.view.points())[..., 2]
    grey = np.clip(np.nan_to_num(heights) / HIGHEST, 0.0, 1.0)
    image = cv2.applyColorMap((40 + 200 * grey).astype(np.uint8), cv2.COLORMAP_BONE)
    image[~np.isfinite(heights)] = (60, 0, 60)
    scale = max(1, min(round(HEIGHT / image.shape[0]), WIDEST // image.shape[1]))
    image = np.repeat(np.repeat(image.astype(np.uint8), scale, axis=0), scale, axis=1)
    for piece in seen.findings.unrecognised:
        ring = np.column_stack([piece.outline, np.full(len(piece.outline), piece.top)])
        _outline(image, scale * _pixels(seen.view, ring), LOST)
    for each in seen.findings.objects:
        _, top = _rings(each)
        pixels = scale * _pixels(seen.view, top)
        _outline(image, pixels, FOUND)
        _label(image, _text(each), pixels.mean(axis=0))
    return image


def _rings(each: PerceivedObject) -> tuple[Array, Array]:
    """Return the (n, 3) outlines of an object's bottom and top in the world."""
    outline = each.outline()
    z, half = each.T_world_object[2, 3], 0.5 * each.height
    bottom, top = (np.column_stack([outline, np.full(len(outline), height)]) for height in (z - half, z + half))
    return bottom, top


def _text(each: PerceivedObject) -> list[str]:
    shape = each.shape
    size = shape.size if shape.type == "box" else (2.0 * shape.radius, shape.height)
    return [each.name, " x ".join(f"{1e3 * length:.0f}" for length in size)]


def _pixels(view: DepthView, points: Array) -> Array:
    rows, columns = view.pixels(points)
    return np.column_stack([columns, rows]).astype(float)


def _in_front(camera: Camera, points: Array) -> bool:
    return bool(np.all((points - camera.T_world_camera[:3, 3]) @ camera.T_world_camera[:3, 2] > 0.02))


def _outline(image: Picture, pixels: Array, colour: Sequence[int]) -> None:
    # What is far outside of the picture would not fit into the drawing's integers.
    bounded = np.clip(np.rint(pixels), -20_000, 20_000).astype(np.int32)
    cv2.polylines(image, [bounded], True, tuple(colour), 2, cv2.LINE_AA)


def _label(image: Picture, lines: Sequence[str], center: Array) -> None:
    for i, line in enumerate(lines):
        (width, _), _ = cv2.getTextSize(line, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 1)
        at = _pixel(center + np.array([-0.5 * width, 16.0 * i]))
        for colour, thickness in (((0, 0, 0), 3), (FOUND, 1)):
            cv2.putText(image, line, at, cv2.FONT_HERSHEY_SIMPLEX, 0.45, colour, thickness, cv2.LINE_AA)


def _pixel(place: Array) -> tuple[int, int]:
    x, y = np.clip(np.rint(place), -20_000, 20_000).astype(int).tolist()
    return x, y
