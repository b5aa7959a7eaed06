"""Ruckig along a polyline: straight, and from rest to rest on each leg, as its free edition passes no waypoint."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from ruckig import InputParameter, Result, Ruckig, Synchronization, Trajectory

from planners.geometry.pose import Array
from planners.motion.timing import JointLimits
from tests.benchmarks.peers.contest import Samples


def time_with_ruckig(waypoints: Array, limits: JointLimits, jerk: Array, step: float) -> Samples:
    """Return the samples, at most `step` apart [s].

    Raises:
        ArithmeticError: It finds no motion.
    """
    count = waypoints.shape[1]
    generator = Ruckig(count)
    t, q, v, a = [], [], [], []
    begin = 0.0
    for start, end in pairwise(waypoints):
        wanted, found = InputParameter(count), Trajectory(count)
        wanted.synchronization = Synchronization.Phase
        wanted.current_position, wanted.target_position = start.tolist(), end.tolist()
        wanted.max_velocity, wanted.max_acceleration = limits.velocity.tolist(), limits.acceleration.tolist()
        wanted.max_jerk = jerk.tolist()
        if generator.calculate(wanted, found) not in (Result.Working, Result.Finished):
            raise ArithmeticError("no motion")
        for time in np.linspace(0.0, found.duration, max(2, int(np.ceil(found.duration / step)) + 1)):
            position, velocity, acceleration = found.at_time(float(time))
            t.append(begin + time)
            q.append(position)
            v.append(velocity)
            a.append(acceleration)
        begin += found.duration
    return np.array(t), np.array(q), np.array(v), np.array(a)
