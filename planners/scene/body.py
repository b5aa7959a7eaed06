"""Rigid bodies of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from planners.contract.shapes import Box, Cylinder, InlineMesh, Prism
from planners.geometry.convex import CollisionBody
from planners.geometry.pose import Array, Transform
from planners.scene.solid import ExtrudedSolid, Solid

Role = Literal["plate", "object", "tool", "support", "obstacle", "table", "frame", "cup", "cable"]


@dataclass(frozen=True, eq=False)
class Body:
    """A named rigid body where it is at the start."""

    name: str
    role: Role
    shape: Box | Cylinder | Prism | InlineMesh
    """As the task names it, a mesh with all its data; its frame is the body frame."""
    solid: Solid
    mass: float | None
    """[kg]; None where nothing depends on it."""
    com: Array
    """(3,) centre of mass in the body frame [m]."""
    T_world_body: Transform
    static: bool
    """Whether it stays where it is."""

    def collision_body(self) -> CollisionBody:
        """Return the body for collision queries, in a movable frame that has its name."""
        return CollisionBody(self.name, self.role, self.name, self.solid.convex_parts)

    def collision_body_in_world(self) -> CollisionBody:
        """Return the body for collision queries, fixed in the world where it is at the start."""
        parts = tuple(part.placed(self.T_world_body) for part in self.solid.convex_parts)
        return CollisionBody(self.name, self.role, "world", parts)


@dataclass(frozen=True, eq=False)
class PlateBody(Body):
    """The plate that is lifted: a convex outline extruded along z, its top face towards +z."""

    solid: ExtrudedSolid

    @property
    def outline(self) -> Array:
        """(n, 2) corners of both faces in the plate's frame, counter-clockwise [m]."""
        return self.solid.outline

    @property
    def height(self) -> float:
        """Thickness [m]."""
        return self.solid.height

    @property
    def top(self) -> float:
        """Height of the top face in the plate's frame [m]."""
        return 0.5 * self.solid.height

    @property
    def bottom(self) -> float:
        """Height of the bottom face in the plate's frame [m]."""
        return -0.5 * self.solid.height
