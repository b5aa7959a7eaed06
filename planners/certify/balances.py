"""Balances, assembled again in the world frame, and where the plan must show them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planners.certify.certificate import Check, Finding
from planners.certify.contact_states import heights, support_height
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
    plan: PlanView, motions: Sequence[SegmentMotion], sets: Sequence[Sequence[ContactSet]], settings: CertifySettings
) -> list[Check]:
    """Check forces, moments, counted inertia and the spacing of contact sets; `sets` are those of each segment."""
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
        _inertia(plan, motions, sets, settings),
        _spacing(plan, motions, sets, settings),
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
) -> Check:
    """What inertia was counted must be what the motion has, up to a small part of the weight.

    The acceleration of the centre of mass is taken from the poses; where it jumps, any value in between will do.
    """
    finding = Finding("inertia", "N")
    weight = float(np.linalg.norm(plan.gravity))
    for motion, group in zip(motions, sets, strict=True):
        accelerations: dict[str, Array] = {}
        for contact_set in group:
            body = plan.bodies[contact_set.body]
            if body.mass is None:
                continue
            if body.name not in accelerations:
                accelerations[body.name] = _accelerations(
                    motion.segment.time, _centres(body, motion.body_poses[body.name])
                )
            counted = sum((c.force for c in contact_set.contacts if c.kind == "inertia"), np.zeros(3))
            low, high = _around(-body.mass * accelerations[body.name], contact_set.sample)
            missing = np.linalg.norm(counted - np.clip(counted, low, high))
            finding.note(settings.inertia_fraction * body.mass * weight - float(missing), contact_set.where)
    return finding.check()


def _accelerations(time: Array, centres: Array) -> Array:
    """Return second differences at the inner samples, (n - 2, 3); zero for two samples, which start and end at rest."""
    if len(time) < 3:
        return np.zeros((1, 3))
    steps = np.diff(time)[:, None]
    rates = np.diff(centres, axis=0) / steps
    return np.diff(rates, axis=0) / ((steps[:-1] + steps[1:]) / 2)


def _around(values: Array, sample: int) -> tuple[Array, Array]:
    near = values[max(0, min(sample - 2, len(values) - 1)) : max(1, sample + 1)]
    return near.min(axis=0), near.max(axis=0)


def _spacing(
    plan: PlanView, motions: Sequence[SegmentMotion], sets: Sequence[Sequence[ContactSet]], settings: CertifySettings
) -> Check:
    finding = Finding("contact_sets", "1")
    for motion, group in zip(motions, sets, strict=True):
        for body in plan.bodies.values():
            if body.mass is None or body.static or not _needs_sets(plan, motion, body, settings):
                continue
            samples = sorted({one.sample for one in group if one.body == body.name})
            _note_spacing(motion, body, samples, finding, settings)
    return finding.check()


def _needs_sets(plan: PlanView, motion: SegmentMotion, body: BodyView, settings: CertifySettings) -> bool:
    """Whether the body is in a hand for all of the segment, or off its rest."""
    segment = motion.segment
    gripped = segment.grip is not None and segment.grip.body == body.name and segment.kind not in ("grip", "release")
    pushed = segment.push is not None and segment.push.body == body.name
    if pushed and segment.push is not None and segment.kind in ("approach", "retreat"):
        pushed = segment.push.arm not in segment.movers
    return gripped or pushed or not _rests_flat(plan, motion, body, settings)


def _rests_flat(plan: PlanView, motion: SegmentMotion, body: BodyView, settings: CertifySettings) -> bool:
    low = body.shape.vertices[:, 2] <= body.shape.vertices[:, 2].min() + _STILL
    above = heights(motion.body_poses[body.name], body.shape.vertices[low]) - support_height(plan)
    return bool(np.abs(above).max() <= settings.element_height)


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
