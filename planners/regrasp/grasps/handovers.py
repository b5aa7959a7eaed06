"""Handovers: which pairs of grasps can pass the tool from hand to hand, at the handover place (paper A's database).

Computed once for a cell and a tool, without objects. The giver holds the tool; the receiver comes straight along its
hand's z with open fingers and closes them; the giver opens and leaves straight. Either arm may be either: the way back
is the way to it, so a pair serves both directions.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.cell.cell import Cell
from planners.cell.hand import Gripper
from planners.collision.kernel import CollisionKernel, first_collision, make_scratch, set_frame
from planners.collision.model import CollisionModel, CollisionQuery, Fixed
from planners.errors import LiftwrightError
from planners.geometry.convex import CollisionBody
from planners.geometry.pose import Array, inverse
from planners.graph.rejections import Rejection
from planners.progress import Progress, Report, silent
from planners.regrasp.grasps.arm_sweeps import ArmSweep, first_branches, sweep_arm
from planners.regrasp.grasps.grasp_reach import Branches, GraspReach, GraspSurroundings
from planners.regrasp.grasps.handover_place import HandoverPlaceSettings, handover_place, tool_poses_at
from planners.regrasp.grasps.tool_grasps import FallenGrasp, ToolGrasps, ToolGraspSettings, tool_grasps
from planners.regrasp.tool_workcell import TOOL_FRAME, ToolClearance, ToolWorkcell
from planners.scene.suction_tool import SuctionTool

REVISION = 2
"""Of what is computed and stored; goes up whenever either changes."""


_DIGEST = hashlib.sha256().digest_size


class HandoverDataError(LiftwrightError):
    """Stored handovers are damaged, or belong to another cell, tool or version."""


@dataclass(frozen=True)
class HandoverSettings:
    """What a handover database is computed with."""

    grasps: ToolGraspSettings = field(default_factory=ToolGraspSettings)
    place: HandoverPlaceSettings = field(default_factory=HandoverPlaceSettings)
    clearance: ToolClearance = field(default_factory=ToolClearance)
    axis_rolls: int = 4
    """Turns of the tool about each of six directions of its axis: 24 orientations. With fewer, pairs of grasps that
    could pass the tool on are not found; our choice."""


@dataclass(frozen=True, eq=False)
class HandoverDatabase:
    """Pairs of grasps that pass the tool on, by number of the tool's orientation at the handover place."""

    key: str
    """Hash of the cell, the tool and the settings it was computed from."""
    grasps: ToolGrasps
    place: Array
    """(3,) of the middle of the grasps [m, world]."""
    T_world_tool: Array
    """(o, 4, 4)"""
    left: Branches
    """(o, n) branches on which the left arm comes to each grasp alone in the cell."""
    right: Branches
    """(o, n) the same of the right arm."""
    codes: NDArray[np.uint8]
    """(o, n, n) by left and right grasp: 0 where the pair passes nothing on, else 1 + 8 left branch + right branch of
    the first branches with which it does."""

    @cached_property
    def compatible(self) -> NDArray[np.bool_]:
        """(o, n, n) whether the left and the right grasp pass the tool on in an orientation."""
        return self.codes != 0

    @cached_property
    def partners(self) -> NDArray[np.bool_]:
        """(n, n) the same in any orientation."""
        return np.any(self.compatible, axis=0)

    def reached(self, arm: str) -> Branches:
        """Return `left` or `right`."""
        return self.left if arm == "left" else self.right

    def pairs_of(self, giver: str, grasp: int) -> NDArray[np.int64]:
        """Return the other arm's grasps that can take the tool from an arm's grasp, in any orientation."""
        return np.flatnonzero(self.partners[grasp] if giver == "left" else self.partners[:, grasp])

    def orientations(self, giver: str, giver_grasp: int, receiver: str, receiver_grasp: int) -> NDArray[np.int64]:
        """Return the numbers of the orientations in which a pair passes the tool on; none within one arm."""
        if giver == receiver:
            return np.empty(0, np.int64)
        left, right = (giver_grasp, receiver_grasp) if giver == "left" else (receiver_grasp, giver_grasp)
        return np.flatnonzero(self.compatible[:, left, right])

    def to_bytes(self) -> bytes:
        """Write the database; the same database gives the same bytes."""
        grasps = self.grasps
        fallen_reasons = list({fallen.rejection.reason: None for fallen in grasps.fallen})
        reason_numbers = [fallen_reasons.index(fallen.rejection.reason) for fallen in grasps.fallen]
        stored = _Stored(
            key=np.frombuffer(self.key.encode(), np.uint8),
            T_tool_tcp=grasps.T_tool_tcp,
            widths=grasps.widths,
            open_widths=grasps.open_widths,
            fallen_T_tool_tcp=np.array([fallen.T_tool_tcp for fallen in grasps.fallen]).reshape(-1, 4, 4),
            fallen_widths=np.array([fallen.width for fallen in grasps.fallen], dtype=float),
            fallen_reason=np.array(reason_numbers, dtype=np.uint8),
            fallen_reasons=np.frombuffer("\n".join(fallen_reasons).encode(), np.uint8),
            place=self.place,
            T_world_tool=self.T_world_tool,
            left=self.left,
            right=self.right,
            codes=self.codes,
        )
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **stored._asdict())
        content = buffer.getvalue()
        return hashlib.sha256(content).digest() + content

    @staticmethod
    def from_bytes(data: bytes, key: str) -> HandoverDatabase:
        """Read what `to_bytes` wrote.

        Args:
            data: of which nothing is trusted.
            key: that the database must have.

        Raises:
            HandoverDataError: the bytes are damaged, or are those of another database.
        """
        digest, content = data[:_DIGEST], data[_DIGEST:]
        if hashlib.sha256(content).digest() != digest:
            raise HandoverDataError("the handovers are damaged")
        try:
            with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
                stored = _Stored(**{name: arrays[name] for name in arrays.files})
            return stored.database(key)
        except (ValueError, TypeError, IndexError, EOFError, zipfile.BadZipFile) as error:
            raise HandoverDataError(f"these are no handovers: {error}") from error

    def branches(self, orientation: int, left_grasp: int, right_grasp: int) -> tuple[int, int]:
        """Return a left and a right branch with which a pair passes the tool on in one of its orientations."""
        return divmod(int(self.codes[orientation, left_grasp, right_grasp]) - 1, 8)


