"""Poses as seven numbers, against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planners.geometry.pose import from_pose7, rotation_from_vector, to_pose7, to_pose7s, transform


def poses(rng):
    """Any turns, and half turns, where three of the four ways to a quaternion divide by nothing."""
    vectors = [*rng.uniform(-np.pi, np.pi, (200, 3)), *(np.pi * np.eye(3)), *(-np.pi * np.eye(3)), np.zeros(3)]
    return np.array([transform(rotation_from_vector(vector), rng.normal(size=3)) for vector in vectors])


def test_many_poses_are_written_as_scipy_writes_their_quaternions():
    transforms = poses(np.random.default_rng(0))
    written = to_pose7s(transforms)
    quaternions = Rotation.from_matrix(transforms[:, :3, :3]).as_quat(scalar_first=True)
    assert np.abs(np.sum(written[:, 3:] * quaternions, axis=1)) == pytest.approx(1.0)
    assert np.array_equal(written[:, :3], transforms[:, :3, 3])
    assert np.all(written[:, 3] >= 0.0)


def test_one_pose_is_written_as_among_many_and_read_back():
    transforms = poses(np.random.default_rng(1))
    for T, row in zip(transforms, to_pose7s(transforms), strict=True):
        assert to_pose7(T) == row.tolist()
        assert from_pose7(to_pose7(T)) == pytest.approx(T, abs=1e-12)
