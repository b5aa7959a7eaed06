"""Inverse kinematics: all branches in closed form, beside one solution by iteration."""

from __future__ import annotations

from time import process_time

import numpy as np
from numba import njit

from planners.kinematics.forward import flange_pose
from planners.kinematics.inverse import inverse_kinematics
from tests.benchmarks.iterative_ik import iterate
from tests.kinematics.arm_oracle import UR3E, PinocchioArm

POSES, ITERATED = 100_000, 300


def measure() -> dict[str, float]:
    """Return CPU microseconds per reachable pose."""
    rng = np.random.default_rng(0)
    reached = rng.uniform(-np.pi, np.pi, (POSES, 6))
    targets = np.array([flange_pose(UR3E, np.eye(4), q) for q in reached])
    all_branches(UR3E, targets[:1])
    begun = process_time()
    solutions = all_branches(UR3E, targets)
    closed_us = 1e6 * (process_time() - begun) / POSES
    arm = PinocchioArm(UR3E)
    begun = process_time()
    found = [iterate(arm, target, rng.uniform(-np.pi, np.pi, 6)) for target in targets[:ITERATED]]
    iterated_us = 1e6 * (process_time() - begun) / ITERATED
    return {
        "closed_form_us": closed_us,
        "solutions_per_pose": solutions / POSES,
        "iteration_us": iterated_us,
        "iteration_found_share": sum(q is not None for q in found) / ITERATED,
        "iteration_over_closed_form": iterated_us / closed_us,
    }


@njit(cache=True)
def all_branches(dh, targets):
    solutions, count = np.empty((8, 6)), 0
    for k in range(targets.shape[0]):
        valid = inverse_kinematics(dh, targets[k], 0.0, solutions)
        for branch in range(8):
            count += (valid >> branch) & 1
    return count
