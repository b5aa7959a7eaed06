"""Whether an arm's joints bear arm, hand, tool and object: at rest in a posture, along an edge, and in timed motion.

Tool and object are point masses fixed to the flange. Of each joint's largest torque more is kept back where postures
are chosen than in motion, so that motion has something left, and more in motion than the certificate asks for, which
counts how the bodies turn as well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit

from planners.cell.arm import Arm
from planners.geometry.pose import Array, Transform, inverse
from planners.geometry.wrench import wrench_about
from planners.graph.rejections import Rejection
from planners.kinematics.forward import link_frames
from planners.kinematics.inverse import inverse_kinematics
from planners.kinematics.joint_torque import WeighedArm, joint_torques, torques_at_rest
from planners.motion.checker import EdgeChecker
from planners.motion.trajectory import Trajectory
from planners.regrasp.grasps.grasp_reach import Branches
from planners.regrasp.statics.static_hold import CarriedLoad, CarryingHand

OVERTAXED = "A joint would need more torque than it may give."
"""Why a grasp cannot have the tool at a pose."""
_SLOWEST = 32.0
"""Factors of time beyond which slowing down is not tried: inertia is a thousandth of what it was."""
_ROUNDING = 1e-9


@dataclass(frozen=True)
class TorqueSettings:
    """Parts of each joint's largest torque that are kept back; the certificate keeps 0.05."""

    posture_reserve: float = 0.10
    """At rest, where postures are chosen and along free motion."""
    motion_reserve: float = 0.07
    """In timed motion, inertia counted."""


@dataclass(frozen=True, eq=False)
class LadenArm:
    """An arm with its hand, and with what hangs on it."""

    arm: Arm
    weighed: WeighedArm

    @classmethod
    def of(
        cls, arm: Arm, gravity: Array, T_flange_tool: Transform | None = None, load: CarriedLoad | None = None
    ) -> LadenArm:
        """Fix tool and object to an arm's flange; without them it carries nothing."""
        weighed = arm.weighed(gravity)
        if T_flange_tool is None or load is None:
            return cls(arm, weighed)
        centres = load.centres @ T_flange_tool[:3, :3].T + T_flange_tool[:3, 3]
        return cls(arm, weighed._replace(masses=np.vstack([weighed.masses, np.column_stack([load.masses, centres])])))

    def share(self, q: Array) -> float:
        """Return the greatest part of any joint's largest torque that q (6,) [rad] takes at rest [1]."""
        return _share_along(self.weighed, self.arm.torque_max, q, q, 1)

    def largest_share(self, q_from: Array, q_to: Array, step: float) -> float:
        """Return the largest such share [1] of all places along a straight joint motion.

        Args:
            q_from: (6,) [rad].
            q_to: (6,) [rad].
            step: largest joint step between the places that are looked at [rad].
        """
        steps = 1 + math.ceil(float(np.abs(q_to - q_from).max()) / step)
        return _share_along(self.weighed, self.arm.torque_max, q_from, q_to, steps)

    def stretch(self, timed: Trajectory, joints: slice, reserve: float, kind: str) -> float | Rejection:
        """Return the factor, 1 or more, by which time must be stretched for the joints to bear a motion.

        Velocities' and accelerations' parts of a torque fall with the square of the factor.

        Args:
            timed: of all joints.
            joints: which of them are this arm's.
            reserve: part of each joint's largest torque that is kept back [1].
            kind: of the motion, for the rejection.

        Returns:
            The factor; or, where the joints would not bear it however slow it is, which one and by how much.
        """
        rows = (timed.positions, timed.velocities, timed.accelerations)
        Q, V, A = (np.ascontiguousarray(row[:, joints]) for row in rows)
        still, middle = np.zeros((len(Q), 6)), np.zeros((len(Q), 3))
        limits = (1.0 - reserve) * self.arm.torque_max
        at_rest = joint_torques(self.weighed, Q, still, still, still, middle)
        inertial = joint_torques(self.weighed, Q, V, A, still, middle) - at_rest
        room = np.where(inertial < 0.0, limits + at_rest, limits - at_rest)
        share = float(np.min(room / np.maximum(np.abs(inertial), _ROUNDING), initial=1.0))
        # Where the joints do not bear the load at rest, what moves it may take load off them for a moment.
        if np.all(np.abs(at_rest) <= limits) and share >= _SLOWEST**-2:
            return 1.0 / math.sqrt(share)
        sample, joint = np.unravel_index(int(np.argmax(np.abs(at_rest) / limits)), at_rest.shape)
        name, needed = self.arm.joint_names[joint], abs(float(at_rest[sample, joint]))
        where = f"{name}, {timed.time[sample]:.3f} s into a {kind}"
        reason = f"{name} would need more torque than it may give."
        return Rejection.measured("torque", reason, where, needed, float(limits[joint]), "Nm")