class _Stored(NamedTuple):
    """The arrays of a file."""

    key: NDArray[np.uint8]
    T_tool_tcp: Array
    widths: Array
    open_widths: Array
    fallen_T_tool_tcp: Array  # noqa: N815 - so it is called in files
    fallen_widths: Array
    fallen_reason: NDArray[np.uint8]
    """Which of the reasons."""
    fallen_reasons: NDArray[np.uint8]
    """A line of text each."""
    place: Array
    T_world_tool: Array
    left: Branches
    right: Branches
    codes: NDArray[np.uint8]

    def database(self, key: str) -> HandoverDatabase:
        """Return what was stored.

        Raises:
            HandoverDataError: it has another key.
        """
        if self.key.tobytes() != key.encode():
            raise HandoverDataError("these are the handovers of another cell, tool or setting")
        reasons = self.fallen_reasons.tobytes().decode().split("\n")
        fallen = tuple(
            FallenGrasp(T, float(width), Rejection("grasp", reasons[int(reason)]))
            for T, width, reason in zip(self.fallen_T_tool_tcp, self.fallen_widths, self.fallen_reason, strict=True)
        )
        grasps = ToolGrasps(self.T_tool_tcp, self.widths, self.open_widths, fallen)
        return HandoverDatabase(key, grasps, self.place, self.T_world_tool, self.left, self.right, self.codes)


