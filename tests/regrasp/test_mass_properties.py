"""Inertia of a moving body."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from planners.geometry.pose import rotation_from_vector, transform
from planners.regrasp.statics.mass_properties import MassProperties


def test_the_tensor_is_that_of_the_filled_surface() -> None:
    mesh = trimesh.creation.annulus(0.03, 0.05, 0.1).apply_transform(trimesh.transformations.random_rotation_matrix())
    com = np.array(mesh.center_mass)
    found = MassProperties.homogeneous(2.0, com, np.array(mesh.vertices), np.array(mesh.faces)).tensor
    assert found == pytest.approx(np.array(mesh.moment_inertia) / mesh.volume * 2.0, rel=1e-9, abs=1e-12)


def test_inertia_is_the_rate_of_change_of_momentum() -> None:
    """A body that is thrown and tumbles freely needs nothing but its weight: Euler's equations, integrated."""
    tensor = np.diag([2e-3, 3e-3, 4.5e-3])
    body = MassProperties(0.5, np.array([0.01, -0.02, 0.03]), tensor)
    step, count, fine = 0.01, 30, 200
    R, omega = np.eye(3), np.array([1.0, 2.0, -1.5])
    time, poses = np.arange(count) * step, []
    for moment in time:
        centre = np.array([0.3, 0.1, 0.5]) * moment - 0.5 * 9.81 * moment**2 * np.array([0.0, 0.0, 1.0])
        poses.append(transform(R, centre - R @ body.com))
        for _ in range(fine):
            h = step / fine
            middle = omega + 0.5 * h * np.linalg.solve(tensor, np.cross(tensor @ omega, omega))
            R = R @ rotation_from_vector(middle * h)
            omega = omega + h * np.linalg.solve(tensor, np.cross(tensor @ middle, middle))
    found = body.inertial_wrenches(time, np.array(poses))
    assert found[:, :3] == pytest.approx(np.tile([0.0, 0.0, 0.5 * 9.81], (count, 1)), abs=1e-6)
    assert np.abs(found[:, 3:]).max() < 1e-5


def test_a_body_that_is_sped_up_in_its_turning_needs_a_moment() -> None:
    tensor = np.diag([2e-3, 3e-3, 4e-3])
    time = np.sort(np.random.default_rng(0).uniform(0.0, 1.0, 60))
    poses = np.array([transform(rotation_from_vector([0.0, 0.0, 1.5 * t**2])) for t in time])
    found = MassProperties(1.0, np.zeros(3), tensor).inertial_wrenches(time, poses)
    assert found[:, 5] == pytest.approx(np.full(60, -3.0 * 4e-3), rel=1e-6)
    assert np.abs(found[:, [0, 1, 2, 3, 4]]).max() < 1e-12


def test_a_body_at_rest_has_no_inertia() -> None:
    found = MassProperties(1.0, np.zeros(3), np.eye(3)).inertial_wrenches(np.arange(4.0), np.tile(np.eye(4), (4, 1, 1)))
    assert not found.any()
