"""Grasps: how a parallel gripper can take the suction tool (paper A: antipodal grasps, rolled about their axis)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.cell.cell_size import resized
from planners.cell.hand import Gripper
from planners.collision.kernel import CollisionKernel, first_collision, make_scratch, set_frame
from planners.collision.model import CollisionModel, Fixed
from planners.errors import LiftwrightError
from planners.geometry.convex import CollisionBody
from planners.geometry.pose import Array, Transform, frame_from_z, inverse, rotation_z, transform
from planners.graph.rejections import Rejection
from planners.hands.workcell import Clearance
from planners.regrasp.grasps.pad_contacts import PadContacts, PadContactSettings, all_pad_contacts, spread
from planners.regrasp.tool_workcell import TOOL_FRAME
from planners.scene.suction_tool import SuctionTool

_HAND = "hand"
_SPACING_GROWTH = 1.15
_TOUCHING = Rejection("grasp", "the hand would touch the tool while it holds it")
_BLOCKED = Rejection("grasp", "the open hand would touch the tool on its way to it")


@dataclass(frozen=True)
class Fingertips:
    """Grasps with the hand drawn back against its approach: less of the fingers reaches past the tool.

    What lies on the table is gripped with little room under it: pads reach 19 mm past their middle, and a shaft of
    18 mm that lies on a head of 35 mm has its middle 18 to 22 mm above the table.
    """

    least: float = 0.003
    """The hand is drawn back by as much at least [m]; our choice."""
    most: float = 0.009
    """And as far as the pads hold, but by no more than this [m]: half a pad's length; our choice."""
    most_off_centre: float = 0.0075
    """`PadContactSettings.most_off_centre` of such grasps [m]: half of a pad lies on the tool; our choice."""

    def among(self, contacts: PadContactSettings) -> PadContactSettings:
        """Return which pairs of contacts they may have."""
        return replace(contacts, most_off_centre=self.most_off_centre)


@dataclass(frozen=True)
class ToolGraspSettings:
    """Which grasps are generated, and how far the hand keeps off the tool."""

    contacts: PadContactSettings = field(default_factory=PadContactSettings)
    rolls: int = 16
    """Directions to approach from in a full turn about the closing axis: 22.5 degrees apart (the authors')."""
    most: int = 480
    """Grasps that are kept; where there are more their contacts move apart, and where that is not enough the last ones
    are left out. Our choice: the handover database grows with the square of it."""
    lip_clearance: float = 0.04
    """Least height of both contacts over the plane of the cup's lip [m]: nothing soft is gripped, and a hand that comes
    along an object's face, half as thick as its force sensor, keeps off it; our choice."""
    finger_gap: float = 0.008
    """Between each pad and the tool while the fingers are open around it [m]; our choice."""
    least_gap: float = 0.004
    """The same where the gripper opens no farther [m]; our choice."""
    approach: float = 0.070
    """Length of the straight way to the tool and away from it, along the hand's z (the authors') [m]."""
    step: float = 0.005
    """Between checked places of that way [m]; at 10 mm plans were seen to touch."""
    margin: float = 0.003
    """Between tool and hand but the fingers that hold it [m]."""
    finger_margin: float = 0.0
    """Between the tool and the parts of the fingers next to the pads [m]."""
    pad_depth: float = 0.0005
    """How deep a pad may be pressed in while it holds [m]: it is rubber."""
    fingertips: Fingertips | None = None
    """How the tool is held by the fingertips too; None: not at all."""

    def __post_init__(self) -> None:
        if (
            min(self.rolls, self.most) < 1
            or self.step <= 0.0
            or min(self.approach, self.least_gap, self.lip_clearance) < 0.0
        ):
            raise LiftwrightError("grasps have positive counts, a positive step and no negative length")

    def in_cell(self, size: float, clearance: Clearance) -> ToolGraspSettings:
        """Return those of a cell of another size than 1, with what bodies keep apart there."""
        contacts = resized(
            self.contacts, size, "grid", "spacing", "patch_radius", "compliance", "pad_radius", "most_off_centre"
        )
        lengths = resized(self, size, "lip_clearance", "finger_gap", "least_gap", "approach", "pad_depth")
        steps = resized(lengths, clearance.steps, "step")
        return replace(steps, contacts=contacts, margin=clearance.near)

    def way(self) -> Array:
        """Return the checked distances (k,) from the grasp along the approach, 0 first [m]."""
        return np.linspace(0.0, self.approach, 1 + math.ceil(self.approach / self.step))


