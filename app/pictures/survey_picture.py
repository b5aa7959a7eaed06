"""What a cell can do, as a picture: maps of its table from above, in colours that everybody tells apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from app.pictures.canvas import INK, BlueGreenRed, viridis, write, write_left, written_width
from planners.geometry.pose import Array
from planners.perception.preview import Picture
from planners.survey.reach_map import ReachMap
from planners.survey.survey import CellSurvey

SIDE = 420
"""Of the longer side of a map [px]."""
MARGIN, TOP, BESIDE, BELOW = 46, 64, 150, 56
"""Left and right of maps and text; above the first map; for a legend; below each map [px]."""
LINE = 20
"""Between two lines of text [px]."""
LEFT: BlueGreenRed = (178, 114, 0)
RIGHT: BlueGreenRed = (0, 159, 230)
BOTH: BlueGreenRed = (115, 158, 0)
"""Of the palette of Okabe and Ito."""
NONE: BlueGreenRed = (235, 235, 235)
ColourAt = Callable[[int, int], BlueGreenRed]
"""Of a place of the map, by its column along x and along y."""


def draw_survey(survey: CellSurvey) -> bytes:
    """Return a PNG: who reaches where, what hands may hold there, and which plates fit or where hands meet."""
    reach = survey.reach
    maps = [
        ("Who reaches it", _who(reach), [(LEFT, "left"), (RIGHT, "right"), (BOTH, "both"), (NONE, "neither")]),
        _shades("One hand holds [kg]", np.maximum.reduce(list(reach.mass.values()))),
    ]
    if survey.plate_sides.any():
        maps.append(_shades("Square plates [m]", survey.plate_sides))
    elif len(survey.handovers):
        maps.append(_shades("Hands meet, heights [m]", _meeting_heights(survey)))
    size = survey.cell.boxes[0].size
    scale = SIDE / max(size[0], size[1])
    width, height = round(scale * size[1]), round(scale * size[0])
    sentences = survey.figures().sentences
    # One below the other: beside each other they would be too small to read on a page, and on a telephone.
    text_width = max(map(written_width, sentences))
    text_top = TOP + len(maps) * (height + BELOW)
    sides = text_top + LINE * (len(sentences) + 1), MARGIN + max(width + BESIDE, text_width + MARGIN)
    image = np.full((*sides, 3), 255, np.uint8)
    write_left(image, f"{survey.cell.name}: its table from above, the robot below", MARGIN, 26, INK, 0.55)
    for index, (title, colour, legend) in enumerate(maps):
        top = TOP + index * (height + BELOW)
        write_left(image, title, MARGIN, top - 10)
        _draw_map(image, reach, colour, (MARGIN, top, width, height))
        _draw_legend(image, legend, MARGIN + width + 12, top + 4)
        _label(image, reach, (MARGIN, top, width, height))
    for index, sentence in enumerate(sentences):
        write_left(image, sentence.replace("×", "x"), MARGIN, text_top + LINE * index)
    done, encoded = cv2.imencode(".png", image)
    assert done
    return encoded.tobytes()


def _who(reach: ReachMap) -> ColourAt:
    left, right = reach.anyhow["left"], reach.anyhow["right"]

    def colour(i: int, j: int) -> BlueGreenRed:
        if left[i, j]:
            return BOTH if right[i, j] else LEFT
        return RIGHT if right[i, j] else NONE

    return colour


def _shades(title: str, values: Array) -> tuple[str, ColourAt, list[tuple[BlueGreenRed, str]]]:
    """Return a map of values, whose lightness tells their order; nothing is 0."""
    most = float(values.max())

    def colour(i: int, j: int) -> BlueGreenRed:
        return viridis(values[i, j] / most) if values[i, j] > 0.0 else NONE

    steps = [most * share for share in (1.0, 0.75, 0.5, 0.25)] if most > 0.0 else []
    return title, colour, [*((viridis(step / most), f"{step:.2f}") for step in steps), (NONE, "nothing")]


def _meeting_heights(survey: CellSurvey) -> Array:
    """(n, m): over how much height both hands meet above each place [m]."""
    reach, places = survey.reach, survey.handovers
    heights = np.zeros((len(reach.x), len(reach.y)))
    step = survey.handover_step
    for x, y, _ in places:
        across = np.abs(reach.x - x) <= 0.5 * step[0] + 1e-9
        along = np.abs(reach.y - y) <= 0.5 * step[1] + 1e-9
        heights[np.ix_(across, along)] += step[2]
    return heights


def _draw_map(image: Picture, reach: ReachMap, colour: ColourAt, frame: tuple[int, int, int, int]) -> None:
    """Draw x upwards and y to the left, as whoever stands behind the robot sees the table."""
    left, top, width, height = frame
    n, m = len(reach.x), len(reach.y)
    for i in range(n):
        for j in range(m):
            corner = left + width - round((j + 1) * width / m), top + height - round((i + 1) * height / n)
            opposite = left + width - round(j * width / m) - 1, top + height - round(i * height / n) - 1
            cv2.rectangle(image, corner, opposite, colour(i, j), cv2.FILLED)
    cv2.rectangle(image, (left, top), (left + width, top + height), INK, 1)


def _draw_legend(image: Picture, legend: Sequence[tuple[BlueGreenRed, str]], x: int, y: int) -> None:
    for index, (colour, word) in enumerate(legend):
        at = y + 24 * index
        cv2.rectangle(image, (x, at), (x + 16, at + 16), colour, cv2.FILLED)
        cv2.rectangle(image, (x, at), (x + 16, at + 16), INK, 1)
        write_left(image, word, x + 24, at + 13)


def _label(image: Picture, reach: ReachMap, frame: tuple[int, int, int, int]) -> None:
    left, top, width, height = frame
    half_x, half_y = 0.5 * (reach.x[1] - reach.x[0]), 0.5 * (reach.y[1] - reach.y[0])
    write_left(image, f"x {_metres(reach.x[-1] + half_x)}", left - 42, top + 10, INK, 0.34)
    write_left(image, f"x {_metres(reach.x[0] - half_x)}", left - 42, top + height, INK, 0.34)
    write(image, f"y {_metres(reach.y[-1] + half_y)}", left + 14, top + height + 16, INK, 0.34)
    write(image, f"y {_metres(reach.y[0] - half_y)}", left + width - 14, top + height + 16, INK, 0.34)


def _metres(length: float) -> str:
    """Return a length to the centimetre; what is next to nothing has no sign."""
    return f"{round(length, 2) + 0.0:.2f}"
