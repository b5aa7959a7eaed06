"""What the grasp in which an object is put down is worth to the object that is moved next.

Paper A takes the last grasp of one object as the first of the next. A grasp that cannot have the next one costs a
handover, which takes longer than everything that is saved by choosing it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planners.geometry.pose import Array
from planners.regrasp.graph.grasp_layer import NodeMask
from planners.regrasp.graph.suction_route import SuctionRoute
from planners.regrasp.motion.travel_time import NodeTravelTimes


class CostToGo:
    """The next object, as far as it can be moved without a handover. Nodes are numbered as in the regrasp graph."""

    def __init__(
        self, routes: Sequence[SuctionRoute], goals: int, travel_times: NodeTravelTimes, otherwise: Array
    ) -> None:
        """Ask nothing yet.

        Args:
            routes: of the next object; only their layers are asked.
            goals: how many of each route's goals are looked at, those that turn the tool least.
            travel_times: how long arms need.
            otherwise: (2 n,) seconds that a grasp costs which moves it by none of the routes.
        """
        self._routes, self._goals, self._travel_times, self._otherwise = tuple(routes), goals, travel_times, otherwise

    def seconds(self, positions: Array) -> Array:
        """Return (2 n,) least seconds of going on from (2 n, k, 6), NaN where a node is not asked about [rad]."""
        asked: NodeMask = np.any(np.isfinite(positions[:, :, 0]), axis=1)
        if not self._routes or not asked.any():
            return self._otherwise.copy()
        there, beyond = [], []
        for route in self._routes:
            reached = route.suction.ask(asked)
            goals = [route.goals[number] for number in route.goal_order[: self._goals]]
            on = np.full(len(asked), np.inf)
            for goal in goals:
                if goal.ask(reached).any():
                    on = np.minimum(on, self._travel_times.between(route.suction.solutions, goal.solutions))
            possible = np.isfinite(on)[:, None, None]
            there.append(np.where(possible, route.suction.solutions, np.nan))
            beyond.append(np.repeat(on[:, None], there[-1].shape[1], axis=1))
        found = self._travel_times.between(positions, np.concatenate(there, axis=1), np.concatenate(beyond, axis=1))
        return np.minimum(found, self._otherwise)
