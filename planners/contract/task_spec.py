"""TaskSpec: what is asked for, with every default filled in. Two kinds, told apart by `kind`."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Discriminator, Field, Tag, TypeAdapter, ValidationError
from pydantic_core import PydanticCustomError

from planners.contract.quantities import (
    SOFT_FINGER_EPS,
    Counted,
    Direction,
    Eccentricity,
    ExternalId,
    Factor,
    Force,
    FrictionCoefficient,
    JointPositions,
    Length,
    Mass,
    MassTolerance,
    Name,
    PeelStiffness,
    Point2,
    Point3,
    Pose,
    Reserve,
    SceneId,
    Seed,
    Tolerance,
)
from planners.contract.shapes import PlateShape, Shape
from planners.contract.strict_json import parse_json
from planners.contract.strict_model import StrictModel

HINGE_KAPPA = 0.005
"""kappa of a plate lift's cup [N]: Dex-Net 3.0's published re-implementation; the cup is then nearly a hinge."""


class Obstacle(StrictModel):
    """A body that nothing may touch; it may stand, hang or be mounted anywhere."""

    name: Name
    shape: Shape
    pose: Pose
    """Body frame in the world."""


Obstacles = Annotated[tuple[Obstacle, ...], Counted(0, 200)]


class Plate(StrictModel):
    """The plate to be lifted."""

    shape: PlateShape
    mass: Mass
    com: Point3 | None = None
    """Centre of mass in the body frame [m]. None: the centroid of the evenly filled shape. Accepted tasks state it."""
    mass_tolerance: MassTolerance = 0.02
    """Share of the mass by which it may be more or less [1]. The plan holds every plate within the tolerances."""
    com_tolerance: Tolerance = 0.005
    """Distance along each of the plate's axes by which the centre of mass may be off, either way [m]."""


class Support(StrictModel):
    """What the plate lies on when that is not the table itself; it stands on the table."""

    shape: Shape
    pose: Pose


class LifterCup(StrictModel):
    """The vacuum lifter's cup on the plate's top face."""

    position: Point2 | None = None
    """Centre of the pad from the shape's origin, in plate axes [m]. None: wherever most can be kept back; documents of
    plans state the place that was found."""
    radius: Length
    """[m]"""
    max_force: Force
    """Largest suction force [N]."""
    mu: FrictionCoefficient = 0.5
    kappa: PeelStiffness = HINGE_KAPPA

    @property
    def place(self) -> Point2:
        """`position`, in a task that has one."""
        assert self.position is not None
        return self.position


class PlateLiftFriction(StrictModel):
    """Friction of the plate lift's contacts."""

    grip: FrictionCoefficient = 0.5
    push: FrictionCoefficient = 0.5
    environment: FrictionCoefficient = 0.4
    eps: Eccentricity = SOFT_FINGER_EPS
    """Torsional friction of a gripping finger, as a length [m]."""


class HandForceLimit(StrictModel):
    """What a task asks of the hands at most. What an arm's payload leaves beside its hand always holds as well."""

    normal: Force = 17.0
    """Largest normal force of the stick, and largest net force of the gripper [N]; of a finger, its normal force with
    the paper's contact model."""
    net: Force = 19.0
    """Largest magnitude of the sum of one hand's contact forces [N]."""
    squeeze: Force | None = None
    """What each pad of the gripper presses with when it bears nothing [N]. None: what the hand's file says."""


class GripSpec(StrictModel):
    """One place where the gripper may hold the plate, one finger on each face."""

    position: Point3
    """Midpoint between the pads' centres, in the plate's frame, inside the plate [m]."""
    approach: Direction
    """Where the gripper points, in the plate's frame and in the plate's plane."""


class PushSpec(StrictModel):
    """One place where the stick may push the plate."""

    position: Point3
    """Contact point on the plate's surface, in the plate's frame [m]."""
    normal: Direction
    """Into the plate, square to the face at `position`, in the plate's frame."""
    direction: Direction
    """Where the stick points, in the plate's frame."""


class PlanningOptions(StrictModel):
    """How a task of either kind is planned."""

    reserve: Reserve = 0.1
    """Share of every force limit (friction, what hands may bear, cup) that is kept back all along [1]. Where there is
    a plan only with less, it is planned with as much as a few searches find, and the document says so."""
    remedies: Annotated[bool, Field(strict=True)] = True
    """Where there is no plan, look for changes of the task with which there is one."""


