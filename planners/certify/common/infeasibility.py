"""What proves that no plan exists: more is needed than there can be; and the causes stated are that proof."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planners.certify.common.cones import StatedCup
from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.motion.solids import gripper_of
from planners.certify.plan_view import BodyView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array
from planners.plan.verdicts import Check

if TYPE_CHECKING:
    import cvxpy as cp

_TILT_STEP = 5.0
"""[degrees]"""
_AZIMUTHS = (0.0, 45.0)
"""Along an axis of the pad, and between two, where its friction (5f) holds most [degrees]."""
_TOLERANCES = 0.005
"""Where bodies rest, are held and end may be off by less, all in all [m]: contacts and attachments, goals and settling
of the contract."""


@dataclass(frozen=True)
class Bound:
    """What is needed against the most that there can be."""

    needed: float
    needed_as_stated: tuple[float, ...]
    """What a document may name as needed: every one of them would have to be met."""
    available: float
    second_opinion: Callable[[], float] | None = None
    """Finds what there is without the formulas that `available` comes from; None where it is but read and compared."""

    @property
    def missing(self) -> float:
        """Part of the need that cannot be met; the claim is proven where it is positive."""
        return 1.0 - self.available / self.needed


def reach_bound(evidence: Evidence, point: Array, further: float) -> Bound:
    """Return how far a point is from the shoulder of the arm that misses it by least, and how far that one reaches [m].

    Args:
        evidence: has arms and hands.
        point: (3,) in the world [m].
        further: what a hand reaches with, and how far around the point it may touch [m].
    """
    reaches = []
    for name, arm in evidence.plan.cell.arms.items():
        # Each row of the table stretched out from the shoulder: the point of the first axis that the joint turns about.
        shoulder = arm.T_world_base[:3, 3] + float(arm.dh[0, 2]) * arm.T_world_base[:3, 2]
        stretched = abs(float(arm.dh[0, 0])) + sum(math.hypot(a, d) for a, _, d, _ in arm.dh[1:].tolist())
        available = stretched + _hand_length(evidence, name) + further + _TOLERANCES
        reaches.append((float(np.linalg.norm(point - shoulder)), available))
    needed, available = max(reaches, key=lambda pair: pair[1] - pair[0])
    return Bound(max(needed, _TOLERANCES), (max(needed, _TOLERANCES),), available)


def body_radius(body: BodyView) -> float:
    """Return how far a body's farthest corner is from its origin [m]."""
    return float(np.linalg.norm(body.shape.vertices, axis=1).max())


def _hand_length(evidence: Evidence, arm: str) -> float:
    """Return how far from the flange's origin a hand can touch anything: pads opened widest, or the tip's pole [m]."""
    hand = evidence.plan.cell.hands[arm]
    if hand.kind == "stick":
        return float(np.linalg.norm(hand.T_flange_tip[:3, 3])) + hand.tip_radius
    width, _, length = gripper_of(arm, evidence.surfaces).pad_size.tolist()
    opening, height = hand.tcp.max(axis=0)
    return math.hypot(width / 2, float(opening) / 2, float(height) + length / 2)


def proof_check(evidence: Evidence, bounds: Mapping[str, Sequence[Bound]]) -> Check:
    """Check that one of the bounds, by unit, is a proof, and that each cause states the numbers of one of them.

    A cause may overstate what is available, as long as it is still less than what is needed; never understate it.
    """
    finding, settings = Finding("infeasibility", "1"), evidence.settings
    every = [(unit, bound) for unit, group in bounds.items() for bound in group]
    unit, best = max(every, key=lambda item: item[1].missing)
    finding.note(
        best.missing - settings.join,
        f"/explanation: {best.needed:.6g} {unit} needed, {best.available:.6g} {unit} available",
    )
    if best.second_opinion is not None and finding.margin >= 0.0:
        found = best.second_opinion()
        where = f"/explanation: {best.needed:.6g} {unit} needed, {found:.6g} {unit} available as the program finds"
        finding.note(1.0 - found / best.needed + settings.stated_bound, where)
    compared = False
    for index, cause in enumerate(evidence.plan.stated.explanation.causes):
        if cause.needed is None or cause.available is None:
            continue
        where, group = f"/explanation/causes/{index}", bounds.get(cause.unit or "")
        if group is None:
            finding.require(False, f"{where}/unit", f"nothing infeasible is measured in {cause.unit!r}")
            continue
        claims = [_claims(cause.needed, cause.available, bound, settings) for bound in group]
        for said, margin in max(claims, key=lambda found: min(found.values())).items():
            finding.note(margin, f"{where}/{said}")
        compared = True
    if not compared:
        finding.require(False, "/explanation/causes", "none states what makes the task infeasible")
    return finding.check()


def _claims(needed: float, available: float, bound: Bound, settings: CertifySettings) -> dict[str, float]:
    """Return the margins by which a cause says of a bound what is so: what was needed, what there is, that it lacks."""
    off = min(abs(needed - one) / bound.needed for one in bound.needed_as_stated)
    understated = (bound.available - available) / bound.needed
    return {
        f"needed: {needed:.6g}, not {bound.needed:.6g}": settings.stated_bound - off,
        f"available: {available:.6g}, not {bound.available:.6g}": settings.stated_bound - understated,
        f"available: {available:.6g} would suffice": 1.0 - available / bound.needed,
    }


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
