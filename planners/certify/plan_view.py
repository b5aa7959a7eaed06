"""A plan as checks look at it: read again from the bytes that are sent, shapes built, contacts as arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from pydantic import ValidationError

from planners.certify.body_shape import BodyShape, box, cylinder, mesh, prism
from planners.contract.shapes import Box, Cylinder, InlineMesh, Prism
from planners.contract.strict_json import NotJson, parse_json
from planners.errors import LiftwrightError
from planners.geometry.pose import Array, Transform, from_pose7
from planners.plan.contacts import Contact
from planners.plan.plan import Plan
from planners.plan.scenery import ARMS, ArmDocument, BodyDocument, GripperDocument, StickDocument
from planners.plan.segment import ContactState, Grip, Push, Segment
from planners.plan.verdicts import Explanation, LeastReserve

_LEVEL = math.cos(math.radians(0.1))
"""Least upward component of the normal of a face that is level; contract."""


class MalformedDocument(LiftwrightError):
    """A member of the document is missing or is not what the contract says; `pointer` is its RFC 6901 path."""

    def __init__(self, pointer: str, detail: str) -> None:
        self.pointer, self.detail = pointer, detail
        super().__init__(f"{pointer or '/'}: {detail}")


@dataclass(frozen=True, eq=False)
class ArmView:
    """One arm as the document states it."""

    T_world_base: Transform
    dh: Array
    """(6, 4): a [m], alpha [rad], d [m], theta0 [rad]."""
    position_min: Array
    position_max: Array
    velocity_max: Array
    acceleration_max: Array
    payload: float
    """Largest mass at the flange, the hand included [kg]."""
    torque_max: Array | None
    """(6,) [Nm]; None, as `links`, in documents of 0.1.0."""
    links: Array | None
    """(6, 4) of the links that move: mass [kg], and centre of mass in the frame after the link's joint [m]."""

    @classmethod
    def of(cls, arm: ArmDocument, pointer: str) -> ArmView:
        """Return the arm with arrays for tuples.

        Raises:
            MalformedDocument: it has no payload.
        """
        return cls(
            T_world_base=from_pose7(arm.base),
            dh=arm.dh,
            position_min=arm.position_min,
            position_max=arm.position_max,
            velocity_max=arm.velocity_max,
            acceleration_max=arm.acceleration_max,
            payload=_stated(arm.payload, f"{pointer}/payload"),
            torque_max=arm.torque_max,
            links=None if arm.links is None else np.array([[link.mass, *link.com] for link in arm.links]),
        )


@dataclass(frozen=True, eq=False)
class HandView:
    """One hand: a gripper with its table of pad heights, or a stick."""

    kind: str
    mass: float
    """Of all that is mounted on the flange [kg]."""
    com: Array | None
    """(3,) its centre of mass in the flange frame [m]; None in documents of 0.1.0."""
    tcp_table: Array | None
    """(n, 2): width, height of the TCP above the flange [m]; grippers only."""
    T_flange_tip: Transform | None
    """Centre of the tip's hemisphere; sticks only."""
    tip_radius: float
    """[m]; sticks only."""
    force_range: tuple[float, float] | None = None
    """Least and largest squeeze [N]; grippers only, None where it is not stated."""

    @classmethod
    def of(cls, hand: GripperDocument | StickDocument, pointer: str) -> HandView:
        """Return the hand.

        Raises:
            MalformedDocument: it has no mass, or the widths of a gripper's table do not rise.
        """
        mass = _stated(hand.mass, f"{pointer}/mass")
        if isinstance(hand, StickDocument):
            return cls(hand.kind, mass, hand.com, None, from_pose7(hand.tcp), hand.tip_radius)
        if len(hand.tcp) < 2 or np.any(np.diff(hand.tcp[:, 0]) <= 0):
            raise MalformedDocument(f"{pointer}/tcp", "needs two rows or more with rising widths")
        return cls(hand.kind, mass, hand.com, hand.tcp, None, 0.0, hand.force_range)

    def T_flange_tcp(self, widths: Array) -> Array:
        """Return the TCP in the flange frame at each opening: (n,) [m] → (n, 4, 4)."""
        if self.tcp_table is None:
            assert self.T_flange_tip is not None
            return np.broadcast_to(self.T_flange_tip, (len(widths), 4, 4))
        poses = np.tile(np.eye(4), (len(widths), 1, 1))
        poses[:, 2, 3] = np.interp(widths, self.tcp_table[:, 0], self.tcp_table[:, 1])
        return poses


