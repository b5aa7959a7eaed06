"""Balances, assembled again in the world frame, and where the plan must show them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planners.certify.certificate import Check, Finding
from planners.certify.document_view import BodyView, ContactView, PlanView, SegmentView
from planners.certify.motion import SegmentMotion
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array, Transform

_ROUNDING = 1e-6
"""Relative excess of the spacing of contact sets that floating point may cause."""
_STILL = 1e-9
"""Motion of a sample that counts as none [m]."""


@dataclass(frozen=True, eq=False)
class ContactSet:
    """All contacts on one body at one sample."""

    segment: SegmentView
    sample: int
    body: str
    T_world_body: Transform
    contacts: tuple[ContactView, ...]

    @property
    def where(self) -> str:
        """Name the set."""
        return f"{self.segment.place(self.sample)}: {self.body}"


def contact_sets(motion: SegmentMotion) -> list[ContactSet]:
    """Group a segment's contacts by body and sample, in order of time."""
    groups: dict[tuple[str, int], list[ContactView]] = defaultdict(list)
    for contact in motion.segment.contacts:
        groups[contact.body, contact.sample].append(contact)
    return [
        ContactSet(motion.segment, sample, body, motion.body_poses[body][sample], tuple(contacts))
        for (body, sample), contacts in sorted(groups.items(), key=lambda item: item[0])
    ]


def balance_checks(
    plan: PlanView,
    motions: Sequence[SegmentMotion],
    sets: Sequence[Sequence[ContactSet]],
    needs_sets: Callable[[SegmentMotion, BodyView], bool],
    settings: CertifySettings,
) -> list[Check]:
    """Check forces, moments, counted inertia and the spacing of contact sets.

    Args:
        plan: the document.
        motions: of each segment.
        sets: of each segment.
        needs_sets: whether a body's contacts must be shown in a segment.
        settings: tolerances.
    """
    force, moment = Finding("balance_force", "N"), Finding("balance_moment", "Nm")
    for contact_set in (one for group in sets for one in group):
        body = plan.bodies[contact_set.body]
        if body.mass is None:
            force.require(False, contact_set.where, "has contacts and no mass")
            continue
        total_force, total_moment = residual(contact_set, body, plan.gravity)
        force.note(settings.force_balance - float(np.linalg.norm(total_force)), contact_set.where)
        moment.note(settings.moment_balance - float(np.linalg.norm(total_moment)), contact_set.where)
    return [
        force.check(),
        moment.check(),
        *_inertia(plan, motions, sets, settings),
        _spacing(plan, motions, sets, needs_sets, settings),
    ]


def residual(contact_set: ContactSet, body: BodyView, gravity: Array) -> tuple[Array, Array]:
    """Return what is left of force [N] and moment about the centre of mass [Nm], world axes."""
    T = contact_set.T_world_body
    com = T[:3, :3] @ body.com + T[:3, 3]
    force, moment = (body.mass or 0.0) * gravity, np.zeros(3)
    for contact in contact_set.contacts:
        force = force + contact.force
        moment = moment + contact.torque + np.cross(contact.point - com, contact.force)
    return force, moment


def _centres(body: BodyView, poses: Array) -> Array:
    return poses[:, :3, :3] @ body.com + poses[:, :3, 3]


def _inertia(
    plan: PlanView, motions: Sequence[SegmentMotion], sets: Sequence[Sequence[ContactSet]], settings: CertifySettings
) -> list[Check]:
    """What inertia was counted must be what the motion has, up to a small part of the weight.

    Force and moment about the centre of mass are taken from the poses, for a homogeneous body of the stated mass; where
    they jump, any value in between will do. The moment may miss that part of the weight at a lever of the body's
    largest radius of gyration.
    """
    force, moment = Finding("inertia", "N"), Finding("angular_inertia", "Nm")
    gravity = float(np.linalg.norm(plan.gravity))
    for motion, group in zip(motions, sets, strict=True):
        for name in sorted({contact_set.body for contact_set in group}):
            body, mass = plan.bodies[name], plan.bodies[name].mass
            if mass is None:
                continue
            time, poses = motion.segment.time, motion.body_poses[name]
            tensor = body.shape.inertia(mass, body.com)
            lever = float(np.sqrt(np.linalg.norm(tensor, 2) / mass))
            forces = -mass * _second_differences(time, np.diff(_centres(body, poses), axis=0))
            moments = -_second_differences(time, _momenta(poses, tensor))
            slack = settings.inertia_fraction * mass * gravity
            for contact_set in group:
                if contact_set.body == name:
                    counted_force, counted_moment = _counted(contact_set, body)
                    missing = _missing(counted_force, forces, contact_set.sample)
                    force.note(slack - missing, contact_set.where)
                    missing = _missing(counted_moment, moments, contact_set.sample)
                    moment.note(slack * lever - missing, contact_set.where)
    return [force.check(), moment.check()]


