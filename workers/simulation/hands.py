"""A hand on the plate: how it gets hold of it, its force sensor, and how it tracks a wrench."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numba import njit

from planners.cell.arm import Arm
from planners.cell.cell_size import tip_stiffness
from planners.cell.hand import Gripper, Pusher
from planners.geometry.linear import solve
from planners.geometry.pose import Array, Transform, inverse, transform
from planners.kinematics.forward import frame_motion, jacobian
from planners.plan.segment import Push, Segment, SegmentKind
from workers.simulation.settings import SensorSettings, SimulationSettings
from workers.simulation.timeline import PlannedMoment
from workers.simulation.touch import Touch
from workers.simulation.world import Motion

_FADE = 0.05
"""How fast a feed-forward correction is taken on [s]."""
_NEWTON_STEPS = 3
_LEAST_STEP = 1e-5
"""Damps Newton's method where an arm is nearly stretched [m^2]."""
_LEAST_ANGLE = 1e-12
"""Below it a rotation is that of first order [rad]."""
_CLEAR = 0.004
"""A stick further than this from the plate has left it [m]."""


class ForceSensor:
    """FT300: reads the contact wrench of its hand at its own rate.

    The weight of the hand itself is compensated by the robot from the hand's known mass; what remains of that is part
    of the offset that taring takes away.
    """

    def __init__(self, rng: np.random.Generator, settings: SensorSettings) -> None:
        """Switch it on: its offset is unknown until it is tared."""
        self._rng, self._settings = rng, settings
        self._noise = np.repeat([settings.force_noise, settings.torque_noise], 3)
        self._offset = rng.normal(scale=np.repeat([settings.force_bias, settings.torque_bias], 3))
        self._tare = np.zeros(6)
        self.tare()

    def tare(self) -> None:
        """Average some readings while the hand bears nothing, and subtract them from now on."""
        noise = self._rng.normal(scale=self._noise, size=(self._settings.tare_readings, 6))
        self._tare = self._offset + noise.mean(axis=0)

    def read(self, wrench: Array) -> Array:
        """Return the (6,) reading for a true wrench (6,) of the hand on what it touches, world axes [N, Nm]."""
        return wrench + self._offset + self._noise * self._rng.standard_normal(6) - self._tare


