"""The lifter: its cup is a force source while the plate is manipulated, and hangs on a winch while it is lifted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numba import njit

from planners.balance.lifter import SuctionPad
from planners.geometry.pose import Array
from planners.manipulation.statics.lift_programs import balance_program
from planners.scene.lift_scene import PlateLiftScene
from workers.simulation.settings import ContactSettings, CupSettings, WinchSettings
from workers.simulation.world import Motion


class _Pad(NamedTuple):
    """The cup on the plate, for compiled code."""

    arm: Array
    """(3,) of the pad's centre from the plate's centre of mass, plate axes [m]."""
    axes: Array
    """(3, 3) of the cup in the plate's axes; it pulls against its z."""
    limits: Array
    """Friction across the pad without a pull [N], what a pull adds to it [1], torque that it bears about its x and y
    [Nm], its radius [m]."""
    cable: bool
    """Whether it hangs on a cable, which pulls straight up and holds no torque."""


class _Spring(NamedTuple):
    """What pulls, for compiled code; vectors are (3,) in world axes."""

    force: Array
    """With which it is at rest [N]."""
    point: Array
    """Where its end is [m]."""
    speed: Array
    """How that moves [m/s]."""
    torque: Array
    """That it gives [Nm]."""
    stiffness: float
    """[N/m]"""
    time: float
    """Damping over stiffness [s]."""
    most: float
    """The largest pull [N]."""
    upright: bool
    """Its end is above the pad wherever that is."""


class SuctionLifter:
    """A cup that pulls at one point of the plate, and lets go when it has to.

    While the plate is manipulated it gives the planned wrench with an error that wanders, and its own compliance pulls
    it towards the planned path (a force without any stiffness would tip the plate: a plate on its edge gets lighter
    the steeper it stands). While it is lifted it is a spring to a head that the winch moves: in all three directions
    for the paper's lifter, along the cable only for a cable.
    """

    def __init__(
        self, scene: PlateLiftScene, settings: CupSettings, contact: ContactSettings, rng: np.random.Generator
    ) -> None:
        """Attach it."""
        cup = scene.cup
        self._settings, self._rng = settings, rng
        pad = balance_program(scene).lifter
        at_rest, per_pull = (pad.grip_at_rest, pad.grip_per_pull) if isinstance(pad, SuctionPad) else (0.0, 0.0)
        bending = math.pi * cup.radius * cup.kappa / math.sqrt(2.0)
        factor, self._radius = contact.friction_factor, cup.radius
        self._pad = _Pad(
            cup.T_plate_cup[:3, 3] - scene.plate.com,
            cup.T_plate_cup[:3, :3].copy(),
            np.array([factor * at_rest, factor * per_pull, bending, cup.radius]),
            scene.lifter_model == "cable",
        )
        self.limit = cup.max_force
        """[N]"""
        self.stiffness = settings.stiffness(cup.max_force)
        """[N/m]"""
        self._source = np.array(
            [self.limit, self.stiffness, settings.damping_time, settings.saturation * self.limit], dtype=float
        )
        self.pull = 0.0
        """Outward along the pad's normal; for a cable its tension [N]."""
        self.force = np.zeros(3)
        """(3,) on the plate, world axes [N]."""
        self.slid = 0.0
        """How far the pad has slid on the plate during the lift [m]."""
        self._error = rng.normal(scale=settings.error)
        self._over = 0.0
        self._hung: tuple[Array, Array, Array] | None = None

    def place(self, plate: Motion) -> Array:
        """Return the pad's place (3,), world."""
        return plate[3] + plate[:3] @ self._pad.arm

    def give(self, wrench: Array, point: Array, velocity: Array, plate: Motion, step: float) -> Array:
        """Act as the force source for one step and return the (6,) wrench on the plate about its centre of mass.

        Args:
            wrench: (6,) planned, about the pad, world axes.
            point: (3,) where the pad should be.
            velocity: (3,) how it should move.
            plate: how the plate is.
            step: [s].
        """
        s = self._settings
        decay = math.exp(-step / s.error_time)
        self._error = decay * self._error + s.error * math.sqrt(1.0 - decay * decay) * self._rng.standard_normal()
        exerted, given = np.zeros(6), np.zeros(3)
        self.pull = _pull_of_source(
            plate, self._pad, wrench, self._error, point, velocity, self._source, exerted, given
        )
        self.force = given
        return exerted

    def hang(self, plate: Motion, torque: Array) -> None:
        """Begin the lift: from now on the head is where the winch has it, and the force now is the force at rest."""
        self._hung = (self.force.copy(), self.place(plate), torque.copy())

    def hoist(self, height: float, speed: float, plate: Motion) -> Array:
        """Act as a spring to the head at a height over where the lift began; return the (6,) wrench as in `give`."""
        assert self._hung is not None
        force0, place0, torque = self._hung
        risen, rises = np.array([[0.0, 0.0, height], [0.0, 0.0, speed]])
        spring = _Spring(
            force0,
            place0 + risen,
            rises,
            torque,
            self.stiffness,
            self._settings.damping_time,
            math.inf,
            upright=self._pad.cable,
        )
        # Into arrays that are there: returned ones cost more than the algebra.
        wrench, given, excess = np.zeros(6), np.zeros(3), np.zeros(3)
        self.pull = _pull_of_spring(plate, self._pad, spring, wrench, given, excess)
        self.force = given
        force0 -= excess
        self.slid += math.sqrt(excess @ excess) / self.stiffness
        return wrench

    def lets_go(self, step: float) -> str | None:
        """Say why the cup lets go after a step, None while it holds."""
        s = self._settings
        borne = s.strength * self.limit
        self._over = self._over + step if self.pull > borne else 0.0
        if self.pull > s.burst * borne:
            return f"the cup was pulled with {self.pull:.1f} N, more than {s.burst:g} times its {borne:g} N"
        if self._over > s.grace:
            return f"the cup was over its {borne:g} N for {s.grace:g} s"
        if self.slid > self._radius:
            return "the cup slid off its place on the plate"
        return None