@dataclass(frozen=True, eq=False)
class BodyView:
    """One body of the document."""

    name: str
    role: str
    shape: BodyShape
    mass: float | None
    com: Array
    T_world_start: Transform
    static: bool

    @classmethod
    def of(cls, name: str, body: BodyDocument) -> BodyView:
        """Return the body with its shape built."""
        shape = shape_of(body.shape, f"/bodies/{name}/shape")
        return cls(name, body.role, shape, body.mass, body.com, body.T_world_start, body.static)

    @cached_property
    def top(self) -> float:
        """Height of the highest level face that looks up, at the start [m]; -inf if there is none."""
        up = self.T_world_start[2, :3]
        planes = np.vstack([part.planes for part in self.shape.parts])
        level = planes[:, :3] @ up >= _LEVEL
        # The point of each plane that is nearest to the body's origin.
        heights = -planes[level, 3] * (planes[level, :3] @ up) + self.T_world_start[2, 3]
        return float(heights.max(initial=-math.inf))

    def centres(self, poses: Array) -> Array:
        """Return the centre of mass in the world at poses `T_world_body`: (n, 4, 4) → (n, 3) [m]."""
        return poses[:, :3, :3] @ self.com + poses[:, :3, 3]

    @cached_property
    def lowest(self) -> float:
        """Height of the lowest vertex at the start [m]."""
        return float((self.shape.vertices @ self.T_world_start[2, :3]).min() + self.T_world_start[2, 3])


@dataclass(frozen=True, eq=False)
class AttachmentView:
    """A body fixed to an arm's flange or to another body over a segment."""

    body: str
    to: str
    T_to_body: Transform


@dataclass(frozen=True, eq=False)
class ContactView:
    """One contact of one set. The wrench is what `by` exerts on `body`, world axes, torque about the point."""

    sample: int
    body: str
    by: str
    finger: int | None
    kind: str
    point: Array
    normal: Array
    force: Array
    torque: Array
    x_axis: Array
    """Of a suction pad, else zero."""
    mu: float = math.nan
    """Here and below NaN where a contact of the kind has none; without a limit that is infinite."""
    eps: float = math.nan
    limit: float = math.inf
    squeeze: float | None = None
    radius: float = math.nan
    kappa: float = math.nan
    suction_force: float = math.nan

    @classmethod
    def of(cls, contact: Contact) -> ContactView:
        """Return the contact, alike for all kinds."""
        stated = {name: getattr(contact, name) for name in _PARAMETERS[contact.kind]}
        return cls(
            sample=contact.sample,
            body=contact.body,
            by=contact.by or "",
            finger=contact.finger if contact.kind == "soft_finger" else None,
            kind=contact.kind,
            point=contact.point,
            normal=np.zeros(3) if contact.kind == "inertia" else contact.normal,
            force=contact.wrench[:3],
            torque=contact.wrench[3:],
            x_axis=contact.x_axis if contact.kind == "suction" else np.zeros(3),
            **{name: value for name, value in stated.items() if value is not None},
        )


_PARAMETERS = {
    "soft_finger": ("mu", "eps", "limit", "squeeze"),
    "point": ("mu", "limit"),
    "environment": ("mu", "limit"),
    "suction": ("mu", "radius", "kappa", "limit", "suction_force"),
    "inertia": (),
}
"""What limits a contact of each kind."""


@dataclass(frozen=True, eq=False)
class SegmentView:
    """One segment of the motion, with its arrays."""

    index: int
    kind: str
    movers: tuple[str, ...]
    contact_state: ContactState | None
    grip: Grip | None
    second_grip: Grip | None
    push: Push | None
    time: Array
    positions: Array
    velocities: Array
    accelerations: Array
    widths: Mapping[str, Array]
    attached: tuple[AttachmentView, ...]
    body_poses: Mapping[str, Array]
    """(n, 4, 4) of every body that moves here."""
    contacts: tuple[ContactView, ...]
    reserve: Array | None = None
    """(n,) as stated, nan where nothing is held [1]; None where none is stated."""

    @classmethod
    def of(cls, index: int, segment: Segment) -> SegmentView:
        """Return the segment with its number."""
        hold = segment.hold
        return cls(
            index=index,
            kind=segment.kind.value,
            movers=tuple(segment.movers),
            contact_state=segment.contact_state,
            grip=None if hold is None else hold.grip,
            second_grip=None if hold is None else hold.second_grip,
            push=None if hold is None else hold.push,
            time=segment.time,
            positions=segment.positions,
            velocities=segment.velocities,
            accelerations=segment.accelerations,
            widths=segment.gripper_width,
            attached=tuple(
                AttachmentView(body, each.to, each.T_to_body)
                for body, rides in segment.attached.items()
                for each in rides
            ),
            body_poses=segment.transforms,
            contacts=tuple(map(ContactView.of, segment.contacts)),
            reserve=segment.reserve,
        )

    @property
    def grips(self) -> tuple[Grip, ...]:
        """The grips there are, that of the hand that acts first."""
        return tuple(grip for grip in (self.grip, self.second_grip) if grip is not None)

    def place(self, sample: int | None = None) -> str:
        """Name the segment, and a sample of it with its time."""
        name = f"segment {self.index} ({self.kind})"
        return name if sample is None else f"{name}, sample {sample} (t = {self.time[sample]:.3f} s)"


