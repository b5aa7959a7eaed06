"""Segments of a plate lift: what hands and plate do in one stretch of motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from planners.balance.balanced import Balanced
from planners.geometry.pose import Array, Transform
from planners.manipulation.contacts.contact_states import PrincipalContact
from planners.motion.trajectory import Trajectory
from planners.plan.segment import SegmentKind


@dataclass(frozen=True, eq=False)
class GripHold:
    """A gripper on the body."""

    arm: str
    T_body_tcp: Transform
    width: float
    T_flange_body: Transform
    """How the body is attached to the arm's flange."""
    flipped: bool
    """Whether the fingers are swapped against the order of the grip's contacts in `Balanced`."""


@dataclass(frozen=True, eq=False)
class PushHold:
    """A stick on the body."""

    arm: str
    point: Array
    """(3,) in the body frame [m]."""
    normal: Array
    """(3,) unit, into the body."""


@dataclass(frozen=True, eq=False)
class BalancedContacts:
    """All contacts on the body at one sample, in balance with its weight."""

    sample: int
    balance: Balanced


@dataclass(frozen=True, eq=False)
class LiftSegment:
    """One stretch of a plan; it starts where the last ended."""

    kind: SegmentKind
    movers: tuple[str, ...]
    """Arms whose joints change."""
    contact: PrincipalContact
    """Of the body with its support, strictly between the ends."""
    contact_points: Array
    """(k, 3) in the body frame [m]."""
    grip: GripHold | None
    push: PushHold | None
    trajectory: Trajectory
    """Of all twelve joints; its time starts at 0."""
    widths: Mapping[str, Array]
    """(n,) inner distance of each gripper's pads [m]."""
    T_world_body: Array
    """(n, 4, 4)"""
    contact_sets: tuple[BalancedContacts, ...]
