"""The velocity-based leader-follower law, paper B, eq. (11): the lifter leads, both hands follow what they bear."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planners.errors import LiftwrightError


@dataclass(frozen=True)
class FollowerGains:
    """Gains of eq. (11). The paper publishes none: `planners.lifting.lift_loop.design_gains` finds those of a hold.

    The sensors also feel the plate's inertia, two readings late, and it rings on pads and tip. What is known of that
    inertia is taken off the readings, so that M_d may be less than what the hands accelerate.
    """

    inertia: float = 2.0
    """M_d [kg]."""
    damping: float = 22.0
    """B_d [Ns/m]."""
    carried: float = 0.0
    """Mass whose inertia is taken off the readings [kg]."""
    memory: float = 1.0
    """Time in which V_d, the estimate of the lifter's speed, takes on the speed of the hands [s]."""
    readings: int = 5
    """The force is the mean of so many: less noise, and less of what rings [1]."""
    period: float = 0.01
    """Of the force sensors, and so of the law [s]: FT300, 100 Hz."""

    def __post_init__(self) -> None:
        if not (min(self.inertia, self.damping, self.memory, self.period) > 0.0 and self.readings >= 1):
            raise LiftwrightError("inertia, damping, memory, period and the number of readings must be positive")


@dataclass(frozen=True)
class FollowerMotion:
    """What the law remembers."""

    velocity: float = 0.0
    """V, upward, common to both hands; never negative [m/s]."""
    lifter_velocity: float = 0.0
    """V_d: the lifter's speed as it is estimated [m/s]."""
    errors: tuple[float, ...] = ()
    """E of the last readings, the newest last [N]."""
    accelerations: tuple[float, float] = (0.0, 0.0)
    """Change of V in the last two periods over their length, the newest last [m/s^2]."""


class LeaderFollower:
    """M_d V' + B_d (V - V_d) = E with V >= 0, where V_d follows V: memory V_d' = V - V_d.

    E = F_goal - F, with F the vertical force of both hands on the plate, upward positive: when the lifter rises, it
    takes load off the hands, F drops, E is positive and the hands speed up. As long as they bear F_goal they rise like
    the lifter, so what they have lately done is an estimate of its speed that needs nothing but their own. At any
    steady speed V_d = V, and so E = 0: the hands bear F_goal, where a fixed V_d would leave B_d (V - V_d) to the cup.
    V_d acts as an integral of E that ends where the hands' own limits end it, and holds nothing against height: the
    paper's K_d, which would, is left out. V_d changes slowly, and M_d V_d' is left out as well.

    Discretised exactly for an E that is held over one period, not by a difference quotient, so that the law behaves the
    same at any sampling rate. Where V would become negative the hands stop, and
    where it would exceed what the arms can make it stays there. What is remembered is the velocity that the hands
    have, not the one they were refused: nothing winds up while a limit acts.
    """

    def __init__(self, gains: FollowerGains | None = None) -> None:
        """Prepare the law."""
        self.gains = gains or FollowerGains()
        g = self.gains
        # The gap V - V_d decays at one rate: (V - V_d)' = E / M_d - rate (V - V_d). All else is its integral.
        stiffness, recall = g.damping / g.inertia, 1.0 / g.memory
        rate = stiffness + recall
        # Over a period: of a gap that is 1 m/s at its begin [s], and of the gap that an E of 1 N opens [m].
        gap = -math.expm1(-rate * g.period) / rate
        pushed = (g.period - gap) / (rate * g.inertia)
        self.discrete = np.array(
            [
                [1.0 - stiffness * gap, stiffness * gap, g.period / g.inertia - stiffness * pushed],
                [recall * gap, 1.0 - recall * gap, recall * pushed],
            ]
        )
        """(2, 3): takes [V, V_d, E] to [V, V_d] one period later."""
        self._kept = math.exp(-g.period / g.memory)

    def follow(
        self, motion: FollowerMotion, goal_force: float, force: float, largest_velocity: float = math.inf
    ) -> FollowerMotion:
        """Return the motion one period later.

        Args:
            motion: now.
            goal_force: F_goal of both hands together, upward [N].
            force: F, the latest reading of both hands together, upward [N].
            largest_velocity: that the arms can make where they are [m/s].
        """
        gains = self.gains
        # The reading is of a period ago: of the end of the period before that, in which V changed linearly.
        inertia = gains.carried * motion.accelerations[0]
        errors = (*motion.errors, goal_force - (force - inertia))[-gains.readings :]
        error = sum(errors) / len(errors)
        free, lifter = self.discrete @ np.array([motion.velocity, motion.lifter_velocity, error])
        velocity = min(max(float(free), 0.0), largest_velocity)
        if velocity != free:
            lifter = velocity + self._kept * (motion.lifter_velocity - velocity)
        gained = (velocity - motion.velocity) / gains.period
        return FollowerMotion(velocity, float(lifter), errors, (motion.accelerations[1], gained))
