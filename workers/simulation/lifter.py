"""The lifter: its cup is a force source while the plate is manipulated, and hangs on a winch while it is lifted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from planners.balance.lifter import SuctionPad
from planners.geometry.pose import Array, skew
from planners.manipulation.statics.lift_programs import balance_program
from planners.scene.lift_scene import PlateLiftScene
from workers.simulation.settings import ContactSettings, CupSettings, WinchSettings
from workers.simulation.world import Motion


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
        self._settings, self._rng, self._cable = settings, rng, scene.lifter_model == "cable"
        self._arm = cup.T_plate_cup[:3, 3] - scene.plate.com
        self._axes = cup.T_plate_cup[:3, :3]
        self._outward = -cup.T_plate_cup[:3, 2]
        self._radius = cup.radius
        pad = balance_program(scene).lifter
        at_rest, per_pull = (pad.grip_at_rest, pad.grip_per_pull) if isinstance(pad, SuctionPad) else (0.0, 0.0)
        self._grip = contact.friction_factor * at_rest, contact.friction_factor * per_pull
        self._bending = math.pi * cup.radius * cup.kappa / math.sqrt(2.0)
        self.limit = cup.max_force
        """[N]"""
        self.stiffness = settings.stiffness(cup.max_force)
        """[N/m]"""
        self.pull = 0.0
        """Outward along the pad's normal; for a cable its tension [N]."""
        self.force = np.zeros(3)
        """(3,) on the plate, world axes [N]."""
        self.slid = 0.0
        """How far the pad has slid on the plate during the lift [m]."""
        self._error = rng.normal(scale=settings.error)
        self._over = 0.0
        self._hung: tuple[Array, Array, Array] | None = None

    def place(self, plate: Motion) -> tuple[Array, Array]:
        """Return the pad's place (3,) and its velocity (3,), world."""
        R, com, velocity, spin = plate
        arm = R @ self._arm
        return com + arm, velocity + skew(spin) @ arm

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
        self._error = decay * self._error + s.error * math.sqrt(1.0 - decay * decay) * self._rng.normal()
        place, moves = self.place(plate)
        loaded = min(1.0, float(np.linalg.norm(wrench[:3])) / (0.2 * self.limit))
        force = (1.0 + self._error) * wrench[:3]
        force = force + loaded * self.stiffness * (point - place + s.damping_time * (velocity - moves))
        return self._exert(force, wrench[3:], plate, s.saturation * self.limit)[0]

    def hang(self, plate: Motion, torque: Array) -> None:
        """Begin the lift: from now on the head is where the winch has it, and the force now is the force at rest."""
        place, _ = self.place(plate)
        self._hung = (self.force.copy(), place, torque)

    def hoist(self, height: float, speed: float, plate: Motion) -> Array:
        """Act as a spring to the head at a height over where the lift began; return the (6,) wrench as in `give`."""
        assert self._hung is not None
        force0, place0, torque = self._hung
        place, moves = self.place(plate)
        lag, rate = place0 - place, -moves
        lag[2] += height
        rate[2] += speed
        if self._cable:
            # The trolley follows above the cup: the cable stays upright.
            lag[:2] = rate[:2] = 0.0
        force = force0 + self.stiffness * (lag + self._settings.damping_time * rate)
        wrench, excess = self._exert(force, torque, plate, math.inf)
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

    def _exert(self, force: Array, torque: Array, plate: Motion, most: float) -> tuple[Array, Array]:
        """Keep a force within what the cup can bear; return the wrench about the centre of mass, and what slid away."""
        R = plate[0]
        if self._cable:
            self.pull = min(max(0.0, float(force[2])), most)
            self.force = np.array([0.0, 0.0, self.pull])
            arm = R @ self._arm
            return np.concatenate([self.force, skew(arm) @ self.force]), np.zeros(3)
        outward = R @ self._outward
        self.pull = min(max(0.0, float(force @ outward)), most)
        across = force - (force @ outward) * outward
        at_rest, per_pull = self._grip
        size, grip = math.sqrt(across @ across), max(0.0, at_rest + per_pull * self.pull)
        excess = across * max(0.0, 1.0 - grip / size) if size > 0.0 else np.zeros(3)
        self.force = self.pull * outward + across - excess
        arm = R @ self._arm
        return np.concatenate([self.force, skew(arm) @ self.force + self._borne(torque, R, grip)]), excess

    def _borne(self, torque: Array, R_world_plate: Array, grip: float) -> Array:
        """Keep a torque (3,) within what the pad bears: paper B's (5g) about its x and y, friction about its normal."""
        axes, twist = R_world_plate @ self._axes, self._radius * grip
        most = np.array([self._bending, self._bending, twist])
        return axes @ np.minimum(np.maximum(axes.T @ torque, -most), most)


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
