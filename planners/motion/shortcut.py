"""Shorter paths by cutting corners."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planners.motion.checker import EdgeChecker
from planners.motion.joint_metric import JointMetric

RELATIVE_GAIN_MIN = 1e-3
"""A cut that saves less than this part of the path's length is not worth a collision check."""


def shorten(
    path: NDArray[np.float64],
    checker: EdgeChecker,
    metric: JointMetric,
    attempts: int,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """Shorten the free polyline path (m, n): leave out vertices, then replace random stretches by straight lines.

    Ends stay. Every new leg was found free by the checker; the length in the metric never grows. Geraerts and
    Overmars, "Creating high-quality paths for motion planning", IJRR 2007, section 3.
    """
    path = _leave_out_vertices(path, checker)
    for _ in range(attempts):
        if path.shape[0] == 2:
            break
        path = _cut_once(path, checker, metric, rng)
    return _leave_out_vertices(path, checker)


def _leave_out_vertices(path: NDArray[np.float64], checker: EdgeChecker) -> NDArray[np.float64]:
    """From each vertex kept, go straight to the last one that can be reached so."""
    kept = [0]
    last = path.shape[0] - 1
    while kept[-1] < last:
        following = kept[-1] + 1
        for candidate in range(last, following, -1):
            if checker.edge_free(path[kept[-1]], path[candidate]):
                following = candidate
                break
        kept.append(following)
    return path[kept]


def _cut_once(
    path: NDArray[np.float64],
    checker: EdgeChecker,
    metric: JointMetric,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """Connect two random points of the path, on different legs, by a straight line if that is free and shorter."""
    arc = np.concatenate([[0.0], np.cumsum(metric.leg_lengths(path))])
    s_from, s_to = np.sort(rng.random(2)) * arc[-1]
    leg_from, leg_to = np.clip(np.searchsorted(arc, [s_from, s_to], side="right") - 1, 0, path.shape[0] - 2)
    if leg_from == leg_to:
        return path
    q_from = _point_on_leg(path, arc, int(leg_from), s_from)
    q_to = _point_on_leg(path, arc, int(leg_to), s_to)
    saved = (s_to - s_from) - metric.length(np.stack([q_from, q_to]))
    if saved < RELATIVE_GAIN_MIN * arc[-1] or not checker.edge_free(q_from, q_to):
        return path
    return np.vstack([path[: leg_from + 1], q_from, q_to, path[leg_to + 1 :]])


def _point_on_leg(path: NDArray[np.float64], arc: NDArray[np.float64], leg: int, s: float) -> NDArray[np.float64]:
    fraction = (s - arc[leg]) / (arc[leg + 1] - arc[leg])
    return path[leg] + fraction * (path[leg + 1] - path[leg])
