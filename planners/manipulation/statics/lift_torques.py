"""Whether the arms' joints bear themselves, their hands and what the hands exert on the plate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.balance.balanced import Balanced
from planners.geometry.pose import Array, Transform
from planners.geometry.wrench import rotated
from planners.graph.rejections import Rejection
from planners.kinematics.joint_torque import joint_torques
from planners.manipulation.reach.lift_workcell import LiftWorkcell
from planners.motion.trajectory import Trajectory

TORQUE_RESERVE = 0.07
"""Part of each joint's largest torque that no plan uses [1]. The certificate keeps 0.05, and looks between contact sets
as well, where forces change evenly."""
OVERTAXED = "A joint would need more torque than it may give."
"""Why hands fall that could hold the plate."""


@dataclass(frozen=True, eq=False)
class LiftTorques:
    """Joint torques of both arms of one plate lift."""

    workcell: LiftWorkcell

    def share(self, trajectory: Trajectory, sample: int, T_world_plate: Transform, balance: Balanced) -> float:
        """Return the greatest part of any joint's largest torque that is used at a sample [1]."""
        return max(float(np.max(used)) for _, used in self._used(trajectory, sample, T_world_plate, balance))

    def refusal(
        self, trajectory: Trajectory, sample: int, T_world_plate: Transform, balance: Balanced
    ) -> Rejection | None:
        """Say which joint would need too much torque [Nm] at a sample, or None; the plate is at its pose (4, 4)."""
        for name, used in self._used(trajectory, sample, T_world_plate, balance):
            joint = int(np.argmax(used))
            if used[joint] > 1.0 - TORQUE_RESERVE:
                arm = self.workcell.arm(name)
                most = float(arm.torque_max[joint])
                needed, available = float(used[joint]) * most, (1.0 - TORQUE_RESERVE) * most
                return Rejection.measured("torque", OVERTAXED, arm.joint_names[joint], needed, available, "Nm")
        return None

    def _used(
        self, trajectory: Trajectory, sample: int, T_world_plate: Transform, balance: Balanced
    ) -> list[tuple[str, Array]]:
        """Return of each arm the share (6,) of its joints' largest torques that a sample uses [1]."""
        scene = self.workcell.scene
        R, p = T_world_plate[:3, :3], T_world_plate[:3, 3]
        com, wrenches = R @ scene.plate.com + p, rotated(R, balance.hand_wrenches)
        result = []
        for name, wrench in zip((self.workcell.gripper, self.workcell.pusher), wrenches, strict=True):
            arm, joints = self.workcell.arm(name), self.workcell.joints(name)
            rows = (trajectory.positions, trajectory.velocities, trajectory.accelerations)
            q, v, a = (np.ascontiguousarray(row[sample : sample + 1, joints]) for row in rows)
            torques = joint_torques(arm.weighed(scene.cell.gravity), q, v, a, wrench[None], com[None])
            result.append((name, np.abs(torques[0]) / arm.torque_max))
        return result
