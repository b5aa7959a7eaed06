"""Members of a plan document that both kinds of plans write alike."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum
from typing import Any, Protocol

import numpy as np

from planners.contract.document_bodies import document_bodies
from planners.contract.plan_document import JOINT_NAMES, SCHEMA_VERSION
from planners.contract.task_spec import PlateLiftTask, SuctionToolTask, write_task
from planners.geometry.pose import Array, Transform, to_pose7s
from planners.graph.rejections import Rejection, Rejections
from planners.motion.trajectory import Trajectory
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.scene import with_centres
from planners.scene.tool_scene import SuctionToolScene
from planners.segment import SegmentKind

_DIGITS = 12
"""Decimals of everything sampled: 1e-12 rad, m or N."""
_VELOCITY_DIGITS, _ACCELERATION_DIGITS = 10, 9
"""Decimals of what readers compare with differences of positions only."""
_SIGNIFICANT = 9
"""Digits of what contacts state: as many as the contract asks for."""


class PlanOutcome(Protocol):
    """What a planner of either kind says of a whole plan."""

    @property
    def outcome(self) -> Enum:
        """How planning ended; the value is its name in the document."""
        ...

    @property
    def summary(self) -> str:
        """What came out, in a sentence."""
        ...

    @property
    def causes(self) -> tuple[Rejection, ...]:
        """Why there is no plan."""
        ...

    @property
    def rejections(self) -> Rejections:
        """What fell, counted."""
        ...

    @property
    def graph(self) -> Mapping[str, Any]:
        """Sizes of what was searched."""
        ...

    @property
    def search(self) -> Mapping[str, Any]:
        """What the search cost."""
        ...


class TimedSegment(Protocol):
    """What segments of either kind say of the robot's motion."""

    @property
    def kind(self) -> SegmentKind:
        """What happens in it."""
        ...

    @property
    def movers(self) -> tuple[str, ...]:
        """Arms whose joints change."""
        ...

    @property
    def trajectory(self) -> Trajectory:
        """Of all twelve joints."""
        ...

    @property
    def widths(self) -> Mapping[str, Array]:
        """(n,) inner distance of each gripper's pads [m]."""
        ...


def document_of(
    task: PlateLiftTask | SuctionToolTask,
    scene: PlateLiftScene | SuctionToolScene,
    plan: PlanOutcome,
    segments: Iterable[dict[str, Any]],
    stages: Mapping[str, float],
) -> dict[str, Any]:
    """Return a plan document, complete but for what only the caller knows: id, software, certificate.

    Args:
        task: as accepted.
        scene: what was planned in.
        plan: what came out.
        segments: of the document, in order.
        stages: seconds by stage, in order.
    """
    return {
        "schema_version": SCHEMA_VERSION,
        "id": "",
        "task": write_task(with_centres(task, scene)),
        "seed": task.seed,
        "software": {"name": "liftwright", "version": "", "commit": None},
        "outcome": plan.outcome.value,
        "explanation": {"summary": plan.summary, "causes": [_cause(cause) for cause in plan.causes]},
        "cell": scene.cell.document(),
        "joint_names": list(JOINT_NAMES),
        "bodies": document_bodies(scene),
        "segments": list(segments),
        "certificate": None,
        "simulation": None,
        "statistics": {
            "total_seconds": sum(stages.values()),
            "stages": [{"name": name, "seconds": seconds} for name, seconds in stages.items()],
            "graph": dict(plan.graph),
            "search": dict(plan.search),
            "rejections": plan.rejections.counts(),
        },
    }


def _cause(cause: Rejection) -> dict[str, Any]:
    return {
        "reason": cause.reason,
        "needed": cause.needed,
        "available": cause.available,
        "unit": cause.unit,
        "where": cause.where or cause.stage,
    }


def motion_members(segment: TimedSegment, begun: float) -> dict[str, Any]:
    """Return kind, movers and samples of a segment that begins at a time [s]."""
    trajectory = segment.trajectory
    return {
        "kind": segment.kind.value,
        "movers": list(segment.movers),
        "time": rounded(trajectory.time + begun),
        "positions": rounded(trajectory.positions),
        "velocities": rounded(trajectory.velocities, _VELOCITY_DIGITS),
        "accelerations": rounded(trajectory.accelerations, _ACCELERATION_DIGITS),
        "gripper_width": {arm: rounded(width) for arm, width in segment.widths.items()},
    }


def pose_row(T: Transform) -> list[float]:
    """Return a sampled pose as `[x, y, z, w, x, y, z]`."""
    return pose_rows(T[None])[0]


def pose_rows(transforms: Array) -> list[list[float]]:
    """Return sampled poses (n, 4, 4), each as `pose_row` does."""
    return rounded(to_pose7s(transforms))


def rounded(values: Array, digits: int = _DIGITS) -> list[Any]:
    """Return sampled numbers as JSON data, without digits that mean nothing."""
    # Adding zero turns -0.0 into 0.0.
    return (np.round(values, digits) + 0.0).tolist()


def significant(values: Array) -> list[Any]:
    """Return numbers as JSON data with nine significant digits, and no more decimals than samples have."""
    exponents = np.floor(np.log10(np.maximum(np.abs(values), 10.0**-_DIGITS)))
    scales = 10.0 ** np.minimum(_SIGNIFICANT - 1 - exponents, _DIGITS)
    return (np.round(values * scales) / scales + 0.0).tolist()
