"""Which kinds of arms have their inverse kinematics in closed form, and why another arm is of neither kind."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

from planners.geometry.pose import Array

SAME_ANGLE = 1e-12
"""How far an alpha may be from a multiple of a right angle [rad]: the closed forms take it for one."""


class ArmKind(Enum):
    """A kind of six-axis arm that `inverse.inverse_kinematics` can solve; the value says what makes it one."""

    PARALLEL_AXES = "three parallel axes"
    SPHERICAL_WRIST = "spherical wrist"


@dataclass(frozen=True)
class NoClosedForm:
    """Why an arm is of neither kind."""

    faults: tuple[str, ...]
    """What about its table would have to be otherwise, for the kind that its third row points to."""

    @property
    def reason(self) -> str:
        """One sentence for a person."""
        kinds = "neither axes 2, 3 and 4 parallel nor a wrist whose three axes meet in one point"
        return f"the arm has {kinds}, with right angles elsewhere: {'; '.join(self.faults)}"


def arm_kind(dh: Array) -> ArmKind | NoClosedForm:
    """Classify an arm by its (6, 4) table of a, alpha, d, theta0 [m, rad].

    Which kind a table is meant to be, alpha 3 says: axis 4 is parallel to axis 3, or at a right angle to it.
    """
    if _is_right(dh[2, 1]):
        faults, kind = tuple(_spherical_faults(dh)), ArmKind.SPHERICAL_WRIST
    else:
        faults, kind = tuple(_parallel_faults(dh)), ArmKind.PARALLEL_AXES
    return NoClosedForm(faults) if faults else kind


def _parallel_faults(dh: Array) -> Iterator[str]:
    yield from _angle_faults(dh, right=(1, 4, 5), straight=(2, 3))
    yield from _zero_faults(dh, "a", 0, (1, 4, 5))
    for joint in (2, 3):
        if dh[joint - 1, 0] == 0.0:
            yield f"a {joint} is 0, so that axes {joint} and {joint + 1} are one"


def _spherical_faults(dh: Array) -> Iterator[str]:
    yield from _angle_faults(dh, right=(1, 3, 4, 5), straight=(2,))
    yield from _zero_faults(dh, "a", 0, (4, 5))
    yield from _zero_faults(dh, "d", 2, (5,))
    if dh[1, 0] == 0.0:
        yield "a 2 is 0, so that axes 2 and 3 are one"
    if dh[2, 0] == 0.0 == dh[3, 2]:
        yield "a 3 and d 4 are 0, so that the wrist is on axis 3"


def _angle_faults(dh: Array, right: tuple[int, ...], straight: tuple[int, ...]) -> Iterator[str]:
    for joint in sorted((*right, *straight)):
        alpha = float(dh[joint - 1, 1])
        if joint in right and not _is_right(alpha):
            yield f"alpha {joint} is {math.degrees(alpha):.6g} deg, not 90 or -90"
        elif joint in straight and not _is_straight(alpha):
            allowed = "not 0 or 180" + (", nor 90 or -90" if joint == 3 else "")
            yield f"alpha {joint} is {math.degrees(alpha):.6g} deg, {allowed}"


def _zero_faults(dh: Array, name: str, column: int, joints: tuple[int, ...]) -> Iterator[str]:
    for joint in joints:
        if dh[joint - 1, column] != 0.0:
            yield f"{name} {joint} is {dh[joint - 1, column]:.6g} m, not 0"


def _is_right(alpha: float) -> bool:
    return abs(abs(alpha) - 0.5 * math.pi) < SAME_ANGLE


def _is_straight(alpha: float) -> bool:
    return min(abs(alpha), abs(abs(alpha) - math.pi)) < SAME_ANGLE
