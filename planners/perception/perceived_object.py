"""Objects as they were perceived: a box or a cylinder from its top facet down to what it stands on."""

from __future__ import annotations

from dataclasses import dataclass

from planners.contract.shapes import Box, Cylinder
from planners.geometry import polygon
from planners.geometry.pose import Array, Transform


@dataclass(frozen=True)
class ObjectUncertainty:
    """Uncertainties of what is told of an object: 19 of 20 errors are within twice as much.

    Were errors normal, these were their standard deviations. `PerceptionSettings` has the floors that make it so.
    """

    position: tuple[float, float, float]
    """Along the object's own axes [m]."""
    yaw: float
    """About its z axis [rad]; 0 for a cylinder, whose turn has no meaning."""
    size: tuple[float, float, float]
    """Of a box: its sides. Of a cylinder: its diameter twice, and its height [m]."""


@dataclass(frozen=True, eq=False)
class PerceivedObject:
    """A box or cylinder that stands upright on the table or on another object."""

    name: str
    shape: Box | Cylinder
    """Centred; z up, x along the longer side."""
    T_world_object: Transform
    uncertainty: ObjectUncertainty
    supported_by: str
    """What it stands on: "table" or the name of another object."""
    top_points: int
    """Pixels that its top was found from."""
    support_points: Array
    """(k, 3) some of the points, in the world, that tell of it [m]."""

    @property
    def height(self) -> float:
        """Of its top above its bottom [m]."""
        return self.shape.size[2] if isinstance(self.shape, Box) else self.shape.height

    def outline(self, beyond: float = 0.0) -> Array:
        """Return the (n, 2) outline in the world, counter-clockwise, moved out by `beyond` [m]."""
        R, p = self.T_world_object[:2, :2], self.T_world_object[:2, 3]
        return self._outline(beyond) @ R.T + p

    def _outline(self, beyond: float) -> Array:
        if isinstance(self.shape, Cylinder):
            return polygon.circle(self.shape.radius + beyond, 48)
        x, y, _ = self.shape.size
        return polygon.rectangle(x + 2.0 * beyond, y + 2.0 * beyond)


@dataclass(frozen=True, eq=False)
class Unrecognised:
    """Something above the table that is neither a box nor a cylinder that can be told; nobody should go there."""

    reason: str
    outline: Array
    """(n, 2) its convex hull seen from above, in the world, counter-clockwise [m]."""
    top: float
    """z of its highest point in the world [m]."""