@njit(cache=True, nogil=True)
def _pull_of_spring(plate, pad, spring, wrench, given, excess):  # noqa: C901 - one compiled pass
    """Return the pull; add the (6,) wrench on the plate about its centre of mass, the force in it, and what slid away.

    The plate moves as `Motion` says; a `_Spring` pulls at a `_Pad`. `wrench` (6,), `given` (3,) and `excess` (3,) are
    zeros, which are written to.
    """
    pad_arm, axes, limits, cable = pad
    force, point, speed, torque, stiffness, time, most, upright = spring
    R, com, velocity, spin = plate[:3], plate[3], plate[4], plate[5]
    at_rest, per_pull, bending, radius = limits
    arm, asked, outward = np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        arm[i] = R[i, 0] * pad_arm[0] + R[i, 1] * pad_arm[1] + R[i, 2] * pad_arm[2]
        outward[i] = -(R[i, 0] * axes[0, 2] + R[i, 1] * axes[1, 2] + R[i, 2] * axes[2, 2])
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        asked[i] = force[i]
        # The trolley follows above the cup: the cable stays upright.
        if i == 2 or not upright:
            moves = velocity[i] + spin[j] * arm[k] - spin[k] * arm[j]
            asked[i] += stiffness * (point[i] - (com[i] + arm[i]) + time * (speed[i] - moves))
    if cable:
        pull = min(max(0.0, asked[2]), most)
        given[2] = pull
    else:
        along = asked[0] * outward[0] + asked[1] * outward[1] + asked[2] * outward[2]
        pull = min(max(0.0, along), most)
        grip = max(0.0, at_rest + per_pull * pull)
        size = 0.0
        for i in range(3):
            asked[i] -= along * outward[i]
            size += asked[i] * asked[i]
        size = math.sqrt(size)
        for i in range(3):
            if size > 0.0:
                excess[i] = asked[i] * max(0.0, 1.0 - grip / size)
            given[i] = pull * outward[i] + asked[i] - excess[i]
        # Paper B's (5g) about its x and y, friction about its normal.
        for axis in range(3):
            x, y, z = axes[0, axis], axes[1, axis], axes[2, axis]
            limit = bending if axis < 2 else radius * grip
            about = 0.0
            for i in range(3):
                about += (R[i, 0] * x + R[i, 1] * y + R[i, 2] * z) * torque[i]
            borne = min(max(about, -limit), limit)
            for i in range(3):
                wrench[3 + i] += (R[i, 0] * x + R[i, 1] * y + R[i, 2] * z) * borne
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        wrench[i] = given[i]
        wrench[3 + i] += arm[j] * given[k] - arm[k] * given[j]
    return pull


