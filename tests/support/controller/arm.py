"""Six joints that go where they are sent, and stop by themselves where they must not."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Triple = tuple[float, float, float]
Chain = tuple[tuple[Triple, Triple, Triple], Triple, list[tuple[Triple, Triple]]]
"""Axes and origin of the flange's frame, and axis and origin of each joint, in the base frame."""
_NEAR = 0.1
"""Steps that turn a joint by more are taken by least squares: the arm may be next to a singularity [rad]."""


class SafetyMode(IntEnum):
    """RTDE's `safety_mode`, those that occur here."""

    NORMAL = 1
    PROTECTIVE_STOP = 3


@dataclass(frozen=True, eq=False)
class ArmLimits:
    """What the controller lets its joints do; SI units, six values each."""

    position_min: Vector
    position_max: Vector
    velocity_max: Vector
    acceleration_max: Vector
    braking: float = 50.0
    """Of a protective stop and of a program that ends while its arm moves [rad/s²]."""
    slack: float = 1.01
    """By how much a finite difference may exceed a limit that the curve keeps."""


class Arm:
    """Joints at `q` with speeds `qd`, moved on by one control cycle at a time.

    The joints are where they were sent one cycle ago. A real arm lags by `servoj`'s lookahead time, which is left out.
    """

    def __init__(self, start: Vector, limits: ArmLimits, dh: Vector, cycle: float) -> None:
        """Stand at `start`.

        Args:
            start: joint positions [rad].
            limits: beyond which the arm stops itself.
            dh: a row a joint: a [m], alpha [rad], d [m], theta0 [rad].
            cycle: of control [s].
        """
        self.q, self.qd = start.astype(float).copy(), np.zeros(6)
        self.limits, self.cycle = limits, cycle
        self.safety_mode, self.reason = SafetyMode.NORMAL, ""
        self.wrench, self._tare = np.zeros(6), np.zeros(6)
        self.tcp, self.payload = np.eye(4), 0.0
        self._rows = [(a, math.cos(alpha), math.sin(alpha), d, theta0) for a, alpha, d, theta0 in dh.tolist()]
        self._sent: Vector | None = None
        self._braking = limits.braking

    def send(self, q: Vector) -> None:
        """Have the joints at `q` at the end of this cycle."""
        self._sent = q

    def brake(self, acceleration: float) -> None:
        """Slow down with this [rad/s²] from here on, unless joints are sent somewhere."""
        self._braking = acceleration

    def protective_stop(self, reason: str) -> None:
        if self.safety_mode is SafetyMode.NORMAL:
            self.safety_mode, self.reason = SafetyMode.PROTECTIVE_STOP, reason
        self._sent, self._braking = None, self.limits.braking

    def unlock(self) -> None:
        self.safety_mode, self.reason = SafetyMode.NORMAL, ""

    @property
    def is_still(self) -> bool:
        return not self.qd.any()

    @property
    def felt(self) -> Vector:
        """What the wrist's sensor tells: force, and torque about the flange, on the tool, base axes [N, Nm]."""
        return self.wrench - self._tare

    def tare(self) -> None:
        """Have the sensor tell nothing of what it feels now."""
        self._tare = self.wrench.copy()

    def step(self) -> None:
        """Let one control cycle pass."""
        sent, self._sent = self._sent, None
        if sent is not None and self.safety_mode is SafetyMode.NORMAL:
            velocity = (sent - self.q) / self.cycle
            broken = self._broken(sent, velocity)
            if broken is None:
                self.q, self.qd, self._braking = sent.copy(), velocity, self.limits.braking
                return
            self.protective_stop(broken)
        self.qd = np.sign(self.qd) * np.maximum(np.abs(self.qd) - self._braking * self.cycle, 0.0)
        self.q = self.q + self.qd * self.cycle

    def _broken(self, q: Vector, velocity: Vector) -> str | None:
        limits = self.limits
        excesses = (
            ("position", np.maximum(limits.position_min - q, q - limits.position_max) - 1e-6),
            ("speed", np.abs(velocity) - limits.velocity_max * limits.slack),
            ("acceleration", np.abs(velocity - self.qd) / self.cycle - limits.acceleration_max * limits.slack),
        )
        for what, excess in excesses:
            if (joint := int(excess.argmax())) >= 0 and not excess[joint] <= 0.0:
                return f"joint {joint}: {what} limit"
        return None

    def tcp_pose(self, q: Vector | None = None, tcp: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """Return `T_base_tcp` (4×4): each joint turns about z, then its row of the table follows."""
        return _pose(self._chain(self.q if q is None else q)) @ (self.tcp if tcp is None else tcp)

    def joint_speeds(self, twist: Vector, q: Vector | None = None) -> Vector:
        """Return the joint speeds of a TCP's speed [m/s, rad/s] in the base frame, by least squares."""
        return _least_squares(self._jacobian(self._chain(self.q if q is None else q)), twist)

    def _jacobian(self, chain: Chain) -> NDArray[np.float64]:
        """Return the (6, 6) that takes joint speeds to the TCP's speed in the base frame."""
        axes, p, screws = chain
        offset = self.tcp[:3, 3].tolist()
        at = [p[i] + sum(axis[i] * part for axis, part in zip(axes, offset, strict=True)) for i in range(3)]
        columns = [(*_cross(z, (at[0] - o[0], at[1] - o[1], at[2] - o[2])), *z) for z, o in screws]
        return np.array(columns).T

    def _chain(self, q: Vector) -> Chain:
        """Return where everything is.

        In plain numbers: this is what a controller does most, and arrays this small take ten times as long.
        """
        xx, xy, xz, yx, yy, yz, zx, zy, zz = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
        px = py = pz = 0.0
        screws: list[tuple[Triple, Triple]] = []
        for angle, (a, cos_alpha, sin_alpha, d, theta0) in zip(q.tolist(), self._rows, strict=True):
            screws.append(((zx, zy, zz), (px, py, pz)))
            c, s = math.cos(angle + theta0), math.sin(angle + theta0)
            xx, yx = c * xx + s * yx, c * yx - s * xx
            xy, yy = c * xy + s * yy, c * yy - s * xy
            xz, yz = c * xz + s * yz, c * yz - s * xz
            px, py, pz = px + d * zx + a * xx, py + d * zy + a * xy, pz + d * zz + a * xz
            yx, zx = cos_alpha * yx + sin_alpha * zx, cos_alpha * zx - sin_alpha * yx
            yy, zy = cos_alpha * yy + sin_alpha * zy, cos_alpha * zy - sin_alpha * yy
            yz, zz = cos_alpha * yz + sin_alpha * zz, cos_alpha * zz - sin_alpha * yz
        return ((xx, xy, xz), (yx, yy, yz), (zx, zy, zz)), (px, py, pz), screws

    def joints_at(self, T: NDArray[np.float64], near: Vector) -> Vector | None:
        """Return joints that put the TCP at a pose in the base frame, near others; None: none were found."""
        q = near.astype(float).copy()
        for _ in range(20):
            chain = self._chain(q)
            off = _way(_pose(chain) @ self.tcp, T)
            if np.abs(off).max() < 1e-10:
                return q
            q = q + _step(self._jacobian(chain), off)
        return None


def _pose(chain: Chain) -> NDArray[np.float64]:
    """Return `T_base_flange` (4×4)."""
    (x, y, z), p, _ = chain
    return np.array([*zip(x, y, z, p, strict=True), (0.0, 0.0, 0.0, 1.0)])


def _step(jacobian: NDArray[np.float64], off: Vector) -> Vector:
    """Return by how much joints (6,) turn for a small way (6,): mostly what solves it, which takes a third as long."""
    try:
        step: Vector = np.linalg.solve(jacobian, off)
    except np.linalg.LinAlgError:
        return _least_squares(jacobian, off)
    return step if np.abs(step).max() < _NEAR else _least_squares(jacobian, off)


def _least_squares(jacobian: NDArray[np.float64], twist: Vector) -> Vector:
    return np.asarray(np.linalg.lstsq(jacobian, twist, rcond=1e-6)[0], dtype=np.float64)


def _way(T: NDArray[np.float64], D: NDArray[np.float64]) -> Vector:
    """Return how a frame moves that goes from one pose to another near it: translation and rotation vector."""
    turn = D[:3, :3] @ T[:3, :3].T
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    return np.concatenate([D[:3, 3] - T[:3, 3], axis])


def _cross(a: Triple, b: Triple) -> Triple:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
