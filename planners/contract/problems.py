"""What is wrong with a body, member by member, as an HTTP problem lists it."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, Field, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from planners.contract.quantities import PATTERN_WORDS, Mass
from planners.contract.shapes import Box, Cylinder, Mesh, Prism
from planners.contract.task_spec import KINDS, UNION_TAGS, CustomTool, ToolPart, task_schema
from planners.errors import AssetFault, LiftwrightError, SceneError
from planners.geometry.pose import Array, from_pose7

MAX_PROBLEMS = 100
"""More are counted, not listed."""
LONGEST_KEY = 200
"""An unknown member with a longer name is pointed at by its object."""
MOST_FRICTION = 2.0
"""Rubber on dry glass has as much [1]."""
DENSEST = 23e3
"""A little more than osmium's, the densest metal's [kg/m³]."""
PAD_BEYOND = 5e-3
"""By which a pad may reach beyond its tool's shapes: a lip is soft, and spreads [m]."""
APART = 5e-3
"""A shape of a tool that is farther from all others is not joined to them: models are seldom exact [m]."""
_TOOL: TypeAdapter[CustomTool] = TypeAdapter(CustomTool)
_MASS: TypeAdapter[float] = TypeAdapter(Mass)
_PLAIN_SHAPE: TypeAdapter[Box | Cylinder | Prism] = TypeAdapter(
    Annotated[Box | Cylinder | Prism, Field(discriminator="type")]
)

Location = Sequence[str | int]
Schema = Mapping[str, Any]
"""A JSON schema (2020-12), or a part of one."""


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong."""

    pointer: str
    """RFC 6901, from the body's root."""
    detail: str
    allowed: Sequence[str] | None = None
    """The valid choices, where they can be listed: values, or the members of the object that has an unknown one."""
    file: str | None = None
    """Of the body, where it holds several: the pointer is one into this file."""

    @classmethod
    def of_fault(cls, fault: AssetFault, file: str = "") -> Self:
        """Return what is wrong with a cell's files; of a fault that names no file, `file` is the one."""
        return cls(fault.pointer, fault.detail, fault.allowed or None, fault.file or file or None)

    @property
    def place(self) -> str:
        """File and pointer, as far as there are any."""
        return ": ".join(part for part in (self.file, self.pointer) if part)

    def document(self) -> dict[str, object]:
        """Return the problem as JSON data."""
        return {name: value for name, value in asdict(self).items() if value is not None}


class NotValid(LiftwrightError):
    """What was given is not what it must be; `problems` says why, with pointers into it."""

    def __init__(self, problems: list[Problem]) -> None:
        self.problems = problems
        super().__init__("; ".join(f"{each.pointer or '/'}: {each.detail}" for each in problems))


def reasons_of(error: ValidationError | SceneError) -> str:
    """Return all that is wrong with a task in one line, each after where it is."""
    return "; ".join(f"{each.pointer}: {each.detail}" for each in problems_of(error))


def problems_of(error: ValidationError | SceneError, model: type[BaseModel] | None = None) -> list[Problem]:
    """Return everything `error` knows about the body, in the order of the body.

    Args:
        error: of whoever read it.
        model: what the body was to be; None: a task.
    """
    if isinstance(error, SceneError):
        return _at_most(
            [Problem(pointer, each.detail, each.allowed) for each in error.all for pointer in each.pointers]
        )
    # A default that could not be derived follows from a fault that is listed itself.
    faults = [
        fault
        for fault in error.errors(include_url=False, include_input=False)
        if fault["type"] != "default_factory_not_called"
    ]
    return _at_most([problem_of(fault, model) for fault in faults])


def _at_most(problems: list[Problem]) -> list[Problem]:
    """Return no more problems than are listed, and how many there are besides."""
    more = len(problems) - MAX_PROBLEMS
    return problems if more <= 0 else [*problems[:MAX_PROBLEMS], Problem("", f"{more} more problems are not listed")]


def doubts_of(task: object) -> list[Problem]:
    """Return what a task, as JSON data, may be read in and was most probably not meant.

    That is a quaternion 0, 0, 0, 1, half a turn about z, as no turn at all is written where w comes last; a mass with
    which a body is denser than any metal, as one in grams is; and a tool's pad that its shapes leave out, or a part of
    the tool that hangs on nothing; and a coefficient of friction beyond that of rubber on dry glass.
    """
    return [*_doubtful_turns(task), *_doubtful_masses(task, ()), *_doubtful_tool(task), *_doubtful_friction(task)]


def _doubtful_friction(task: object) -> Iterator[Problem]:
    for path in (("friction", "grip"), ("friction", "push"), ("friction", "environment"), ("cup", "mu")):
        value = task
        for member in path:
            value = value.get(member) if isinstance(value, dict) else None
        if isinstance(value, int | float) and value > MOST_FRICTION:
            detail = f"hardly anything has a coefficient of friction of {value:g}: most are between 0.1 and 1"
            yield Problem(json_pointer(path), detail)