class SimulatedHand(ABC):
    """One arm's hand. Subclasses say how it gets hold of the plate.

    Admittance: the hand is commanded to where it should be by the plan, plus how far its compliance gives way under
    the planned wrench, plus an integral of the measured wrench's error over a damping, which leaks.
    """

    turns: bool
    """Whether the hand can exert a torque on the plate, which its admittance then follows."""

    def __init__(self, arm: Arm, first_joint: int, settings: SimulationSettings, rng: np.random.Generator) -> None:
        self.arm, self.settings = arm, settings
        self.joints = slice(first_joint, first_joint + 6)
        self.sensor = ForceSensor(rng, settings.sensor)
        self.reading = np.zeros(6)
        """(6,) last reading of the sensor: wrench on the plate about the contacts' middle, world axes [N, Nm]."""
        self.knock: Array | None = None
        """(6,) what else of the hand than pads and tip did to the plate when the sensor was read last, about the
        plate's centre of mass, world axes [N, Nm]; None: it is clear of the plate."""
        self.touch: Touch
        self.T_flange_hand: Transform
        self._forward, self._trim = np.zeros(6), np.zeros(6)
        self._away = 0.0
        turning = 1.0 / settings.hand.torsional_damping if self.turns else 0.0
        self._admittance = np.repeat([1.0 / settings.hand.damping, turning], 3)
        self._limits = np.array([settings.hand.leak, settings.hand.largest_correction, settings.hand.largest_turning])

    @property
    def force(self) -> Array:
        """(3,) true force on the plate, world axes [N]."""
        return self.touch.force if self.knock is None else self.touch.force + self.knock[:3]

    @abstractmethod
    def update(self, moment: PlannedMoment, T_world_hand: Transform, plate: Motion) -> None:
        """Get hold of the plate, or let it go, as the plan says."""

    def sense(self, R_world_plate: Array, knock: Array | None) -> None:
        """Take a reading, with the plate's orientation (3, 3) of now and what else of the hand touches it (`knock`)."""
        self.knock = knock
        wrench = self.touch.wrench(R_world_plate)
        if knock is not None:
            # A sensor cannot tell by what of its hand it is pushed.
            wrench += knock
            wrench[3:] -= np.cross(R_world_plate @ self.touch.anchors.mean(axis=0), knock[:3])
        self.reading = self.sensor.read(wrench)

    def track(self, wrench: Array | None, R_world_plate: Array) -> None:
        """Take one period of the admittance towards a planned wrench (6,), world axes; None: bear nothing."""
        period = self.settings.sensor.period
        faded = 1.0 - math.exp(-period / _FADE)
        if wrench is not None and self.touch.engaged:
            admit(
                wrench, self.reading, R_world_plate, self.touch.compliance(), self._admittance, self._limits, period,
                faded, self._trim, self._forward,
            )  # fmt: skip
        else:
            self._trim *= 1.0 - period / self.settings.hand.fading
            self._forward -= faded * self._forward

    def correction(self, positions: Array) -> Array:
        """Return the (6,) joint corrections at the planned joint positions (6,) [rad]."""
        away = self._forward + self._trim
        if not away.any():
            return away
        return moved_joints(self.arm, self.T_flange_hand, positions, away) - positions

    def lost(self, expected: bool, step: float) -> str | None:
        """Say how the hand has lost the plate, None while it has not; `expected`: whether it should have it now."""
        s = self.settings.hand
        if not expected:
            self._away = 0.0
            return None
        self._away = 0.0 if self.touch.pressed else self._away + step
        if self._away > s.lost_time:
            return f"the {self.arm.name} hand lost touch with the plate"
        if self.touch.slip > s.largest_slip:
            return f"the {self.arm.name} hand slid {1e3 * self.touch.slip:.0f} mm on the plate"
        return None


class GrippingHand(SimulatedHand):
    """Two pads with four points each; the fingers close on the plate wherever it is, and squeeze."""

    turns = True

    def __init__(
        self,
        arm: Arm,
        first_joint: int,
        settings: SimulationSettings,
        rng: np.random.Generator,
        friction: tuple[float, float],
        width: float,
    ) -> None:
        """Take the plan's friction coefficient and eccentricity [1, m], and the plate's thickness [m]."""
        super().__init__(arm, first_joint, settings, rng)
        contact, (mu, eps) = settings.contact, friction
        self._squeeze = contact.squeeze
        self._segment: Segment | None = None
        self._holds = False
        assert isinstance(arm.hand, Gripper)
        self.T_flange_hand = arm.hand.T_flange_tcp(width).copy()
        along = eps / math.hypot(1.0, 1.0 / contact.pad_aspect)
        patch = [(sx * along / contact.pad_aspect, sz * along) for sx in (-1, 1) for sz in (-1, 1)]
        points = np.array([[x, side * 0.5 * width, z] for side in (-1.0, 1.0) for x, z in patch])
        self.touch = Touch(
            points,
            normal=0.25 * contact.pad_normal_stiffness,
            tangential=0.25 * contact.pad_tangential_stiffness,
            damping_time=contact.damping_time,
            mu=contact.friction_factor * mu,
        )

    def update(self, moment: PlannedMoment, T_world_hand: Transform, plate: Motion) -> None:
        """Close and open the fingers as the plan says."""
        segment = moment.segment
        if segment is not self._segment:
            self._segment, grips = segment, segment.grips
            self._holds = bool(grips)
            for grip in grips:
                self._squeeze = self.settings.contact.squeeze if grip.squeeze is None else grip.squeeze
        holds, squeeze = self._holds, 1.0
        if segment.kind is SegmentKind.GRIP:
            part = moment.elapsed
            holds, squeeze = part > 0.6, min(1.0, max(0.0, (part - 0.6) / 0.3))
        elif segment.kind is SegmentKind.RELEASE:
            part = moment.elapsed
            holds, squeeze = part < 0.3, max(0.0, 1.0 - part / 0.3)
        if holds and not self.touch.engaged:
            T_plate_hand = inverse(transform(plate[:3], plate[3])) @ T_world_hand
            y = T_plate_hand[:3, 1]
            self.touch.engage(T_plate_hand, np.repeat([y, -y], 4, axis=0))
        elif not holds and self.touch.engaged:
            self.touch.release()
            self.sensor.tare()
        if self.touch.engaged:
            self.touch.preload[:] = 0.25 * self._squeeze * squeeze