@njit(cache=True, nogil=True)
def _pull_of_source(  # noqa: PLR0913 - one compiled pass
    plate, pad, wrench, error, point, speed, source, exerted, given
):
    """Return the pull of the force source, see `SuctionLifter.give`; write the wrench and the force in it.

    `wrench` (6,) is planned and exerted with this relative `error`; `source` (4,) is the cup's largest force [N], the
    stiffness that it has from a fifth of that on, and `time` and `most`. The rest is as in `_pull_of_spring`.
    """
    limit, stiffness, time, most = source
    force, excess = np.empty(3), np.zeros(3)
    for i in range(3):
        force[i] = (1.0 + error) * wrench[i]
    size = math.sqrt(wrench[0] * wrench[0] + wrench[1] * wrench[1] + wrench[2] * wrench[2])
    loaded = min(1.0, size / (0.2 * limit))
    spring = _Spring(force, point, speed, wrench[3:], loaded * stiffness, time, most, False)
    return _pull_of_spring(plate, pad, spring, exerted, given, excess)


@dataclass(frozen=True, eq=False)
class WinchProfile:
    """Height of the lifter over time, drawn before the lift begins: it takes no notice of the robot.

    Somebody else operates it, by a switch that is pressed and let go, unevenly.
    """

    step: float
    """[s]"""
    heights: Array
    """(n,) never falling, from 0 [m]."""

    @classmethod
    def draw(cls, travel: float, step: float, rng: np.random.Generator, settings: WinchSettings) -> Self:
        """Draw moves, holds and jerks until the lifter has risen by `travel` [m]; it stops as it does anywhere."""
        speed, heights = 0.0, [0.0]
        wanted = [0.0] * round(rng.uniform(*settings.hold) / step)
        while heights[-1] < travel:
            if not wanted:
                wanted = _next_press(step, rng, settings)
            # Who operates it lets go in time, so that it comes to rest at the top as it does anywhere else.
            last = math.sqrt(2.0 * settings.deceleration * (travel - heights[-1]))
            faster, slower = speed + settings.acceleration * step, speed - settings.deceleration * step
            speed = max(min(wanted.pop(), last, faster), slower)
            heights.append(min(heights[-1] + speed * step, travel))
        return cls(step, np.array(heights))

    @property
    def duration(self) -> float:
        """Until the lifter stands for good [s]."""
        return self.step * (len(self.heights) - 1)

    def at(self, time: float) -> tuple[float, float]:
        """Return height [m] and speed [m/s]."""
        index = min(round(time / self.step), len(self.heights) - 1)
        after = min(index + 1, len(self.heights) - 1)
        return float(self.heights[index]), float(self.heights[after] - self.heights[index]) / self.step


def _next_press(step: float, rng: np.random.Generator, settings: WinchSettings) -> list[float]:
    """Return wanted speeds, last first: perhaps a jerk, a move, perhaps a hold."""
    speed = rng.uniform(*settings.speed)
    move = [speed] * round(rng.uniform(*settings.move) / step)
    jerk = rng.random() < settings.jerk_chance
    if jerk:
        move = [settings.jerk_speed] * round(settings.jerk_time / step) + move
    if rng.random() < settings.hold_chance:
        move += [0.0] * round(rng.uniform(*settings.hold) / step)
    return move[::-1]
