"""The force-torque sensor in a wrist: noise, an offset, and taring."""

from __future__ import annotations

import numpy as np

from planners.geometry.pose import Array
from workers.simulation.settings import SensorSettings


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
        return wrench + self._offset + self._rng.normal(scale=self._noise) - self._tare