def handover_key(cell: Cell, tool: SuctionTool, settings: HandoverSettings) -> str:
    """Return the hash of everything a database depends on: the same key means the same database."""
    digest = hashlib.sha256(f"{REVISION} {cell.hash} {settings!r}".encode())
    vertices, faces = tool.body.solid.surface()
    parts = tool.body.solid.convex_parts
    radii = np.array([part.radius for part in parts], dtype=float)
    for array in (vertices, faces, radii, *(part.vertices for part in parts)):
        digest.update(f" {array.dtype} {array.shape} ".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def find_handovers(
    cell: Cell, tool: SuctionTool, settings: HandoverSettings, progress: Progress = silent
) -> HandoverDatabase:
    """Find the grasps of a tool and everything that `build_handovers` finds for them.

    Raises:
        LiftwrightError: the hands are not two equal grippers.
    """
    gripper = next(iter(cell.arms.values())).hand
    if not isinstance(gripper, Gripper):
        raise LiftwrightError("a handover takes two arms with equal grippers")
    return build_handovers(cell, tool, tool_grasps(tool, gripper, settings.grasps), settings, progress)


def build_handovers(
    cell: Cell, tool: SuctionTool, grasps: ToolGrasps, settings: HandoverSettings, progress: Progress = silent
) -> HandoverDatabase:
    """Find the handover place and all pairs of grasps that pass the tool on there.

    Args:
        cell: with a left and a right arm, which carry equal grippers.
        tool: where it is at the start does not matter.
        grasps: of `tool_grasps` with `settings.grasps`.
        settings: what is searched.
        progress: told of the tool's orientations that are done; may raise to stop.

    Raises:
        LiftwrightError: the hands are not two equal grippers.
    """
    grippers = [arm.hand for arm in cell.arms.values()]
    if not all(isinstance(hand, Gripper) and hand.fingerprint == grippers[0].fingerprint for hand in grippers):
        raise LiftwrightError("a handover takes two arms with equal grippers")
    key = handover_key(cell, tool, settings)
    count, orientations = len(grasps), 6 * settings.axis_rolls
    if not count:
        none = np.zeros((0, 0), np.uint8)
        return HandoverDatabase(
            key, grasps, np.zeros(3), np.empty((0, 4, 4)), none, none, np.zeros((0, 0, 0), np.uint8)
        )
    place = handover_place(cell, grasps, settings.place)
    pairing = _Pairing(ToolWorkcell(cell, tool, settings=settings.clearance), grasps, settings)
    T_world_tools = tool_poses_at(place, grasps, settings.axis_rolls)
    left, right = (np.zeros((orientations, count), np.uint8) for _ in range(2))
    codes = np.zeros((orientations, count, count), np.uint8)
    for o, T_world_tool in enumerate(T_world_tools):
        progress(Report("handovers", o, orientations))
        for reached, reach in zip((left, right), pairing.reaches.values(), strict=True):
            reached[o] = reach.branches(T_world_tool)
        codes[o] = pairing.codes(T_world_tool, left[o], right[o])
    progress(Report("handovers", orientations, orientations))
    return HandoverDatabase(key, grasps, place, T_world_tools, left, right, codes)


@dataclass(frozen=True, eq=False)
class _Pairing:
    """Both arms at the handover place."""

    workcell: ToolWorkcell
    grasps: ToolGrasps
    settings: HandoverSettings
    _arms_queries: dict[tuple[int, int], CollisionQuery] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def reaches(self) -> dict[str, GraspReach]:
        """The left arm, then the right arm, each without the other."""
        alone = {
            arm: GraspSurroundings({}, None, self.workcell.gripper(other).width_max)
            for arm, other in (("left", "right"), ("right", "left"))
        }
        return {
            arm: GraspReach(self.workcell, arm, self.grasps, each, self.settings.grasps) for arm, each in alone.items()
        }

    @cached_property
    def hands_apart(self) -> NDArray[np.bool_]:
        """(n, n) whether the hands keep apart in two grasps, closed and on either's open way: the same everywhere."""
        one_way = np.zeros((len(self.grasps), len(self.grasps)), bool)
        gripper = self.workcell.gripper("left")
        T_tool_flange = self.grasps.T_tool_flange(gripper)
        T_flange_tool = np.array([inverse(T) for T in T_tool_flange])
        # Most pairs are another pair moved along the tool.
        relative = (T_flange_tool[:, None] @ T_tool_flange[None])[..., :3, :]
        group = self._group
        for a in range(len(self._openings)):
            for b in range(len(self._openings)):
                rows, columns = np.flatnonzero(group == a), np.flatnonzero(group == b)
                poses = relative[np.ix_(rows, columns)].reshape(-1, 12)
                _, first, same = np.unique(poses.round(6) + 0.0, axis=0, return_index=True, return_inverse=True)
                apart = self._second_comes(gripper, a, b, poses[first].reshape(-1, 3, 4))
                one_way[np.ix_(rows, columns)] = apart[same.ravel()].reshape(len(rows), len(columns))
        return one_way & one_way.T

    def codes(self, T_world_tool: Array, left: Branches, right: Branches) -> NDArray[np.uint8]:
        """Return the codes (n, n) of one orientation, see `HandoverDatabase`."""
        codes = np.zeros((len(self.grasps), len(self.grasps)), np.uint8)
        wanted = self.hands_apart & (left > 0)[:, None] & (right > 0)[None, :]
        if not wanted.any():
            return codes
        sweeps = [self._sweep(arm, T_world_tool, branches) for arm, branches in (("left", left), ("right", right))]
        for a, b in np.ndindex(len(self._openings), len(self._openings)):
            pairs = np.argwhere(wanted & (self._group == a)[:, None] & (self._group == b)[None, :])
            if len(pairs):
                first_branches(self._arms_query(a, b).kernel, pairs, sweeps[0], sweeps[1], codes)
        return codes

    @cached_property
    def _openings(self) -> Array:
        """(k, 2) different openings while holding, and open."""
        return np.unique(np.column_stack([self.grasps.widths, self.grasps.open_widths]).round(6), axis=0)

    @cached_property
    def _group(self) -> NDArray[np.int64]:
        """(n,) which of them each grasp has."""
        pairs = np.column_stack([self.grasps.widths, self.grasps.open_widths]).round(6)
        return np.unique(pairs, axis=0, return_inverse=True)[1].ravel()

    def _sweep(self, arm: str, T_world_tool: Array, branches: Branches) -> ArmSweep:
        base, reach = self.workcell.arm(arm), self.reaches[arm]
        T_base_tool = inverse(base.T_world_base) @ T_world_tool
        return sweep_arm(
            base.dh, base.T_world_base, T_base_tool, reach.T_tool_flange, branches, self.settings.grasps.way()
        )

    def _arms_query(self, left: int, right: int) -> CollisionQuery:
        """Query the arms against one another but for hand against hand; the hands have these `_openings`, open."""
        if (left, right) not in self._arms_queries:
            widths = {"left": float(self._openings[left, 1]), "right": float(self._openings[right, 1])}
            query = self.workcell.query(widths, {TOOL_FRAME: None}, only=self._arm_pairs)
            self._arms_queries[left, right] = query
        return self._arms_queries[left, right]

    def _arm_pairs(self, a: CollisionBody, b: CollisionBody) -> bool:
        hands = all(self.workcell.is_hand(body, body.group) for body in (a, b))
        return self.workcell.between_arms(a, b) and not hands

    def _second_comes(self, gripper: Gripper, held: int, coming: int, T_first_second: Array) -> NDArray[np.bool_]:
        """Say of each place (m, 3, 4) of a second hand whether it comes and closes without meeting a closed first."""
        margin = self.settings.clearance.margin
        first = gripper.bodies("left", float(self._openings[held, 0]))
        kernels = []
        for width in self._openings[coming]:
            second = gripper.bodies("right", float(width))
            model = CollisionModel.build({}, [*(_in_world(body) for body in first), *second])
            query = model.scene({second[0].frame: Fixed(np.eye(4))}, margin=margin)
            kernels.append((query.kernel_copy(), query.frame_index(second[0].frame)))
        (closed, frame), (opened, _) = kernels
        return _comes_free(closed, opened, frame, np.ascontiguousarray(T_first_second), self.settings.grasps.way())


def _in_world(body: CollisionBody) -> CollisionBody:
    return CollisionBody(body.name, body.group, "world", body.shapes)


@njit(cache=True, nogil=True)
def _comes_free(
    closed: CollisionKernel, opened: CollisionKernel, frame: int, T_first_second: Array, way: Array
) -> NDArray[np.bool_]:
    closed_scratch, opened_scratch = make_scratch(closed), make_scratch(opened)
    q, T = np.empty(0), np.eye(4)
    result = np.zeros(T_first_second.shape[0], np.bool_)
    for pair in range(T_first_second.shape[0]):
        T[:3, :] = T_first_second[pair]
        set_frame(closed, frame, T)
        free = first_collision(closed, q, closed_scratch) < 0
        for back in way:
            if not free:
                break
            for i in range(3):
                T[i, 3] = T_first_second[pair, i, 3] - back * T_first_second[pair, i, 2]
            set_frame(opened, frame, T)
            free = first_collision(opened, q, opened_scratch) < 0
        result[pair] = free
    return result