class PlateLiftOptions(PlanningOptions):
    """How a plate lift is planned."""

    goal_height: Annotated[float, Field(strict=True, ge=0.001, le=0.5, allow_inf_nan=False)] = 0.03
    """Height of the plate's lowest corner above its support at the end [m]."""
    minimise: Literal["cost", "force", "risk"] = "cost"
    """The paper's path cost; the largest effort of a hand along the path; or the risk: of all plans the one that keeps
    the largest reserve, however much more than `reserve` that is."""
    search: Literal["lazy", "full"] = "lazy"
    """Solve balances only where the search goes, or build the whole graph first. The plan is the same."""
    simulate: Annotated[bool, Field(strict=True)] = True
    """Execute the plan in physics afterwards. That a simulation fails is told, and leaves the plan as it is."""
    contact_density: Factor = 1.0
    """Number of sampled plate poses, relative to the default."""
    hold_density: Factor = 1.0
    """Number of generated grips and pushes, relative to the default."""
    grips: Annotated[tuple[GripSpec, ...], Counted(1, 200)] | None = None
    """Grips to use instead of generated ones."""
    pushes: Annotated[tuple[PushSpec, ...], Counted(1, 400)] | None = None
    """Pushes to use instead of generated ones."""


LIFT_CELL, TOOL_CELL = "dual_ur3e_lift", "dual_ur3e_tool"
"""In which a task is that names none."""
DEFAULT_CELLS = {"plate_lift": LIFT_CELL, "suction_tool": TOOL_CELL}
"""The same, by kind."""
LifterModel = Literal["paper", "cable", "dexnet"]
"""What the vacuum lifter's cup can exert, see `planners.balance.lifter`."""


class PlateLiftTask(StrictModel):
    """Raise a plate from its support with two hands and the vacuum lifter (paper B)."""

    kind: Literal["plate_lift"]
    cell: Name = LIFT_CELL
    plate: Plate
    plate_pose: Pose
    """The plate's body frame in the world: top face up, its whole bottom face at rest."""
    support: Support | None = None
    """None: the table."""
    cup: LifterCup
    lifter_model: LifterModel = "paper"
    contact_model: Literal["squeeze", "paper"] = "squeeze"
    """How the gripper holds: with a commanded squeeze that what it bears comes on top of, or as in the paper, with two
    fingers whose normal forces are free up to a cap."""
    friction: PlateLiftFriction = PlateLiftFriction()
    hand_force_limit: HandForceLimit = HandForceLimit()
    obstacles: Obstacles = ()
    start_positions: JointPositions | None = None
    """None: the cell's home."""
    seed: Seed = 0
    external_id: ExternalId | None = None
    options: PlateLiftOptions = PlateLiftOptions()

    def with_cup_at(self, place: Point2) -> PlateLiftTask:
        """Return the task with the cup at a place, in plate axes [m]."""
        return self.model_copy(update={"cup": self.cup.model_copy(update={"position": place})})


def _half_peel_limit(validated: dict[str, Any]) -> float:
    """Return half the kappa at which a pad peels, sqrt(2) F / pi: the default of a hand-held tool's cup [N]."""
    return 0.5 * math.sqrt(2.0) * validated["max_force"] / math.pi


class ToolCup(StrictModel):
    """The cup of a hand-held suction tool."""

    radius: Length
    """[m]"""
    max_force: Force
    """Largest suction force [N]."""
    mu: FrictionCoefficient = 0.5
    kappa: PeelStiffness = Field(default_factory=_half_peel_limit)
    """Default: half the peel limit sqrt(2) max_force / pi [N]."""


class ToolPart(StrictModel):
    """One shape of a tool."""

    shape: Shape
    pose: Pose
    """Shape frame in the tool frame."""


class CustomTool(StrictModel):
    """A suction tool; its origin is the centre of the cup's lip, +z runs from the cup up the shaft."""

    shapes: Annotated[tuple[ToolPart, ...], Counted(1, 64)]
    mass: Mass
    com: Point3 | None = None
    """In the tool frame [m]. None: the centroid of all shapes, evenly filled. Accepted tasks state it."""
    cup: ToolCup


def _default_symmetry(validated: dict[str, Any]) -> Literal["axis", "none"]:
    return "axis" if validated["shape"].type == "cylinder" else "none"


def _perceived_may_be_left_out(schema: dict[str, Any]) -> None:
    """Tell in the JSON schema that a task with a scene need not say what was perceived."""
    schema["required"] = [name for name in schema["required"] if name not in ("name", "shape", "pose")]
    schema["properties"]["detection"] = {
        "type": "string",
        "description": "Name of the perceived object, in a task with `scene_id`; default: its own name.",
    }
    schema["description"] += " Name, shape and pose may be left out in a task with `scene_id`."


class ObjectToMove(StrictModel):
    """A body that is to be brought from its pose to its goal pose."""

    model_config = ConfigDict(json_schema_extra=_perceived_may_be_left_out)

    name: Name
    shape: Shape
    mass: Mass
    com: Point3 | None = None
    """In the body frame [m]. None: the centroid of the evenly filled shape. Accepted tasks state it."""
    pose: Pose
    goal_pose: Pose
    goal_symmetry: Literal["none", "axis", "shape"] = Field(default_factory=_default_symmetry)
    """Default: axis for a cylinder, else none."""


