"""Contact sets balance weight and inertia, and stand close enough together along the way of the body."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.geometry.vectors import length
from planners.certify.motion.segment_motion import BodyContacts, SegmentMotion, added_up, turns_between
from planners.certify.plan_view import BodyView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array
from planners.plan.verdicts import Check

_NO_TURN = 1e-12
"""Sine of an angle below which it is its sine."""
_ROUNDING = 1e-6
"""Relative excess of the spacing that floating point may cause."""
_STILL = 1e-9
"""Motion of a sample that counts as none [m]."""


def balance_checks(evidence: Evidence) -> list[Check]:
    """Check forces and moments of all contact sets, assembled again in the world frame."""
    plan, settings = evidence.plan, evidence.settings
    force, moment = Finding("balance_force", "N"), Finding("balance_moment", "Nm")
    for contact_set in evidence.contacts:
        body, T = plan.bodies[contact_set.body], contact_set.T_world_body
        if body.mass is None:
            force.require(False, contact_set.where, "has contacts and no mass")
            continue
        centre = T[:3, :3] @ body.com + T[:3, 3]
        left, left_moment = added_up(contact_set.contacts, body.mass * plan.cell.gravity, centre)
        force.note(settings.force_balance - length(left), contact_set.where)
        moment.note(settings.moment_balance - length(left_moment), contact_set.where)
    return [force.check(), moment.check()]


@dataclass(frozen=True, eq=False)
class InertialLoad:
    """Minus the rates of change of momentum of a homogeneous body at the samples of a segment, world axes.

    Rates are taken over the two steps about a sample; the first and the last sample have those of their neighbours.
    """

    centres: Array
    """(n, 3) the centre of mass [m]."""
    forces: Array
    """(n, 3) [N]"""
    moments: Array
    """(n, 3) about the centre of mass [Nm]."""
    lever: float
    """The body's largest radius of gyration [m]."""

    @classmethod
    def of(cls, body: BodyView, mass: float, motion: SegmentMotion) -> InertialLoad:
        """Take the load of a body of that mass [kg] along a segment."""
        time, poses = motion.segment.time, motion.body_poses[body.name]
        centres = body.centres(poses)
        return cls(
            centres=centres,
            forces=-mass * _rates(time, np.diff(centres, axis=0)),
            moments=-_rates(time, _momenta(poses, body.inertia)),
            lever=body.gyration,
        )


def inertia_checks(evidence: Evidence) -> list[Check]:
    """Check that the inertia that was counted is what the motion has, at every sample, up to a part of the weight.

    Between two contact sets the mean of both, weighted by time, counts: what it balances is held, because cones are
    convex and the contacts stay where they are on the body. One weight for all bodies keeps what they exert on one
    another opposite. The moment may miss that part of the weight at a lever of the body's largest radius of gyration.
    """
    force, moment = Finding("inertia", "N"), Finding("angular_inertia", "Nm")
    gravity = float(np.linalg.norm(evidence.plan.cell.gravity))
    for motion in evidence.motions:
        for name in sorted({contact_set.body for contact_set in motion.contacts}):
            body = evidence.plan.bodies[name]
            if body.mass is None:
                continue
            shown = [contact_set for contact_set in motion.contacts if contact_set.body == name]
            looked_at = slice(shown[0].sample, shown[-1].sample + 1)
            counted = _counted_between(shown, body, motion.segment.time[looked_at])
            load = InertialLoad.of(body, body.mass, motion)
            slack = evidence.settings.inertia_fraction * body.mass * gravity
            rests = np.abs(motion.segment.velocities).max() <= evidence.settings.rest_velocity
            too_short = f"{motion.samples} samples do not tell the inertia of {name}, which moves"
            force.require(motion.samples > 2 or rests, motion.segment.place(0), too_short)

            def where(i: int, m: SegmentMotion = motion, first: int = looked_at.start, text: str = name) -> str:
                return f"{m.segment.place(first + i)}: {text}"

            missing = np.linalg.norm(counted[:, :3] - load.forces[looked_at], axis=1)
            force.note_all(slack - missing, where)
            missing = np.linalg.norm(counted[:, 3:] - load.moments[looked_at], axis=1)
            moment.note_all(slack * load.lever - missing, where)
    return [force.check(), moment.check()]


