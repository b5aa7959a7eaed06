"""Where everything is during one segment: at the samples, between them, and how far it can stray in between."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from planners.certify.geometry.vectors import cross, length
from planners.certify.motion.kinematics import ArmKinematics, HermiteCurve
from planners.certify.motion.robot_surfaces import GripperSurfaces, RobotSurfaces
from planners.certify.motion.solids import ConvexSolid, Frame, gripper_of
from planners.certify.plan_view import NumberedSegment, PlanView
from planners.geometry.pose import Array, Transform, inverse, skew, transform
from planners.plan.contacts import BearingContact, Contact, InertiaEntry
from planners.plan.scenery import ARMS

_STILL = 1e-10
"""Positions [rad, m] and velocities that differ by no more are equal: a tenth of what joins may differ by."""


@dataclass(frozen=True, eq=False)
class Rider:
    """A body that is fixed to an arm's flange over a segment."""

    arm: str
    T_flange_body: Transform


@dataclass(frozen=True, eq=False)
class BodyContacts:
    """All contacts on one body at one sample."""

    segment: NumberedSegment
    sample: int
    body: str
    T_world_body: Transform
    contacts: tuple[Contact, ...]

    @cached_property
    def where(self) -> str:
        """Name the set."""
        return f"{self.segment.place(self.sample)}: {self.body}"

    @cached_property
    def T_body_world(self) -> Transform:
        """The world in the frame of the body."""
        return inverse(self.T_world_body)

    @cached_property
    def bearing(self) -> list[BearingContact]:
        """The contacts that bear; inertia is a load."""
        return [contact for contact in self.contacts if contact.kind != "inertia"]

    @cached_property
    def inertia(self) -> list[InertiaEntry]:
        """The inertia that is counted."""
        return [contact for contact in self.contacts if contact.kind == "inertia"]

    @cached_property
    def net_forces(self) -> dict[str, float]:
        """What each hand that touches the body exerts on it in all [N]."""
        forces: dict[str, Array] = {}
        for contact in self.contacts:
            if contact.by in ARMS:
                forces[contact.by] = forces[contact.by] + contact.force if contact.by in forces else contact.force
        return {arm: length(forces[arm]) for arm in ARMS if arm in forces}


def added_up(contacts: Iterable[Contact], force: Array, point: Array) -> tuple[Array, Array]:
    """Return a force with those of contacts [N], and the moment of these about a point [Nm]."""
    moment = np.zeros(3)
    for contact in contacts:
        force = force + contact.force
        moment = moment + contact.torque + cross(contact.point - point, contact.force)
    return force, moment