def _doubtful_turns(task: object) -> list[Problem]:
    poses = list(_poses(task, ()))
    # Who writes 1, 0, 0, 0 elsewhere in the same task knows that w comes first.
    if any(pose[3:] == [1, 0, 0, 0] for _, pose in poses):
        return []
    detail = (
        "0, 0, 0, 1 is half a turn about z: a pose is [x, y, z, qw, qx, qy, qz], with w before x; no turn is 1, 0, 0, 0"
    )
    return [Problem(json_pointer(path), detail) for path, pose in poses if pose[3:] == [0, 0, 0, 1]]


def _doubtful_masses(data: object, path: tuple[str | int, ...]) -> Iterator[Problem]:
    """Yield a doubt for every body with a mass and a shape whose volume is known that no matter is dense enough for."""
    members = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in members:
        yield from _doubtful_masses(value, (*path, key))
    if not isinstance(data, dict) or not {"shape", "mass"} <= data.keys():
        return
    try:
        mass, shape = _MASS.validate_python(data["mass"]), _PLAIN_SHAPE.validate_python(data["shape"])
    except ValidationError:
        # What is wrong with it is told as a problem.
        return
    density = mass / shape.volume
    if density > DENSEST:
        detail = f"{mass:g} kg make it {1e-3 * density:.0f} kg a litre, and no metal has more than 23: is it in grams?"
        yield Problem(json_pointer((*path, "mass")), detail)


def _doubtful_tool(task: object) -> Iterator[Problem]:
    """Yield doubts whether a tool's shapes, which alone are kept from touching anything, are all of it."""
    try:
        tool = _TOOL.validate_python(task.get("tool") if isinstance(task, dict) else None)
    except ValidationError:
        return
    if (beyond := pad_beyond(tool)) > PAD_BEYOND:
        detail = (
            f"the pad reaches {1e3 * beyond:.0f} mm beyond the tool's shapes, and they alone are kept from touching "
            "anything: a cylinder of its radius at the origin is missing among them"
        )
        yield Problem("/tool/cup/radius", detail)
    for number, gap in _parts_apart(tool):
        detail = (
            f"nothing joins it to the first shape: what hangs on that is {1e3 * gap:.0f} mm away, and what is between "
            "is not kept from touching anything; a pose is that of the middle of a box, cylinder or prism"
        )
        yield Problem(f"/tool/shapes/{number}", detail)


def _parts_apart(tool: CustomTool) -> list[tuple[int, float]]:
    """Return the numbers of a tool's shapes that are apart from those joined to the first one, and by how much [m].

    Judged by boxes around them, which are apart only where the shapes are; meshes take reading, and are left out.
    """
    boxes = {i: _box_around(part) for i, part in enumerate(tool.shapes) if not isinstance(part.shape, Mesh)}
    if len(boxes) < len(tool.shapes):
        return []
    joined = [boxes.pop(0)]
    while boxes:
        gaps = {number: min(_box_gap(box, other) for other in joined) for number, box in boxes.items()}
        nearest = min(gaps, key=lambda number: gaps[number])
        if gaps[nearest] > APART:
            return sorted(gaps.items())
        joined.append(boxes.pop(nearest))
    return []


def _box_around(part: ToolPart) -> Array:
    """Return the lowest and the highest corner (2, 3) of a box around a shape of a tool, along the tool's axes [m]."""
    shape, T = part.shape, from_pose7(part.pose)
    assert not isinstance(shape, Mesh)
    match shape:
        case Box():
            outline, height = (
                np.array([[x, y] for x in (-0.5, 0.5) for y in (-0.5, 0.5)]) * shape.size[:2],
                shape.size[2],
            )
        case Cylinder():
            outline, height = shape.radius * np.array([[x, y] for x in (-1.0, 1.0) for y in (-1.0, 1.0)]), shape.height
        case Prism():
            outline, height = np.array(shape.outline), shape.height
    levels = (np.column_stack([outline, np.full(len(outline), z)]) for z in (-0.5 * height, 0.5 * height))
    corners = np.vstack([*levels]) @ T[:3, :3].T + T[:3, 3]
    return np.array([corners.min(axis=0), corners.max(axis=0)])


def _box_gap(one: Array, other: Array) -> float:
    """Return how far two boxes (2, 3) along the same axes are apart [m]; 0 where they touch."""
    return float(np.linalg.norm(np.maximum(np.maximum(one[0] - other[1], other[0] - one[1]), 0.0)))


