"""PlanDocument: the JSON result of one task, by which the motion can be replayed and every claim be checked.

The models state the document for readers and for OpenAPI, and `check_document` checks what is written against them.
Arrays of samples are checked by their lengths only: a plan has hundreds of thousands of numbers.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import Field, JsonValue, model_validator
from pydantic_core import PydanticCustomError

from planners.contract.considered import Considered
from planners.contract.document_numbers import (
    ArmName,
    Numbers,
    PoseArray,
    Real,
    Rows,
    SixJoints,
    Vector,
    WrenchArray,
)
from planners.contract.shapes import Box, Cylinder, InlineMesh, Prism
from planners.contract.strict_model import StrictModel
from planners.contract.task_spec import TaskSpec
from planners.graph.rejections import is_shortage

SCHEMA_VERSION = "1.0"
JOINTS = (
    *("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"),
    *("wrist_1_joint", "wrist_2_joint", "wrist_3_joint"),
)
"""Joints of one arm from base to flange."""
JOINT_NAMES = tuple(f"{arm}_{joint}" for arm in ("left", "right") for joint in JOINTS)
"""The order of joints in every array of twelve."""

Outcome = Literal["solved", "infeasible", "not_found"]
SegmentKind = Literal[
    "transit", "transfer", "handover", "approach", "retreat", "grip", "release", "attach", "detach"
]  # fmt: skip


class Software(StrictModel):
    """What made the plan."""

    name: str
    version: str
    commit: str | None


class Cause(StrictModel):
    """One reason why there is no plan, in numbers."""

    reason: str
    needed: Real | None
    available: Real | None
    unit: str | None
    where: JsonValue = None

    @model_validator(mode="after")
    def _says_what_is_short(self) -> Self:
        needed, available, unit = self.needed, self.available, self.unit
        if needed is None and available is None and unit is None:
            return self
        if needed is None or available is None or unit is None or not is_shortage(needed, available, unit):
            raise PydanticCustomError(
                "no_shortage",
                "a cause has needed, available and a unit, with more needed than available, or none of them",
            )
        return self


class Explanation(StrictModel):
    """What came out, for a person."""

    summary: str
    causes: list[Cause] = Field(default_factory=list)


class LinkDocument(StrictModel):
    """A link that moves, in the frame after its joint."""

    mass: Real
    """[kg]"""
    com: Vector
    """Centre of mass [m]."""


class ArmDocument(StrictModel):
    """One arm: `T_world_flange = base · Π Rz(q + theta0) Tz(d) Tx(a) Rx(alpha)`."""

    base: PoseArray
    dh: Annotated[list[tuple[Real, Real, Real, Real]], Field(min_length=6, max_length=6)]
    """Rows [a, alpha, d, theta0]."""
    position_min: SixJoints
    position_max: SixJoints
    velocity_max: SixJoints
    acceleration_max: SixJoints
    payload: Real
    """Largest mass at the flange, the hand included [kg]."""
    torque_max: SixJoints | None = None
    """Largest torque of each joint [Nm]; documents of 0.1.0 have none of this, nor of masses and centres of mass."""
    links: Annotated[list[LinkDocument], Field(min_length=6, max_length=6)] | None = None
    """Of the six joints, from shoulder to wrist 3."""


class GripperDocument(StrictModel):
    """A gripper; its TCP lies between the pads' centres, z the approach, y the opening axis."""

    kind: Literal["gripper"]
    mass: Real
    """Of all that is mounted on the flange [kg]."""
    com: Vector | None = None
    """Its centre of mass, in the flange frame [m]."""
    tcp: list[tuple[Real, Real]]
    """Rows [width, z from the flange]."""
    force_range: tuple[Real, Real] | None = None
    """Least and largest force with which it squeezes [N]."""


class StickDocument(StrictModel):
    """A stick; its TCP is the centre of the tip's hemisphere, in the flange frame."""

    kind: Literal["stick"]
    mass: Real
    """Of all that is mounted on the flange [kg]."""
    com: Vector | None = None
    """Its centre of mass, in the flange frame [m]."""
    tcp: PoseArray
    tip_radius: Real


