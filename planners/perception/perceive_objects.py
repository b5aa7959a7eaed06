"""From a depth view to the table and what stands on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from planners.geometry.convex import ConvexShape
from planners.geometry.pose import Array
from planners.perception.depth_view import DepthView
from planners.perception.object_finder import Findings, find_objects
from planners.perception.perception_settings import PerceptionSettings
from planners.perception.refusal import ScanRefused
from planners.perception.table_plane import TablePlane, find_table
from planners.perception.top_facets import Mask, Relief, pitch_at_table

COARSEST = 0.008
"""With pixels farther apart on the table no edge can be told [m]."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What is known of the place before anybody looks."""

    table_height: float | None = None
    """z of the table's top in the world; None: not known [m]."""
    workspace: Array | None = None
    """(n, 2) convex, counter-clockwise outline, in the world, of where objects may be; None: anywhere [m]."""
    bodies: Sequence[ConvexShape] = ()
    """What is there anyway, in the world: no part of it is an object."""


@dataclass(frozen=True, eq=False)
class SeenTable:
    """A table and what stands on it."""

    plane: TablePlane
    findings: Findings
    view: DepthView
    """As it was looked at."""


def perceive_objects(
    view: DepthView, surroundings: Surroundings, settings: PerceptionSettings, rng: np.random.Generator
) -> SeenTable:
    """Find the table and the objects on it.

    Raises:
        ScanRefused: There is no table to be seen, or its pixels are too far apart.
    """
    points = view.points()
    plane = find_table(points[np.isfinite(view.depth)], view.eye, surroundings.table_height, settings, rng)
    pitch = pitch_at_table(view, plane)
    if pitch > COARSEST:
        detail = f"the image's pixels are {1e3 * pitch:.1f} mm apart on the table, more than {1e3 * COARSEST:g} mm"
        raise ScanRefused("depth", detail)
    view = view.thinned(max(1, round(settings.pitch / pitch)))
    relief = Relief.of(view, plane, _known(view, surroundings.bodies, settings), settings)
    return SeenTable(plane, find_objects(relief, surroundings.workspace, settings), view)


def _known(view: DepthView, bodies: Sequence[ConvexShape], settings: PerceptionSettings) -> Mask:
    """Tell which pixels show bodies that are known."""
    points = view.points()
    known = np.zeros(view.shape, dtype=bool)
    for body in bodies:
        margin = settings.margin_of_known + body.radius
        low, high = body.vertices.min(axis=0) - margin, body.vertices.max(axis=0) + margin
        with np.errstate(invalid="ignore"):
            near = np.argwhere(np.all((points >= low) & (points <= high), axis=2))
        planes = ConvexHull(body.vertices).equations
        seen = points[near[:, 0], near[:, 1]]
        inside = np.all(seen @ planes[:, :3].T + planes[:, 3] <= margin, axis=1)
        known[near[inside, 0], near[inside, 1]] = True
    return known
