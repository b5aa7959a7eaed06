"""The loop of law (11) and what it feels: whether it swings, and gains for which it does not, found without trying."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from planners.geometry.pose import Array, skew
from planners.lifting.leader_follower import FollowerGains, LeaderFollower


def felt_mass(points: Array, up: Array, mass: float, inertia: Array) -> float:
    """Return the force over the acceleration of points that all go up alike on a body that is otherwise free [kg].

    A body that turns about its bearers is lighter for them than its mass. What else holds it turns it less, or not at
    all, but takes a part of the force: hands feel no more than this of a plate that also hangs on a cup.

    Args:
        points: (n, 3) of the bearers from the centre of mass, body axes [m].
        up: (3,) unit vector, body axes.
        mass: [kg].
        inertia: (3,) principal moments about the body axes [kg m^2].
    """
    arms = np.cross(points, up)
    # Mobility: the acceleration upward of each point under a unit force upward at each.
    mobility = 1.0 / mass + arms @ (arms / inertia).T
    # Two bearers at one place share a force in any way.
    return float(np.linalg.pinv(mobility, rcond=1e-9).sum())


def box_inertia(sides: Array, mass: float) -> Array:
    """Return the (3,) principal moments of a homogeneous box with these sides (3,) [kg m^2]."""
    squares = np.asarray(sides) ** 2
    return mass / 12.0 * (squares.sum() - squares)


SERVO = 0.0035
"""Lag of the arms behind their commanded velocity [s]: a robot's servos at 500 Hz."""
SERVO_DOUBTS = (0.0001, SERVO)
"""Arms may follow almost at once, too: no loop may swing, as one would that relies on their lag [s]."""
LIFTER_ACCELERATION = 0.5
"""Gains are compared by moves of a lifter that speeds up and brakes like this [m/s^2]."""
MOVES = ((0.15, 0.15, 1.0), (0.2, 0.1, 0.5))
"""By each: the speed with which it begins, that with which it goes on [m/s], and for how long [s]. One begins evenly
and lasts; one begins with a jerk and is short, so that the hands are not yet at rest when it ends."""
_JERK = 0.06
"""How long a jerk lasts [s]."""
_SEEN = 0.5
"""How long the forces are looked at after the lifter has stopped [s]."""
STIFFNESS_DOUBTS = (0.85, 1.0, 1.2)
"""Contacts may be so much stiffer than they are said to be: no loop may swing [1]."""
GAIN_MARGIN = 1.2
"""With contacts as they are said to be, all forces may grow so much before the loop swings [1]."""
SENSOR_NOISE = 0.5 * math.sqrt(2.0)
"""Of a reading of two FT300 together: standard deviation [N]."""
RESTLESSNESS = 0.015
"""The noise moves the hands by no more: usual lifters move at 0.02 m/s and more [m/s]."""

_SQUARINGS = 18
"""A quarter of a million steps: what does not grow by then never does."""

_INERTIAS = (0.2, 0.33, 0.45, 0.6, 0.8, 1.0, 1.4, 2.0)
"""M_d over the mass that the hands accelerate, to choose from [1]."""
_CARRIED = (0.0, 0.5, 0.7, 0.9)
"""Part of that mass whose inertia is taken off the readings, to choose from [1]."""
_READINGS = (5, 7, 8)
"""Readings that are averaged, to choose from [1]."""
_DAMPINGS = (0.5, 0.7, 0.9, 1.1)
"""B_d over the cup's largest force, to choose from [s/m]: a stronger cup is stiffer."""
_MEMORIES = (0.3, 0.5, 1.0)
"""To choose from [s]."""


def moved_stiffness(stiffness: Array, arm: Array) -> Array:
    """Return a (6, 6) stiffness against small motions about a point as one about the place that is `arm` (3,) from."""
    to_point = np.eye(6)
    to_point[:3, 3:] = -skew(arm)
    return to_point.T @ stiffness @ to_point


@dataclass(frozen=True, eq=False)
class HungPlate:
    """A plate that hangs on a lifter's cup and on both hands, for small motions about where it is at rest.

    All in the plate's axes, about its centre of mass; velocity before angular velocity.
    """

    mass: float
    """[kg]"""
    inertia: Array
    """(3,) principal moments [kg m^2]."""
    hands: Array
    """(6, 6) stiffness of pads and tip [N/m, N, Nm]."""
    hands_damping_time: float
    """Their damping over their stiffness [s]."""
    cup: Array
    """(6, 6) stiffness of cup and suspension."""
    cup_damping_time: float
    """[s]"""
    up: Array
    """(3,) unit vector."""

    @cached_property
    def rising(self) -> Array:
        """(6,) motion of hands, lifter and plate that all rise with 1 m/s."""
        return np.concatenate([self.up, np.zeros(3)])