class PushingHand(SimulatedHand):
    """A round tip against one face of the plate."""

    turns = False

    def __init__(
        self,
        arm: Arm,
        first_joint: int,
        settings: SimulationSettings,
        rng: np.random.Generator,
        mu: float,
        plate_com: Array,
        pushes: Sequence[float],
    ) -> None:
        """Take the plan's friction coefficient, the plate's centre of mass (3,), plate frame, and `largest_pushes`."""
        super().__init__(arm, first_joint, settings, rng)
        contact = settings.contact
        assert isinstance(arm.hand, Pusher)
        self.T_flange_hand = arm.hand.T_flange_tcp.copy()
        self._com, self._radius, self._pushes = plate_com, arm.hand.tip_radius, pushes
        self._push: Push | None = None
        self.touch = Touch(
            np.zeros((1, 3)),
            normal=contact.tip_normal_stiffness,
            tangential=contact.tip_tangential_stiffness,
            damping_time=contact.damping_time,
            mu=contact.friction_factor * mu,
            radius=self._radius,
        )

    def update(self, moment: PlannedMoment, T_world_hand: Transform, plate: Motion) -> None:
        """Watch the face that is to be pushed; there is contact where the tip is beyond it."""
        R, com, push = plate[:3], plate[3], moment.segment.push
        if push is not None and push is not self._push:
            if self._push is None or not np.array_equal(push.point, self._push.point):
                T_plate_hand = inverse(transform(R, com)) @ T_world_hand
                face, normal = push.point - self._com, push.normal
                tip = T_plate_hand[:3, 3] + self._radius * normal
                # What is stated is for the papers' pushes, however light.
                self.touch.stiffen(max(1.0, tip_stiffness(self._radius, self._pushes[moment.number])))
                self.touch.engage_at((tip + ((face - tip) @ normal) * normal)[None], normal[None])
            self._push = push
        if push is None and self.touch.engaged:
            n = R @ self.touch.normals[0]
            gap = -float((T_world_hand[:3, 3] + self._radius * n - com - R @ self.touch.anchors[0]) @ n)
            if gap > _CLEAR:
                self.touch.release()
                self.sensor.tare()
                self._push = None

    def track(self, wrench: Array | None, R_world_plate: Array) -> None:
        """Track a planned push; the stick never presses less than it must to stay in touch."""
        if wrench is not None and self.touch.engaged:
            n = R_world_plate @ self.touch.normals[0]
            missing = self.settings.contact.least_push - float(wrench[:3] @ n)
            if missing > 0.0:
                wrench = wrench + np.concatenate([missing * n, np.zeros(3)])
        super().track(wrench, R_world_plate)


def moved_joints(arm: Arm, T_flange_hand: Transform, positions: Array, away: Array) -> Array:
    """Return the joint positions (6,) that put a hand somewhere else, near [rad].

    Newton's method, as one step of it would be millimetres off: soft pads are turned by a tenth of a radian.

    Args:
        arm: whose hand.
        T_flange_hand: (4, 4).
        positions: (6,) from where [rad].
        away: (6,) translation of the hand's origin, then rotation vector about it, world axes [m, rad].
    """
    return _moved_joints(arm.dh, arm.T_world_base, T_flange_hand, positions, away)


