"""Reuse one proof of imbalance against every node: all poses of the plate with all grips and pushes at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planners.balance.balanced import UnbalanceProof
from planners.balance.contact_power import environment_power, grip_power, point_velocity, push_power
from planners.balance.contacts import GripContacts, PushContact
from planners.balance.solver import PROOF_MARGIN, Balance
from planners.geometry.pose import Array


class TwistTable:
    """The nodes (pose, grip, push) of a plate lift, ready to be tested against twists.

    For any twist, the most power of all contacts at a node is a sum of table entries: one of the pose (weight,
    environment, cup), one of the grip, one of the push. Where the sum is negative the node cannot be balanced.
    """

    def __init__(
        self,
        balance: Balance,
        rotations: Array,
        environment_points: Sequence[Array],
        grips: Sequence[GripContacts],
        pushes: Sequence[PushContact],
    ) -> None:
        """List the nodes.

        Args:
            balance: The program that the proofs come from.
            rotations: (n, 3, 3), `R_world_plate` of each pose.
            environment_points: For each pose, (k, 3), where the plate stands, plate frame.
            grips: The gripper's contacts.
            pushes: The stick's contacts.
        """
        self._balance = balance
        self._rotations = np.asarray(rotations, dtype=float)
        self._ups = self._rotations[:, 2, :]
        self._groups = _same_count(environment_points, balance.com)
        self._cup_lever = balance.cup.T_plate_cup[:3, 3] - balance.com
        self._grip_levers = np.array([grip.points for grip in grips]).reshape(-1, 2, 3) - balance.com
        self._grip_normals = np.array([grip.normals for grip in grips]).reshape(-1, 2, 3)
        self._push_levers = np.array([push.point for push in pushes]).reshape(-1, 3) - balance.com
        self._push_normals = np.array([push.normal for push in pushes]).reshape(-1, 3)

    def infeasible(self, proof: UnbalanceProof | Array) -> NDArray[np.bool_]:
        """Test one twist, fixed in the plate, at every node.

        A motion fixed in the world instead was tried: it rules out hardly any node more.

        Args:
            proof: A proof found anywhere, or a bare twist (6,) in plate axes about the centre of mass.

        Returns:
            Booleans (pose, 1 + grip, 1 + push), index 0 for the hand that is absent: true where there is no balance.
        """
        proof = _as_proof(proof)
        balance, twist = self._balance, proof.twist
        friction, limits = balance.friction, balance.limits
        poses = self._pose_power(np.broadcast_to(twist, (len(self._rotations), 6)))
        grips = grip_power(twist, self._grip_levers, self._grip_normals, friction, limits, proof.net_multiplier)
        pushes = push_power(twist, self._push_levers, self._push_normals, friction, limits)
        grips, pushes = np.append(0.0, grips), np.append(0.0, pushes)
        threshold = -PROOF_MARGIN * balance.weight * max(float(np.linalg.norm(twist[:3])), 1.0)
        # One pass over all nodes, which are many: what the push would have to add.
        lacking = threshold - (poses[:, None] + grips)
        return pushes < lacking[:, :, None]

    def _pose_power(self, twists: Array) -> Array:
        """Return the most power of weight, environment and cup at each pose, (n,), for twists (n, 6) [W]."""
        balance = self._balance
        # A node must be held whichever plate within the tolerances it is, so the one that this motion rules out counts.
        power = balance.uncertainty.least_power(balance.weight, twists, self._ups)
        velocities = point_velocity(twists, self._cup_lever)
        power += balance.lifter.largest_power(velocities, twists[:, 3:], self._ups)
        for members, levers in self._groups:
            cones = balance.cones(levers + balance.com, self._ups[members])
            power[members] += environment_power(twists[members], levers, cones)
        return power


def _as_proof(proof: UnbalanceProof | Array) -> UnbalanceProof:
    """Take a twist (6,) for a proof without a multiplier."""
    return proof if isinstance(proof, UnbalanceProof) else UnbalanceProof(np.asarray(proof, dtype=float), np.zeros(3))


def _same_count(environment_points: Sequence[Array], com: Array) -> list[tuple[NDArray[np.intp], Array]]:
    """Group the poses by their number of environment points: indices (g,) and levers (g, k, 3)."""
    points = [np.asarray(each, dtype=float).reshape(-1, 3) for each in environment_points]
    counts = np.array([len(each) for each in points])
    groups = []
    for count in np.unique(counts[counts > 0]):
        members = np.flatnonzero(counts == count)
        groups.append((members, np.stack([points[index] for index in members]) - com))
    return groups