class LiftLoop:
    """Plate, hands and lifter from one reading of the sensors to the next; exact for velocities that change linearly.

    The state x has the plate's motion and velocity (6 + 6), the hands' height and velocity, the velocity that the arms
    are told, and the lifter's height and velocity. The law knows of none but the force.
    """

    _HANDS, _LIFTER = 12, 15
    TOLD, STATES = 14, 17
    """Place in x of the velocity that the arms are told, and how many x has; the reading of a period ago comes next."""

    def __init__(self, plate: HungPlate, period: float, stiffer: float = 1.0, servo: float = SERVO) -> None:
        """Discretise.

        Args:
            plate: as it hangs.
            period: of the sensors [s].
            stiffer: contacts are so much stiffer than they are said to be [1].
            servo: lag of the arms behind their commanded velocity [s].
        """
        up, hands, cup = plate.rising, stiffer * plate.hands, plate.cup
        damped, hung = plate.hands_damping_time * hands, plate.cup_damping_time * cup
        mobility = 1.0 / np.concatenate([np.full(3, plate.mass), plate.inertia])[:, None]
        h, told, lifter, size = self._HANDS, self.TOLD, self._LIFTER, self.STATES
        # d/dt of x, then of the two accelerations that are held over a period: of what is told, and of the lifter.
        A = np.zeros((size + 2, size + 2))
        A[:6, 6:12] = np.eye(6)
        A[6:12, :6], A[6:12, 6:12] = -mobility * (hands + cup), -mobility * (damped + hung)
        A[6:12, h], A[6:12, h + 1] = (mobility * hands) @ up, (mobility * damped) @ up
        A[6:12, lifter], A[6:12, lifter + 1] = (mobility * cup) @ up, (mobility * hung) @ up
        A[h, h + 1] = A[lifter, lifter + 1] = 1.0
        A[h + 1, [h + 1, told]] = -1.0 / servo, 1.0 / servo
        A[told, size] = A[lifter + 1, size + 1] = 1.0
        stepped = np.asarray(expm(A * period), dtype=float)
        self._step, self._accelerated = stepped[:size, :size], stepped[:size, size:]
        self._up = up
        self._force = np.zeros(size)
        """(17,) both hands' vertical force on the plate, off its goal, over the state."""
        self._force[:6], self._force[6:12] = -up @ hands, -up @ damped
        self._force[h], self._force[h + 1] = up @ hands @ up, up @ damped @ up

    def closed(self, gains: FollowerGains, gain: float = 1.0) -> Array:
        """Return the (n, n) step of the whole loop, all forces being so much larger [1].

        After x come the reading of a period ago, what the law remembers of readings, V_d, and the accelerations of the
        last two periods, the newest first.
        """
        size, told = self.STATES, self.TOLD
        reading, errors, estimate = size, size + 1, size + gains.readings
        newest, before = estimate + 1, estimate + 2
        every = np.eye(before + 1)
        error = gain * (gains.carried * every[before] - every[reading])
        mean = (error + every[errors:estimate].sum(axis=0)) / gains.readings
        law = LeaderFollower(gains).discrete @ np.array([every[told], every[estimate], mean])
        acceleration = (law[0] - every[told]) / gains.period
        step = np.zeros_like(every)
        step[:size, :size] = self._step
        step[:size] += np.outer(self._accelerated[:, 0], acceleration)
        step[reading, :size] = self._force
        step[errors:estimate] = np.vstack([error, every[errors : estimate - 1]])[: gains.readings - 1]
        step[estimate], step[newest], step[before] = law[1], acceleration, every[newest]
        return step

    def reading(self, state: Array) -> float:
        """Return both hands' vertical force on the plate, off its goal, in a state [N]."""
        return float(self._force @ state[: self.STATES])

    def growth(self, gains: FollowerGains, gain: float = 1.0) -> float:
        """Return the largest factor by which any motion grows in a period, but those of a lifter that goes on [1]."""
        return _spectral_radius(self._without_lifter(gains, gain)[0])

    def restlessness(self, gains: FollowerGains) -> float:
        """Return how fast the sensors' noise alone moves the hands: standard deviation [m/s]."""
        closed, kept = self._without_lifter(gains)
        heard = np.where(kept == self.STATES, SENSOR_NOISE, 0.0)
        spread, power = np.outer(heard, heard), closed
        for _ in range(_SQUARINGS):
            # Covariance after twice as many steps.
            spread, power = spread + power @ spread @ power.T, power @ power
        return float(np.sqrt(spread[self.TOLD, self.TOLD]))

    def deviations(self, gains: Sequence[FollowerGains]) -> Array:
        """Return how far the hands' force gets off its goal behind the lifter that makes `MOVES`, from rest to rest.

        The hands do not go down: what they have risen too far stays, and is borne until the lifter goes on.

        Args:
            gains: (n) of one period.

        Returns:
            (n,) of each the largest amount, in either direction [N].
        """
        return np.max([_off_goal(self, gains, move) for move in _accelerations(gains[0].period)], axis=0)

    @property
    def matrices(self) -> tuple[Array, Array, Array]:
        """Step of x (17, 17), what two accelerations add to it (17, 2), and the hands' force over it (17,).

        The accelerations, over a period, are of what the arms are told, and of the lifter [m/s^2].
        """
        return self._step, self._accelerated, self._force

    def _without_lifter(self, gains: FollowerGains, gain: float = 1.0) -> tuple[Array, NDArray[np.int64]]:
        """Return the loop behind a lifter that stands, and which of its states those are."""
        closed = self.closed(gains, gain)
        kept = np.delete(np.arange(len(closed)), [self._LIFTER, self._LIFTER + 1])
        return closed[np.ix_(kept, kept)], kept


