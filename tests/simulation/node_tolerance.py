"""How far simulated forces may be from planned ones at a node, from what the simulation is told to do wrong."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from planners.geometry.pose import Array
from planners.plan.simulation import SimulatedManipulation
from workers.simulation.settings import SimulationSettings

OWN_SHARE = 0.1
"""Of a bearer's own planned force: its path is followed by compliant hands [1]."""
SIGMAS = 3.0
_READINGS = 6
"""In the mean over which nodes are compared: 60 ms of a sensor of 100 Hz."""


def largest_excess(manipulation: SimulatedManipulation) -> float:
    """Return the largest difference of force over what is allowed for it, of all bearers at all nodes [1]."""
    return max(
        float(np.linalg.norm(node.simulated[name] - force)) / _allowed(node.planned, name)
        for node in manipulation.nodes
        for name, force in node.planned.items()
    )


def _allowed(planned: Mapping[str, Array], name: str) -> float:
    """Return what a bearer may differ by [N].

    The lifter errs by some per cent of its planned pull, and what it does not bear the others do. A sensor is noisy,
    and the stick never presses less than a stated force.
    """
    settings = SimulationSettings()
    lifter = SIGMAS * settings.cup.error * float(np.linalg.norm(planned["cup"]))
    sensor = settings.sensor
    noise = SIGMAS * sensor.force_noise * float(np.sqrt(1.0 / _READINGS + 1.0 / sensor.tare_readings))
    own = OWN_SHARE * float(np.linalg.norm(planned[name]))
    return own + lifter + noise + _least_push(planned, settings.contact.least_push)


def _least_push(planned: Mapping[str, Array], least: float) -> float:
    """Return how much more than planned the stick may press [N]: nothing where all hands are to bear more than it."""
    hands = [float(np.linalg.norm(force)) for name, force in planned.items() if name in ("left", "right")]
    return max(0.0, least - min(hands, default=least))
