"""What has happened so far in a suction-tool plan: where everything is, who holds what, and the segments up to here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from planners.geometry.pose import Array, Transform
from planners.regrasp.tool_segment import SuckedObject, ToolSegment


@dataclass(frozen=True)
class HeldGrasp:
    """One of the tool's grasps, by one arm: a node of the regrasp graph."""

    arm: str
    grasp: int
    """Index in `ToolGrasps`."""


@dataclass(frozen=True, eq=False)
class ToolStage:
    """A moment at which everything is at rest. Stages are never changed: trying a way leaves where it began alone."""

    q: Array
    """(12,) [rad]"""
    widths: Mapping[str, float]
    """Opening of each gripper [m]."""
    holder: HeldGrasp | None
    T_world_tool: Transform
    T_world_objects: Mapping[str, Transform]
    sucked: SuckedObject | None
    segments: tuple[ToolSegment, ...]

    @property
    def duration(self) -> float:
        """Of all segments up to here [s]."""
        return sum(segment.trajectory.duration for segment in self.segments)

    @property
    def held(self) -> HeldGrasp:
        """The grasp of the hand that holds the tool, in steps in which one does."""
        assert self.holder is not None, "the tool is held in this step"
        return self.holder

    @property
    def carried(self) -> frozenset[str]:
        """Frames of the tool and of what hangs on it."""
        return frozenset({"tool"} if self.sucked is None else {"tool", self.sucked.name})

    @property
    def places(self) -> dict[str, Transform]:
        """Where the tool and all objects are, by name."""
        return {"tool": self.T_world_tool, **self.T_world_objects}
