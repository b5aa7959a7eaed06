"""From where a cell is looked at: near enough to see much, far enough that nothing is cut off, whatever its size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.cell.cell import Cell
from planners.geometry.pose import Array
from planners.scene.clashes import arm_frames, placed_body

FIELD_OF_VIEW = 0.66
"""Vertical [rad]."""
WIDTH_OVER_HEIGHT = 2.0
"""Of the narrowest picture that shows the cell whole [1]: a laptop's, beside the page's panels."""
NO_OBSTACLES = np.zeros((0, 3))
SURROUNDINGS = 0.25
"""Obstacles are in the picture as far as they are no farther beyond the cell than this part of its size [1]."""
MARGIN = 1.05
"""The cell's part of the picture is smaller than the picture by this factor [1]."""


@dataclass(frozen=True)
class View:
    """The direction that a camera looks from, along the world's axes."""

    toward_camera: tuple[float, float, float]
    """From what is looked at; its length is the distance in a cell of size 1 [m] where the body that is moved is
    looked at, and means nothing where the cell is."""
    above_body: float | None = None
    """So far above the body that is moved, wherever it is, is what is looked at, likewise [m]; None: the cell is."""

    def place(self, cell: Cell, body_position: Array, obstacles: Array = NO_OBSTACLES) -> tuple[Array, Array]:
        """Return where a camera is and what it looks at (3,), both in the world [m].

        Args:
            cell: that is shown.
            body_position: (3,) where the body that is moved is, in the world [m].
            obstacles: (n, 3) points that the task's obstacles lie between, in the world [m].
        """
        if self.above_body is None:
            points = _extent(cell)
            low, high = points.min(axis=0), points.max(axis=0)
            beyond = SURROUNDINGS * (high - low)
            return _whole(
                np.vstack([points, np.clip(obstacles, low - beyond * [1.0, 1.0, 0.0], high + beyond)]),
                np.array(self.toward_camera),
            )
        target = body_position + cell.size * np.array([0.0, 0.0, self.above_body])
        return target + cell.size * np.array(self.toward_camera), target


@dataclass(frozen=True)
class RecordedView:
    """A view as a page finds it that has no cell to ask."""

    position: tuple[float, ...]
    """(3,) of the camera [m]: in the world, or from the body that is moved."""
    target: tuple[float, ...]
    """(3,) of what is looked at, likewise [m]."""
    from_body: bool

    @classmethod
    def of(cls, view: View, cell: Cell, obstacles: Array) -> RecordedView:
        """Return a view of a cell with obstacles (n, 3) [m]."""
        position, target = view.place(cell, np.zeros(3), obstacles)
        return cls(tuple(position.tolist()), tuple(target.tolist()), view.above_body is not None)


VIEWS = {
    "overview": View((1.69, -0.97, 0.63)),
    "front": View((1.9, 0.0, 0.26)),
    "side": View((0.06, -1.95, 0.3)),
    "top": View((0.1, 0.0, 1.8)),
    "close": View((0.68, -0.64, 0.34), above_body=0.06),
}
PERCEIVED_VIEW = View((0.96, -0.66, 0.76), above_body=0.04)
"""From which a perceived scene is seen first."""
DRAFT_VIEW = View((1.25, -0.35, 0.7))
"""From which a draft is seen first: from the front and above, so that the table can be dragged on."""


def _extent(cell: Cell) -> Array:
    """Return points (n, 3) that table, arms at home and what bears them lie between, in the world [m].

    What stands below the table is left out: it would take half of the picture.
    """
    underside = cell.boxes[0].center[2] - 0.5 * cell.boxes[0].size[2]
    frames = {"world": np.eye(4), **arm_frames(cell, cell.home)}
    placed = [placed_body(body, frames[body.frame], None) for body in cell.collision_bodies()]
    points = np.vstack([shape.vertices for body in placed if body.highest[2] > underside for shape in body.shapes])
    points[:, 2] = np.maximum(points[:, 2], underside)
    return points


def _whole(points: Array, toward_camera: Array) -> tuple[Array, Array]:
    """Return the nearest position of a camera that sees all points (n, 3), and what it looks at.

    A point at (r, u) to the right of and above the target, and w beyond it, is in the picture of a camera at distance
    D when |r - right| <= t (D + w), and alike upward, where t is the tangent of half the angle of view. Each point
    asks two lines of `right` and D: the least D is where the farthest two of them cross.
    """
    ahead = -toward_camera / np.linalg.norm(toward_camera)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(right, ahead)])
    tangents = np.tan(0.5 * FIELD_OF_VIEW) / MARGIN * np.array([WIDTH_OVER_HEIGHT, 1.0])
    across, beyond = points @ axes.T, np.outer(points @ ahead, tangents)
    most, least = (across - beyond).max(axis=0), (across + beyond).min(axis=0)
    distance = (0.5 * (most - least) / tangents).max()
    target = 0.5 * (most + least) @ axes
    return target - distance * ahead, target