@dataclass(eq=False)
class SegmentMotion:
    """The motion of one segment.

    Arms follow the cubic Hermite curve through their samples. A body attached to an arm follows its flange rigidly;
    other bodies that move go straight from sample to sample, turning steadily.
    """

    segment: NumberedSegment
    frames: Mapping[str, Array]
    """{arm: (n, 7, 4, 4)} `T_world_i` at the samples."""
    body_poses: Mapping[str, Array]
    """{body: (n, 4, 4)} of every body, as the document states them."""
    riders: Mapping[str, Rider]
    kinematics: Mapping[str, ArmKinematics]
    reaches: Mapping[str, Array]
    """{arm: (7, 6)} how far the origin of frame i can be from the axis of joint j [m]."""
    curves: Mapping[str, HermiteCurve]
    grippers: Mapping[str, GripperSurfaces]
    _poses: dict[Frame, Array] = field(default_factory=dict)
    _strays: dict[tuple[Frame, float, int], Array] = field(default_factory=dict)
    _between: dict[tuple[str, int, float], Array] = field(default_factory=dict)

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.segment.time)

    @cached_property
    def contacts(self) -> list[BodyContacts]:
        """The contacts by body and sample, in order of time."""
        groups: dict[tuple[str, int], list[Contact]] = defaultdict(list)
        for contact in self.segment.contacts:
            groups[contact.body, contact.sample].append(contact)
        return [
            BodyContacts(self.segment, sample, body, self.body_poses[body][sample], tuple(contacts))
            for (body, sample), contacts in sorted(groups.items(), key=lambda item: item[0])
        ]

    def anchor(self, frame: Frame) -> tuple[str, int] | None:
        """Return the arm's link that the frame is rigidly fixed to during the segment, if it is."""
        if frame.kind == "link" or (frame.kind == "finger" and not self.fingers_move(frame.owner)):
            return frame.owner, frame.link
        if frame.kind == "body" and frame.owner in self.riders:
            return self.riders[frame.owner].arm, 6
        return None

    def fingers_move(self, arm: str) -> bool:
        """Whether the gripper's opening changes."""
        return bool(np.ptp(self.segment.gripper_width[arm]) > _STILL)

    def moves(self, frame: Frame) -> bool:
        """Whether the frame moves in the world."""
        if frame.kind == "finger" and self.fingers_move(frame.owner):
            return True
        if frame.kind == "body" and frame.owner not in self.riders:
            return bool(np.ptp(self.body_poses[frame.owner], axis=0).max() > _STILL)
        arm, link = self._link_of(frame)
        columns = slice(6 * ARMS.index(arm), 6 * ARMS.index(arm) + link)
        still = np.abs(self.segment.velocities[:, columns]).max(initial=0.0) <= _STILL
        return not still or bool(np.ptp(self.segment.positions[:, columns], axis=0).max(initial=0.0) > _STILL)

    def poses(self, frame: Frame) -> Array:
        """Return `T_world_frame` at the samples: (n, 4, 4)."""
        if frame not in self._poses:
            self._poses[frame] = np.ascontiguousarray(self._sample_poses(frame))
        return self._poses[frame]

    def pose(self, frame: Frame, interval: int, u: float) -> Transform:
        """Return `T_world_frame` at fraction `u` of the interval after a sample."""
        if frame.kind == "body" and frame.owner not in self.riders:
            poses = self.body_poses[frame.owner]
            return _interpolate(poses[interval], poses[interval + 1], u)
        arm, link = self._link_of(frame)
        T_world_link = self._arm_frames(arm, interval, u)[link]
        if frame.kind == "link":
            return T_world_link
        if frame.kind == "body":
            return T_world_link @ self.riders[frame.owner].T_flange_body
        width = self.segment.gripper_width[arm][interval : interval + 2] @ [1.0 - u, u]
        return T_world_link @ self.grippers[arm].finger_poses(frame.part, frame.finger, np.array([width]))[0]

    def way(self, solid: ConvexSolid, interval: int, start: float, end: float) -> float:
        """Return how far any point of the solid gets in a part of an interval, in a straight line [m]."""
        ends = np.stack([self.pose(solid.frame, interval, u) for u in (start, end)])
        straight = float(chord_lengths(ends, solid.centre, solid.bound)[0])
        return straight + self.finger_travel_between(solid.frame, interval, start, end)

    def stray(self, frame: Frame, far: float, first_joint: int = 0) -> Array:
        """Return how far a point of the frame strays from the straight way between two samples: (n - 1,) [m].

        A point p(u), where u goes from 0 to 1 in a step and |p''| <= A, strays from the step's chord by no more than
        A / 8; a part of the step strays by the square of its share of that.

        Args:
            frame: What the point moves with.
            far: The point's distance from the frame's origin, or more [m].
            first_joint: Joints up to this one are taken as fixed: motion relative to the frame after them.
        """
        key = frame, far, first_joint
        if key not in self._strays:
            self._strays[key] = self._stray(frame, far, first_joint)
        return self._strays[key]

    def _stray(self, frame: Frame, far: float, first_joint: int) -> Array:
        if frame.kind == "body" and frame.owner not in self.riders:
            return far * turns_between(self.poses(frame)) ** 2 / 8
        arm, link = self._link_of(frame)
        if frame.kind == "finger":
            gripper = self.grippers[arm]
            far += gripper.extent
        if frame.kind == "body":
            far += float(np.linalg.norm(self.riders[frame.owner].T_flange_body[:3, 3]))
        reach = self.reaches[arm][link, first_joint:link] + far
        curve, columns = self.curves[arm], slice(first_joint, link)
        rise, bend = curve.rise_peak[:, columns], curve.bend_peak[:, columns]
        # |p''| <= sum_j |q''_j| r_j + sum_jk |q'_j| |q'_k| r_max(j, k): the outer joint's lever counts.
        lever = np.minimum.outer(reach, reach)
        bends = (bend @ reach + np.sum((rise @ lever) * rise, axis=1)) / 8
        return bends + self.finger_travel(frame)

    def turn(self, frame: Frame) -> Array:
        """Return the largest angle between the frame's orientations at any two moments of a step: (n - 1,) [rad]."""
        if frame.kind == "body" and frame.owner not in self.riders:
            return turns_between(self.poses(frame))
        arm, link = self._link_of(frame)
        turns = self.curves[arm].rise_peak[:, :link].sum(axis=1)
        if frame.kind != "finger":
            return turns
        if not self.fingers_move(frame.owner):
            return turns
        return turns + self.grippers[arm].fingers.turns(self.segment.gripper_width[arm])

    def finger_travel(self, frame: Frame) -> Array | float:
        """Return how far a finger moves in the flange's frame from sample to sample: (n - 1,); else 0 [m]."""
        if frame.kind != "finger" or not self.fingers_move(frame.owner):
            return 0.0
        return self.grippers[frame.owner].fingers.travel(self.segment.gripper_width[frame.owner])

    def finger_travel_between(self, frame: Frame, interval: int, start: float, end: float) -> float:
        """Return the same for a part of an interval [m]."""
        if frame.kind != "finger" or not self.fingers_move(frame.owner):
            return 0.0
        first, last = self.segment.gripper_width[frame.owner][interval : interval + 2]
        widths = np.array([first + (last - first) * u for u in (start, end)])
        return float(self.grippers[frame.owner].fingers.travel(widths)[0])

    def _link_of(self, frame: Frame) -> tuple[str, int]:
        if frame.kind == "body":
            return self.riders[frame.owner].arm, 6
        return frame.owner, frame.link

    def _sample_poses(self, frame: Frame) -> Array:
        if frame.kind == "body":
            rider = self.riders.get(frame.owner)
            if rider is None:
                return self.body_poses[frame.owner]
            return self.frames[rider.arm][:, 6] @ rider.T_flange_body
        links = self.frames[frame.owner][:, frame.link]
        if frame.kind == "link":
            return links
        widths = self.segment.gripper_width[frame.owner]
        if not self.fingers_move(frame.owner):
            widths = widths[:1]
        return links @ self.grippers[frame.owner].finger_poses(frame.part, frame.finger, widths)

    def _arm_frames(self, arm: str, interval: int, u: float) -> Array:
        key = (arm, interval, u)
        if key not in self._between:
            q = self.curves[arm].position(interval, u)
            self._between[key] = self.kinematics[arm].frames(q[None])[0]
        return self._between[key]


