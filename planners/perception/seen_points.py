"""What a camera measured, thinned out to be drawn: points in the world, each with the object it speaks for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array
from planners.perception.depth_view import DepthView

NOBODY = -1
"""Owner of a point that speaks for no object: the table's, or what was not recognised."""
MOST_POINTS = 50_000
"""In all [1]: a browser without a graphics card still turns them."""
_RECORD = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("owner", "<i2")])


@dataclass(frozen=True, eq=False)
class SeenPoints:
    """Points and their owners."""

    points: Array
    """(n, 3) in the world [m]."""
    owners: NDArray[np.int16]
    """(n,) index of the object that a point speaks for, else `NOBODY`."""

    @classmethod
    def of(cls, view: DepthView, owners: NDArray[np.int16], most: int = MOST_POINTS) -> Self:
        """Take what was measured in a view; what is too much is thinned out, objects' points less than the others.

        Args:
            view: of a table.
            owners: (h, w) of its pixels.
            most: points that are kept.
        """
        measured = np.isfinite(view.depth)
        points, of_points = view.points()[measured], owners[measured]
        mine, others = np.flatnonzero(of_points != NOBODY), np.flatnonzero(of_points == NOBODY)
        mine = _thinned(mine, max(most // 2, most - len(others)))
        kept = np.concatenate([mine, _thinned(others, most - len(mine))])
        return cls(points[kept], of_points[kept])

    @classmethod
    def from_bytes(cls, content: bytes) -> Self:
        """Read what `to_bytes` wrote."""
        records = np.frombuffer(content, _RECORD)
        return cls(np.column_stack([records[axis].astype(float) for axis in "xyz"]), records["owner"].astype(np.int16))

    def to_bytes(self) -> bytes:
        """Write the points, to a tenth of a micrometre."""
        records = np.empty(len(self.points), _RECORD)
        for axis, values in zip("xyz", self.points.T, strict=True):
            records[axis] = values
        records["owner"] = self.owners
        return records.tobytes()


def _thinned(indices: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    return indices[:: max(1, math.ceil(len(indices) / most))] if most > 0 else indices[:0]