def _counted(contact_set: ContactSet, body: BodyView) -> tuple[Array, Array]:
    """Return force [N] and moment about the centre of mass [Nm] of the contacts of kind `inertia`."""
    T = contact_set.T_world_body
    com, force, moment = T[:3, :3] @ body.com + T[:3, 3], np.zeros(3), np.zeros(3)
    for contact in contact_set.contacts:
        if contact.kind == "inertia":
            force = force + contact.force
            moment = moment + contact.torque + np.cross(contact.point - com, contact.force)
    return force, moment


def _missing(counted: Array, needed: Array, sample: int) -> float:
    low, high = _around(needed, sample)
    return float(np.linalg.norm(counted - np.clip(counted, low, high)))


def _momenta(poses: Array, tensor: Array) -> Array:
    """Return what angular momentum times the step is, about the centre of mass and world axes: (n - 1, 3) [Nm s²]."""
    before, after = poses[:-1, :3, :3], poses[1:, :3, :3]
    middle = (before + after) / 2
    R = after @ np.swapaxes(before, 1, 2)
    sines = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1) / 2
    # Steps are small: the angle is its sine.
    return np.einsum("nij,jk,nlk,nl->ni", middle, tensor, middle, sines, optimize=True)


def _second_differences(time: Array, steps: Array) -> Array:
    """Return rates of change of steps / time at the inner samples, (n - 2, 3); zero for two samples: at rest both."""
    if len(time) < 3:
        return np.zeros((1, 3))
    intervals = np.diff(time)[:, None]
    return np.diff(steps / intervals, axis=0) / ((intervals[:-1] + intervals[1:]) / 2)


def _around(values: Array, sample: int) -> tuple[Array, Array]:
    near = values[max(0, min(sample - 2, len(values) - 1)) : max(1, sample + 1)]
    return near.min(axis=0), near.max(axis=0)


def _spacing(
    plan: PlanView,
    motions: Sequence[SegmentMotion],
    sets: Sequence[Sequence[ContactSet]],
    needs_sets: Callable[[SegmentMotion, BodyView], bool],
    settings: CertifySettings,
) -> Check:
    finding = Finding("contact_sets", "1")
    for motion, group in zip(motions, sets, strict=True):
        for body in plan.bodies.values():
            if body.mass is None or body.static or not needs_sets(motion, body):
                continue
            samples = sorted({one.sample for one in group if one.body == body.name})
            _note_spacing(motion, body, samples, finding, settings)
    return finding.check()


def _note_spacing(
    motion: SegmentMotion, body: BodyView, samples: list[int], finding: Finding, settings: CertifySettings
) -> None:
    segment, last = motion.segment, len(motion.segment.time) - 1
    for end, name in ((0, "first"), (last, "last")):
        finding.require(end in samples, segment.place(end), f"no contact set of {body.name} at the {name} sample")
    poses = motion.body_poses[body.name]
    centres = _centres(body, poses)
    still = np.abs(np.diff(poses, axis=0)).max(axis=(1, 2), initial=0.0) <= _STILL
    for before, after in pairwise(samples):
        chord = np.linalg.norm(poses[after, :3, :3] - poses[before, :3, :3]) / np.sqrt(2.0)
        turn = 2 * float(np.arcsin(min(1.0, chord / 2)))
        way = float(np.linalg.norm(centres[after] - centres[before]))
        rest = _longest_rest(segment.time[before : after + 1], still[before:after])
        used = max(turn / settings.set_angle, way / settings.set_distance, rest / settings.set_time)
        finding.note(1.0 + _ROUNDING - used, f"{segment.place(before)} to sample {after}: {body.name}")


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
