"""The regrasp graph of one object as plain data, to be drawn: layers of grasps, and the edges whose motion was tried.

A node is `index of its arm * number of grasps + grasp`, with the arms left, right and the grasps as in `ToolGrasps`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from planners.geometry.pose import Transform


class LayerName(StrEnum):
    """Which layer of Fig. 4, for both rounds at once."""

    INITIAL = "initial"
    """The tool where it rests, or in the hand that holds it."""
    SUCTION = "suction"
    """The tool on the object at its start: the end of the first round."""
    GOAL = "goal"
    """The tool on the object at one of its goals."""


class RegraspEdgeKind(StrEnum):
    """What an edge does."""

    PICK = "pick"
    TRANSFER = "transfer"
    """Within one arm: to the suction pose in the first round, to a goal in the second."""
    HANDOVER = "handover"


class EdgeState(StrEnum):
    """What became of an edge."""

    CHOSEN = "chosen"
    MOVED = "moved"
    """Its motion was found, and that of an edge after it was not."""
    DELETED = "deleted"
    """Its motion was not found."""


@dataclass(frozen=True, eq=False)
class LayerFigures:
    """Grasps of the tool at one pose. A node in neither collection was not asked: no sequence needed it."""

    layer: LayerName
    goal: int | None
    """Number of the goal pose."""
    T_world_tool: Transform
    possible: tuple[int, ...]
    rejected: Mapping[str, tuple[int, ...]]
    """Nodes by why the arm cannot hold the tool so."""


@dataclass(frozen=True)
class EdgeFigures:
    """An edge that was tried."""

    kind: RegraspEdgeKind
    round: int
    """0: the tool alone; 1: with the object."""
    start: int | None
    """The node it leads from; None for a pick."""
    end: int
    """The node it leads to."""
    goal: int | None
    """Which goal pose it leads to, in the second round within an arm."""
    state: EdgeState
    reason: str | None
    """Why it was deleted."""


@dataclass(frozen=True, eq=False)
class RegraspFigures:
    """The regrasp graph of one object with one suction pose: that which was used, or that which was tried most."""

    object: str
    moved: bool
    """Whether a sequence was found."""
    T_object_tool: Transform
    """The suction pose."""
    layers: tuple[LayerFigures, ...]
    """Initial, suction, and the goals to which an edge leads."""
    handover_pairs: tuple[int, int]
    """Pairs of grasps that pass the tool on, alone and with the object; either way counts."""
    edges: tuple[EdgeFigures, ...]
    sequence: tuple[int, ...]
    """Numbers of the chosen edges, in order; none where the object was not moved."""
