"""A plan document, read into arrays once and refused at the first member that is missing or of the wrong type."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np

from planners.certify.body_shape import BodyShape, box, cylinder, mesh, prism
from planners.errors import LiftwrightError
from planners.geometry.pose import Array, Transform, from_pose7

ARMS = ("left", "right")
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
JOINT_NAMES = tuple(f"{arm}_{joint}_joint" for arm in ARMS for joint in JOINTS)
SEGMENT_KINDS = ("transit", "transfer", "handover", "approach", "retreat", "grip", "release", "attach", "detach")
OUTCOMES = ("solved", "infeasible", "not_found")
CONTACT_KINDS = ("soft_finger", "point", "environment", "suction", "inertia")
ROLES = ("plate", "object", "tool", "support", "obstacle", "table", "frame", "cup", "cable")
ELEMENT_SIZES = {"face": range(3, 1000), "edge": range(2, 3), "vertex": range(1, 2), "none": range(1)}
_UNIT_QUATERNION = 1e-6
_ABSURD = 1e9
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

    name: str
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
class ContactStateView:
    """The element of a body that rests on another one during a segment."""

    element: str
    other: str
    vertices: Array
    """(k, 3), body frame [m]."""


@dataclass(frozen=True, eq=False)
class GripView:
    """A held grip."""

    arm: str
    body: str
    T_body_tcp: Transform
    width: float
    squeeze: float | None = None
    """As commanded [N]; None where none is stated."""


@dataclass(frozen=True, eq=False)
class PushView:
    """A held push: one point of a body and the inward normal there, both in the body frame."""

    arm: str
    body: str
    point: Array
    normal: Array


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
    parameters: Mapping[str, Any]
    """Numbers of the kind: mu, eps, limit and squeeze (None for none), radius, kappa, suction_force."""
    x_axis: Array
    """Of a suction pad, else zero."""


@dataclass(frozen=True, eq=False)
class SegmentView:
    """One segment of the motion, with its arrays."""

    index: int
    kind: str
    movers: tuple[str, ...]
    contact_state: ContactStateView | None
    grip: GripView | None
    second_grip: GripView | None
    push: PushView | None
    time: Array
    positions: Array
    velocities: Array
    accelerations: Array
    widths: dict[str, Array]
    attached: tuple[AttachmentView, ...]
    body_poses: dict[str, Array]
    """(n, 4, 4) of every body that moves here."""
    contacts: tuple[ContactView, ...]
    reserve: Array | None = None
    """(n,) as stated, nan where nothing is held [1]; None where none is stated."""

    @property
    def grips(self) -> tuple[GripView, ...]:
        """The grips there are, that of the hand that acts first."""
        return tuple(grip for grip in (self.grip, self.second_grip) if grip is not None)

    def place(self, sample: int | None = None) -> str:
        """Name the segment, and a sample of it with its time."""
        name = f"segment {self.index} ({self.kind})"
        return name if sample is None else f"{name}, sample {sample} (t = {self.time[sample]:.3f} s)"


@dataclass(frozen=True)
class CauseView:
    """One cause of a plan that has no solution, with its numbers where it has any."""

    reason: str
    needed: float | None
    available: float | None
    unit: str | None


@dataclass(frozen=True)
class ExplanationView:
    """Why a plan has no solution, or in a sentence how it goes."""

    summary: str
    causes: tuple[CauseView, ...]


@dataclass(frozen=True)
class ReserveView:
    """The smallest reserve along the plan, as stated."""

    value: float
    segment: int
    sample: int


@dataclass(frozen=True, eq=False)
class PlanView:
    """The whole document."""

    outcome: str
    task: Mapping[str, Any]
    cell: Mapping[str, Any]
    explanation: ExplanationView | None
    gravity: Array
    arms: dict[str, ArmView]
    hands: dict[str, HandView]
    bodies: dict[str, BodyView]
    segments: tuple[SegmentView, ...]
    least_reserve: ReserveView | None = None

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


def child(pointer: str, key: str | int) -> str:
    """Extend an RFC 6901 pointer."""
    return f"{pointer}/{str(key).replace('~', '~0').replace('/', '~1')}"


def read_object(value: Any, pointer: str) -> Mapping[str, Any]:
    """Return the value if it is a JSON object."""
    if not isinstance(value, Mapping):
        raise MalformedDocument(pointer, "must be an object")
    return value


def read_member(parent: Mapping[str, Any], key: str, pointer: str) -> Any:
    """Return a member that must be there."""
    if key not in parent:
        raise MalformedDocument(child(pointer, key), "is missing")
    return parent[key]


def read_list(value: Any, pointer: str) -> list[Any]:
    """Return the value if it is a JSON array."""
    if not isinstance(value, (list, tuple)):
        raise MalformedDocument(pointer, "must be an array")
    return list(value)


def read_number(value: Any, pointer: str) -> float:
    """Return a finite number; strings and booleans are none."""
    if type(value) not in (int, float) and not isinstance(value, (np.floating, np.integer)):
        raise MalformedDocument(pointer, "must be a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not abs(number) < _ABSURD:
        raise MalformedDocument(pointer, "must be a finite number of sensible size")
    return number


def read_positive(value: Any, pointer: str) -> float:
    """Return a number greater than 0."""
    number = read_number(value, pointer)
    if number <= 0:
        raise MalformedDocument(pointer, "must be greater than 0")
    return number


def read_text(value: Any, pointer: str, choices: tuple[str, ...] | None = None) -> str:
    """Return a string, one of the choices if there are any."""
    if not isinstance(value, str):
        raise MalformedDocument(pointer, "must be a string")
    if choices is not None and value not in choices:
        raise MalformedDocument(pointer, f"{value!r} is none of {', '.join(choices)}")
    return value


def read_vector(value: Any, pointer: str, length: int) -> Array:
    """Return an array of `length` finite numbers."""
    return read_matrix([value], pointer, (1, length))[0]


def read_matrix(value: Any, pointer: str, shape: tuple[int | None, int]) -> Array:
    """Return rows of equally many finite numbers; None as the first extent takes any number of rows."""
    rows = read_list(value, pointer)
    if shape[0] is not None and len(rows) != shape[0]:
        raise MalformedDocument(pointer, f"has {len(rows)} rows, not {shape[0]}")
    single = shape[0] == 1
    for index, row in enumerate(rows):
        if not isinstance(row, (list, tuple)) or len(row) != shape[1]:
            raise MalformedDocument(pointer if single else child(pointer, index), f"must hold {shape[1]} numbers")
    # The types of thousands of numbers are looked at together; one by one only to name the wrong one.
    clean = set(map(type, chain.from_iterable(rows))) <= {int, float}
    if clean:
        try:
            matrix = np.array(rows, dtype=float).reshape(len(rows), shape[1])
        except OverflowError:
            clean = False
        else:
            if np.all(np.abs(matrix) < _ABSURD):
                return matrix
    numbers = [
        [read_number(x, child(pointer if single else child(pointer, i), j)) for j, x in enumerate(row)]
        for i, row in enumerate(rows)
    ]
    return np.array(numbers, dtype=float).reshape(len(rows), shape[1])


def read_unit(value: Any, pointer: str) -> Array:
    """Return a unit vector of three numbers."""
    vector = read_vector(value, pointer, 3)
    if abs(float(np.linalg.norm(vector)) - 1.0) > _UNIT_QUATERNION:
        raise MalformedDocument(pointer, "is not a unit vector")
    return vector


def read_pose(value: Any, pointer: str) -> Transform:
    """Return `[x, y, z, w, x, y, z]` with a unit quaternion as a transform."""
    pose = read_vector(value, pointer, 7)
    if abs(float(np.linalg.norm(pose[3:])) - 1.0) > _UNIT_QUATERNION:
        raise MalformedDocument(pointer, "has a quaternion that is not unit to 1e-6")
    return from_pose7(pose)


def read_poses(value: Any, pointer: str, count: int) -> Array:
    """Return `count` poses as (count, 4, 4)."""
    rows = read_matrix(value, pointer, (count, 7))
    bad = np.flatnonzero(np.abs(np.linalg.norm(rows[:, 3:], axis=1) - 1.0) > _UNIT_QUATERNION)
    if bad.size:
        raise MalformedDocument(child(pointer, int(bad[0])), "has a quaternion that is not unit to 1e-6")
    w, x, y, z = (rows[:, 3:] / np.linalg.norm(rows[:, 3:], axis=1, keepdims=True)).T
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=1)
    poses[:, 1, :3] = np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=1)
    poses[:, 2, :3] = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)
    poses[:, :3, 3] = rows[:, :3]
    return poses


def read_shape(value: Any, pointer: str) -> BodyShape:
    """Return a shape of the contract as vertices and convex parts."""
    shape = read_object(value, pointer)
    kind = read_text(read_member(shape, "type", pointer), child(pointer, "type"), ("box", "cylinder", "prism", "mesh"))
    if kind == "box":
        size = read_vector(read_member(shape, "size", pointer), child(pointer, "size"), 3)
        if np.any(size <= 0):
            raise MalformedDocument(child(pointer, "size"), "must be positive")
        return box(size)
    if kind == "mesh":
        return _read_mesh(shape, pointer)
    height = read_positive(read_member(shape, "height", pointer), child(pointer, "height"))
    if kind == "cylinder":
        return cylinder(read_positive(read_member(shape, "radius", pointer), child(pointer, "radius")), height)
    where = child(pointer, "outline")
    outline = read_matrix(read_member(shape, "outline", pointer), where, (None, 2))
    return _refuse_flat(lambda: prism(outline, height), where)


def _read_mesh(shape: Mapping[str, Any], pointer: str) -> BodyShape:
    where = child(pointer, "convex_parts")
    parts = [
        read_matrix(
            part["vertices"] if isinstance(part, Mapping) and "vertices" in part else part, child(where, i), (None, 3)
        )
        for i, part in enumerate(read_list(read_member(shape, "convex_parts", pointer), where))
    ]
    if not parts:
        raise MalformedDocument(where, "has no part")
    vertices = read_matrix(read_member(shape, "vertices", pointer), child(pointer, "vertices"), (None, 3))
    at = child(pointer, "faces")
    numbers = read_matrix(read_member(shape, "faces", pointer), at, (None, 3))
    faces = numbers.astype(np.intp)
    if not len(faces) or np.any(faces != numbers) or faces.min() < 0 or faces.max() >= len(vertices):
        raise MalformedDocument(at, "are no triples of vertices")
    return _refuse_flat(lambda: mesh(vertices, faces, parts), pointer)


def _refuse_flat(build: Any, pointer: str) -> BodyShape:
    try:
        return build()
    except ValueError as error:
        raise MalformedDocument(pointer, str(error)) from error


def read_document(document: Any) -> PlanView:
    """Read the whole document.

    Raises:
        MalformedDocument: A member is missing, of the wrong type, size or range, or names something unknown.
    """
    root = read_object(document, "")
    if read_text(read_member(root, "schema_version", ""), "/schema_version") != "1.0":
        raise MalformedDocument("/schema_version", "is not 1.0")
    outcome = read_text(read_member(root, "outcome", ""), "/outcome", OUTCOMES)
    task = read_object(read_member(root, "task", ""), "/task")
    cell = read_object(read_member(root, "cell", ""), "/cell")
    names = read_list(read_member(root, "joint_names", ""), "/joint_names")
    if tuple(names) != JOINT_NAMES:
        raise MalformedDocument("/joint_names", f"are not {', '.join(JOINT_NAMES)}")
    explanation = root.get("explanation")
    arms = read_object(read_member(cell, "arms", "/cell"), "/cell/arms")
    hands = read_object(read_member(cell, "hands", "/cell"), "/cell/hands")
    bodies = read_object(read_member(root, "bodies", ""), "/bodies")
    body_views = {name: _read_body(name, body, child("/bodies", name)) for name, body in bodies.items()}
    hand_views = {arm: read_hand(read_member(hands, arm, "/cell/hands"), child("/cell/hands", arm)) for arm in ARMS}
    segments = read_list(read_member(root, "segments", ""), "/segments")
    reader = _SegmentReader(frozenset(body_views), hand_views)
    return PlanView(
        outcome=outcome,
        task=task,
        cell=cell,
        explanation=None if explanation is None else _read_explanation(explanation),
        gravity=read_vector(read_member(cell, "gravity", "/cell"), "/cell/gravity", 3),
        arms={arm: read_arm(arm, read_member(arms, arm, "/cell/arms"), child("/cell/arms", arm)) for arm in ARMS},
        hands=hand_views,
        bodies=body_views,
        segments=tuple(reader.read(i, segment, child("/segments", i)) for i, segment in enumerate(segments)),
        least_reserve=_read_reserve(root.get("statistics")),
    )


def _read_reserve(statistics: Any) -> ReserveView | None:
    """Read the only member of the statistics that is a claim about the plan."""
    stated = None if statistics is None else read_object(statistics, "/statistics").get("reserve")
    if stated is None:
        return None
    at = "/statistics/reserve"
    reserve = read_object(stated, at)
    numbers = [read_number(read_member(reserve, key, at), child(at, key)) for key in ("value", "segment", "sample")]
    return ReserveView(numbers[0], int(numbers[1]), int(numbers[2]))


def _optional_number(parent: Mapping[str, Any], key: str, pointer: str) -> float | None:
    return None if parent.get(key) is None else read_number(parent[key], child(pointer, key))


def _read_explanation(value: Any) -> ExplanationView:
    at = "/explanation"
    explanation = read_object(value, at)
    where = child(at, "causes")
    causes = read_list(read_member(explanation, "causes", at), where)
    return ExplanationView(
        summary=read_text(read_member(explanation, "summary", at), child(at, "summary")),
        causes=tuple(_read_cause(cause, child(where, i)) for i, cause in enumerate(causes)),
    )


def _read_cause(value: Any, pointer: str) -> CauseView:
    cause = read_object(value, pointer)

    def number(key: str) -> float | None:
        member = read_member(cause, key, pointer)
        return None if member is None else read_number(member, child(pointer, key))

    unit = read_member(cause, "unit", pointer)
    return CauseView(
        reason=read_text(read_member(cause, "reason", pointer), child(pointer, "reason")),
        needed=number("needed"),
        available=number("available"),
        unit=None if unit is None else read_text(unit, child(pointer, "unit")),
    )


def read_arm(name: str, value: Any, pointer: str) -> ArmView:
    """Return an entry of `cell.arms`.

    Raises:
        MalformedDocument: A member is missing or of the wrong type.
    """
    arm = read_object(value, pointer)

    def six(key: str) -> Array:
        return read_vector(read_member(arm, key, pointer), child(pointer, key), 6)

    return ArmView(
        name=name,
        T_world_base=read_pose(read_member(arm, "base", pointer), child(pointer, "base")),
        dh=read_matrix(read_member(arm, "dh", pointer), child(pointer, "dh"), (6, 4)),
        position_min=six("position_min"),
        position_max=six("position_max"),
        velocity_max=six("velocity_max"),
        acceleration_max=six("acceleration_max"),
        payload=read_positive(read_member(arm, "payload", pointer), child(pointer, "payload")),
        torque_max=None if arm.get("torque_max") is None else six("torque_max"),
        links=None if arm.get("links") is None else _read_links(arm["links"], child(pointer, "links")),
    )


def _read_links(value: Any, pointer: str) -> Array:
    entries = read_list(value, pointer)
    if len(entries) != len(JOINTS):
        raise MalformedDocument(pointer, f"has {len(entries)} links, not {len(JOINTS)}")
    rows = []
    for i, entry in enumerate(entries):
        at = child(pointer, i)
        link = read_object(entry, at)
        mass = read_positive(read_member(link, "mass", at), child(at, "mass"))
        rows.append([mass, *read_vector(read_member(link, "com", at), child(at, "com"), 3)])
    return np.array(rows)


def read_hand(value: Any, pointer: str) -> HandView:
    """Return an entry of `cell.hands`.

    Raises:
        MalformedDocument: A member is missing or of the wrong type.
    """
    hand = read_object(value, pointer)
    kind = read_text(read_member(hand, "kind", pointer), child(pointer, "kind"), ("gripper", "stick"))
    mass = read_positive(read_member(hand, "mass", pointer), child(pointer, "mass"))
    com = None if hand.get("com") is None else read_vector(hand["com"], child(pointer, "com"), 3)
    where = child(pointer, "tcp")
    tcp = read_member(hand, "tcp", pointer)
    if kind == "stick":
        radius = read_positive(read_member(hand, "tip_radius", pointer), child(pointer, "tip_radius"))
        return HandView(kind, mass, com, None, read_pose(tcp, where), radius)
    table = read_matrix(tcp, where, (None, 2))
    if len(table) < 2 or np.any(np.diff(table[:, 0]) <= 0):
        raise MalformedDocument(where, "needs two rows or more with rising widths")
    force_range = hand.get("force_range")
    if force_range is not None:
        force_range = tuple(read_vector(force_range, child(pointer, "force_range"), 2).tolist())
    return HandView(kind, mass, com, table, None, 0.0, force_range)


def _read_body(name: str, value: Any, pointer: str) -> BodyView:
    body = read_object(value, pointer)
    mass = read_member(body, "mass", pointer)
    static = read_member(body, "static", pointer)
    if not isinstance(static, bool):
        raise MalformedDocument(child(pointer, "static"), "must be true or false")
    return BodyView(
        name=name,
        role=read_text(read_member(body, "role", pointer), child(pointer, "role"), ROLES),
        shape=read_shape(read_member(body, "shape", pointer), child(pointer, "shape")),
        mass=None if mass is None else read_positive(mass, child(pointer, "mass")),
        com=read_vector(read_member(body, "com", pointer), child(pointer, "com"), 3),
        T_world_start=read_pose(read_member(body, "pose", pointer), child(pointer, "pose")),
        static=static,
    )


@dataclass(frozen=True)
class _SegmentReader:
    """Reads segments against the bodies and hands that the document has."""

    bodies: frozenset[str]
    hands: Mapping[str, HandView]

    def read(self, index: int, value: Any, pointer: str) -> SegmentView:
        segment = read_object(value, pointer)

        def member(key: str) -> tuple[Any, str]:
            return read_member(segment, key, pointer), child(pointer, key)

        time = read_matrix([[t] for t in read_list(*member("time"))], child(pointer, "time"), (None, 1))[:, 0]
        n = len(time)
        if n < 2:
            raise MalformedDocument(child(pointer, "time"), "needs two samples or more")
        movers = [
            read_text(arm, child(child(pointer, "movers"), i), ARMS)
            for i, arm in enumerate(read_list(*member("movers")))
        ]
        grip, second_grip, push = self._hold(*member("hold"))
        poses = read_object(*member("body_poses"))
        where = child(pointer, "body_poses")
        return SegmentView(
            index=index,
            kind=read_text(*member("kind"), SEGMENT_KINDS),
            movers=tuple(movers),
            contact_state=self._contact_state(*member("contact_state")),
            grip=grip,
            second_grip=second_grip,
            push=push,
            time=time,
            positions=read_matrix(*member("positions"), (n, 12)),
            velocities=read_matrix(*member("velocities"), (n, 12)),
            accelerations=read_matrix(*member("accelerations"), (n, 12)),
            widths=self._widths(*member("gripper_width"), n),
            attached=self._attached(*member("attached")),
            body_poses={
                self._body(name, child(where, name)): read_poses(rows, child(where, name), n)
                for name, rows in poses.items()
            },
            contacts=tuple(
                self._contact(contact, child(child(pointer, "contacts"), i), n)
                for i, contact in enumerate(read_list(*member("contacts")))
            ),
            reserve=self._reserve(segment.get("reserve"), child(pointer, "reserve"), n),
        )

    @staticmethod
    def _reserve(value: Any, pointer: str, n: int) -> Array | None:
        if value is None:
            return None
        rows = read_list(value, pointer)
        if len(rows) != n:
            raise MalformedDocument(pointer, f"has {len(rows)} entries, not {n}")
        return np.array([math.nan if v is None else read_number(v, child(pointer, i)) for i, v in enumerate(rows)])

    def _body(self, value: Any, pointer: str) -> str:
        name = read_text(value, pointer)
        if name not in self.bodies:
            raise MalformedDocument(pointer, f"names no body of the document: {name!r}")
        return name

    def _hand(self, value: Any, pointer: str, kind: str) -> str:
        arm = read_text(value, pointer, ARMS)
        if self.hands[arm].kind != kind:
            raise MalformedDocument(pointer, f"the {arm} hand is no {kind}")
        return arm

    def _widths(self, value: Any, pointer: str, n: int) -> dict[str, Array]:
        widths = read_object(value, pointer)
        grippers = {arm for arm, hand in self.hands.items() if hand.kind == "gripper"}
        if set(widths) != grippers:
            raise MalformedDocument(
                pointer, f"must have the grippers {sorted(grippers)}, not {sorted(map(str, widths))}"
            )
        return {arm: read_vector(widths[arm], child(pointer, arm), n) for arm in sorted(grippers)}

    def _contact_state(self, value: Any, pointer: str) -> ContactStateView | None:
        if value is None:
            return None
        state = read_object(value, pointer)
        element = read_text(read_member(state, "element", pointer), child(pointer, "element"), tuple(ELEMENT_SIZES))
        other = state.get("with")
        if element != "none":
            other = self._body(read_member(state, "with", pointer), child(pointer, "with"))
        where = child(pointer, "vertices")
        vertices = read_matrix(read_member(state, "vertices", pointer), where, (None, 3))
        if len(vertices) not in ELEMENT_SIZES[element]:
            raise MalformedDocument(where, f"{len(vertices)} vertices do not make the element {element!r}")
        return ContactStateView(element, other if isinstance(other, str) else "", vertices)

    def _hold(self, value: Any, pointer: str) -> tuple[GripView | None, GripView | None, PushView | None]:
        if value is None:
            return None, None, None
        hold = read_object(value, pointer)
        grip = self._grip(read_member(hold, "grip", pointer), child(pointer, "grip"))
        second = self._grip(hold.get("second_grip"), child(pointer, "second_grip"))
        if second is not None and (grip is None or grip.arm == second.arm):
            raise MalformedDocument(child(pointer, "second_grip"), "is not that of the other hand")
        return grip, second, self._push(read_member(hold, "push", pointer), child(pointer, "push"))

    def _grip(self, value: Any, pointer: str) -> GripView | None:
        if value is None:
            return None
        member = read_object(value, pointer)
        return GripView(
            arm=self._hand(read_member(member, "arm", pointer), child(pointer, "arm"), "gripper"),
            body=self._body(read_member(member, "body", pointer), child(pointer, "body")),
            T_body_tcp=read_pose(read_member(member, "pose", pointer), child(pointer, "pose")),
            width=read_number(read_member(member, "width", pointer), child(pointer, "width")),
            squeeze=_optional_number(member, "squeeze", pointer),
        )

    def _push(self, value: Any, pointer: str) -> PushView | None:
        if value is None:
            return None
        member = read_object(value, pointer)
        return PushView(
            arm=self._hand(read_member(member, "arm", pointer), child(pointer, "arm"), "stick"),
            body=self._body(read_member(member, "body", pointer), child(pointer, "body")),
            point=read_vector(read_member(member, "point", pointer), child(pointer, "point"), 3),
            normal=read_unit(read_member(member, "normal", pointer), child(pointer, "normal")),
        )

    def _attached(self, value: Any, pointer: str) -> tuple[AttachmentView, ...]:
        attachments = []
        for name, entries in read_object(value, pointer).items():
            where = child(pointer, name)
            body = self._body(name, where)
            for i, entry in enumerate(read_list(entries, where)):
                at = child(where, i)
                member = read_object(entry, at)
                to = read_text(read_member(member, "to", at), child(at, "to"))
                if to not in ARMS and (to not in self.bodies or to == name):
                    raise MalformedDocument(child(at, "to"), f"{to!r} is no arm and no other body")
                attachments.append(
                    AttachmentView(body, to, read_pose(read_member(member, "pose", at), child(at, "pose")))
                )
        return tuple(attachments)

    def _contact(self, value: Any, pointer: str, n: int) -> ContactView:
        contact = read_object(value, pointer)

        def member(key: str) -> tuple[Any, str]:
            return read_member(contact, key, pointer), child(pointer, key)

        sample = contact.get("sample")
        if type(sample) is not int or not 0 <= sample < n:
            raise MalformedDocument(child(pointer, "sample"), f"must be a whole number from 0 to {n - 1}")
        kind = read_text(*member("kind"), CONTACT_KINDS)
        finger = contact.get("finger")
        if kind == "soft_finger" and (type(finger) is not int or finger not in (0, 1)):
            raise MalformedDocument(child(pointer, "finger"), "must be 0 or 1 for a soft finger")
        by = "" if kind == "inertia" else read_text(*member("by"))
        if kind != "inertia" and by not in ARMS and by not in ("cup", "tool") and by not in self.bodies:
            raise MalformedDocument(child(pointer, "by"), f"{by!r} is no arm, cup, tool or body")
        wrench = read_vector(*member("wrench"), 6)
        normal = np.zeros(3) if kind == "inertia" else read_unit(*member("normal"))
        return ContactView(
            sample=sample,
            body=self._body(*member("body")),
            by=by,
            finger=finger if kind == "soft_finger" else None,
            kind=kind,
            point=read_vector(*member("point"), 3),
            normal=normal,
            force=wrench[:3],
            torque=wrench[3:],
            parameters=self._parameters(contact, kind, pointer),
            x_axis=read_unit(*member("x_axis")) if kind == "suction" else np.zeros(3),
        )

    @staticmethod
    def _parameters(contact: Mapping[str, Any], kind: str, pointer: str) -> Mapping[str, Any]:
        if kind == "inertia":
            return {}
        needed = {
            "soft_finger": ("mu", "eps", "limit"),
            "point": ("mu", "limit"),
            "environment": ("mu", "limit"),
            "suction": ("mu", "radius", "kappa", "limit", "suction_force"),
        }[kind]
        values: dict[str, Any] = {}
        for key in needed:
            value = read_member(contact, key, pointer)
            may_be_null = key == "limit" and kind in ("point", "environment")
            values[key] = None if value is None and may_be_null else read_number(value, child(pointer, key))
        if kind == "soft_finger":
            values["squeeze"] = _optional_number(contact, "squeeze", pointer)
        return values
