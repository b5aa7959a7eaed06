"""Shapes of bodies, as a task names them. Each has its own frame, the body frame."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from planners.contract.arrays import Rows
from planners.contract.quantities import Counted, Length, Name, Point2, Scale
from planners.contract.strict_model import StrictModel
from planners.geometry.pose import Array

SHORTEST_EDGE = 1e-4
"""Outline points closer than this are one point given twice [m]."""
SMALLEST_TURN = 1e-3
"""An outline that turns less than this at a point has no corner there [rad]."""


class Box(StrictModel):
    """A box; the origin is its centre."""

    type: Literal["box"]
    size: tuple[Length, Length, Length]
    """Full lengths along x, y, z [m]."""

    @property
    def volume(self) -> float:
        """How much room it takes [m³]."""
        return math.prod(self.size)


class Cylinder(StrictModel):
    """A cylinder about z; the origin is its centre."""

    type: Literal["cylinder"]
    radius: Length
    """[m]"""
    height: Length
    """[m]"""

    @property
    def volume(self) -> float:
        """How much room it takes [m³]."""
        return math.pi * self.radius**2 * self.height


class Prism(StrictModel):
    """A convex polygon extruded along z; the origin is at mid-height."""

    type: Literal["prism"]
    outline: Annotated[tuple[Point2, ...], Counted(3, 64)]
    """Corners [[x, y], ...], counter-clockwise and strictly convex [m]."""
    height: Length
    """[m]"""

    @field_validator("outline")
    @classmethod
    def _is_convex_and_counter_clockwise(cls, outline: tuple[Point2, ...]) -> tuple[Point2, ...]:
        fault = outline_fault(outline)
        if fault is not None:
            raise PydanticCustomError("outline", "{fault}", {"fault": fault})
        return outline

    @property
    def volume(self) -> float:
        """How much room it takes [m³]."""
        return _signed_area(self.outline) * self.height


class Mesh(StrictModel):
    """A closed triangle mesh, named by asset or by upload; the frame is the mesh's own."""

    type: Literal["mesh"]
    asset: Name | None = None
    upload: Name | None = None
    scale: Scale = 1.0
    """What the mesh's coordinates are multiplied by to be metres."""

    @model_validator(mode="after")
    def _names_one_source(self) -> Self:
        if (self.asset is None) == (self.upload is None):
            raise PydanticCustomError("mesh_source", "a mesh names either an asset or an upload")
        return self


class InlineMesh(StrictModel):
    """A mesh of a plan document, with all its data: nothing else is needed to draw or collide it."""

    type: Literal["mesh"]
    vertices: Annotated[Array, Rows(3, digits=None)]
    faces: list[tuple[int, int, int]]
    """Counter-clockwise from outside; closed."""
    convex_parts: Annotated[list[Annotated[Array, Rows(3, digits=None)]], Field(min_length=1)]
    """Vertices of each convex part."""

    @classmethod
    def of(cls, vertices: Array, faces: NDArray[np.int64], parts: Iterable[Array]) -> Self:
        """Return a surface of vertices (n, 3) [m] and triangles (m, 3), with the corners (k, 3) of its convex parts."""
        return cls(
            type="mesh",
            vertices=vertices.tolist(),
            faces=faces.tolist(),
            convex_parts=[part.tolist() for part in parts],
        )

    @model_validator(mode="after")
    def _faces_are_of_its_vertices(self) -> Self:
        numbers = np.array(self.faces)
        if not len(numbers) or numbers.min() < 0 or numbers.max() >= len(self.vertices):
            raise PydanticCustomError("faces", "faces are no triples of vertices")
        return self


Shape = Annotated[Box | Cylinder | Prism | Mesh, Field(discriminator="type")]
PlateShape = Annotated[Box | Prism, Field(discriminator="type")]
"""A plate has a flat top and a flat bottom with corners to tilt about."""


def outline_fault(outline: tuple[Point2, ...]) -> str | None:
    """Return why `outline` is not a strictly convex, counter-clockwise polygon, or None if it is one."""
    ahead = zip(outline, outline[1:] + outline[:1], strict=True)
    edges = [(bx - ax, by - ay) for (ax, ay), (bx, by) in ahead]
    for index, edge in enumerate(edges):
        if math.hypot(*edge) < SHORTEST_EDGE:
            return f"points {index} and {(index + 1) % len(edges)} are less than {SHORTEST_EDGE} m apart"
    if _signed_area(outline) < 0.0:
        return "the outline runs clockwise; list its points counter-clockwise"
    turns = [_turn(before, after) for before, after in zip(edges[-1:] + edges[:-1], edges, strict=True)]
    for index, turn in enumerate(turns):
        if abs(turn) < SMALLEST_TURN:
            return f"point {index} is no corner: it lies on the line through its neighbours"
        if turn < 0.0 or turn > math.pi - SMALLEST_TURN:
            return f"the outline is not convex at point {index}"
    # Every corner turns left; only an outline that crosses itself turns by more than one full circle.
    if sum(turns) > 3.0 * math.pi:
        return "the outline crosses itself"
    return None


def _signed_area(outline: tuple[Point2, ...]) -> float:
    """Return the area, negative when the outline runs clockwise [m^2]."""
    ahead = zip(outline, outline[1:] + outline[:1], strict=True)
    return 0.5 * sum(ax * by - bx * ay for (ax, ay), (bx, by) in ahead)


def _turn(before: tuple[float, float], after: tuple[float, float]) -> float:
    """Return the angle from one edge to the next, in (-pi, pi], positive to the left [rad]."""
    cross = before[0] * after[1] - before[1] * after[0]
    return math.atan2(cross, before[0] * after[0] + before[1] * after[1])


def named_uploads(task: object) -> frozenset[str]:
    """Return the ids of all uploaded meshes in a task as JSON data, as accepted."""
    if isinstance(task, Mapping):
        upload = task.get("upload") if task.get("type") == "mesh" else None
        own = frozenset() if upload is None else frozenset({str(upload)})
        return own.union(*map(named_uploads, task.values()))
    if isinstance(task, Sequence) and not isinstance(task, str):
        return frozenset().union(*map(named_uploads, task))
    return frozenset()
