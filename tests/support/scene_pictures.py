"""What the viewer's frame shows in a browser, and whether it changed."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import Page

from tests.support.browser import LOADING_MILLISECONDS
from tests.support.service import wait_for

PICTURE_SECONDS = 90.0
"""On a busy machine."""
ONLY_THE_SCENE = "#now, #views, #ending, #message { visibility: hidden }"
VISIBLE = 40
"""Difference of one colour channel, of 255."""
BLUR = 8
"""Pixels a side."""
MOVED_SHARE = 2e-3
"""Share of pixels that differ when something in the scene moved: a wrist covers more."""
LAYER_SHARE = 2e-4
"""The frames' axes are thin."""


def picture(page: Page) -> np.ndarray:
    """Return what the scene's frame shows, without the words over it."""
    box: Any = page.locator("#scene-frame").bounding_box()
    shot = page.screenshot(clip=box, style=ONLY_THE_SCENE, timeout=1e3 * PICTURE_SECONDS)
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"), dtype=int)


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Return the share of pixels that differ visibly."""
    return float((np.abs(a - b).max(axis=2) > VISIBLE).mean())


def settled(page: Page) -> np.ndarray:
    """Wait until there is a picture of the scene and it no longer changes, and return it."""
    shots = [picture(page)]

    def still() -> bool:
        page.wait_for_timeout(300)
        shots.append(picture(page))
        colours = len(np.unique(shots[-1].reshape(-1, 3) // 16, axis=0))
        return difference(*shots[-2:]) < 1e-5 and colours > 40

    wait_for(still, 1e-3 * LOADING_MILLISECONDS)
    return shots[-1]


def wait_until_it_differs(page: Page, reference: np.ndarray, share: float = MOVED_SHARE) -> None:
    """Wait until more than a share of the pixels differ: without a graphics card a frame takes a while."""
    wait_for(lambda: difference(reference, picture(page)) > share, PICTURE_SECONDS)


def wait_until_it_is_as_before(page: Page, reference: np.ndarray, share: float = MOVED_SHARE) -> None:
    """Wait until hardly anything differs but the sharpness: viser draws coarser while frames are slow."""
    wait_for(lambda: difference(*(blurred(each) for each in (reference, picture(page)))) < share, PICTURE_SECONDS)


def blurred(shot: np.ndarray) -> np.ndarray:
    """Return the means of squares of pixels, about as wide as an arm's joint."""
    rows, columns = (size // BLUR for size in shot.shape[:2])
    squares = shot[: rows * BLUR, : columns * BLUR].reshape(rows, BLUR, columns, BLUR, 3)
    return squares.mean(axis=(1, 3))
