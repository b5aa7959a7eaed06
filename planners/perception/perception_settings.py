"""Settings of the perception of objects on a table."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class PerceptionSettings:
    """What counts as table, top, edge and object. Engineering choices for cameras about a metre above the table."""

    table_band: float = 0.1
    """How far the table may be seen above or below where the cell has it [m]."""
    table_tilt: float = math.radians(5.0)
    """How far the table may be seen tilted [rad]: more is a wrong pose of the camera."""
    table_inlier: float = 0.006
    """Points so near a plane speak for it [m]: four times the noise of a depth camera."""
    table_trials: int = 200
    """Planes through three points that are tried [1]."""
    fewest_table_points: int = 500
    """Of a table that is seen [1]."""
    pitch: float = 2.0e-3
    """An image with pixels closer together on the table is thinned [m]: its noise has a longer reach than they."""
    lowest_top: float = 0.010
    """A top that is lower is table [m]: six times the noise."""
    highest_top: float = 0.60
    """A top that is higher is no object's [m]: arms and cameras."""
    level_slope: float = math.tan(math.radians(35.0))
    """Places that are steeper belong to no top [1]."""
    depth_noise: float = 0.0015
    """Standard deviation of a depth if the table's own points do not tell a larger one [m]."""
    height_floor: float = 0.0007
    """Uncertainty of a height that more pixels do not improve [m]: the sensor's own error."""
    edge_floor: float = 0.00076
    """Uncertainty of an edge that more pixels do not improve [m]: pixels that mix both sides of an edge."""
    edge_shared: float = 0.25
    """... of opposite edges together, both in or both out, which moves no centre and spoils a size [px]."""
    yaw_floor: float = math.radians(0.17)
    """Uncertainty of a yaw that more pixels do not improve [rad]."""
    edge_inset: float = 0.15
    """Edges seem so many pixels further in: pixels that mix both sides belong to neither [1]."""
    least_side: float = 0.015
    """Of a top [m]."""
    fewest_pixels: int = 20
    """Of a top [1]."""
    most_tops: int = 200
    """More are clutter; the largest are looked at [1]."""
    coverage: float = 0.90
    """Share of a model's outline that its top fills, or something that hides it [1]."""
    fitting_edge: float = 0.75
    """Share of a top's edge that lies on the model's [1]."""
    edge_tolerance: float = 1.1
    """... within so many pixels [1]."""
    seen_side: float = 0.35
    """Share of every side that is seen [1]."""
    margin_of_known: float = 0.010
    """Points so near a body that is known are taken for its own [m]."""
    skirt: float = 0.015
    """Reach round a model in which its own sides must not be seen: they would not be upright [m]."""
    skirt_share: float = 0.25
    """... in more pixels than this share of its edge [1]."""
    support_points: int = 64
    """At most so many points are told for each object [1]."""
