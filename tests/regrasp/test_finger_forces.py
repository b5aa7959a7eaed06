"""Two soft fingers that squeeze: the closed forms are the least of the cone programs."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest

from planners.regrasp.statics.finger_forces import least_squeeze, squeezed

WIDTH, MU, EPS = 0.018, 0.5, 0.0075


def random_wrenches(count: int) -> np.ndarray:
    wrenches = np.random.default_rng(3).normal(size=(count, 6)) * [5.0, 5.0, 5.0, 0.2, 0.2, 0.2]
    wrenches[0] = 0.0
    wrenches[1, [0, 2, 3, 5]] = 0.0  # squeezed and twisted about the closing axis
    wrenches[2, [1, 4]] = 0.0
    wrenches[3, 1] = -20.0
    wrenches[4, 4] = 0.0
    return wrenches


def stated(wrench: np.ndarray, mu: float | cp.Expression, squeeze: float | cp.Expression) -> list[cp.Constraint]:
    """The model as it is written: forces and torques free, but that both normals add up to twice the squeeze."""
    forces, torques = cp.Variable((2, 3)), cp.Variable(2)
    y = np.array([0.0, 1.0, 0.0])
    constraints, force, moment, normals = [], 0, 0, []
    for finger, inward in ((0, 1.0), (1, -1.0)):
        point = -0.5 * WIDTH * inward * y
        cross = np.array([[0, -point[2], point[1]], [point[2], 0, -point[0]], [-point[1], point[0], 0]])
        force, moment = force + forces[finger], moment + cross @ forces[finger] + torques[finger] * y
        normals.append(inward * forces[finger, 1])
        shear = cp.hstack([forces[finger, 0], forces[finger, 2], torques[finger] / EPS])
        # With the normals as the squeeze and the wrench make them, so that friction may be the unknown.
        constraints.append(cp.norm(shear) <= mu * (squeeze + 0.5 * inward * wrench[1]))
    return [*constraints, normals[0] + normals[1] == 2.0 * squeeze, *(n >= 0.0 for n in normals),
            force == wrench[:3], moment == wrench[3:]]  # fmt: skip


def solved(unknown: cp.Variable, constraints: list[cp.Constraint]) -> float:
    cp.Problem(cp.Minimize(unknown), constraints).solve(solver=cp.CLARABEL)
    return float(unknown.value)


def test_what_friction_is_used_is_the_least_of_the_cone_program() -> None:
    wrenches, squeeze = random_wrenches(25), 30.0
    found = squeezed(wrenches, WIDTH, MU, EPS, squeeze).slip
    least = []
    for wrench in wrenches:
        part = cp.Variable()
        least.append(solved(part, stated(wrench, MU * part, squeeze)))
    assert found == pytest.approx(least, abs=1e-5)


def test_the_least_squeeze_is_that_of_the_cone_program() -> None:
    wrenches = random_wrenches(25)
    least = []
    for wrench in wrenches:
        squeeze = cp.Variable()
        least.append(solved(squeeze, stated(wrench, MU, squeeze)))
    assert least_squeeze(wrenches, WIDTH, MU, EPS) == pytest.approx(least, abs=1e-5)


def test_the_fingers_exert_the_wrench_and_squeeze_as_they_should() -> None:
    wrenches, squeeze = random_wrenches(500), 40.0
    exerted = squeezed(wrenches, WIDTH, MU, EPS, squeeze)
    points = np.array([[0.0, -0.5 * WIDTH, 0.0], [0.0, 0.5 * WIDTH, 0.0]])
    moments = np.cross(points, exerted.forces).sum(axis=1)
    moments[:, 1] += exerted.torques.sum(axis=1)
    assert exerted.forces.sum(axis=1) == pytest.approx(wrenches[:, :3], abs=1e-12)
    assert moments == pytest.approx(wrenches[:, 3:], abs=1e-12)
    assert exerted.normals.sum(axis=1) == pytest.approx(np.full(500, 2.0 * squeeze))
    shear = np.sqrt(exerted.forces[:, :, 0] ** 2 + exerted.forces[:, :, 2] ** 2 + (exerted.torques / EPS) ** 2)
    assert (shear / (MU * exerted.normals)).max(axis=1) == pytest.approx(exerted.slip)


def test_fingers_hold_just_what_needs_no_harder_squeeze() -> None:
    wrenches = random_wrenches(500)
    needed = least_squeeze(wrenches, WIDTH, MU, EPS)
    for squeeze in (20.0, 40.0, 80.0):
        holds = squeezed(wrenches, WIDTH, MU, EPS, squeeze).slip <= 1.0
        clear = np.abs(needed - squeeze) > 1e-6
        assert holds.any()
        assert not holds.all()
        np.testing.assert_array_equal(holds[clear], (needed <= squeeze)[clear])


def test_a_load_that_a_finger_would_have_to_pull_is_not_held() -> None:
    pulling = np.array([[0.0, 41.0, 0.0, 0.0, 0.0, 0.0], [0.0, -41.0, 0.0, 0.0, 0.0, 0.0]])
    assert np.all(squeezed(pulling, WIDTH, MU, EPS, 20.0).slip > 1.0)
    assert np.all(squeezed(pulling, WIDTH, MU, EPS, 21.0).slip <= 1.0)
