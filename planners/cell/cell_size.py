"""How large a cell is beside the papers' laboratory, and settings for cells of another size."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, TypeVar

from planners.cell.arm import Arm
from planners.cell.hand import Gripper, Pusher
from planners.contract.task_spec import HandForceLimit
from planners.geometry.pose import Array

_REACH = 0.5
"""Of the papers' arms, by the data sheet of a UR3e [m]."""
_PAD = (0.022, 0.00635, 0.0375)
"""Of their gripper, a 2F-85: width, thickness, length [m]."""
_TIP_RADIUS = 0.010
"""Of their stick [m]."""

_Settings = TypeVar("_Settings")


def size_of(arms: Iterable[Arm]) -> float:
    """Return how many times as large arms and hands are as in the papers' laboratory, but at least 1.

    Of what the arms reach and what the hands touch with, the one that is least beside the papers' counts: distances
    must suit the smallest hand as well. Where something is smaller, bodies are known no better, and distances stay.
    """
    shares = [share for arm in arms for share in (arm.robot.reach / _REACH, _hand_size(arm.hand))]
    return max(1.0, min(shares))


def _hand_size(hand: Gripper | Pusher) -> float:
    return float(hand.pad_size[0]) / _PAD[0] if isinstance(hand, Gripper) else hand.tip_radius / _TIP_RADIUS


def pad_stiffness(pad: Array) -> float:
    """Return how many times as stiff as the papers' a gripper's pad is, by width, thickness and length (3,) [1].

    A layer of the same rubber is as stiff as its area over its thickness.
    """
    width, thickness, length = pad.tolist()
    return width * length / thickness / (_PAD[0] * _PAD[2] / _PAD[1])


def tip_stiffness(radius: float, force: float) -> float:
    """Return how many times as stiff as the papers' a stick's tip is, of the same rubber [1].

    By Hertz a ball's contact is the larger the harder it is pressed: its stiffness grows with the cube root of radius
    times force.

    Args:
        radius: of the tip [m].
        force: with which it presses at most [N].
    """
    return ((radius / _TIP_RADIUS) * (force / HandForceLimit().normal)) ** (1.0 / 3.0)


def resized(settings: _Settings, times: float, *names: str) -> _Settings:
    """Return settings, a dataclass, in which some members, numbers or tuples of such, are so many times as large."""
    changed = {name: _times(getattr(settings, name), times) for name in names}
    return replace(settings, **changed)  # pyright: ignore[reportArgumentType, reportCallIssue, reportUnknownVariableType]


def _times(value: Any, times: float) -> Any:
    return tuple(_times(each, times) for each in value) if isinstance(value, tuple) else times * value
