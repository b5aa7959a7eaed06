"""Every contact within its cone and its limit, and with the parameters of the task."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planners.certify.finding import Finding
from planners.certify.geometry.vectors import angle, cross, length
from planners.certify.motion.segment_motion import BodyContacts
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array
from planners.plan.contacts import BearingContact, EnvironmentContact, PointContact, SoftFingerContact, SuctionContact
from planners.plan.verdicts import Check

_UP = np.array([0.0, 0.0, 1.0])
_SQUARE = 1e-3
"""Length of an axis projected on a pad below which it is square to the pad [1]."""


@dataclass(frozen=True)
class StatedCup:
    """What the hold of a suction cup depends on."""

    radius: float
    """[m]"""
    max_force: float
    """[N]"""
    mu: float
    kappa: float
    """[N]"""


@dataclass(frozen=True)
class ContactLimits:
    """What contacts of one plan can bear."""

    friction: Mapping[str, float]
    """By kind of contact: "soft_finger", "point", "environment"."""
    eps: float
    """Torsional friction of a finger [m]."""
    normal: float
    """Largest normal force of a hand's contact [N]: of a finger that squeezes see `finger`."""
    hands: Mapping[str, float]
    """Largest net force of each arm's hand [N]."""
    cup: StatedCup | None
    """None: believed as each contact states it."""
    model: str
    """"paper", "cable" or "dexnet"."""
    pads: float = math.inf
    """What no finger may press more than, however hard it squeezes [N]."""

    def finger(self, arm: str, squeeze: float | None) -> float:
        """Return the largest normal force of a finger [N].

        A load along the closing axis adds half of itself to one finger and takes it from the other.
        """
        return self.normal if squeeze is None else min(self.pads, squeeze + 0.5 * self.hands[arm])


class ConeChecks:
    """Friction (paper B, 5c–5e), suction (5f–5h), limits of normals, hands and cup (5i)."""

    def __init__(self, limits: ContactLimits, settings: CertifySettings) -> None:
        self._limits, self._slack, self._equal = limits, settings.cone_slack, settings.join
        self._friction = Finding("friction", "N")
        self._suction = Finding("suction", "N")
        self._suction_moment = Finding("suction_moment", "Nm")
        self._torque = Finding("contact_torque", "Nm")
        self._normal = Finding("normal_force", "N")
        self._hand = Finding("hand_force", "N")
        self._cup = Finding("cup_force", "N")
        self._parameters = Finding("contact_parameters", "1")

    def run(self, sets: Sequence[BodyContacts]) -> list[Check]:
        """Check all contact sets."""
        for contact_set in sets:
            for contact in contact_set.bearing:
                where = f"{contact_set.where} by {contact_name(contact)} ({contact.kind})"
                if contact.kind == "suction":
                    self._suction_limits(contact, where)
                else:
                    self._contact(contact, where)
            for arm, net in contact_set.net_forces.items():
                self._hand.note(self._limits.hands[arm] + self._slack - net, f"{contact_set.where} by {arm}")
        return [
            self._friction.check(),
            self._suction.check(),
            self._suction_moment.check(),
            self._torque.check(),
            self._normal.check(),
            self._hand.check(),
            self._cup.check(),
            self._parameters.check(),
        ]

    def _contact(self, contact: SoftFingerContact | PointContact | EnvironmentContact, where: str) -> None:
        pressed = float(contact.force @ contact.normal)
        sliding = length(contact.force - pressed * contact.normal)
        turning = float(contact.torque @ contact.normal)
        other = length(contact.torque - turning * contact.normal)
        self._same(contact.mu, self._limits.friction.get(contact.kind), f"{where}: mu")
        if contact.kind == "soft_finger":
            self._same(contact.eps, self._limits.eps, f"{where}: eps")
            sliding = math.hypot(sliding, turning / max(contact.eps, 1e-12))
            self._same(contact.limit, self._limits.finger(contact.by, contact.squeeze), f"{where}: limit")
        else:
            other = math.hypot(other, turning)
        if contact.kind == "point":
            self._same(contact.limit, self._limits.normal, f"{where}: limit")
        self._torque.note(self._slack - other, where)
        self._friction.note(contact.mu * pressed - sliding + self._slack, where)
        self._normal.note(pressed + self._slack, where)
        if contact.limit is not None:
            self._normal.note(contact.limit + self._slack - pressed, where)

    def _same(self, value: float | None, stated: float | None, where: str) -> None:
        if stated is None or value is None:
            self._parameters.require(False, where, "is not known")
        else:
            self._parameters.note(self._equal - abs(value - stated), where)

    def _suction_limits(self, contact: SuctionContact, where: str) -> None:
        cup, slack = self._limits.cup, self._slack
        if cup is not None:
            self._same(contact.mu, cup.mu, f"{where}: mu")
            self._same(contact.radius, cup.radius, f"{where}: radius")
            self._same(contact.kappa, cup.kappa, f"{where}: kappa")
            self._same(contact.limit, cup.max_force, f"{where}: limit")
        force = contact.suction_force
        self._cup.note(contact.limit + slack - force, where)
        self._cup.note(force + slack, f"{where}: presses")
        if self._limits.model == "cable":
            up = float(contact.force @ _UP)
            self._suction.note(slack - length(contact.force - up * _UP), f"{where}: not vertical")
            self._suction.note(slack - abs(up - force), f"{where}: suction_force")
            self._torque.note(slack - length(contact.torque), where)
            return
        pull, shear, twist, bend = pad_loads(contact)
        self._suction.note(slack - abs(pull - force), f"{where}: suction_force")
        hold = contact.mu * (force if self._limits.model == "paper" else contact.limit - force)
        slips, twists, peels = pad_margins(hold, shear, twist, bend, contact.radius, contact.kappa)
        self._suction.note(float(slips) + slack, f"{where}: shear")
        self._suction_moment.note(float(twists) + slack, f"{where}: twist")
        self._suction_moment.note(float(peels) + slack, f"{where}: peel")


