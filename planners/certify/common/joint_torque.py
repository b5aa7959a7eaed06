"""What the joints must exert, at every sample, against what they can.

Torques come from pinocchio's recursion of Newton and Euler (RNEA) with the positions, velocities and accelerations of
the document, links and hands being point masses; to them is added what the wrench takes that a hand exerts on the body
it holds, by its contacts. What bodies weigh and what moving them takes is in the contacts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.motion.kinematics import ArmDynamics
from planners.certify.motion.segment_motion import BodyContacts, SegmentMotion
from planners.certify.plan_view import PlanView
from planners.contract.arrays import ArmName
from planners.geometry.pose import Array
from planners.plan.scenery import ARMS, JOINT_NAMES, CellDocument
from planners.plan.verdicts import Check

NAME = "joint torque"


@dataclass(frozen=True, eq=False)
class _Weighed:
    """An arm with its hand, and all that its torques follow from."""

    dynamics: ArmDynamics
    torque_max: Array
    """(6,) [Nm]."""

    @classmethod
    def of(cls, cell: CellDocument, arm: ArmName, gravity: Array) -> _Weighed | None:
        """Return an arm as it is stated; None where masses or torques are not."""
        stated, hand = cell.arms[arm], cell.hands[arm]
        if stated.links is None or stated.torque_max is None or hand.com is None or hand.mass is None:
            return None
        masses = np.array([[part.mass, *part.com] for part in stated.links] + [[hand.mass, *hand.com]])
        return cls(ArmDynamics(stated.dh, stated.T_world_base, masses, gravity), stated.torque_max)


def torque_check(evidence: Evidence) -> Check:
    """Check |torque| of each joint at every sample against its largest torque, less a part of it.

    The worst place is where the smallest share of a joint's largest torque is left.

    Documents of 0.1.0 state neither masses of links nor torques: those of the known cell of that name are taken.
    """
    arms = {arm: _weighed(evidence, arm) for arm in ARMS}
    unknown = [arm for arm, weighed in arms.items() if weighed is None]
    if unknown:
        where = f"not checked: masses and largest torques are not stated of the {' and the '.join(unknown)} arm"
        return Check(name=NAME, passed=True, margin=None, unit="Nm", where=where)
    finding, reserve = Finding(NAME, "1"), evidence.settings.torque_reserve
    most = 1.0
    """Of the joint at the worst place [Nm]."""

    def place(sample: int, joint: int, motion: SegmentMotion, first: int, torque_max: Array) -> str:
        nonlocal most
        most = float(torque_max[joint])
        return f"{motion.segment.place(sample)}: {JOINT_NAMES[first + joint]}"

    for motion in evidence.motions:
        for number, (arm, weighed) in enumerate(arms.items()):
            assert weighed is not None
            columns = slice(6 * number, 6 * number + 6)
            held = _unladen(weighed.dynamics, motion, columns)
            torques = np.max([np.abs(held + exerting) for exerting in _exerting(evidence.plan, motion, arm)], axis=0)
            left = 1.0 - reserve - torques / weighed.torque_max
            finding.note_all(left, partial(place, motion=motion, first=6 * number, torque_max=weighed.torque_max))
    share = finding.check()
    if share.margin is None:
        return share
    margin = share.margin * most if math.isfinite(share.margin * most) else share.margin
    return share.model_copy(update={"margin": margin, "unit": "Nm", "share_left": share.margin + reserve})


def _weighed(evidence: Evidence, arm: ArmName) -> _Weighed | None:
    cell, reference = evidence.plan.cell, evidence.reference
    stated = _Weighed.of(cell, arm, cell.gravity)
    if stated is not None or reference is None or cell.name != reference.cell.name:
        return stated
    return _Weighed.of(reference.cell, arm, cell.gravity)


def _unladen(dynamics: ArmDynamics, motion: SegmentMotion, columns: slice) -> Array:
    """Return the torques (n, 6) of an arm that exerts nothing; those of one that rests are computed once."""
    sampled = motion.segment.positions, motion.segment.velocities, motion.segment.accelerations
    state = np.hstack([rows[:, columns] for rows in sampled])
    if np.all(state == state[0]):
        return np.broadcast_to(dynamics.torques(*np.split(state[:1], 3, axis=1)), (len(state), 6))
    return dynamics.torques(*np.split(state, 3, axis=1))


def _exerting(plan: PlanView, motion: SegmentMotion, arm: str) -> Array:
    """Return the torques (2, n, 6) by which an arm's hand exerts what contacts show: of the set before, and the next.

    Between two sets each wrench goes with the body's centre of mass, in world axes, as a weight does. Torques are
    linear in the wrench: no mean of both sets asks for more than the worse of them.
    """
    torques = np.zeros((2, motion.samples, 6))
    frames = motion.frames[arm]
    for name in sorted({contact_set.body for contact_set in motion.contacts}):
        shown = [contact_set for contact_set in motion.contacts if contact_set.body == name]
        centres = plan.bodies[name].centres(motion.body_poses[name])
        samples, count = [contact_set.sample for contact_set in shown], np.arange(motion.samples)
        wrenches = _exerted(shown, arm, centres[samples])
        if not wrenches.any():
            continue
        before = np.maximum(np.searchsorted(samples, count, side="right") - 1, 0)
        after = np.minimum(np.searchsorted(samples, count), len(samples) - 1)
        for row, chosen in enumerate((before, after)):
            torques[row] += _by_virtual_work(frames, wrenches[chosen], centres)
    return torques


def _exerted(sets: Sequence[BodyContacts], arm: str, points: Array) -> Array:
    """Return the wrench of one hand on the body in each of n sets, about points (n, 3) of the world: (n, 6)."""
    wrenches = np.zeros((len(sets), 6))
    made = [(row, one) for row, contact_set in enumerate(sets) for one in contact_set.contacts if one.by == arm]
    if made:
        rows = [row for row, _ in made]
        forces = np.array([one.force for _, one in made])
        levers = np.array([one.point for _, one in made]) - points[rows]
        moments = np.array([one.torque for _, one in made]) + np.cross(levers, forces)
        np.add.at(wrenches, rows, np.hstack([forces, moments]))
    return wrenches


def _by_virtual_work(frames: Array, wrenches: Array, points: Array) -> Array:
    """Return J^T w at n samples: frames (n, 7, 4, 4), wrenches (n, 6) about points (n, 3) → (n, 6)."""
    axes, origins = frames[:, :6, :3, 2], frames[:, :6, :3, 3]
    moments = wrenches[:, None, 3:] + np.cross(points[:, None] - origins, wrenches[:, None, :3])
    return np.sum(axes * moments, axis=2)
