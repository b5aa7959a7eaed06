"""Forward kinematics and torques by pinocchio, and the curve that the arms follow between samples."""

# pinocchio has no type stubs for what its compiled part exports.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from functools import cached_property

import numpy as np
import pinocchio as pin

from planners.geometry.pose import Array, Transform, rotation_x, rotation_z, transform


class ArmKinematics:
    """One arm as a pinocchio model, `T_world_i = base · Π Rz(q + theta0) Tz(d) Tx(a) Rx(alpha)`."""

    def __init__(self, dh: Array, T_world_base: Transform) -> None:
        self._T_world_base = T_world_base
        self._T_joint_link = _joint_links(dh)
        self._model = _model(dh, T_world_base)
        self._data = self._model.createData()

    def frames(self, positions: Array) -> Array:
        """Return `T_world_i` of the frames after i = 0…6 joints: (n, 6) [rad] → (n, 7, 4, 4)."""
        joints = np.empty((len(positions), 6, 4, 4))
        placements = self._data.oMi
        for sample, q in enumerate(np.ascontiguousarray(positions)):
            pin.forwardKinematics(self._model, self._data, q)
            for joint in range(6):
                joints[sample, joint] = placements[joint + 1].homogeneous
        frames = np.empty((len(positions), 7, 4, 4))
        frames[:, 0] = self._T_world_base
        frames[:, 1:] = joints @ self._T_joint_link
        return frames


class ArmDynamics:
    """One arm as a pinocchio model with masses: the torques that move it and hold it against gravity."""

    def __init__(self, dh: Array, T_world_base: Transform, masses: Array, gravity: Array) -> None:
        """Put the arm together.

        Args:
            dh: (6, 4) rows a, alpha, d, theta0 [m, rad].
            T_world_base: (4, 4).
            masses: (7, 4) mass [kg] and centre of mass [m] of the links, each in the frame after its joint, then of the
                hand in the flange's; points without extent.
            gravity: (3,) in the world [m/s^2].
        """
        self._model = _model(dh, T_world_base)
        self._model.gravity.linear = gravity
        placements = _joint_links(dh)
        for number, (mass, *com) in enumerate(masses.tolist()):
            joint = min(number, 5)
            inertia = pin.Inertia(mass, np.array(com), np.zeros((3, 3)))
            self._model.appendBodyToJoint(joint + 1, inertia, pin.SE3(placements[joint]))
        self._data = self._model.createData()

    def torques(self, positions: Array, velocities: Array, accelerations: Array) -> Array:
        """Return what the motors exert at n samples of (n, 6) each [rad, rad/s, rad/s^2]: (n, 6) [Nm]."""
        rows = zip(*(np.ascontiguousarray(one) for one in (positions, velocities, accelerations)), strict=True)
        return np.array([pin.rnea(self._model, self._data, q, v, a) for q, v, a in rows])


def _joint_links(dh: Array) -> Array:
    """Return what a row does after its turn: (6, 4, 4). Pinocchio's joint frame stops after the turn about z."""
    return np.array([transform(rotation_x(alpha), [a, 0.0, d]) for a, alpha, d, _ in dh.tolist()])


def _model(dh: Array, T_world_base: Transform) -> pin.Model:
    """Return the joints of an arm, without masses."""
    model, parent, T_link_joint = pin.Model(), 0, T_world_base
    for joint, (row, T_joint_link) in enumerate(zip(dh, _joint_links(dh), strict=True)):
        placement = T_link_joint @ transform(rotation_z(float(row[3])))
        parent = model.addJoint(parent, pin.JointModelRZ(), pin.SE3(placement), f"joint_{joint + 1}")
        T_link_joint = T_joint_link
    return model


class HermiteCurve:
    """The cubic Hermite curve through samples of positions and velocities, (n, k) each."""

    def __init__(self, time: Array, positions: Array, velocities: Array) -> None:
        self._step = np.diff(time)[:, None]
        self._q0, self._q1 = positions[:-1], positions[1:]
        self._v0, self._v1 = velocities[:-1], velocities[1:]
        h, rise = self._step, positions[1:] - positions[:-1]
        # q(u) = q0 + h v0 u + c2 u² + c3 u³ for u = (t - t0) / h.
        self._c2 = 3 * rise - h * (2 * self._v0 + self._v1)
        self._c3 = h * (self._v0 + self._v1) - 2 * rise

    def position(self, interval: int, u: float) -> Array:
        """Return the positions at fraction `u` of an interval: (k,)."""
        linear = self._step[interval] * self._v0[interval]
        return self._q0[interval] + u * (linear + u * (self._c2[interval] + u * self._c3[interval]))

    def position_extremes(self) -> tuple[Array, Array]:
        """Return the lowest and highest position of each interval: (n - 1, k) each."""
        values = [self._q0, self._q1]
        for u in self._turning_points():
            linear = self._step * self._v0
            values.append(self._q0 + u * (linear + u * (self._c2 + u * self._c3)))
        return np.min(values, axis=0), np.max(values, axis=0)

    @cached_property
    def velocity_peak(self) -> Array:
        """The largest speed of each interval: (n - 1, k)."""
        return self.rise_peak / self._step

    @cached_property
    def acceleration_peak(self) -> Array:
        """The largest acceleration of each interval, at one of its ends: (n - 1, k)."""
        return self.bend_peak / self._step**2

    @cached_property
    def rise_peak(self) -> Array:
        """The largest |dq/du| of each interval, for the fraction u of it: (n - 1, k); its step may be none."""
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.nan_to_num(-self._c2 / (3 * self._c3), nan=0.0, posinf=0.0, neginf=0.0)
        u = np.clip(u, 0.0, 1.0)
        start, end = self._step * self._v0, self._step * self._v1
        return np.max(np.abs([start, start + 2 * self._c2 * u + 3 * self._c3 * u * u, end]), axis=0)

    @cached_property
    def bend_peak(self) -> Array:
        """The largest |d²q/du²| of each interval, at one of its ends: (n - 1, k)."""
        return np.maximum(np.abs(2 * self._c2), np.abs(2 * self._c2 + 6 * self._c3))

    def _turning_points(self) -> tuple[Array, Array]:
        a, b, c = 3 * self._c3, 2 * self._c2, self._step * self._v0
        root = np.sqrt(np.maximum(b * b - 4 * a * c, 0.0))
        # The stable pair of roots: no difference of nearly equal numbers.
        q = -0.5 * (b + np.where(b >= 0, root, -root))
        with np.errstate(divide="ignore", invalid="ignore"):
            first = np.nan_to_num(q / a, nan=0.0, posinf=0.0, neginf=0.0)
            second = np.nan_to_num(c / q, nan=0.0, posinf=0.0, neginf=0.0)
        return np.clip(first, 0.0, 1.0), np.clip(second, 0.0, 1.0)
