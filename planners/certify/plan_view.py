"""A plan as checks look at it: read again from the bytes that are sent, shapes built, segments numbered."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from pydantic import ValidationError

from planners.certify.geometry.body_shape import BodyShape, box, cylinder, mesh, prism
from planners.certify.geometry.level_contacts import LEVEL
from planners.contract.shapes import Box, Cylinder, InlineMesh, Prism
from planners.contract.strict_json import NotJson, parse_json
from planners.errors import LiftwrightError
from planners.geometry.pose import Array, Transform
from planners.plan.plan import Plan
from planners.plan.scenery import ARMS, BodyDocument, CellDocument, GripperDocument, StickDocument
from planners.plan.segment import Segment


class MalformedDocument(LiftwrightError):
    """A member of the document is missing or is not what the contract says; `pointer` is its RFC 6901 path."""

    def __init__(self, pointer: str, detail: str) -> None:
        self.pointer, self.detail = pointer, detail
        super().__init__(f"{pointer or '/'}: {detail}")


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
        level = planes[:, :3] @ up >= LEVEL
        # The point of each plane that is nearest to the body's origin.
        heights = -planes[level, 3] * (planes[level, :3] @ up) + self.T_world_start[2, 3]
        return float(heights.max(initial=-math.inf))

    def centres(self, poses: Array) -> Array:
        """Return the centre of mass in the world at poses `T_world_body`: (n, 4, 4) → (n, 3) [m]."""
        return poses[:, :3, :3] @ self.com + poses[:, :3, 3]

    @cached_property
    def inertia(self) -> Array:
        """(3, 3) moment of inertia about the centre of mass, evenly filled; of a body with a mass [kg m²]."""
        assert self.mass is not None
        return self.shape.inertia(self.mass, self.com)

    @cached_property
    def gyration(self) -> float:
        """The largest radius of gyration; of a body with a mass [m]."""
        assert self.mass is not None
        return float(np.sqrt(np.linalg.norm(self.inertia, 2) / self.mass))

    @cached_property
    def heights(self) -> Array:
        """(n,) heights of its vertices at the start [m]."""
        return self.shape.vertices @ self.T_world_start[2, :3] + self.T_world_start[2, 3]

    @property
    def lowest(self) -> float:
        """Height of the lowest vertex at the start [m]."""
        return float(self.heights.min())


class NumberedSegment(Segment):
    """A segment that knows which one it is."""

    index: int

    def place(self, sample: int | None = None) -> str:
        """Name the segment, and a sample of it with its time."""
        name = f"segment {self.index} ({self.kind})"
        return name if sample is None else f"{name}, sample {sample} (t = {self.time[sample]:.3f} s)"


@dataclass(frozen=True, eq=False)
class PlanView:
    """The whole document, with bodies and segments as checks need them."""

    stated: Plan
    """As it was read."""
    bodies: Mapping[str, BodyView]
    segments: tuple[NumberedSegment, ...]

    @property
    def plate(self) -> BodyView:
        """What a lift moves."""
        return self.bodies["plate"]

    @property
    def cell(self) -> CellDocument:
        """Gravity, arms and hands."""
        return self.stated.cell

    @cached_property
    def grippers(self) -> dict[str, GripperDocument]:
        """The grippers, by arm."""
        return {arm: hand for arm, hand in self.cell.hands.items() if isinstance(hand, GripperDocument)}

    @cached_property
    def sticks(self) -> dict[str, StickDocument]:
        """The sticks, by arm."""
        return {arm: hand for arm, hand in self.cell.hands.items() if isinstance(hand, StickDocument)}

    @property
    def opening(self) -> float:
        """How far a gripper opens at most; 0 without one [m]."""
        return max((float(gripper.tcp[-1, 0]) for gripper in self.grippers.values()), default=0.0)

    @cached_property
    def support(self) -> str:
        """Name of the body that the plate rests on at the start.

        Of table and support the one whose top is nearer to the plate's lowest vertex: a support may stand beside.
        """
        known = [name for name in ("table", "support") if name in self.bodies]
        if "plate" not in self.bodies or not known:
            return "table"
        lowest = self.plate.lowest
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
    bodies = {name: BodyView.of(name, body) for name, body in plan.bodies.items()}
    segments = (NumberedSegment.model_construct(index=index, **dict(one)) for index, one in enumerate(plan.segments))
    view = PlanView(plan, bodies, tuple(segments))
    for index, cause in enumerate(plan.explanation.causes):
        if not cause.says_what_is_short:
            detail = "a cause has needed, available and a unit, with more needed than available, or none of them"
            raise MalformedDocument(f"/explanation/causes/{index}", detail)
    for arm in ARMS:
        # The first documents state neither; of these no certificate is asked.
        for stated, pointer in (
            (plan.cell.arms[arm].payload, f"arms/{arm}/payload"),
            (plan.cell.hands[arm].mass, f"hands/{arm}/mass"),
        ):
            if stated is None:
                raise MalformedDocument(f"/cell/{pointer}", "is missing")
    for arm, gripper in view.grippers.items():
        if len(gripper.tcp) < 2 or np.any(np.diff(gripper.tcp[:, 0]) <= 0):
            raise MalformedDocument(f"/cell/hands/{arm}/tcp", "needs two rows or more with rising widths")
    return view


def T_flange_tcp(gripper: GripperDocument, widths: Array) -> Array:
    """Return a gripper's TCP in the flange frame at each opening: (n,) [m] → (n, 4, 4)."""
    poses = np.tile(np.eye(4), (len(widths), 1, 1))
    poses[:, 2, 3] = np.interp(widths, gripper.tcp[:, 0], gripper.tcp[:, 1])
    return poses


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