@dataclass(frozen=True, eq=False)
class PlanView:
    """The whole document."""

    stated: Plan
    """As it was read."""
    gravity: Array
    arms: Mapping[str, ArmView]
    hands: Mapping[str, HandView]
    bodies: Mapping[str, BodyView]
    segments: tuple[SegmentView, ...]

    @property
    def outcome(self) -> str:
        """How planning ended."""
        return self.stated.outcome

    @property
    def explanation(self) -> Explanation:
        """Why a plan has no solution, or in a sentence how it goes."""
        return self.stated.explanation

    @property
    def least_reserve(self) -> LeastReserve | None:
        """The smallest reserve along the plan, as stated."""
        return self.stated.statistics.reserve

    @cached_property
    def support(self) -> str:
        """Name of the body that the plate rests on at the start.

        Of table and support the one whose top is nearer to the plate's lowest vertex: a support may stand beside.
        """
        known = [name for name in ("table", "support") if name in self.bodies]
        if "plate" not in self.bodies or not known:
            return "table"
        lowest = self.bodies["plate"].lowest
        return min(known, key=lambda name: abs(self.bodies[name].top - lowest))


def read_plan(document: bytes) -> PlanView:
    """Read a plan from the bytes that are sent.

    Raises:
        MalformedDocument: A member is missing, of the wrong type, size or range, or names something unknown.
    """
    try:
        data = parse_json(document)
    except NotJson as error:
        raise MalformedDocument("", str(error)) from error
    try:
        plan = Plan.model_validate(data)
    except ValidationError as error:
        raise _malformed(data, error) from error
    return PlanView(
        stated=plan,
        gravity=plan.cell.gravity,
        arms={name: ArmView.of(plan.cell.arms[name], f"/cell/arms/{name}") for name in ARMS},
        hands={name: HandView.of(plan.cell.hands[name], f"/cell/hands/{name}") for name in ARMS},
        bodies={name: BodyView.of(name, body) for name, body in plan.bodies.items()},
        segments=tuple(SegmentView.of(index, segment) for index, segment in enumerate(plan.segments)),
    )


def _stated(value: float | None, pointer: str) -> float:
    """Return what only the first documents leave out, of which no certificate is asked."""
    if value is None:
        raise MalformedDocument(pointer, "is missing")
    return value


def _malformed(data: Any, error: ValidationError) -> MalformedDocument:
    """Return the first fault that was found, with its place in the document."""
    first = error.errors(include_url=False, include_input=False)[0]
    context, pointer, node = first.get("ctx", {}), "", data
    for step in first["loc"]:
        members: Mapping[Any, Any] = dict(enumerate(node)) if isinstance(node, list) else {}
        if isinstance(node, Mapping):
            members = node
        # Branches of unions stand among the members, by the names that tell them apart.
        if step not in members and step in (members.get("kind"), members.get("type")):
            continue
        pointer += "/" + str(step).replace("~", "~0").replace("/", "~1")
        node = members.get(step)
    if first["type"] == "union_tag_not_found":
        return MalformedDocument(f"{pointer}/{context['discriminator'].strip(chr(39))}", "is missing")
    detail = "is missing" if first["type"] == "missing" else first["msg"]
    return MalformedDocument(pointer + context.get("at", ""), detail)


def shape_of(shape: Box | Cylinder | Prism | InlineMesh, pointer: str) -> BodyShape:
    """Return a shape as vertices and convex parts.

    Raises:
        MalformedDocument: it has no volume.
    """
    try:
        match shape:
            case Box():
                return box(np.array(shape.size))
            case Cylinder():
                return cylinder(shape.radius, shape.height)
            case Prism():
                return prism(np.array(shape.outline), shape.height)
            case InlineMesh():
                return mesh(shape.vertices, np.array(shape.faces, dtype=np.intp), shape.convex_parts)
    except ValueError as error:
        raise MalformedDocument(pointer, str(error)) from error
