"""The most that a cup and hands can lift: by a formula, and as stated in cvxpy tilt by tilt for a second opinion."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from planners.certify.common.cones import StatedCup

if TYPE_CHECKING:
    import cvxpy as cp

_TILT_STEP = 5.0
"""[degrees]"""
_AZIMUTHS = (0.0, 45.0)
"""Along an axis of the pad, and between two, where its friction (5f) holds most [degrees]."""


def largest_lift(cup: StatedCup, model: str) -> float:
    """Return the largest vertical force of the lifter on a plate at any tilt [N].

    Tilted by t, a pull p and a shear s along the plate have the vertical part p cos t + s sin t, whose largest value
    over t is hypot(p, s). By (5f) sqrt(3)|s_x| and sqrt(3)|s_y| are at most mu p, thus s at most sqrt(2/3) mu p; in the
    model `dexnet` mu (V - p) stands for mu p, and the value is convex in p, so largest at an end of 0 <= p <= V.
    """
    shear = math.sqrt(2.0 / 3.0) * cup.mu
    if model == "cable":
        return cup.max_force
    if model == "dexnet":
        return cup.max_force * max(1.0, shear)
    return cup.max_force * math.hypot(1.0, shear)


def stated_lift(cup: StatedCup, model: str, hands: Sequence[float]) -> float:
    """Return the largest vertical force on a body at any tilt from 0 to 90 degrees [N]; infinite if it is not found.

    The cup exerts what (5f) and (5h) of paper B allow, or another lifter's limits, without any moments, which would
    only take from it; tilts are in steps, with the one between them at which (5f) allows most.

    Args:
        cup: of the lifter or of a tool.
        model: of the cup: "paper", "cable" or "dexnet".
        hands: the largest net force of each hand [N]; a hand may exert it in any direction.
    """
    # Takes a second to import, and is needed for tasks that are too heavy alone.
    import cvxpy as cp

    up, force, tension = cp.Parameter(3), cp.Variable(3), cp.Variable()
    nets = [cp.Variable(3) for _ in hands]
    limits: list[cp.Constraint] = [cp.norm(net) <= most for net, most in zip(nets, hands, strict=True)]
    if model == "cable":
        limits += [force == tension * up, tension >= 0, tension <= cup.max_force]
    else:
        pressed = force[2] if model == "paper" else cup.max_force - force[2]
        limits += [force[2] >= 0, force[2] <= cup.max_force, math.sqrt(3.0) * cp.abs(force[:2]) <= cup.mu * pressed]
    problem = cp.Problem(cp.Maximize(up @ (force + sum(nets))), limits)
    most = 0.0
    for tilt in (
        *np.arange(0.0, 90.0 + _TILT_STEP, _TILT_STEP),
        math.degrees(math.atan(math.sqrt(2.0 / 3.0) * cup.mu)),
    ):
        for azimuth in _AZIMUTHS:
            t, a = math.radians(tilt), math.radians(azimuth)
            up.value = np.array([math.sin(t) * math.cos(a), math.sin(t) * math.sin(a), math.cos(t)])
            found = problem.objective.value if solve_with_care(problem) else math.inf
            most = max(most, float(np.asarray(found)))
    return most


def solve_with_care(problem: cp.Problem) -> bool:
    """Solve a problem stated in cvxpy, once more with data scaled with more care where the answer is inaccurate.

    Returns:
        Whether the answer is accurate.
    """
    with warnings.catch_warnings():
        # It warns of what the status says.
        warnings.simplefilter("ignore", UserWarning)
        for settings in ({}, {"equilibrate_max_iter": 50}):
            problem.solve(solver="CLARABEL", **settings)
            if problem.status == "optimal":
                return True
    return False