def chord_lengths(poses: Array, centre: Array, bound: float) -> Array:
    """Return how far any point of a ball fixed in a moving frame gets from pose to pose: (n, 4, 4) → (n - 1,) [m]."""
    centres = poses[:, :3, :3] @ centre + poses[:, :3, 3]
    turns = np.linalg.norm(np.diff(poses[:, :3, :3], axis=0), axis=(1, 2)) / np.sqrt(2.0)
    return np.linalg.norm(np.diff(centres, axis=0), axis=1) + bound * turns


def rotation_angles(poses: Array, others: Array) -> Array:
    """Return the angles between orientations of poses (n, 4, 4) and those of as many, or of one pose: (n,) [rad]."""
    chord = np.linalg.norm(poses[:, :3, :3] - others[..., :3, :3], axis=(1, 2)) / np.sqrt(2.0)
    return 2 * np.arcsin(np.clip(chord / 2, 0.0, 1.0))


def turns_between(poses: Array) -> Array:
    """Return the angles between successive orientations: (n - 1,) [rad]."""
    return rotation_angles(poses[1:], poses[:-1])


def motions_of(plan: PlanView, surfaces: RobotSurfaces) -> list[SegmentMotion]:
    """Return the motion of every segment. Arms that rest are computed once a segment."""
    kinematics = {arm: ArmKinematics(stated.dh, stated.T_world_base) for arm, stated in plan.cell.arms.items()}
    reaches = {arm: _reaches(stated.dh) for arm, stated in plan.cell.arms.items()}
    grippers = {arm: gripper_of(arm, surfaces) for arm in plan.grippers}
    last = {name: body.T_world_start for name, body in plan.bodies.items()}
    motions = []
    for segment in plan.segments:
        n = len(segment.time)
        poses = {name: segment.transforms.get(name, np.broadcast_to(pose, (n, 4, 4))) for name, pose in last.items()}
        last = {name: each[-1] for name, each in poses.items()}
        positions, velocities = (
            dict(zip(ARMS, np.split(rows, 2, axis=1), strict=True)) for rows in (segment.positions, segment.velocities)
        )
        frames = {arm: _frames(kinematics[arm], positions[arm]) for arm in ARMS}
        curves = {arm: HermiteCurve(segment.time, positions[arm], velocities[arm]) for arm in ARMS}
        motions.append(SegmentMotion(segment, frames, poses, _riders(segment), kinematics, reaches, curves, grippers))
    return motions