class CellDocument(StrictModel):
    """What is needed of the cell to replay and check a plan."""

    name: str
    hash: str
    gravity: Vector
    arms: dict[ArmName, ArmDocument]
    hands: dict[ArmName, Annotated[GripperDocument | StickDocument, Field(discriminator="kind")]]


class BodyDocument(StrictModel):
    """A body at the start."""

    role: Literal["plate", "object", "tool", "support", "obstacle", "table", "frame", "cup", "cable"]
    shape: Annotated[Box | Cylinder | Prism | InlineMesh, Field(discriminator="type")]
    mass: Real | None
    com: Vector
    pose: PoseArray
    static: bool


class ContactStateDocument(StrictModel):
    """Which element of a body touches its environment between a segment's first and last sample."""

    element: Literal["face", "edge", "vertex", "none"]
    index: int | None
    with_: Annotated[str | None, Field(alias="with")]
    vertices: list[Vector]
    """In the body frame."""


class GripDocument(StrictModel):
    """A grasp."""

    arm: ArmName
    body: str
    pose: PoseArray
    """`T_body_tcp`"""
    width: Real
    squeeze: Real | None = None
    """The commanded force of the fingers, from grip to release: what each pad presses with while nothing pulls [N]."""


class PushDocument(StrictModel):
    """A point contact with the stick."""

    arm: ArmName
    body: str
    point: Vector
    """In the body frame."""
    normal: Vector
    """Into the body, in the body frame."""


class HoldDocument(StrictModel):
    """What the hands have on a body."""

    grip: GripDocument | None
    push: PushDocument | None
    second_grip: GripDocument | None = None
    """Of the other gripper, while a body is passed from hand to hand; `grip` is the one that is taken or given up."""


class Attachment(StrictModel):
    """A body rides on an arm's flange or on another body, at a constant pose."""

    to: str
    pose: PoseArray
    """`T_to_body`"""


class _Contact(StrictModel):
    sample: int
    body: str
    by: str
    finger: Literal[0, 1] | None
    point: Vector
    normal: Vector
    """Into the body."""
    wrench: WrenchArray
    """That `by` exerts on `body`, about `point`."""


class SoftFingerContact(_Contact):
    """A pad: friction of a soft finger, its torque about the normal only."""

    kind: Literal["soft_finger"]
    mu: Real
    eps: Real
    limit: Real | None
    """Largest normal force there can be: the squeeze, and half of what the hand may bear in all [N]."""
    squeeze: Real | None = None
    """As of the grip: the normal forces of both fingers add up to twice as much [N]."""


class PointContact(_Contact):
    """A stick's tip: friction, no torque."""

    kind: Literal["point"]
    mu: Real
    limit: Real | None


class EnvironmentContact(_Contact):
    """One corner of the contact with a resting surface: friction, no torque."""

    kind: Literal["environment"]
    mu: Real
    limit: Real | None


class SuctionContact(_Contact):
    """A suction pad; x = body x projected on the pad, y = z cross x, pull outward positive."""

    kind: Literal["suction"]
    mu: Real
    radius: Real
    kappa: Real
    limit: Real
    suction_force: Real
    x_axis: Vector


class InertiaEntry(StrictModel):
    """The inertial wrench that was counted in a set, about `point`, the centre of mass."""

    kind: Literal["inertia"]
    sample: int
    body: str
    by: str | None = None
    finger: None = None
    point: Vector
    normal: Vector | None = None
    wrench: WrenchArray


Contact = Annotated[
    SoftFingerContact | PointContact | EnvironmentContact | SuctionContact | InertiaEntry, Field(discriminator="kind")
]