def _accelerations(period: float) -> Iterator[Array]:
    """Yield for each of `MOVES` the lifter's acceleration in each period [m/s^2]."""
    for first, speed, seconds in MOVES:
        changes = [(first, 0.0), (0.0, _JERK if first > speed else 0.0), (speed - first, 0.0), (0.0, seconds)]
        parts = []
        for change, still in (*changes, (-speed, 0.0), (0.0, _SEEN)):
            taken = round(abs(change) / LIFTER_ACCELERATION / period)
            parts += [np.full(taken, np.sign(change) * LIFTER_ACCELERATION), np.zeros(round(still / period))]
        yield np.concatenate(parts)


def _off_goal(loop: LiftLoop, gains: Sequence[FollowerGains], accelerations: Array) -> Array:
    """Return the largest (n,) force off its goal with each of n gains; the law is that of `LeaderFollower.follow`."""
    stepped, accelerated, felt = loop.matrices
    discrete = np.array([LeaderFollower(each).discrete for each in gains])
    carried = np.array([each.carried for each in gains])
    readings = np.array([each.readings for each in gains])
    kept = np.array([math.exp(-each.period / each.memory) for each in gains])
    averaged = np.arange(readings.max()) >= readings.max() - readings[:, None]
    count, period = len(gains), gains[0].period
    x, errors = np.zeros((count, loop.STATES)), np.zeros(averaged.shape)
    velocity, lifter, reading, largest, gained, before = np.zeros((6, count))
    for number, acceleration in enumerate(accelerations, start=1):
        errors = np.column_stack([errors[:, 1:], carried * before - reading])
        error = (errors * averaged).sum(axis=1) / np.minimum(readings, number)
        free, estimate = np.einsum("nij,jn->in", discrete, [velocity, lifter, error])
        now = np.maximum(free, 0.0)
        # Of a velocity that the hands were refused nothing is remembered.
        lifter = np.where(now == free, estimate, now + kept * (lifter - now))
        before, gained = gained, (now - velocity) / period
        velocity = now
        reading = x @ felt
        largest = np.maximum(largest, np.abs(reading))
        told = (now - x[:, loop.TOLD]) / period
        x = x @ stepped.T + np.outer(told, accelerated[:, 0]) + acceleration * accelerated[:, 1]
    return largest


def _spectral_radius(A: Array) -> float:
    """Return the largest modulus of the eigenvalues, by squaring: many times faster than they for small matrices."""
    logarithm = 0.0
    for number in range(_SQUARINGS):
        size = float(np.linalg.norm(A))
        logarithm += math.log(size) / 2**number
        A = A / size
        A = A @ A
    return math.exp(logarithm + math.log(float(np.linalg.norm(A))) / 2**_SQUARINGS)


def design_gains(plate: HungPlate, felt_mass: float, cup_force: float) -> FollowerGains:
    """Return the gains with which the hands follow best of all that stay away from swinging.

    They follow from plate, hands, cup and sensor, and from no lifter. The first of those that follow best for which no
    motion grows, with `GAIN_MARGIN`, and with contacts that are stiffer or softer than they are said to be, whatever
    the lag of the arms, and whose hands keep still at the sensors' noise.

    Args:
        plate: as it hangs.
        felt_mass: that the hands accelerate at most [kg].
        cup_force: largest force of the cup [N].
    """
    usual = FollowerGains()
    doubts = {
        (stiffer, servo): LiftLoop(plate, usual.period, stiffer, servo)
        for stiffer, servo in itertools.product(STIFFNESS_DOUBTS, SERVO_DOUBTS)
    }
    said = doubts[1.0, SERVO]

    def worst_growth(gains: FollowerGains) -> float:
        with_margin = [doubts[1.0, servo].growth(gains, GAIN_MARGIN) for servo in SERVO_DOUBTS]
        return max(*with_margin, *(loop.growth(gains) for loop in doubts.values()))

    candidates = list(_candidates(usual, felt_mass, cup_force))
    sharpest_first = [candidates[number] for number in np.argsort(said.deviations(candidates), kind="stable")]
    steady = (gains for gains in sharpest_first if worst_growth(gains) < 1.0)
    calm = next((gains for gains in steady if said.restlessness(gains) < RESTLESSNESS), None)
    return calm or min(sharpest_first, key=worst_growth)


def _candidates(usual: FollowerGains, felt_mass: float, cup_force: float) -> Iterator[FollowerGains]:
    choices = itertools.product(_INERTIAS, _CARRIED, _READINGS, _DAMPINGS, _MEMORIES)
    for share, carried, readings, damping, memory in choices:
        yield FollowerGains(
            share * felt_mass, damping * cup_force, carried * felt_mass, memory, readings, period=usual.period
        )