def _frames(kinematics: ArmKinematics, positions: Array) -> Array:
    if np.all(positions == positions[0]):
        return np.broadcast_to(kinematics.frames(positions[:1]), (len(positions), 7, 4, 4))
    return kinematics.frames(positions)


def _riders(segment: NumberedSegment) -> dict[str, Rider]:
    """Follow attachments from body to body down to an arm."""
    riders = {}
    for body, ride in segment.rides:
        T_to_body, to, seen = ride.T_to_body, ride.to, {body}
        while to not in ARMS and to not in seen:
            seen.add(to)
            below = next((other for name, other in segment.rides if name == to), None)
            if below is None:
                break
            T_to_body, to = below.T_to_body @ T_to_body, below.to
        if to in ARMS:
            riders.setdefault(body, Rider(to, T_to_body))
    return riders


def _reaches(dh: Array) -> Array:
    """Sum the lengths of the links between each joint's axis and each frame's origin."""
    lengths = np.hypot(dh[:, 0], dh[:, 2])
    return np.array([[lengths[j:i].sum() if j < i else 0.0 for j in range(6)] for i in range(7)])


def _interpolate(T_from: Transform, T_to: Transform, u: float) -> Transform:
    """Go straight and turn steadily from one pose to another."""
    R = T_from[:3, :3].T @ T_to[:3, :3]
    vector = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = float(np.linalg.norm(vector))
    position = (1.0 - u) * T_from[:3, 3] + u * T_to[:3, 3]
    if sine < 1e-12:
        return transform(T_from[:3, :3], position)
    angle = float(np.arctan2(sine, 0.5 * (np.trace(R) - 1.0)))
    S, part = skew(vector / sine), u * angle
    turn = np.eye(3) + np.sin(part) * S + (1.0 - np.cos(part)) * (S @ S)
    return transform(T_from[:3, :3] @ turn, position)


def relative(poses_a: Array, poses_b: Array) -> Array:
    """Return `T_a_b` at every sample: (n, 4, 4)."""
    R = np.swapaxes(poses_a[:, :3, :3], 1, 2)
    out = np.tile(np.eye(4), (max(len(poses_a), len(poses_b)), 1, 1))
    out[:, :3, :3] = R @ poses_b[:, :3, :3]
    out[:, :3, 3] = np.einsum("nij,nj->ni", R, poses_b[:, :3, 3] - poses_a[:, :3, 3])
    return out
