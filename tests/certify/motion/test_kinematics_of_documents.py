"""Forward kinematics against the contract's formula, the Hermite curve against scipy."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from planners.certify.motion.kinematics import ArmKinematics, HermiteCurve
from planners.geometry.pose import rotation_from_vector, rotation_x, rotation_z, transform


def test_frames_are_the_contracts_product() -> None:
    """`base · Π Rz(q + theta0) Tz(d) Tx(a) Rx(alpha)`, for any table."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        dh = rng.normal(size=(6, 4))
        T = transform(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3))
        q = rng.normal(size=6)
        frames = ArmKinematics(dh, T).frames(q[None])[0]
        np.testing.assert_allclose(frames[0], T, atol=1e-12)
        for i, (a, alpha, d, theta0) in enumerate(dh):
            turn = transform(rotation_z(q[i] + theta0), [0.0, 0.0, 0.0])
            T = T @ turn @ transform(None, [a, 0.0, d]) @ transform(rotation_x(alpha))
            np.testing.assert_allclose(frames[i + 1], T, atol=1e-12)


def test_extremes_of_the_hermite_curve_are_those_of_its_samples() -> None:
    """No dense sample leaves the extremes, and some sample comes close to each."""
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.1, 1.0, size=30))
    positions, velocities = rng.normal(size=(2, 30, 4))
    positions[5], velocities[5:7] = positions[6], 0.0
    curve, spline = HermiteCurve(time, positions, velocities), CubicHermiteSpline(time, positions, velocities)
    low, high = curve.position_extremes()
    u = np.linspace(0.0, 1.0, 401)
    for i in range(29):
        t = time[i] + u * (time[i + 1] - time[i])
        for values, peak in (
            (spline(t), high[i]),
            (-spline(t), -low[i]),
            (np.abs(spline(t, 1)), curve.velocity_peak[i]),
            (np.abs(spline.derivative(2)(np.clip(t, time[i] + 1e-9, time[i + 1] - 1e-9))), curve.acceleration_peak[i]),
        ):
            assert np.all(values.max(axis=0) <= peak + 1e-6)
            assert np.all(values.max(axis=0) >= peak - 1e-3 * (1 + np.abs(peak)))
        np.testing.assert_allclose(curve.position(i, 0.3), spline(time[i] + 0.3 * (time[i + 1] - time[i])), atol=1e-12)
