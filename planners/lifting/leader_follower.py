"""The velocity-based leader-follower law, paper B, eq. (11): the lifter leads, both hands follow one force."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.linalg import expm

from planners.errors import LiftwrightError

_DAMPING_PER_CUP_FORCE = 1.4
"""B_d over the cup's largest force [s/m]."""


@dataclass(frozen=True)
class FollowerGains:
    """Gains of eq. (11). The paper publishes none; these follow from plate, cup and sensor.

    The sensor also feels the plate's inertia, two readings late: when the hands speed up, so does the plate, and the
    force rises. With M_d below the mass that the hand accelerates the loop swings at the sensor's rate, so M_d is the
    whole plate's mass (a hand accelerates about half of it).

    B_d trades how far the force drops while following, B_d times the lifter's speed, against damping. Both sides grow
    with the cup: a stronger one is stiffer, and bears more before it is over its limit. So B_d is proportional to the
    cup's largest force. `planners.lifting.loop_margin` has the margins.
    """

    inertia: float = 4.0
    """M_d [kg]."""
    damping: float = 28.0
    """B_d [Ns/m]: hands that follow a lifter at 50 mm/s push with 1.4 N less than their goal."""
    stiffness: float = 0.0
    """K_d [N/m]. It would hold the arms back by K_d times the height."""
    period: float = 0.01
    """Of the force sensor, and so of the law [s]: FT300, 100 Hz."""

    def __post_init__(self) -> None:
        if not (self.inertia > 0.0 and self.damping > 0.0 and self.stiffness >= 0.0 and self.period > 0.0):
            raise LiftwrightError("inertia, damping and period must be positive, the stiffness not negative")

    @classmethod
    def for_lift(cls, mass: float, cup_force: float) -> Self:
        """Return the gains for a plate's mass [kg] and a cup's largest force [N].

        Following at 50 mm/s takes 7 % of the cup's force off the pushing hand, and about as much or twice that off the
        gripping hand: together what `lift_goal` would keep back for it.
        """
        return cls(inertia=mass, damping=_DAMPING_PER_CUP_FORCE * cup_force)


@dataclass(frozen=True)
class FollowerMotion:
    """What the law remembers."""

    velocity: float = 0.0
    """V, upward, common to both hands; never negative [m/s]."""
    lead: float = 0.0
    """Integral of V - V_d [m]."""


class LeaderFollower:
    """M_d (V' - V_d') + B_d (V - V_d) + K_d int (V - V_d) = E with E = F_goal - F and V >= 0.

    F is the vertical force of the *pushing* hand on the plate, upward positive: when the lifter rises, it takes load
    off the hand, F drops, E is positive and the hands speed up. V_d is constant between two readings (the paper
    writes V' - V_d; with its V_d = 0 the two are the same).

    Discretised exactly for an E that is held over one period: the matrix exponential of the law, not a difference
    quotient, so that the law behaves the same at any sampling rate. Where V would become negative the hands stop, and
    where it would exceed what the arms can make it stays there. What is remembered is the velocity that the hands
    have, not the one they were refused: nothing winds up while a limit acts.
    """

    def __init__(
        self,
        gains: FollowerGains | None = None,
        target_velocity: float = 0.0,
        largest_velocity: float = math.inf,
    ) -> None:
        """Prepare the law.

        Args:
            gains: see there.
            target_velocity: V_d [m/s]: the lifter's speed at which the hands bear F_goal.
            largest_velocity: that the arms can make [m/s].
        """
        self.largest_velocity = largest_velocity
        self.gains = gains or FollowerGains()
        self.target_velocity = target_velocity
        g = self.gains
        # d/dt [lead, V - V_d, E] = A [lead, V - V_d, E]
        A = np.zeros((3, 3))
        A[0, 1] = 1.0
        A[1] = np.array([-g.stiffness, -g.damping, 1.0]) / g.inertia
        self.discrete = expm(A * g.period)[:2]
        """(2, 3): takes [lead, V - V_d, E] to [lead, V - V_d] one period later."""

    def follow(self, motion: FollowerMotion, goal_force: float, force: float) -> FollowerMotion:
        """Return the motion one period later.

        Args:
            motion: now.
            goal_force: F_goal [N].
            force: F, the latest reading of the pushing hand, upward [N].
        """
        error = goal_force - force
        lead, relative = self.discrete @ np.array([motion.lead, motion.velocity - self.target_velocity, error])
        free = self.target_velocity + float(relative)
        velocity = min(max(free, 0.0), self.largest_velocity)
        if velocity != free:
            lead = motion.lead + (velocity - self.target_velocity) * self.gains.period
        return FollowerMotion(velocity, float(lead))
