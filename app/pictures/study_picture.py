"""A study's map as a picture: how much is kept back at each point, in colours that everybody tells apart."""

from __future__ import annotations

import math

import cv2
import numpy as np
from pydantic import JsonValue

from app.pictures.canvas import INK, PAPER, BlueGreenRed, viridis, write, write_left
from planners.perception.preview import Picture
from planners.study.study_map import StudyMap, StudyPoint

CELL = 44
"""Side of a point at least [pixels]."""
LARGEST = 640
"""The map is about so large [pixels]."""
MARGIN_LEFT, MARGIN_TOP, MARGIN_RIGHT, MARGIN_BOTTOM = 130, 56, 210, 70
WORDS = {
    "not_found": "not found",
    "infeasible": "infeasible",
    "refused": "no such task",
    "failed": "failed",
}
GREYS: dict[str, BlueGreenRed] = {
    "not_found": (216, 216, 216),
    "infeasible": (150, 150, 150),
    "refused": (255, 255, 255),
    "failed": (90, 90, 90),
}
"""What is not solved is grey and hatched: no colour has to be told from another one."""
FULL_RESERVE = 0.2
"""The brightest colour, and all that keeps more back [1]."""


def draw_map(study: StudyMap) -> bytes:
    """Return the map as a PNG: the first axis to the right, the second one upwards, and what is known so far."""
    columns = len(study.axes[0].values)
    rows = len(study.axes[1].values) if len(study.axes) > 1 else 1
    side = max(6, min(CELL * 2, LARGEST // max(columns, rows)))
    width, height = columns * side, rows * side
    shape = (MARGIN_TOP + max(height, 260) + MARGIN_BOTTOM, MARGIN_LEFT + width + MARGIN_RIGHT, 3)
    image = np.full(shape, 255, np.uint8)
    for point in study.points:
        column, row = point.at[0], point.at[1] if len(point.at) > 1 else 0
        x, y = MARGIN_LEFT + column * side, MARGIN_TOP + (rows - 1 - row) * side
        _draw_point(image, point, x, y, side)
        if study.best is not None and point.index == study.best.index:
            cv2.rectangle(image, (x + 2, y + 2), (x + side - 3, y + side - 3), INK, 2)
    cv2.rectangle(image, (MARGIN_LEFT, MARGIN_TOP), (MARGIN_LEFT + width, MARGIN_TOP + height), INK, 1)
    _label_axes(image, study, (rows, columns), side)
    _draw_legend(image, study, MARGIN_LEFT + width + 24)
    done, encoded = cv2.imencode(".png", image)
    assert done
    return encoded.tobytes()


def colour_of(reserve: float) -> BlueGreenRed:
    """Return the colour of a reserve, as blue, green and red: of viridis, whose lightness alone tells the order."""
    return viridis(reserve / FULL_RESERVE)


def whole_percent(reserve: float | None) -> int:
    """Return how many whole per cent of every limit are kept back, no more than there are."""
    return math.floor(100.0 * (reserve or 0.0) + 1e-9)


def _draw_point(image: Picture, point: StudyPoint, x: int, y: int, side: int) -> None:
    corner = (x + side - 1, y + side - 1)
    if point.outcome == "solved":
        colour = colour_of(point.reserve or 0.0)
        cv2.rectangle(image, (x, y), corner, colour, cv2.FILLED)
        if side >= 30:
            dark = sum(colour) < 330
            write(
                image, f"{100 * (point.reserve or 0.0):.0f}", x + side // 2, y + side // 2 + 5, PAPER if dark else INK
            )
        return
    cv2.rectangle(image, (x, y), corner, GREYS[point.outcome], cv2.FILLED)
    _hatch(image, point.outcome, x, y, side)


def _hatch(image: Picture, outcome: str, x: int, y: int, side: int) -> None:
    """Mark what is not solved: one stroke where nothing was found, a cross where nothing can be."""
    inset = max(2, side // 4)
    low, high = (x + inset, y + side - inset), (x + side - inset, y + inset)
    if outcome in ("not_found", "infeasible", "failed"):
        cv2.line(image, low, high, INK if outcome != "failed" else PAPER, 1, cv2.LINE_AA)
    if outcome in ("infeasible", "failed"):
        cv2.line(image, (low[0], high[1]), (high[0], low[1]), INK if outcome != "failed" else PAPER, 1, cv2.LINE_AA)
    if outcome == "refused":
        cv2.circle(image, (x + side // 2, y + side // 2), 1, INK, cv2.FILLED)


def _label_axes(image: Picture, study: StudyMap, shape: tuple[int, int], side: int) -> None:
    rows, columns = shape
    first = study.axes[0]
    below = MARGIN_TOP + rows * side
    for place in _labelled(columns, side, 52):
        write(image, _short(first.values[place]), MARGIN_LEFT + place * side + side // 2, below + 18, INK)
    write(image, f"{first.pointer}{_of(first.part)}", MARGIN_LEFT + columns * side // 2, below + 42, INK, 0.5)
    if len(study.axes) > 1:
        second = study.axes[1]
        for place in _labelled(rows, side, 18):
            text = _short(second.values[place])
            write(image, text, MARGIN_LEFT - 34, MARGIN_TOP + (rows - 1 - place) * side + side // 2 + 5, INK)
        write(image, f"{second.pointer}{_of(second.part)}", MARGIN_LEFT, MARGIN_TOP - 14, INK, 0.5)


def _labelled(count: int, side: int, room: int) -> range:
    """Return which values have room for a label."""
    return range(0, count, max(1, -(-room // side)))


def _draw_legend(image: Picture, study: StudyMap, x: int) -> None:
    y = MARGIN_TOP + 10
    write_left(image, "kept back of all limits", x, y)
    for step in range(101):
        column = x + step
        cv2.line(image, (column, y + 10), (column, y + 24), colour_of(FULL_RESERVE * step / 100), 1)
    write_left(image, "0 %", x - 4, y + 40)
    write_left(image, f"{100 * FULL_RESERVE:.0f} % +", x + 80, y + 40)
    y += 64
    for outcome, word in WORDS.items():
        if study.outcomes[outcome]:
            cv2.rectangle(image, (x, y), (x + 18, y + 18), GREYS[outcome], cv2.FILLED)
            _hatch(image, outcome, x, y, 19)
            cv2.rectangle(image, (x, y), (x + 18, y + 18), INK, 1)
            write_left(image, f"{word}: {study.outcomes[outcome]}", x + 26, y + 14)
            y += 26
    if study.best is not None:
        cv2.rectangle(image, (x + 2, y + 2), (x + 16, y + 16), INK, 2)
        write_left(image, "best", x + 26, y + 14)
        y += 26
    write_left(image, f"{study.outcomes['solved']} of {study.count} solved", x, y + 14)
    if study.done < study.count:
        write_left(image, f"{study.count - study.done} not known yet", x, y + 34)
    elif not study.certify:
        write_left(image, "searched, not certified", x, y + 34)


def _of(part: str) -> str:
    return " turned by [rad]" if part == "yaw" else ""


def _short(value: JsonValue) -> str:
    text = f"{value:.3g}" if isinstance(value, int | float) and not isinstance(value, bool) else str(value)
    return text if len(text) <= 9 else f"{text[:8]}~"
