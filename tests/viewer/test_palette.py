"""Colours that say who exerts a force are told apart by people who see no red, no green or no blue, too."""

from __future__ import annotations

import re
from itertools import combinations

import numpy as np
import pytest

from app.pictures.canvas import viridis
from app.viewer.page import static_text
from app.viewer.palette import MEANINGS, code_rgb
from planners.geometry.pose import Array

SIGHTS = {
    "all colours": np.eye(3),
    "no red": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "no green": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "no blue": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
"""Linear sRGB as it is seen: Machado, Oliveira and Fernandes, "A physiologically-based model for simulation of color
vision deficiency", 2009, severity 1."""
XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
WHITE = np.array([0.95047, 1.0, 1.08883])
"""D65, as sRGB has it."""
APART = 15.0
"""Distance in CIELAB: 2.3 are just seen side by side."""
DRAWN = ("left", "right", "environment", "suction", "limit", "reserve")
PAPERS = ("#ffffff", "#161e28")
"""What curves are drawn on, light and dark."""
LEAST_CONTRAST = 2.3
"""Of lines, that are never without words beside them."""


def linear(code: str) -> Array:
    """Return a colour's channels in linear light (3,), 0 to 1 (IEC 61966-2-1)."""
    channels = np.array(code_rgb(code)) / 255.0
    return np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)


def lab(channels: Array) -> Array:
    """Return linear channels (3,) in CIELAB."""
    share = XYZ @ np.clip(channels, 0.0, 1.0) / WHITE
    f = np.where(share > (6 / 29) ** 3, np.cbrt(share), share / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("sight", SIGHTS)
def test_forces_are_told_apart(sight: str) -> None:
    seen = {name: lab(SIGHTS[sight] @ linear(MEANINGS[name][0])) for name in DRAWN}
    too_near = [(a, b) for a, b in combinations(DRAWN, 2) if np.linalg.norm(seen[a] - seen[b]) < APART]
    assert too_near == []


@pytest.mark.parametrize("paper", PAPERS)
def test_curves_stand_out_from_their_paper(paper: str) -> None:
    ground = float(XYZ[1] @ linear(paper))
    for name in DRAWN:
        light, dark = sorted((float(XYZ[1] @ linear(MEANINGS[name][0])), ground), reverse=True)
        assert (light + 0.05) / (dark + 0.05) > LEAST_CONTRAST, name


def test_the_scale_of_maps_is_viridis_on_pages_as_in_pictures() -> None:
    stated = re.search(r"--viridis: ([^;]+);", static_text("style.css"))
    assert stated is not None
    stops = [code_rgb(code) for code in stated[1].split(", ")]
    for place, stop in enumerate(stops):
        # Between whole levels of OpenCV's table of 256.
        assert np.abs(np.array(stop)[::-1] - viridis(place / (len(stops) - 1))).max() <= 2