@dataclass(frozen=True, eq=False)
class FallenGrasp:
    """A grasp that was considered, and why it is none."""

    T_tool_tcp: Transform
    width: float
    """[m]"""
    rejection: Rejection


@dataclass(frozen=True, eq=False)
class ToolGrasps:
    """Grasps of a tool by number: two contacts, a flip of the hand and a roll each.

    A hand turned by half a turn about its approach direction swaps its fingers; that is another grasp, since it
    takes another posture of the wrist.
    """

    T_tool_tcp: Array
    """(n, 4, 4): origin midway between the pads, z along the approach, y along the opening."""
    widths: Array
    """(n,) inner distance of the pads while they hold [m]."""
    open_widths: Array
    """(n,) the same on the way to the tool and away from it [m]."""
    fallen: tuple[FallenGrasp, ...]
    """Considered and dropped."""

    @staticmethod
    def none() -> ToolGrasps:
        """Return no grasps."""
        return ToolGrasps(np.empty((0, 4, 4)), np.empty(0), np.empty(0), ())

    def __len__(self) -> int:
        return len(self.widths)

    def T_tool_flange(self, gripper: Gripper) -> Array:
        """Return the flange poses (n, 4, 4) of all grasps."""
        heights = {width: inverse(gripper.T_flange_tcp(float(width))) for width in set(self.widths.tolist())}
        return self.T_tool_tcp @ np.array([heights[width] for width in self.widths.tolist()]).reshape(-1, 4, 4)


def tool_grasps(tool: SuctionTool, gripper: Gripper, settings: ToolGraspSettings) -> ToolGrasps:
    """Find how a gripper can take a tool, and can come to it and leave it on a straight way.

    Args:
        tool: of any shape.
        gripper: with the tool's frame as the only other thing in the world.
        settings: which grasps.

    Returns:
        The grasps, those on the same contacts next to one another; none where the tool is too thick all over.
    """
    vertices, faces = tool.body.solid.surface()
    width_max = gripper.width_max - 2.0 * settings.least_gap
    contacts = all_pad_contacts(vertices, faces, width_max, settings.contacts)
    ends = None
    if settings.fingertips is not None:
        ends = all_pad_contacts(vertices, faces, width_max, settings.fingertips.among(settings.contacts))
        ends = _off_the_lip(ends, settings.lip_clearance)
    spacing, farthest = settings.contacts.spacing, float(np.linalg.norm(np.ptp(vertices, axis=0)))
    while True:
        chosen = _off_the_lip(spread(contacts, replace(settings.contacts, spacing=spacing)), settings.lip_clearance)
        grasps = _grasps_on(tool, gripper, settings, chosen, ends)
        if len(grasps) <= settings.most or spacing > farthest:
            break
        spacing *= _SPACING_GROWTH
    while len(grasps) > settings.most:
        # What closes along other axes stays, however far apart contacts have to be: the last of them are left out.
        chosen = chosen.only(np.arange(len(chosen) - 1))
        grasps = _grasps_on(tool, gripper, settings, chosen, ends)
    return grasps


def _grasps_on(
    tool: SuctionTool, gripper: Gripper, settings: ToolGraspSettings, contacts: PadContacts, ends: PadContacts | None
) -> ToolGrasps:
    T_tool_tcp, widths = _hand_poses(contacts, settings.rolls)
    if settings.fingertips is not None and ends is not None:
        T_drawn_back, at_ends = _drawn_back(T_tool_tcp, ends, settings.fingertips, settings.contacts.grid)
        T_tool_tcp, widths = np.concatenate([T_tool_tcp, T_drawn_back]), np.concatenate([widths, at_ends])
    open_widths = np.minimum(widths + 2.0 * settings.finger_gap, gripper.width_max)
    candidates = ToolGrasps(T_tool_tcp, widths, open_widths, ())
    touching, blocked = _meetings(candidates, tool, gripper, settings)
    fallen = [
        FallenGrasp(T_tool_tcp[k], float(widths[k]), _TOUCHING if touching[k] else _BLOCKED)
        for k in np.flatnonzero(touching | blocked)
    ]
    free = ~(touching | blocked)
    return ToolGrasps(T_tool_tcp[free], widths[free], open_widths[free], tuple(fallen))


def _off_the_lip(contacts: PadContacts, clearance: float) -> PadContacts:
    lowest = contacts.midpoints[:, 2] - 0.5 * np.abs(contacts.axes[:, 2]) * contacts.widths
    good = lowest >= clearance
    return contacts.only(good)


