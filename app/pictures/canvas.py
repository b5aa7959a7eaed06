"""What all pictures have: ink, text, and a scale of colours."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np

from planners.perception.preview import Picture

BlueGreenRed = tuple[int, int, int]
INK: BlueGreenRed = (40, 40, 40)
PAPER: BlueGreenRed = (255, 255, 255)


def viridis(share: float) -> BlueGreenRed:
    """Return the colour of a share, 0 to 1, as blue, green and red; its lightness alone tells the order."""
    level = round(255 * min(1.0, max(0.0, share)))
    scale = cv2.applyColorMap(np.array([[level]], np.uint8), cv2.COLORMAP_VIRIDIS)
    blue, green, red = (int(each) for each in scale[0, 0])
    return blue, green, red


def write(image: Picture, text: str, x: int, y: int, colour: BlueGreenRed, size: float = 0.42) -> None:
    """Write text about a point."""
    write_left(image, text, x - written_width(text, size) // 2, y, colour, size)


def written_width(text: str, size: float = 0.42) -> int:
    """Return how wide a text is [px]."""
    (width, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
    return width


def write_left(image: Picture, text: str, x: int, y: int, colour: BlueGreenRed = INK, size: float = 0.42) -> None:
    """Write text from a point on."""
    cv2.putText(cast("cv2.typing.MatLike", image), text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)