def contact_name(contact: BearingContact) -> str:
    """Name who makes a contact."""
    return contact.by if contact.finger is None else f"{contact.by} finger {contact.finger}"


def pad_loads(contact: SuctionContact) -> tuple[float, Array, float, Array]:
    """Return what a suction pad bears.

    Returns:
        The pull outward [N], shear along the pad's x and y (2,) [N], torque about its normal [Nm], and about its x and
        y (2,) [Nm].
    """
    x, z = contact.x_axis, contact.normal
    axes = np.array([x, cross(z, x)])
    return -float(contact.force @ z), axes @ contact.force, float(contact.torque @ z), axes @ contact.torque


def pad_margins(
    hold: Array | float, shear: Array, twist: Array | float, bend: Array, radius: float, kappa: float
) -> tuple[Array, Array, Array]:
    """Return what a suction pad's bounds (paper B, 5f-5h) leave of shear [N], of twist [Nm] and of bend [Nm]: (...,).

    Args:
        hold: (...,) largest shear [N].
        shear: (..., 2) force along the pad's x and y [N].
        twist: (...,) torque about the pad's normal [Nm].
        bend: (..., 2) torque about the pad's x and y [Nm].
        radius: of the pad [m].
        kappa: how stiff the lip is against bending [N].
    """
    slips = hold - math.sqrt(3.0) * np.abs(shear).max(axis=-1)
    twists = radius * hold - math.sqrt(3.0) * np.abs(twist)
    peels = math.pi * radius * kappa - math.sqrt(2.0) * np.abs(bend).max(axis=-1)
    return slips, twists, peels


def x_axis_error(contact: SuctionContact, T_world_body: Array) -> float:
    """Return the angle between a pad's x axis as stated and as it is [rad]."""
    return angle(contact.x_axis, pad_x_axes(T_world_body[None], contact.normal[None])[0])


def pad_x_axes(poses: Array, normals: Array) -> Array:
    """Return the x axis of a pad on a body: the body's x projected on the pad, or its y where x is square to the pad.

    Args:
        poses: (n, 4, 4) `T_world_body`.
        normals: (n, 3) unit, of the pad.

    Returns:
        (n, 3) unit vectors, world axes.
    """
    x, y = (poses[:, :3, k] - normals * np.sum(poses[:, :3, k] * normals, axis=1, keepdims=True) for k in (0, 1))
    axes = np.where(np.linalg.norm(x, axis=1, keepdims=True) > _SQUARE, x, y)
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)