def _drawn_back(T_tool_tcp: Array, contacts: PadContacts, tips: Fingertips, grid: float) -> tuple[Array, Array]:
    """Return the poses (m, 4, 4) of hands that are drawn back as far as there are contacts, and the widths (m,)."""
    found = [(T, contacts.behind(T, tips.least, tips.most, 0.75 * grid)) for T in T_tool_tcp]
    kept = [(T, number) for T, number in found if number is not None]
    poses = [transform(T[:3, :3], contacts.midpoints[number]) for T, number in kept]
    return np.array(poses).reshape(-1, 4, 4), contacts.widths[[number for _, number in kept]]


def _hand_poses(contacts: PadContacts, rolls: int) -> tuple[Array, Array]:
    """Return `T_tool_tcp` (n, 4, 4) and widths (n,) of both flips and all rolls of each pair of contacts."""
    poses: list[Transform] = []
    for midpoint, axis in zip(contacts.midpoints, contacts.axes, strict=True):
        hint = np.array([1.0, 0.0, 0.0]) if abs(axis[2]) > 0.9 else np.array([0.0, 0.0, 1.0])
        R = frame_from_z(axis, hint)
        for y_sign in (1.0, -1.0):
            for k in range(rolls):
                across = R @ rotation_z(2.0 * math.pi * k / rolls)
                # The hand's z, then its x.
                poses.append(transform(frame_from_z(-across[:, 0], y_sign * across[:, 1]), midpoint))
    return np.array(poses).reshape(-1, 4, 4), np.repeat(contacts.widths, 2 * rolls)


def _meetings(
    grasps: ToolGrasps, tool: SuctionTool, gripper: Gripper, settings: ToolGraspSettings
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Say of each grasp whether the hand meets the tool while it holds it (n,), and on its open way to it (n,)."""
    T_tool_flange = grasps.T_tool_flange(gripper)
    touching, blocked = np.zeros(len(grasps), bool), np.zeros(len(grasps), bool)
    pairs = np.column_stack([grasps.widths, grasps.open_widths])
    for held, opened in np.unique(pairs, axis=0):
        these = np.flatnonzero((pairs == (held, opened)).all(axis=1))
        touching[these] = _touches(tool, gripper, float(held), settings, T_tool_flange[these], np.zeros(1))
        free = these[~touching[these]]
        blocked[free] = _touches(tool, gripper, float(opened), settings, T_tool_flange[free], settings.way())
    return touching, blocked


def _touches(
    tool: SuctionTool, gripper: Gripper, width: float, settings: ToolGraspSettings, T_tool_flanges: Array, way: Array
) -> NDArray[np.bool_]:
    """Say whether a hand of an opening meets the tool anywhere on its way; with a way of one place it holds it."""
    hand = gripper.bodies(_HAND, width)
    body = CollisionBody(TOOL_FRAME, TOOL_FRAME, "world", tool.body.solid.convex_parts)
    model = CollisionModel.build({}, [*hand, body])
    frame = hand[0].frame
    holding = len(way) == 1
    # The tool is drawn larger than it is by its excess at most: a pad lies on the tool itself.
    depth = settings.pad_depth + tool.body.solid.excess
    margins = {
        (each.name, TOOL_FRAME): -depth if "_pad_" in each.name else settings.finger_margin
        for each in hand
        if "_finger_" in each.name or (holding and "_pad_" in each.name)
    }
    query = model.scene({frame: Fixed(np.eye(4))}, margin=settings.margin, margins=margins)
    return _meets_on_way(query.kernel_copy(), query.frame_index(frame), np.ascontiguousarray(T_tool_flanges), way)


@njit(cache=True, nogil=True)
def _meets_on_way(kernel: CollisionKernel, frame: int, T_tool_flanges: Array, way: Array) -> NDArray[np.bool_]:
    scratch = make_scratch(kernel)
    q, T = np.empty(0), np.eye(4)
    result = np.zeros(T_tool_flanges.shape[0], np.bool_)
    for k in range(T_tool_flanges.shape[0]):
        T[:, :] = T_tool_flanges[k]
        for back in way:
            for i in range(3):
                T[i, 3] = T_tool_flanges[k, i, 3] - back * T_tool_flanges[k, i, 2]
            set_frame(kernel, frame, T)
            if first_collision(kernel, q, scratch) >= 0:
                result[k] = True
                break
    return result