def pad_beyond(tool: CustomTool) -> float:
    """Return how far the rim of a tool's pad reaches beyond its shapes [m]; 0 where that takes reading a mesh."""
    shapes = [(part.shape, from_pose7(part.pose)) for part in tool.shapes if not isinstance(part.shape, Mesh)]
    if len(shapes) < len(tool.shapes):
        return 0.0
    angles = np.linspace(0.0, 2.0 * math.pi, 32, endpoint=False)
    rim = tool.cup.radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
    return float(np.min([_beyond(shape, (rim - T[:3, 3]) @ T[:3, :3]) for shape, T in shapes], axis=0).max())


def _beyond(shape: Box | Cylinder | Prism, points: Array) -> Array:
    """Return how far points (n, 3) in a shape's frame are outside at least (n,) [m]."""
    x, y, z = points.T
    if isinstance(shape, Box):
        return np.linalg.norm(np.maximum(np.abs(points) - 0.5 * np.array(shape.size), 0.0), axis=1)
    if isinstance(shape, Cylinder):
        across = np.hypot(x, y) - shape.radius
    else:
        # As `polygon.depth_inside`, whose module loads a compiler: a refused task does not wait for that.
        corners = np.array(shape.outline)
        edges = np.roll(corners, -1, axis=0) - corners
        outward = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.linalg.norm(edges, axis=1)[:, None]
        across = (points[:, :2] @ outward.T - np.sum(corners * outward, axis=1)).max(axis=1)
    return np.hypot(np.maximum(across, 0.0), np.maximum(np.abs(z) - 0.5 * shape.height, 0.0))


def _poses(data: object, path: tuple[str | int, ...]) -> Iterator[tuple[tuple[str | int, ...], list[object]]]:
    """Yield every member that is a pose, by its name and length, and where it is."""
    members = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in members:
        if key in _POSES and isinstance(value, list) and len(value) == 7:
            yield (*path, key), value
        else:
            yield from _poses(value, (*path, key))


def json_pointer(path: Iterable[str | int]) -> str:
    """Return the RFC 6901 pointer of a path of keys and indices."""
    return "".join("/" + str(step).replace("~", "~0").replace("/", "~1") for step in path)


def problem_of(fault: ErrorDetails, model: type[BaseModel] | None = None) -> Problem:
    """Return one of pydantic's faults as it is told; arguments as of `problems_of`."""
    kind, context = fault["type"], fault.get("ctx", {})
    path = _body_path(fault["loc"], keep_last=kind == "extra_forbidden")
    if kind == "extra_forbidden" and len(str(path[-1])) > LONGEST_KEY:
        detail = f"a member whose name has {len(str(path[-1]))} characters is not known here"
        return Problem(json_pointer(path[:-1]), detail)
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        path = [*path, _quoted(context["discriminator"])[0]]
    return Problem(json_pointer(path), _detail(fault, path), _choices(fault, path, model))


def _choices(fault: ErrorDetails, path: Sequence[str | int], model: type[BaseModel] | None) -> list[str] | None:
    """Return what could stand at a path in place of what is wrong there, where that can be listed."""
    kind, context, location = fault["type"], fault.get("ctx", {}), fault["loc"]
    expected = context.get("expected_tags") or (context.get("expected") if kind == "literal_error" else None)
    if expected:
        return _quoted(expected)
    if kind == "extra_forbidden" and (model is not None or location[0] in KINDS):
        # A member that is known only beside others is none of the choices.
        return [name for name in _known_members(location[:-1], _schema(model)) if name != path[-1]] or None
    return list(KINDS) if path == ["kind"] else None


def _body_path(location: Location, *, keep_last: bool) -> list[str | int]:
    """Leave the names of union branches out; a member that the body itself calls so is kept."""
    last = len(location) - 1
    return [step for i, step in enumerate(location) if step not in UNION_TAGS or (keep_last and i == last)]


def _quoted(text: str) -> list[str]:
    return re.findall(r"'([^']*)'", text)


_SENTENCES = {
    "missing": "is required",
    "extra_forbidden": "is not known here",
    "float_type": "must be a number, and a finite one; strings and booleans are none",
    "int_type": "must be a whole number; strings and booleans are not numbers",
    "float_parsing": "must be a number",
    "int_parsing": "must be a whole number",
    "finite_number": "must be a finite number",
    "string_type": "must be a string",
    "tuple_type": "must be an array",
    "union_tag_not_found": "is required",
    "model_type": "must be an object",
    "model_attributes_type": "must be an object",
    "dict_type": "must be an object",
}


_IN_METRES = frozenset({"size", "radius", "height", "outline", "position", "com", "com_tolerance", "goal_height"})
"""Members whose numbers are lengths: drawings are in millimetres."""
_SHARES = frozenset({"mass_tolerance", "reserve"})
"""Members that are parts of a whole: in per cent they are a hundred times as much."""
_POSES = frozenset({"plate_pose", "pose", "goal_pose", "tool_pose"})
"""Members whose first three numbers are."""


