"""Colours, each with one meaning wherever it appears: in the scene, in the curves, on the timeline, in the legend."""

from __future__ import annotations

from colorsys import hsv_to_rgb, rgb_to_hsv
from typing import Final

Rgb = tuple[int, int, int]

MEANINGS: Final[dict[str, tuple[str, str]]] = {
    "left": ("#2f7fe0", "left hand"),
    "right": ("#f08a24", "right hand"),
    "environment": ("#11a852", "table, support"),
    "suction": ("#af7cbf", "vacuum cup"),
    "sum": ("var(--ink)", "both hands"),
    "reserve": ("#b21b6c", "reserve"),
    "limit": ("#d62026", "limit"),
    "start": ("#8a97a6", "ghost at start"),
    "goal": ("#16a3b8", "ghost at goal"),
}
"""Colour and words by meaning; what both hands bear is drawn in the ink of the page, be it dark or light."""

SEGMENT_KINDS: Final[dict[str, tuple[str, str]]] = {
    "transit": ("#b8c4d2", "a hand travels"),
    "approach": ("#8fb4de", "a hand approaches"),
    "retreat": ("#a9b3e0", "a hand retreats"),
    "transfer": ("#16a3b8", "the body moves"),
    "handover": ("#5cc4a8", "from hand to hand"),
    "grip": ("#f0b429", "fingers close"),
    "release": ("#f6d67a", "fingers open"),
    "attach": ("#af7cbf", "vacuum on"),
    "detach": ("#d9c0e0", "vacuum off"),
    "settle": ("#8d95d6", "hands take up the load"),
    "lift": ("#3f4fb5", "lift behind the lifter"),
    "still": ("#dde2e8", "robot stands still"),
}
"""Colour and words by kind of segment; the last three are stretches of a simulation."""

FORCE_SCALES: Final[dict[str, float]] = {"plate_lift": 0.010, "suction_tool": 0.005}
"""Length of a force arrow by kind of task [m/N]."""

GOOD_COLOUR: Final = "#1f8f5a"
"""Of what was considered and did not fall."""
REASON_COLOURS: Final = (
    *("#a9977c", "#c2417a", "#3f9c8f", "#7d6bc9", "#8fa03a", "#5a6b7d", "#c98f3f"),
    *("#d291b0", "#4f7a55", "#b5bec8"),
)
"""Of reasons why something fell, the most frequent first; the last one for all others."""
OBJECT_TINTS: Final[tuple[Rgb, ...]] = (
    *((214, 190, 150), (150, 184, 206), (206, 158, 148), (168, 196, 160), (190, 172, 208), (214, 206, 150)),
)
"""Of objects, so that they are told apart in a pile; again from the first after the last."""

BODIES: Final[dict[str, Rgb]] = {
    "plate": (214, 190, 150),
    "object": (214, 190, 150),
    "tool": (120, 128, 140),
    "support": (150, 128, 104),
    "obstacle": (196, 120, 118),
    "table": (84, 96, 110),
    "frame": (58, 66, 76),
    "cup": (175, 124, 191),
    "cable": (52, 58, 66),
}
"""By role of a plan document's bodies."""


def object_tint(index: int) -> Rgb:
    """Return the colour of the object that comes at a place, from 0, in the order of its document."""
    return OBJECT_TINTS[index % len(OBJECT_TINTS)]


def vivid_tint(index: int) -> Rgb:
    """Return the same colour, stronger: of what is drawn small, or translucent."""
    hue, saturation, _ = rgb_to_hsv(*(channel / 255.0 for channel in object_tint(index)))
    red, green, blue = hsv_to_rgb(hue, min(1.0, 2.6 * saturation), 0.82)
    return round(255.0 * red), round(255.0 * green), round(255.0 * blue)


def rgb(meaning: str) -> Rgb:
    """Return the colour of a meaning, 0 to 255 a channel."""
    return code_rgb(MEANINGS[meaning][0])


def code_rgb(code: str) -> Rgb:
    """Return the channels, 0 to 255, of a colour written as "#rrggbb"."""
    return int(code[1:3], 16), int(code[3:5], 16), int(code[5:7], 16)


def linear_rgb(meaning: str) -> Rgb:
    """Return the colour of a meaning in linear light, which viser expects of arrows (three.js' instance colours)."""
    red, green, blue = (round(255.0 * _linear(channel / 255.0)) for channel in rgb(meaning))
    return red, green, blue


def meaning_of(by: str, arms: frozenset[str], kind: str) -> str:
    """Return the meaning of a contact of a kind, made by an arm or a body."""
    if kind == "suction":
        return "suction"
    return by if by in arms else "environment"


def _linear(value: float) -> float:
    """Undo the transfer function of sRGB (IEC 61966-2-1)."""
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4
