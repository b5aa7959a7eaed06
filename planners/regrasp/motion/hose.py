"""How far the tool's vacuum hose is wound up: the turns of the tool about its own axis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planners.geometry.pose import Array
from planners.regrasp.tool_segment import ToolSegment
from planners.regrasp.tool_workcell import TOOL_FRAME


@dataclass(frozen=True)
class HoseTurns:
    """Signed turns of the tool about its own z axis [1]."""

    end: float
    """From start to end of the plan."""
    most: float
    """The largest number of turns, either way, at any time."""


def hose_turns(segments: Sequence[ToolSegment]) -> HoseTurns:
    """Add up the tool's turning about its own axis over a plan.

    Turning is what is left when the tilt of the axis is taken out the shortest way (parallel transport), summed from
    sample to sample.
    """
    turns = [np.zeros(1)]
    for segment in segments:
        poses = segment.body_poses.get(TOOL_FRAME)
        if poses is not None:
            turns.append(turns[-1][-1] + np.cumsum(twists(poses)))
    angles = np.concatenate(turns) / (2.0 * math.pi)
    return HoseTurns(float(angles[-1]), float(np.abs(angles).max()))


def twists(poses: Array) -> Array:
    """Return the turns about the poses' own z axis (n - 1,) between neighbours of (n, 4, 4) [rad].

    Of the rotation from one to the next, in the frame of the one, the twist about z is `2 atan2(q_z, q_w)`.
    """
    relative = np.einsum("nji,njk->nik", poses[:-1, :3, :3], poses[1:, :3, :3])
    trace = np.einsum("nii->n", relative)
    # q_z / q_w = (R10 - R01) / (1 + trace): no sample turns by half a turn.
    return 2.0 * np.arctan2(relative[:, 1, 0] - relative[:, 0, 1], 1.0 + trace)
