"""Polylines with rounded corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.motion.checker import EdgeChecker
from planners.motion.path import PathPoints


@dataclass(frozen=True)
class BlendSettings:
    """How corners of a polyline are rounded."""

    reach_max: float = 0.6
    """Most of a leg that one corner may take [rad of joint-space length]."""
    reach_min: float = 0.005
    """Below this a corner is not rounded: the motion stops there [rad]."""
    halvings: int = 6
    """How often a corner's reach is halved until its blend is free."""
    chord_error: float = 5e-4
    """The polyline checked in place of a blend is no farther from it than this [rad]: 0.4 mm at 0.8 m reach."""


CELLS_PER_LEG = 24
CELLS_PER_BLEND = 16
"""Grid cells of a leg and of a blend: the limits are exceeded by less than 2 % between the grid's points."""


@dataclass(frozen=True, eq=False)
class BlendedPath:
    """A polyline whose corners are replaced by blends; s is the joint-space arc length except within blends.

    A corner with incoming and outgoing unit directions t0, t1 and reach d becomes, for u = (s - s0) / 2d in [0, 1],
    `q'(s) = (1 - f(u)) t0 + f(u) t1` with f(u) = 3u² - 2u³: it leaves the incoming leg and joins the outgoing one at
    distance d from the corner, stays in the triangle between, and q'' is continuous (0 at both ends), so that the
    joints' accelerations do not jump. A reach of 0 keeps the corner; the motion must stop there.
    """

    waypoints: NDArray[np.float64]
    """(m, k) [rad], without repeated neighbours."""
    reaches: NDArray[np.float64]
    """(m,) [rad]; 0 at both ends."""

    @staticmethod
    def through(
        waypoints: NDArray[np.float64], checker: EdgeChecker, settings: BlendSettings | None = None
    ) -> BlendedPath:
        """Round the corners of a free polyline (m, k) [rad] as far as `checker` allows.

        Legs are not checked again: they were found free when the polyline was made.
        """
        settings = settings or BlendSettings()
        waypoints = _without_repeats(waypoints)
        legs = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
        reaches = np.zeros(waypoints.shape[0])
        for i in range(1, waypoints.shape[0] - 1):
            room = min(legs[i - 1] - reaches[i - 1], legs[i] if i == legs.size - 1 else 0.5 * legs[i])
            reaches[i] = _largest_free_reach(waypoints[i - 1 : i + 2], min(room, settings.reach_max), checker, settings)
        return BlendedPath(waypoints, reaches)

    @property
    def length(self) -> float:
        """Length of the polyline [rad]."""
        return float(self._corners()[-1])

    @property
    def stops(self) -> NDArray[np.float64]:
        """(m,) parameters of the corners that are not rounded."""
        return self._corners()[1:-1][self.reaches[1:-1] == 0.0]

    def grid(self, s_from: float, s_to: float) -> NDArray[np.float64]:
        """Parameters (n,) from s_from to s_to, dense in the blends."""
        corners = self._corners()
        knots = np.concatenate([corners - self.reaches, corners + self.reaches, [s_from, s_to]])
        knots = np.unique(knots[(knots >= s_from) & (knots <= s_to)])
        knots = knots[np.concatenate([[True], np.diff(knots) > 1e-12 * max(1.0, s_to)])]
        knots[-1] = s_to
        middles = 0.5 * (knots[1:] + knots[:-1])
        in_blend = np.any(np.abs(middles[:, None] - corners) < self.reaches, axis=1)
        cells = np.where(in_blend, CELLS_PER_BLEND, CELLS_PER_LEG)
        pieces = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(knots[:-1], knots[1:], cells, strict=True)]
        return np.concatenate([*pieces, [s_to]])

    def evaluate(self, s: NDArray[np.float64]) -> PathPoints:
        """Points at s (n,), derivatives exact."""
        if self.waypoints.shape[0] == 1:
            still = np.zeros((s.size, self.waypoints.shape[1]))
            return PathPoints(still + self.waypoints, still, still)
        corners, legs = self._corners(), np.diff(self.waypoints, axis=0)
        directions = legs / np.linalg.norm(legs, axis=1)[:, None]
        leg = np.clip(np.searchsorted(corners, s, side="right") - 1, 0, directions.shape[0] - 1)
        positions = self.waypoints[leg] + (s - corners[leg])[:, None] * directions[leg]
        first, second = directions[leg].copy(), np.zeros_like(positions)
        for i in np.flatnonzero(self.reaches):
            inside = np.abs(s - corners[i]) < self.reaches[i]
            blend = _blend(directions[i - 1], directions[i], self.reaches[i], s[inside] - corners[i])
            positions[inside] = self.waypoints[i] + blend.positions
            first[inside], second[inside] = blend.first, blend.second
        return PathPoints(positions, first, second)

    def _corners(self) -> NDArray[np.float64]:
        """(m,) parameter of each waypoint."""
        legs = np.linalg.norm(np.diff(self.waypoints, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(legs)])


def _blend(
    direction_in: NDArray[np.float64], direction_out: NDArray[np.float64], reach: float, s: NDArray[np.float64]
) -> PathPoints:
    """Points of a blend relative to its corner, at s (n,) from -reach to reach."""
    u = ((s + reach) / (2.0 * reach))[:, None]
    turn = direction_out - direction_in
    # The integral of f from 0 to u is u³ - u⁴/2.
    positions = s[:, None] * direction_in + 2.0 * reach * (u**3 - 0.5 * u**4) * turn
    first = direction_in + (3.0 * u**2 - 2.0 * u**3) * turn
    second = (6.0 * u - 6.0 * u**2) * turn / (2.0 * reach)
    return PathPoints(positions, first, second)


def _largest_free_reach(
    corner: NDArray[np.float64], reach: float, checker: EdgeChecker, settings: BlendSettings
) -> float:
    """Largest of reach, reach/2, … with which the corner (3, k) can be rounded; 0 if none."""
    legs = np.diff(corner, axis=0)
    direction_in, direction_out = legs / np.linalg.norm(legs, axis=1)[:, None]
    turn = float(np.linalg.norm(direction_out - direction_in))
    for _ in range(settings.halvings + 1):
        if reach < settings.reach_min:
            break
        # The greatest curvature is 0.75 turn / reach; a chord of length c is off by curvature c² / 8.
        chords = max(2, int(np.ceil(np.sqrt(0.375 * turn * reach / settings.chord_error))))
        s = np.linspace(-reach, reach, chords + 1)
        if checker.path_free(corner[1] + _blend(direction_in, direction_out, reach, s).positions):
            return reach
        reach *= 0.5
    return 0.0


def _without_repeats(waypoints: NDArray[np.float64]) -> NDArray[np.float64]:
    kept = np.concatenate([[True], np.linalg.norm(np.diff(waypoints, axis=0), axis=1) > 1e-12])
    return waypoints[kept]