_PLATE_TYPE = ["plate", "shape", "type"]
_OTHER_PLATES = (
    ": of any other plate give the convex outline as a prism, the centre of mass as com, and by cup.position, "
    "options.grips and options.pushes where there is something to touch: cup and hands may be anywhere on the outline"
)
_OTHER_SOLIDS = ": a solid that is not convex is given as a mesh"
_A_POSE = "a pose is [x, y, z, qw, qx, qy, qz]"


def _detail(fault: ErrorDetails, path: Sequence[str | int]) -> str:
    kind, context, message = fault["type"], fault.get("ctx", {}), fault["msg"]
    if kind == "missing" and _is_of_a_pose(path):
        return f"{_SENTENCES[kind]}: {_A_POSE}"
    if kind in _SENTENCES:
        return _SENTENCES[kind]
    if kind in ("union_tag_invalid", "literal_error"):
        return f"is none of the valid choices{_OTHER_PLATES if [*path] == _PLATE_TYPE else ''}"
    if kind in ("less_than_equal", "greater_than_equal"):
        message += _of_a_range(path, too_much=kind == "less_than_equal", signed=context.get("ge", 0.0) < 0.0)
    if kind == "too_long":
        return f"has too many items: {context['max_length']} are expected"
    if kind == "string_pattern_mismatch":
        pattern = context["pattern"]
        return PATTERN_WORDS.get(pattern, f"must match {pattern}")
    message = message.removeprefix("Value error, ").replace("Input should be", "must be", 1)
    if "outline is not convex" in message:
        message += _OTHER_PLATES if path and path[0] == "plate" else _OTHER_SOLIDS
    return message


def _of_a_range(path: Sequence[str | int], *, too_much: bool, signed: bool) -> str:
    """Say in what unit a number that is out of its range was to be, and in which it may have been meant.

    Args:
        path: of the number.
        too_much: whether it is beyond the upper end.
        signed: whether the range has negative numbers in it.
    """
    member = path[-1] if path else ""
    if _is_length(path):
        return " metres" + (": is it in millimetres?" if too_much or signed else "")
    if _is_of_a_pose(path):
        return f": {_A_POSE}"
    if member == "mass":
        return " kg" + (": is it in grams?" if too_much else "")
    if member in _SHARES:
        return ", a share" + (": is it in per cent?" if too_much else "")
    return " rad: is it in degrees?" if "start_positions" in path else ""


def _is_length(path: Sequence[str | int]) -> bool:
    if _IN_METRES.intersection(map(str, path)):
        return True
    return _is_of_a_pose(path) and path[-1] in (0, 1, 2)


def _is_of_a_pose(path: Sequence[str | int]) -> bool:
    """Tell whether a path leads to one of the numbers of a pose."""
    return len(path) > 1 and path[-2] in _POSES


_TAGGED = ("kind", "type")
"""Members whose constants tell the branches of unions apart."""


def _known_members(location: Location, schema: Schema) -> list[str]:
    """Return the names of the members of an object, as a schema lists them; none where the schema knows no object.

    Args:
        location: of the object in a body, with the names of union branches as pydantic puts them in.
        schema: of the body.
    """
    definitions = schema.get("$defs", {})
    objects = list(_branches(schema, definitions))
    for step in location:
        below = (member for each in objects for member in _below(each, step))
        inside = [branch for each in below for branch in _branches(each, definitions)]
        branches = objects if isinstance(step, str) else []
        objects = inside or [each for each in branches if _tag(each) == step] or branches
    return list(dict.fromkeys(name for each in objects for name in each.get("properties", {})))


@cache
def _schema(model: type[BaseModel] | None) -> Schema:
    return task_schema() if model is None else model.model_json_schema()


def _branches(schema: Schema, definitions: Schema) -> Iterator[Schema]:
    """Yield a schema, or the branches of one that has several, without references."""
    if "$ref" in schema:
        yield from _branches(definitions[schema["$ref"].rsplit("/", 1)[-1]], definitions)
    elif several := schema.get("oneOf") or schema.get("anyOf"):
        for branch in several:
            yield from _branches(branch, definitions)
    else:
        yield schema


def _below(schema: Schema, step: str | int) -> Iterator[Schema]:
    if isinstance(step, str):
        below = schema.get("properties", {}).get(step, schema.get("additionalProperties"))
    else:
        below = schema.get("items")
    if isinstance(below, Mapping):
        yield below


def _tag(schema: Schema) -> str | None:
    """Return the constant by which a branch is told from the others."""
    properties = schema.get("properties", {})
    return next((properties[name].get("const") for name in _TAGGED if name in properties), None)