def bearing_branches(
    arm: Arm, T_world_tool: Transform, T_tool_flange: Array, load: CarriedLoad, branches: Branches, reserve: float
) -> Branches:
    """Return those branches on which an arm's joints bear the tool, and what is on it, at rest.

    Args:
        arm: that has the tool.
        T_world_tool: where the tool is.
        T_tool_flange: (n, 4, 4) the flange on the tool in each grasp.
        load: what hangs on the hand.
        branches: (n,) sets of branches to look at, one for each grasp.
        reserve: part of each joint's largest torque that is kept back [1].
    """
    centres = load.centres @ T_world_tool[:3, :3].T + T_world_tool[:3, 3]
    weights = np.column_stack([-load.masses[:, None] * load.gravity, np.zeros((len(centres), 3))])
    wrench = wrench_about(weights, centres, T_world_tool[:3, 3]).sum(axis=0)
    limits = (1.0 - reserve) * arm.torque_max
    T_base_flanges = inverse(arm.T_world_base) @ T_world_tool @ T_tool_flange
    point = np.ascontiguousarray(T_world_tool[:3, 3])
    return _bearing_branches(arm.weighed(load.gravity), limits, T_base_flanges, wrench, point, branches)


@njit(cache=True, nogil=True)
def _bearing_branches(weighed, limits, T_base_flanges, wrench, point, branches):
    result = branches.copy()
    frames, solutions, torques = np.empty((7, 4, 4)), np.empty((8, 6)), np.empty(6)
    for grasp in range(branches.shape[0]):
        if branches[grasp] == 0:
            continue
        inverse_kinematics(weighed.dh, T_base_flanges[grasp], 0.0, solutions)
        for branch in range(8):
            if not (branches[grasp] >> branch) & 1:
                continue
            link_frames(weighed.dh, weighed.T_world_base, solutions[branch], frames)
            torques_at_rest(weighed, frames, wrench, point, torques)
            for i in range(6):
                if not abs(torques[i]) <= limits[i]:
                    result[grasp] &= ~np.uint8(1 << branch)
    return result


@njit(cache=True, nogil=True)
def _share_along(weighed, torque_max, q_from, q_to, steps):
    """Return the greatest part of any joint's largest torque at rest, at equal steps from one posture to another."""
    frames, q, torques = np.empty((7, 4, 4)), np.empty(6), np.empty(6)
    nothing = np.zeros(6)
    greatest = 0.0
    for k in range(steps + 1):
        for i in range(6):
            q[i] = q_from[i] + k / steps * (q_to[i] - q_from[i])
        link_frames(weighed.dh, weighed.T_world_base, q, frames)
        torques_at_rest(weighed, frames, nothing, nothing[:3], torques)
        for i in range(6):
            greatest = max(greatest, abs(torques[i]) / torque_max[i])
    return greatest


STEP = 0.05
"""Joint step between the places of an edge at which the load is looked at [rad]: it is no matter of collision."""


@dataclass(frozen=True, eq=False)
class LadenChecker:
    """An `EdgeChecker` that also bounds the tilt of the tool, and asks whether the load is borne at rest."""

    inner: EdgeChecker
    hand: CarryingHand
    least_cosine: float
    """Of the angle between the tool's axis and the vertical."""
    arm: LadenArm
    """The same arm, with the same load."""
    most_torque: float
    """Part of each joint's largest torque that may be used [1]."""

    def state_free(self, q: Array) -> bool:
        """Whether q (6,) [rad] is level enough, borne, and touches nothing."""
        return self._borne(q, q) and self.inner.state_free(q)

    def edge_free(self, q_from: Array, q_to: Array) -> bool:
        """Whether all of the straight line between q_from and q_to (6,) [rad] is so."""
        return self._borne(q_from, q_to) and self.inner.edge_free(q_from, q_to)

    def path_free(self, path: Array) -> bool:
        """Whether all of the polyline through the rows of path (m, 6) [rad] is so."""
        return all(self._borne(a, b) for a, b in pairwise(path)) and self.inner.path_free(path)

    def _borne(self, q_from: Array, q_to: Array) -> bool:
        held = self.hand.bears(q_from, q_to, STEP, self.least_cosine)
        return held and self.arm.largest_share(q_from, q_to, STEP) <= self.most_torque