class Segment(StrictModel):
    """A stretch of motion of one kind, with one set of attachments."""

    kind: SegmentKind
    movers: list[ArmName]
    contact_state: ContactStateDocument | None
    hold: HoldDocument | None
    time: Numbers
    positions: Rows
    velocities: Rows
    accelerations: Rows
    gripper_width: dict[ArmName, Numbers]
    attached: dict[str, list[Attachment]]
    body_poses: dict[str, Rows]
    contacts: list[Contact]
    reserve: list[Real | None] | None = None
    """By sample: the largest share of every limit that could be missing with the forces still borne [1]; null where
    nothing is held."""

    @model_validator(mode="after")
    def _arrays_fit_the_samples(self) -> Self:
        n = len(self.time)
        if n < 2:
            raise PydanticCustomError("samples", "a segment has at least two samples")
        for name, array, width in self._sampled():
            if len(array) != n or (width is not None and any(len(row) != width for row in array)):
                wanted = f"{n}" if width is None else f"{n} x {width}"
                raise PydanticCustomError("samples", "{name} is not {wanted}", {"name": name, "wanted": wanted})
        if any(not 0 <= contact.sample < n for contact in self.contacts):
            raise PydanticCustomError("samples", "a contact names a sample that the segment does not have")
        return self

    def _sampled(self) -> Iterator[tuple[str, Sequence[Any], int | None]]:
        """Yield name, array and row length of everything that is sampled."""
        yield "positions", self.positions, 12
        yield "velocities", self.velocities, 12
        yield "accelerations", self.accelerations, 12
        if self.reserve is not None:
            yield "reserve", self.reserve, None
        for arm, widths in self.gripper_width.items():
            yield f"gripper_width/{arm}", widths, None
        for body, poses in self.body_poses.items():
            yield f"body_poses/{body}", poses, 7


class Check(StrictModel):
    """One thing that was checked again on the finished document."""

    name: str
    passed: bool
    margin: Real | None
    """How far the worst case is from failing; negative when it fails."""
    unit: str | None
    where: JsonValue = None


class Certificate(StrictModel):
    """An independent second opinion."""

    passed: bool
    checks: list[Check]


class ForceCurve(StrictModel):
    """One quantity of the simulated lift over time."""

    name: str
    unit: str
    time: Numbers
    value: Numbers


class NodeComparison(StrictModel):
    """Forces on the plate at the end of one of the plan's motions, shortly before the lifter prepares the next."""

    segment: int
    time: Real
    planned: dict[str, Vector]
    """By "left", "right", "cup", "support"."""
    simulated: dict[str, Vector]
    largest_difference: Real
    """Largest norm of a difference [N]."""


class SimulatedManipulation(StrictModel):
    """How well the simulated manipulation kept to its plan."""

    nodes: list[NodeComparison]
    largest_difference: Real
    """[N]"""
    largest_difference_of_weight: Real
    """The same over the plate's weight [1]."""
    largest_distance: Real
    """Of the pad from its planned place [m]."""
    largest_angle: Real
    """Of the plate from its planned orientation [rad]."""


class SimulatedLift(StrictModel):
    """The cooperative lift, as prepared and as it went."""

    begin: Real
    """On the time axis of the curves, which begins with the plan's [s]."""
    height: Real
    """How far up the plate came, over the plan's last pose [m]."""
    reachable_height: Real
    """How far up both arms can go with the plate [m]."""
    end_of_reach: str
    """What ends the way up."""
    goal_force: Real
    """F_goal of paper B, eq. (11): vertical force of the pushing hand [N]."""
    cup_reserve: Real
    """Part of the cup's largest force that F_goal keeps back [1]."""
    lifter_travel: Real
    lifter_seconds: Real
    controlled: bool
    """Whether the hands followed by force."""


class ForceDips(StrictModel):
    """How often both hands together bore less than the minimum during the lift."""

    count: int
    seconds: Real
    lowest: Real | None
    """Smallest sum of both hands' vertical forces [N]."""


class SimulatedMotion(StrictModel):
    """How robot and plate moved from start to end, for playing it back."""

    time: Numbers
    positions: Rows
    plate: Rows
    """Poses [x, y, z, w, x, y, z]."""