def _counted_between(shown: Sequence[BodyContacts], body: BodyView, time: Array) -> Array:
    """Return the inertia counted from the first to the last of one body's sets.

    Returns:
        (n, 6) force [N] and moment about the centre of mass [Nm] of the contacts of kind `inertia`.
    """
    centres = [body.centres(one.T_world_body[None])[0] for one in shown]
    counted = [added_up(one.inertia, np.zeros(3), centre) for one, centre in zip(shown, centres, strict=True)]
    times = [float(one.segment.time[one.sample]) for one in shown]
    return np.column_stack([np.interp(time, times, column) for column in np.array(counted).reshape(-1, 6).T])


def _momenta(poses: Array, tensor: Array) -> Array:
    """Return what angular momentum times the step is, about the centre of mass and world axes: (n - 1, 3) [Nm s²]."""
    before, after = poses[:-1, :3, :3], poses[1:, :3, :3]
    R = after @ np.swapaxes(before, 1, 2)
    sines = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1) / 2
    sine = np.linalg.norm(sines, axis=1)
    angle = np.arctan2(sine, (np.trace(R, axis1=1, axis2=2) - 1.0) / 2)
    turns = sines * np.where(sine > _NO_TURN, angle / np.maximum(sine, _NO_TURN), 1.0)[:, None]
    middle = (before + after) / 2
    return np.einsum("nij,jk,nlk,nl->ni", middle, tensor, middle, turns, optimize=True)


def _rates(time: Array, steps: Array) -> Array:
    """Return the rates of change of steps (n - 1, 3) over time at all samples, (n, 3); zero for two: they rest."""
    if len(time) < 3:
        return np.zeros((len(time), 3))
    intervals = np.diff(time)[:, None]
    inner = np.diff(steps / intervals, axis=0) / ((intervals[:-1] + intervals[1:]) / 2)
    return np.concatenate([inner[:1], inner, inner[-1:]])


def spacing_check(evidence: Evidence, needs_sets: Callable[[SegmentMotion, BodyView], bool]) -> Check:
    """Check that contact sets stand where a segment begins and ends, and close enough together in between.

    What a body turns and goes from one set to the next is added up over the samples in between: a way there and back
    is as long as both ways.

    Args:
        evidence: of the document.
        needs_sets: whether a body's contacts must be shown in a segment.
    """
    finding = Finding("contact_sets", "1")
    for motion in evidence.motions:
        for body in evidence.plan.bodies.values():
            if body.mass is None or body.static or not needs_sets(motion, body):
                continue
            samples = sorted({one.sample for one in motion.contacts if one.body == body.name})
            for end, name in ((0, "first"), (motion.samples - 1, "last")):
                missing = f"no contact set of {body.name} at the {name} sample"
                finding.require(end in samples, motion.segment.place(end), missing)
            _between(motion, body, samples, finding, evidence.settings)
    return finding.check()


def _between(
    motion: SegmentMotion, body: BodyView, samples: list[int], finding: Finding, settings: CertifySettings
) -> None:
    segment, poses = motion.segment, motion.body_poses[body.name]
    way = _added_up(np.linalg.norm(np.diff(body.centres(poses), axis=0), axis=1))
    turn = _added_up(turns_between(poses))
    still = np.abs(np.diff(poses, axis=0)).max(axis=(1, 2), initial=0.0) <= _STILL
    for before, after in pairwise(samples):
        rest = _longest_rest(segment.time[before : after + 1], still[before:after])
        used = max(
            (turn[after] - turn[before]) / settings.set_angle,
            (way[after] - way[before]) / settings.set_distance,
            rest / settings.set_time,
        )
        finding.note(1.0 + _ROUNDING - used, f"{segment.place(before)} to sample {after}: {body.name}")


def _added_up(steps: Array) -> Array:
    """Return how far it is to each sample: (n - 1,) → (n,)."""
    return np.concatenate([[0.0], np.cumsum(steps)])


def _longest_rest(time: Array, still: Array) -> float:
    """Return the longest time without motion among consecutive samples [s]."""
    longest = start = 0.0
    resting = False
    for index, at_rest in enumerate(still):
        if at_rest and not resting:
            start = float(time[index])
        resting = bool(at_rest)
        if resting:
            longest = max(longest, float(time[index + 1]) - start)
    return longest
