"""What has happened so far in a suction-tool plan: where everything is, who holds what, and the segments up to here."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from planners.geometry.pose import Array, Transform, inverse
from planners.hands.arm_motion import openings
from planners.kinematics.forward import flange_poses
from planners.motion.trajectory import Trajectory, hold_still
from planners.plan.segment import SegmentKind
from planners.regrasp.grasps.tool_grasps import ToolGrasps
from planners.regrasp.tool_segment import SuckedObject, ToolHold, ToolSegment
from planners.regrasp.tool_workcell import TOOL_FRAME, ToolWorkcell


@dataclass(frozen=True)
class HeldGrasp:
    """One of the tool's grasps, by one arm: a node of the regrasp graph."""

    arm: str
    grasp: int
    """Index in `ToolGrasps`."""


@dataclass(frozen=True, eq=False)
class SceneState:
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


@dataclass(frozen=True, eq=False)
class SegmentWriter:
    """Writes the segments of one scene. A state is never changed: writing returns the next one."""

    workcell: ToolWorkcell
    grasps: ToolGrasps
    T_tool_flanges: Mapping[str, Array]
    """(n, 4, 4) of each arm: where its flange is on the tool in each grasp."""
    sample_step: float
    """Between samples where nothing moves [s]."""

    def appended(
        self,
        state: SceneState,
        kind: SegmentKind,
        movers: tuple[str, ...],
        trajectory: Trajectory,
        widths: Mapping[str, float] | None = None,
        holds: Iterable[HeldGrasp] | None = None,
    ) -> SceneState:
        """Append a segment; `widths` are openings at its end [m], `holds` the hands on the tool, if not the holder."""
        after = {**state.widths, **(widths or {})}
        if holds is None:
            holds = [] if state.holder is None else [state.holder]
        body_poses = self._body_poses(state, trajectory) if kind is SegmentKind.TRANSFER else {}
        segment = ToolSegment(
            kind=kind,
            movers=movers,
            trajectory=trajectory,
            widths={arm: openings(trajectory.time, state.widths[arm], after[arm]) for arm in after},
            holds=tuple(self.hold(held) for held in holds),
            sucked=state.sucked,
            body_poses=body_poses,
        )
        ends = {name: poses[-1] for name, poses in body_poses.items()}
        return replace(
            state,
            q=trajectory.positions[-1].copy(),
            widths=after,
            T_world_tool=ends.pop(TOOL_FRAME, state.T_world_tool),
            T_world_objects={**state.T_world_objects, **ends},
            segments=(*state.segments, segment),
        )

    def _body_poses(self, state: SceneState, trajectory: Trajectory) -> dict[str, Array]:
        held = state.held
        arm = self.workcell.arm(held.arm)
        Q = np.ascontiguousarray(trajectory.positions[:, self.workcell.joints(held.arm)])
        tool = flange_poses(arm.dh, arm.T_world_base, Q) @ inverse(self.T_tool_flanges[held.arm][held.grasp])
        poses = {TOOL_FRAME: tool}
        if state.sucked is not None:
            poses[state.sucked.name] = tool @ state.sucked.T_tool_object
        return poses

    def hold(self, held: HeldGrasp) -> ToolHold:
        """Return a grasp as segments name it."""
        return ToolHold(
            arm=held.arm,
            T_tool_tcp=self.grasps.T_tool_tcp[held.grasp],
            width=float(self.grasps.widths[held.grasp]),
            T_flange_tool=inverse(self.T_tool_flanges[held.arm][held.grasp]),
        )

    def still(
        self,
        state: SceneState,
        kind: SegmentKind,
        duration: float,
        widths: Mapping[str, float],
        holds: Iterable[HeldGrasp] | None = None,
    ) -> SceneState:
        """Append a segment in which no joint moves; see `appended`."""
        trajectory = hold_still(state.q, duration, self.sample_step)
        return self.appended(state, kind, (), trajectory, widths, holds)