@njit(cache=True, nogil=True)
def _moved_joints(dh, T_world_base, T_flange_hand, positions, away):  # noqa: C901 - one compiled pass
    turn = np.empty((3, 3))
    _turn(away[3:], turn)
    q, still, normal, way = positions.copy(), np.zeros(6), np.empty((6, 6)), np.empty(6)
    place, wanted, turned = np.empty(3), np.zeros((3, 3)), np.empty((3, 3))
    for number in range(_NEWTON_STEPS):
        T, _ = frame_motion(dh, T_world_base, T_flange_hand, q, still)
        if number == 0:
            for i in range(3):
                place[i] = T[i, 3] + away[i]
                for j in range(3):
                    wanted[i, j] = turn[i, 0] * T[0, j] + turn[i, 1] * T[1, j] + turn[i, 2] * T[2, j]
        for i in range(3):
            way[i] = place[i] - T[i, 3]
            for j in range(3):
                turned[i, j] = wanted[i, 0] * T[j, 0] + wanted[i, 1] * T[j, 1] + wanted[i, 2] * T[j, 2]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            way[3 + i] = 0.5 * (turned[k, j] - turned[j, k])
        J = jacobian(dh, T_world_base, q, T[:3, 3].copy())
        for i in range(6):
            for j in range(6):
                normal[i, j] = _LEAST_STEP if i == j else 0.0
                for k in range(6):
                    normal[i, j] += J[i, k] * J[j, k]
        weights = solve(normal, way)
        for i in range(6):
            for j in range(6):
                q[j] += J[i, j] * weights[i]
    return q


@njit(cache=True, nogil=True)
def _turn(vector, out):
    """Write what `rotation_from_vector` returns."""
    angle = math.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])
    sine, versine, S = 1.0, 0.0, np.zeros((3, 3))
    if angle >= _LEAST_ANGLE:
        sine, versine = math.sin(angle), 1.0 - math.cos(angle)
    size = angle if angle >= _LEAST_ANGLE else 1.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        S[k, j], S[j, k] = vector[i] / size, -vector[i] / size
    for i in range(3):
        for j in range(3):
            out[i, j] = (1.0 if i == j else 0.0) + sine * S[i, j]
            out[i, j] += versine * (S[i, 0] * S[0, j] + S[i, 1] * S[1, j] + S[i, 2] * S[2, j])


@njit(cache=True, nogil=True)
def admit(wrench, reading, R, compliance, admittance, limits, period, faded, trim, forward):  # noqa: PLR0913
    """Take one period of an admittance: `trim` follows the wrench's error, `forward` how far the hand gives way.

    Args:
        wrench: (6,) planned, world axes.
        reading: (6,) measured.
        R: (3, 3) `R_world_plate`.
        compliance: (6, 6) in the plate's axes.
        admittance: (6,) inverse dampings.
        limits: leak [1/s], and the largest translation and rotation of the trim [m, rad].
        period: [s].
        faded: part of the way that `forward` goes [1].
        trim: (6,), changed.
        forward: (6,), changed.
    """
    turned, given = np.empty(6), np.empty(6)
    for i in range(3):
        turned[i] = wrench[0] * R[0, i] + wrench[1] * R[1, i] + wrench[2] * R[2, i]
        turned[3 + i] = wrench[3] * R[0, i] + wrench[4] * R[1, i] + wrench[5] * R[2, i]
    for i in range(6):
        given[i] = 0.0
        for j in range(6):
            given[i] += compliance[i, j] * turned[j]
    for half in range(0, 6, 3):
        size = 0.0
        for i in range(half, half + 3):
            row = R[i - half]
            wanted = row[0] * given[half] + row[1] * given[half + 1] + row[2] * given[half + 2]
            forward[i] += faded * (wanted - forward[i])
            trim[i] += period * ((wrench[i] - reading[i]) * admittance[i] - limits[0] * trim[i])
            size += trim[i] * trim[i]
        size, most = math.sqrt(size), limits[1 + half // 3]
        if size > most:
            for i in range(half, half + 3):
                trim[i] *= most / size
