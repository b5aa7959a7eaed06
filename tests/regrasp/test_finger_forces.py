"""Two soft fingers: the closed form is the least of the cone program."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest

from planners.regrasp.finger_forces import least_squeeze, scaled

WIDTH, MU, EPS = 0.018, 0.5, 0.0075


def random_wrenches(count: int) -> np.ndarray:
    wrenches = np.random.default_rng(3).normal(size=(count, 6)) * [5.0, 5.0, 5.0, 0.2, 0.2, 0.2]
    wrenches[0] = 0.0
    wrenches[1, [0, 2, 3, 5]] = 0.0  # squeezed and twisted about the closing axis
    wrenches[2, [1, 4]] = 0.0
    wrenches[3, 1] = -20.0
    wrenches[4, 4] = 0.0
    return wrenches


def least_by_cone_program(wrench: np.ndarray) -> float:
    """The program as it is written: both fingers' forces and torques free, the greater normal least."""
    forces, torques, most = cp.Variable((2, 3)), cp.Variable(2), cp.Variable()
    y = np.array([0.0, 1.0, 0.0])
    constraints, force, moment = [], 0, 0
    for finger, inward in ((0, 1.0), (1, -1.0)):
        point = -0.5 * WIDTH * inward * y
        cross = np.array([[0, -point[2], point[1]], [point[2], 0, -point[0]], [-point[1], point[0], 0]])
        force, moment = force + forces[finger], moment + cross @ forces[finger] + torques[finger] * y
        normal = inward * forces[finger, 1]
        shear = cp.hstack([forces[finger, 0], forces[finger, 2], torques[finger] / EPS])
        constraints += [cp.norm(shear) <= MU * normal, normal <= most]
    constraints += [force == wrench[:3], moment == wrench[3:]]
    problem = cp.Problem(cp.Minimize(most), constraints)
    problem.solve(solver=cp.CLARABEL)
    return float(most.value)


def test_the_least_squeeze_is_that_of_the_cone_program() -> None:
    wrenches = random_wrenches(25)
    found = least_squeeze(wrenches, WIDTH, MU, EPS).normal
    assert found == pytest.approx([least_by_cone_program(wrench) for wrench in wrenches], abs=1e-5)


def test_the_fingers_exert_the_wrench_and_stay_in_their_cones() -> None:
    wrenches = random_wrenches(500)
    exerted = least_squeeze(wrenches, WIDTH, MU, EPS)
    points = np.array([[0.0, -0.5 * WIDTH, 0.0], [0.0, 0.5 * WIDTH, 0.0]])
    moments = np.cross(points, exerted.forces).sum(axis=1)
    moments[:, 1] += exerted.torques.sum(axis=1)
    assert exerted.forces.sum(axis=1) == pytest.approx(wrenches[:, :3], abs=1e-12)
    assert moments == pytest.approx(wrenches[:, 3:], abs=1e-12)
    normals = exerted.forces[:, :, 1] * [1.0, -1.0]
    shear = np.sqrt(exerted.forces[:, :, 0] ** 2 + exerted.forces[:, :, 2] ** 2 + (exerted.torques / EPS) ** 2)
    assert np.all(MU * normals - shear >= -1e-9)
    assert normals.max(axis=1) == pytest.approx(exerted.normal)


def test_a_share_of_the_load_needs_that_share_of_the_squeeze() -> None:
    wrenches = random_wrenches(50)
    share = np.linspace(0.0, 1.0, 50)
    by_share = scaled(least_squeeze(wrenches, WIDTH, MU, EPS), share)
    assert by_share.normal == pytest.approx(least_squeeze(wrenches * share[:, None], WIDTH, MU, EPS).normal, abs=1e-9)