class LiftSimulation(StrictModel):
    """A plate lift executed in physics, and the cooperative lift that follows it."""

    kind: Literal["plate_lift"]
    outcome: Literal["lifted", "slipped", "cup_lost", "overload"]
    time: Real
    """When it ended [s]."""
    cause: str | None
    """What gave way."""
    force_curves: list[ForceCurve]
    """Forces of hands are vertical, upward on the plate."""
    minimum_total_force: Real | None
    """Weight less the cup's largest force: what both hands together must bear [N]."""
    lift: SimulatedLift | None
    dips: ForceDips
    manipulation: SimulatedManipulation
    motion: SimulatedMotion
    model: list[str]
    """What is modelled, in sentences."""
    seed: int
    settings: dict[str, JsonValue]
    """All assumptions, SI units."""


class BodyTrack(StrictModel):
    """How one body moved; it stands between two poses that are equal."""

    time: Numbers
    poses: Rows
    """[x, y, z, w, x, y, z]"""


class SimulatedToolMotion(StrictModel):
    """How robot, tool and objects moved from start to end, for playing it back."""

    time: Numbers
    positions: Rows
    bodies: dict[str, BodyTrack]


class GoalError(StrictModel):
    """How far an object ended from its goal, up to its symmetry."""

    distance: Real
    """[m]"""
    angle: Real
    """[rad]"""


class LargestLoads(StrictModel):
    """Greatest values of the curves."""

    suction_share: Real
    """Of what the cup bears [1]."""
    squeeze: Real
    """[N]"""
    tool_off_plan: Real
    object_off_plan: Real
    """[m]"""


class ToolSimulation(StrictModel):
    """A suction-tool plan executed in physics."""

    kind: Literal["suction_tool"]
    outcome: Literal["done", "object_dropped", "tool_slipped", "toppled", "off_goal"]
    time: Real
    """When it ended, some moments after a failure [s]."""
    failed_at: Real | None
    """[s]"""
    cause: str | None
    """What gave way."""
    force_curves: list[ForceCurve]
    goals: dict[str, GoalError]
    largest: LargestLoads
    motion: SimulatedToolMotion
    model: list[str]
    """What is modelled, in sentences."""
    settings: dict[str, JsonValue]
    """All assumptions, SI units."""


Simulation = Annotated[LiftSimulation | ToolSimulation, Field(discriminator="kind")]


class StageTime(StrictModel):
    """How long one stage took."""

    name: str
    seconds: Real


class LeastReserve(StrictModel):
    """Where along a plan least of the limits is left."""

    value: Real
    """The least of the segments' `reserve` [1]."""
    limited_by: str
    """What would give way first, in words."""
    body: str
    """What would be lost."""
    segment: int
    sample: int


class Statistics(StrictModel):
    """What the work cost and what fell by the way."""

    total_seconds: Real | None
    stages: list[StageTime]
    graph: dict[str, JsonValue]
    search: dict[str, JsonValue]
    rejections: dict[str, int]
    reserve: LeastReserve | None = None
    """None: nothing is held, or a document of before there was any."""
    considered: Considered | None = None
    """What a suction-tool planner looked at."""


class PlanDocument(StrictModel):
    """The result of one task."""

    schema_version: Literal["1.0"]
    id: str
    task: TaskSpec
    """As accepted, every default filled in."""
    seed: int
    software: Software
    outcome: Outcome
    explanation: Explanation
    cell: CellDocument
    joint_names: Annotated[list[str], Field(min_length=12, max_length=12)]
    bodies: dict[str, BodyDocument]
    segments: list[Segment]
    certificate: Certificate | None
    simulation: Simulation | None
    statistics: Statistics


def check_document(document: dict[str, Any]) -> None:
    """Check that a finished document is what the contract says.

    Raises:
        pydantic.ValidationError: naming the members that are not.
    """
    PlanDocument.model_validate(document)


def encode_document(document: dict[str, Any]) -> bytes:
    """Write a document as JSON; every number is written so that reading it gives the same number.

    Raises:
        ValueError: if a number is not finite.
    """
    return json.dumps(document, allow_nan=False, ensure_ascii=False, separators=(",", ":")).encode("utf-8")


def document_schema() -> dict[str, Any]:
    """Return the JSON schema (2020-12) of a plan document."""
    return PlanDocument.model_json_schema()
