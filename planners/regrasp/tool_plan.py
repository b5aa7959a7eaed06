"""What comes out of planning a suction-tool task."""

from __future__ import annotations

from dataclasses import dataclass, field

from planners.geometry.pose import Transform
from planners.graph.rejections import Rejection, Rejections
from planners.plan.verdicts import PlanningOutcome
from planners.regrasp.graph.regrasp_figures import RegraspFigures
from planners.regrasp.grasps.tool_grasps import ToolGrasps
from planners.regrasp.suction.suction_poses import SuctionCandidate
from planners.regrasp.tool_segment import ToolSegment


@dataclass(frozen=True, eq=False)
class ConsideredSuction:
    """A suction pose that was tried for an object."""

    object: str
    T_object_tool: Transform
    rejection: Rejection | None
    """Why it was given up; None for the one that is used."""


@dataclass(frozen=True, eq=False)
class ConsideredPlaces:
    """Where the cup was looked at, for drawing. Which grasps were, is in `ToolPlan.regrasp`."""

    places: dict[str, tuple[SuctionCandidate, ...]] = field(default_factory=dict)
    """By object, an even choice of the sampled places of the cup."""
    suctions: tuple[ConsideredSuction, ...] = ()


@dataclass(frozen=True)
class GraspStep:
    """One grasp of the sequence that was found, for reports."""

    object: str
    round: int
    """0: the tool alone, 1: with the object."""
    arm: str
    grasp: int
    by: str
    """How the grasp came about: "held", "picked up" or "handover"."""


@dataclass(frozen=True, eq=False)
class ToolPlan:
    """What came out of planning a suction-tool task, and what it cost."""

    outcome: PlanningOutcome
    summary: str
    causes: tuple[Rejection, ...]
    rejections: Rejections
    segments: tuple[ToolSegment, ...] = ()
    graph: dict[str, int] = field(default_factory=dict)
    search: dict[str, int | float | str | None] = field(default_factory=dict)
    order: tuple[str, ...] = ()
    """Objects as they are moved; one that makes a stopover comes twice."""
    steps: tuple[GraspStep, ...] = ()
    """The grasps of the tool, one after the other."""
    considered: ConsideredPlaces = field(default_factory=ConsideredPlaces)
    grasps: ToolGrasps = field(default_factory=ToolGrasps.none)
    """All grasps of the tool that are free of collision."""
    regrasp: tuple[RegraspFigures, ...] = ()
    """The regrasp graph of every move that was planned, those first that were not found."""
    hose_turns: float = 0.0
    """Turns of the tool about its own axis from start to end, signed [1]: so often its vacuum hose winds about it."""
    most_hose_turns: float = 0.0
    """The most of it at any time, unsigned [1]."""
