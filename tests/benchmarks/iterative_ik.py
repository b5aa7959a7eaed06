"""Inverse kinematics as the paper's system does it: by iteration, here damped least squares on pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from tests.kinematics.arm_oracle import PinocchioArm

MAX_ITERATIONS = 100
DAMPING = 1e-4
TOLERANCE = 1e-5
"""Norm of the twist that is left [m, rad]."""
LARGEST_STEP = 0.5
"""Of one joint in one iteration [rad]."""


def iterate(arm: PinocchioArm, T_base_flange: np.ndarray, q_start: np.ndarray) -> np.ndarray | None:
    """Return joint positions (6,) that reach a pose, or None if the iteration does not get there."""
    target, q = pin.SE3(T_base_flange), q_start.copy()
    for _ in range(MAX_ITERATIONS):
        pin.forwardKinematics(arm.model, arm.data, q)
        error = pin.log6(pin.updateFramePlacement(arm.model, arm.data, arm.flange).actInv(target)).vector
        if np.linalg.norm(error) < TOLERANCE:
            return np.remainder(q + np.pi, 2 * np.pi) - np.pi
        J = pin.computeFrameJacobian(arm.model, arm.data, q, arm.flange, pin.LOCAL)
        step = J.T @ np.linalg.solve(J @ J.T + DAMPING * np.eye(6), error)
        q += step * min(1.0, LARGEST_STEP / np.abs(step).max())
    return None
