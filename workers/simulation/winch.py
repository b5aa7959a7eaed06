"""The lifter that somebody else operates: a switch that is pressed and let go, unevenly."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from planners.geometry.pose import Array
from workers.simulation.settings import WinchSettings


@dataclass(frozen=True, eq=False)
class WinchProfile:
    """Height of the lifter over time, drawn before the lift begins: it takes no notice of the robot."""

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