class SuctionToolFriction(StrictModel):
    """Friction of the suction tool's contacts."""

    grip: FrictionCoefficient = 0.5
    environment: FrictionCoefficient = 0.4
    eps: Eccentricity = Field(default=SOFT_FINGER_EPS, exclude_if=lambda eps: eps == SOFT_FINGER_EPS)
    """Of a finger. Documents say it where it is not the default."""


class SuctionToolOptions(PlanningOptions):
    """How a suction-tool task is planned."""

    simulate: Annotated[bool, Field(strict=True)] = True
    """Whether the plan is executed in physics."""


ToolName = Literal["carton_lifter", "long_symmetric", "long_symmetric_large_pad", "short_asymmetric"]
"""Of a shipped one; a cell may bring others."""


def _tool_form(tool: Any) -> str:
    return "tool by name" if isinstance(tool, str) else "custom tool"


Tool = Annotated[
    Annotated[Name, Tag("tool by name")] | Annotated[CustomTool, Tag("custom tool")], Discriminator(_tool_form)
]


class SuctionToolTask(StrictModel):
    """Move objects to their goals with a suction tool that the hands regrasp (paper A)."""

    kind: Literal["suction_tool"]
    cell: Name = TOOL_CELL
    tool: Tool = "long_symmetric"
    """Name of a shipped one or of one that the cell brings, or a description."""
    tool_pose: Pose | None = None
    """None: the cell's tool rest."""
    scene_id: SceneId | None = None
    """The perceived scene that shapes and poses come from where a posted task leaves them out."""
    scene_filled: Annotated[bool, Field(strict=True, exclude_if=lambda filled: not filled)] = False
    """Whether all that the scene gives is written out already, as in every task that was accepted: nothing is looked up
    in it again."""
    objects: Annotated[tuple[ObjectToMove, ...], Counted(1, 50)]
    friction: SuctionToolFriction = SuctionToolFriction()
    grip_force_limit: Force = 60.0
    """Largest normal force of one finger [N]."""
    carry_force_limit: Force | None = None
    """What one hand may carry, tool and object, at rest and in motion [N]; never more than its arm's payload leaves.
    None: all of that."""
    obstacles: Obstacles = ()
    start_positions: JointPositions | None = None
    """None: the cell's home."""
    seed: Seed = 0
    external_id: ExternalId | None = None
    options: SuctionToolOptions = SuctionToolOptions()


TaskSpec = Annotated[PlateLiftTask | SuctionToolTask, Field(discriminator="kind")]
KINDS = ("plate_lift", "suction_tool")
UNION_TAGS = frozenset({*KINDS, "box", "cylinder", "prism", "mesh", "tool by name", "custom tool"})
"""Names by which pydantic tells the branches of unions apart in its error locations. None of them is a member."""
_NO_TEXT = (
    "a text is no task: give a pathlib.Path to read a file, as read_task(Path('task.json')), bytes of JSON, or the "
    "dict that JSON was parsed to"
)
_ADAPTER: TypeAdapter[PlateLiftTask | SuctionToolTask] = TypeAdapter(TaskSpec)


def read_task(body: object) -> PlateLiftTask | SuctionToolTask:
    """Read a task; defaults are filled in, but for those that take the scene: see `with_centres`.

    Args:
        body: parsed JSON, or bytes of JSON, or the path of a file.

    Raises:
        NotJson: the bytes are not JSON.
        pydantic.ValidationError: a ValueError, for text too, which is neither opened nor parsed;
            `planners.contract.problems.problems_of` turns it into what the caller is told.
    """
    if isinstance(body, Path):
        body = body.read_bytes()
    if isinstance(body, str):
        # Never opened: it may have come with a request, for which this is what any other value but an object is.
        fault = PydanticCustomError("model_attributes_type", _NO_TEXT)
        raise ValidationError.from_exception_data("task", [{"type": fault, "input": body}])
    return _ADAPTER.validate_python(parse_json(body) if isinstance(body, bytes) else body)


def write_task(task: PlateLiftTask | SuctionToolTask) -> dict[str, Any]:
    """Return the task as accepted, every default filled in, as JSON data. `read_task` gives the same task again."""
    return task.model_dump(mode="json")


def to_post_again(task: PlateLiftTask | SuctionToolTask) -> PlateLiftTask | SuctionToolTask:
    """Return a task of a plan as it is posted again: it has all of its scene, also where plans did not say so yet."""
    if isinstance(task, PlateLiftTask) or task.scene_id is None:
        return task
    return task.model_copy(update={"scene_filled": True})


def without(task: PlateLiftTask | SuctionToolTask, pointers: Iterable[str]) -> dict[str, Any]:
    """Return a task as JSON data without some of its members, by their pointers (RFC 6901, names of objects only)."""
    data = write_task(task)
    for pointer in pointers:
        holder, *steps = data, *pointer.split("/")[1:]
        for step in steps[:-1]:
            holder = holder[step]
        holder.pop(steps[-1], None)
    return data


def task_schema() -> dict[str, Any]:
    """Return the JSON schema (2020-12) of a task body."""
    return _ADAPTER.json_schema()
