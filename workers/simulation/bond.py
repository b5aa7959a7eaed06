"""Compliant holds: what fingers do to the tool, and the cup to an object, as springs and dampers in all six directions.

All bonds of a chain hand, tool, object are solved together and implicitly, as of the end of the step. So a hold may be
as stiff as rubber is, and what it holds as light as it likes, without the step having to be shorter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planners.geometry.pose import Array, Transform, inverse, small_motion
from workers.simulation.free_body import FreeBody


@dataclass(frozen=True)
class BondStiffness:
    """A hold's compliance."""

    linear: float
    """[N/m]"""
    angular: float
    """[Nm/rad]"""
    damping_time: float
    """Damping over stiffness [s]."""

    def diagonals(self) -> tuple[Array, Array]:
        """Return stiffness and damping (6,)."""
        stiffness = np.array([self.linear] * 3 + [self.angular] * 3)
        return stiffness, self.damping_time * stiffness


class Bond:
    """Ties a child to a parent's frame as the two are when it is made; it pulls at the parent's origin."""

    def __init__(
        self, child: FreeBody, parent: FreeBody | None, T_world_parent: Transform, give: BondStiffness
    ) -> None:
        """Tie them.

        Args:
            child: what is held.
            parent: what holds it; None: a hand, whose way is given.
            T_world_parent: the frame at whose origin it is held.
            give: its compliance.
        """
        self.child, self.parent = child, parent
        self.stiffness, self.damping = give.diagonals()
        self.T_world_parent = T_world_parent
        self.hand_twist = np.zeros(6)
        """(6,) velocity of a hand at the origin of its frame, world axes."""
        self.wrench: Array = np.zeros(6)
        """(6,) on the child about the parent's origin, world axes [N, Nm]."""
        self._T_child_parent = inverse(child.T_world_body) @ T_world_parent

    @property
    def point(self) -> Array:
        """(3,) where it acts, in the world [m]."""
        return self.T_world_parent[:3, 3]

    def follow(self, T_world_parent: Transform, hand_twist: Array | None = None) -> None:
        """Tell it where its parent is now, and how a hand moves."""
        self.T_world_parent = T_world_parent
        if hand_twist is not None:
            self.hand_twist = hand_twist

    def wrench_in_parent(self) -> Array:
        """Return the wrench (6,) on the child in the axes of the parent's frame."""
        return (self.wrench.reshape(2, 3) @ self.T_world_parent[:3, :3]).reshape(6)

    def displacement(self) -> Array:
        """Return how far (6,) the parent is ahead of the child, world axes [m, rad]."""
        T_world_rest = self.child.T_world_body @ self._T_child_parent
        # The sine of the angle times the axis: holds give way by few degrees.
        return small_motion(T_world_rest, self.T_world_parent)

    def lead(self, gained: Array) -> Array:
        """Return how fast (6,) the parent moves ahead, where free bodies have gained a velocity (3,) by themselves."""
        gain = np.concatenate([gained, np.zeros(3)])
        parent = self.hand_twist if self.parent is None else self.parent.twist_at(self.point) + gain
        return parent - self.child.twist_at(self.point) - gain


def exert(bonds: Sequence[Bond], step: float, gravity: Array) -> None:
    """Find the wrenches of bonds for the next step and push the free bodies with them.

    With x how far a parent is ahead, u how fast, K and C stiffness and damping, h the step and W the mobility,
    `F = K (x + h u') + C u'` with `u' = u - h W F` is linear in all wrenches F.

    Args:
        bonds: all there are.
        step: [s].
        gravity: (3,) [m/s^2].
    """
    if not bonds:
        return
    size = 6 * len(bonds)
    matrix, right = np.eye(size), np.empty(size)
    for i, bond in enumerate(bonds):
        rows = slice(6 * i, 6 * i + 6)
        rate = step * bond.stiffness + bond.damping
        right[rows] = bond.stiffness * bond.displacement() + rate * bond.lead(step * gravity)
        for j, other in enumerate(bonds):
            W = _mobility(bond, other)
            if W is not None:
                matrix[rows, 6 * j : 6 * j + 6] += step * rate[:, None] * W
    wrenches = np.asarray(np.linalg.solve(matrix, right), dtype=np.float64).reshape(-1, 6)
    for bond, wrench in zip(bonds, wrenches, strict=True):
        bond.wrench = wrench
        bond.child.push(wrench, bond.point)
        if bond.parent is not None:
            bond.parent.push(-wrench, bond.point)


def _mobility(one: Bond, other: Bond) -> Array | None:
    """Return (6, 6): how the lead of one bond is lost under the wrench of another; None: not at all."""
    total = None
    for body, sign in ((one.child, 1.0), (one.parent, -1.0)):
        for pushed, push in ((other.child, 1.0), (other.parent, -1.0)):
            if body is not None and body is pushed:
                W = sign * push * body.mobility(one.point, other.point)
                total = W if total is None else total + W
    return total
