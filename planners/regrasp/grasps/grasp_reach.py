"""Which grasps of the tool an arm can take where the tool is: contact, straight way to it, straight lift (compiled).

A grasp is reached on a branch of the inverse kinematics if on that one branch the arm can come to the tool straight
along the hand's z with open fingers, close them, and carry the tool along a straight line, all free of collision and
within one winding of the joints' limits. The way back from the tool is the way to it. A set of branches is a byte, one
bit for each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.collision.kernel import (
    CollisionKernel,
    first_collision,
    first_collisions,
    make_scratch,
    set_frame,
)
from planners.collision.model import CollisionQuery, Fixed, NamePair, PairChoice, Placement, Riding
from planners.geometry.convex import CollisionBody
from planners.geometry.pose import Array, Transform
from planners.hands.workcell import ArmKernel
from planners.kinematics.inverse import inverse_kinematics, multiply
from planners.kinematics.windings import LIMIT_SLACK, wrap
from planners.regrasp.grasps.tool_grasps import ToolGrasps, ToolGraspSettings
from planners.regrasp.tool_workcell import TOOL_FRAME, ToolWorkcell

Branches = NDArray[np.uint8]

CONTINUITY = 0.25
"""Largest joint step between neighbouring samples of a straight way that still counts as continuous [rad]."""
_TURN = 2.0 * math.pi


class ReachFault(StrEnum):
    """Why an arm cannot take a grasp; the value is the sentence for a person."""

    CARRIED = "The tool or what hangs on it would touch something."
    AWAY = "The arm does not reach all of the straight way on one branch."
    HAND = "The hand would touch something."
    LINKS = "The arm would touch something."


REACH_FAULTS = tuple(ReachFault)
TOUCHING = frozenset({ReachFault.CARRIED, ReachFault.HAND, ReachFault.LINKS})
"""Faults for which something is in the way."""
_NO_FAULT, _CARRIED, _AWAY, _HAND, _LINKS = range(5)
"""A fault as a number: 0, or 1 + its place in `REACH_FAULTS`."""


@dataclass(frozen=True, eq=False)
class ReachedGrasps:
    """What was found out about all grasps of one arm; of those not asked, nothing."""

    branches: Branches
    """(n,) the set of branches on which each is reached."""
    faults: NDArray[np.uint8]
    """(n,) 1 + the number in `REACH_FAULTS` of what keeps the last branch away; 0 for none."""


@dataclass(frozen=True, eq=False)
class GraspSurroundings:
    """What stands about while an arm takes the tool."""

    objects: Mapping[str, Placement | None]
    """Each object: Fixed, Riding on the tool, or None where it does not matter."""
    idle_positions: Array | None
    """(6,) where the other arm stands [rad]; None: it is not looked at."""
    idle_width: float
    """Opening of the other arm's hand [m]."""
    margins: Mapping[NamePair, float] = field(default_factory=dict)
    """Of pairs that do not keep the usual margin [m]."""


@dataclass(frozen=True, eq=False)
class GraspReach:
    """One arm and all grasps of the tool, in one setting. Safe to share between threads."""

    workcell: ToolWorkcell
    arm: str
    """Which takes the tool."""
    grasps: ToolGrasps
    surroundings: GraspSurroundings
    settings: ToolGraspSettings = field(default_factory=ToolGraspSettings)

    @cached_property
    def T_tool_flange(self) -> Array:
        """(n, 4, 4) the flange on the tool in each grasp."""
        return np.ascontiguousarray(self.grasps.T_tool_flange(self.workcell.gripper(self.arm)))

    def branches(
        self, T_world_tool: Transform, lift: Array | None = None, chosen: NDArray[np.integer] | None = None
    ) -> Branches:
        """Return the set of branches on which each grasp is reached: (n,). See `reached`."""
        return self.reached(T_world_tool, lift, chosen).branches

    def reached(
        self,
        T_world_tool: Transform,
        lift: Array | None = None,
        chosen: NDArray[np.integer] | None = None,
        riding: Mapping[str, Transform] | None = None,
    ) -> ReachedGrasps:
        """Find out on which branches each grasp is reached, and why the others are not.

        Args:
            T_world_tool: where the tool is.
            lift: (3,) straight way that the tool goes from there, with what rides on it [m, world]; None: none. Margins
                count from the first step on, so that it may start from what it rests on.
            chosen: numbers of the grasps to look at; all others are not reached. None: all.
            riding: `T_tool_object` of objects that ride on the tool elsewhere than `surroundings` says, by name.
        """
        result, faults = np.zeros((2, len(self.grasps)), np.uint8)
        wanted = np.arange(len(self.grasps)) if chosen is None else np.asarray(chosen, dtype=np.int64)
        T_world_tools = self._lifted(T_world_tool, lift)
        ridden = {} if riding is None else riding
        if not len(wanted) or not self._carried_free(T_world_tools[1:], ridden):
            faults[wanted] = _CARRIED
            return ReachedGrasps(result, faults)
        arm = ArmKernel.of(self.workcell.arm(self.arm), self.workcell.joints(self.arm).start)
        for width, group in self._groups.items():
            these = wanted[self._group_of[wanted] == width]
            if len(these):
                grasps = _GraspKernel(self.T_tool_flange, these, self.settings.way())
                queries = _QueryKernels(
                    _ridden(group.held, ridden),
                    _ridden(group.opened, ridden),
                    _ridden(group.links, ridden),
                    group.links.frame_index(TOOL_FRAME),
                )
                _reach(arm, grasps, queries, T_world_tools, self._positions.copy(), result, faults)
        return ReachedGrasps(result, faults)

    def in_the_way(
        self, T_world_tool: Transform, lift: Array | None, grasp: int, riding: Mapping[str, Transform]
    ) -> tuple[str, str] | None:
        """Name for a person two things that touch where the arm takes a grasp; None where none do in reach.

        Of several it is what is met first on the way that `reached` goes, whose arguments these are but for the number
        of the grasp.
        """
        T_world_tools, way = self._lifted(T_world_tool, lift), self.settings.way()
        arm = ArmKernel.of(self.workcell.arm(self.arm), self.workcell.joints(self.arm).start)
        back, count = len(way), len(way) + len(T_world_tools) - 1
        T_base_flanges, solutions = np.empty((count, 4, 4)), np.zeros((count, 8, 6))
        _place_flanges(arm.T_base_world, T_world_tools, self.T_tool_flange[grasp], way, T_base_flanges)
        branches = _passes(arm.dh, arm.position_min, arm.position_max, T_base_flanges, back, solutions)
        taken = [branch for branch in range(8) if branches >> branch & 1]
        group, lifted = self._groups[int(self._group_of[grasp])], range(back, count)
        # Tool and object are where they are, wherever the arm is.
        asked = (
            (self._carried, lifted, [0]),
            (group.opened, range(back), taken),
            (group.held, (0, *lifted), taken),
            (group.links, range(count), taken),
        )
        for query, places, on in asked:
            kernel, frame = _ridden(query, riding), query.frame_index(TOOL_FRAME)
            Q = np.repeat(self._positions[None], len(on), axis=0)
            for place in places if on and len(kernel.pairs) else ():
                set_frame(kernel, frame, T_world_tools[max(0, place - back + 1)])
                Q[:, arm.first_joint : arm.first_joint + 6] = solutions[place, on]
                pair = int(first_collisions(kernel, Q).max())
                if pair >= 0:
                    a, b = query.pair_names(pair)
                    return self._told(query, a), self._told(query, b)
        return None

    def _told(self, query: CollisionQuery, name: str) -> str:
        """Say for a person which body it is: of hands and arms only whose they are."""
        body = next(body for body in query.model.bodies if body.name == name)
        for arm in self.workcell.cell.arms:
            if body.group == arm:
                return f"the {arm} {'hand' if self.workcell.is_hand(body, arm) else 'arm'}"
        return f"the {TOOL_FRAME}" if body.frame == TOOL_FRAME else name

    def _lifted(self, T_world_tool: Transform, lift: Array | None) -> Array:
        """Return the poses (m, 4, 4) of the tool along its lift, where it is first."""
        way = np.zeros(3) if lift is None else np.asarray(lift, dtype=float)
        steps = math.ceil(float(np.linalg.norm(way)) / self.settings.step)
        T_world_tools = np.repeat(T_world_tool[None], steps + 1, axis=0)
        T_world_tools[:, :3, 3] += np.linspace(0.0, 1.0, steps + 1)[:, None] * way
        return T_world_tools

    def _carried_free(self, T_world_tools: Array, riding: Mapping[str, Transform]) -> bool:
        """Tell whether tool and object, without a hand, keep their margins at all poses (m, 4, 4)."""
        query = self._carried
        return not len(query.kernel.pairs) or bool(
            _all_free(
                _ridden(query, riding),
                query.frame_index(TOOL_FRAME),
                np.ascontiguousarray(T_world_tools),
                self._positions,
            )
        )

    @cached_property
    def _positions(self) -> Array:
        """(12,) with the other arm where it stands."""
        positions = np.zeros(6 * len(self.workcell.cell.arms))
        if self.surroundings.idle_positions is not None:
            positions[self.workcell.joints(self.workcell.other(self.arm))] = self.surroundings.idle_positions
        return positions

    @cached_property
    def _group_of(self) -> NDArray[np.int64]:
        """(n,) which of `_groups` each grasp belongs to: one for each pair of openings."""
        pairs = np.column_stack([self.grasps.widths, self.grasps.open_widths]).round(6)
        return np.unique(pairs, axis=0, return_inverse=True)[1].ravel()

    @cached_property
    def _groups(self) -> dict[int, _GroupQueries]:
        firsts = {int(group): k for k, group in reversed(list(enumerate(self._group_of)))}
        return {group: self._queries(k) for group, k in sorted(firsts.items())}

    def _queries(self, grasp: int) -> _GroupQueries:
        held, opened = float(self.grasps.widths[grasp]), float(self.grasps.open_widths[grasp])
        return _GroupQueries(
            held=self._query(held, "hand", self._hand_pairs),
            opened=self._query(opened, "hand", self._hand_pairs),
            links=self._query(opened, "links", self._link_pairs),
        )

    @cached_property
    def _carried(self) -> CollisionQuery:
        return self._query(float(self.grasps.widths[0]), "carried", self._carried_pairs)

    def _query(self, width: float, kind: str, choice: PairChoice) -> CollisionQuery:
        around, other = self.surroundings, self.workcell.other(self.arm)
        riding = [name for name, placement in around.objects.items() if isinstance(placement, Riding)]
        widths = {self.arm: width, other: around.idle_width}
        key = (kind, self.arm, around.idle_positions is None, *sorted(riding))
        return self.workcell.query(
            widths,
            {TOOL_FRAME: Fixed(np.eye(4)), **around.objects},
            touching=[(TOOL_FRAME, name) for name in riding],
            margins=around.margins,
            only=self.workcell.pairs(key, choice),
        )

    def _hand_pairs(self, a: CollisionBody, b: CollisionBody) -> bool:
        """Choose the hand with all else but its own arm and the tool, which `tool_grasps` has checked."""
        if not self.workcell.is_hand(a, self.arm):
            a, b = b, a
        return self.workcell.is_hand(a, self.arm) and b.group not in (self.arm, TOOL_FRAME) and self._looked_at(b)

    def _link_pairs(self, a: CollisionBody, b: CollisionBody) -> bool:
        """Choose what else the arm has to keep away from: its links, and all."""
        if a.group != self.arm:
            a, b = b, a
        if a.group != self.arm or not self._looked_at(b):
            return False
        return not self.workcell.is_hand(a, self.arm) or (
            b.group == self.arm and not self.workcell.is_hand(b, self.arm)
        )

    def _carried_pairs(self, a: CollisionBody, b: CollisionBody) -> bool:
        """Choose the tool and what rides on it with all else but the arm."""
        if not self._is_carried(a):
            a, b = b, a
        return self._is_carried(a) and not self._is_carried(b) and b.group != self.arm and self._looked_at(b)

    def _is_carried(self, body: CollisionBody) -> bool:
        return body.frame == TOOL_FRAME or isinstance(self.surroundings.objects.get(body.frame), Riding)

    def _looked_at(self, body: CollisionBody) -> bool:
        return self.surroundings.idle_positions is not None or body.group != self.workcell.other(self.arm)


def _ridden(query: CollisionQuery, riding: Mapping[str, Transform]) -> CollisionKernel:
    """Return a kernel of one's own, in which objects ride at `T_tool_object`."""
    kernel = query.kernel_copy()
    for name, T_tool_object in riding.items():
        set_frame(kernel, query.frame_index(name), T_tool_object)
    return kernel


@dataclass(frozen=True, eq=False)
class _GroupQueries:
    """What is asked of grasps with the same openings."""

    held: CollisionQuery
    """The hand closed on the tool."""
    opened: CollisionQuery
    """The hand open around it."""
    links: CollisionQuery
    """The rest of the arm; the fingers are open, which is the larger hand."""


class _GraspKernel(NamedTuple):
    """Grasps for compiled code."""

    T_tool_flange: Array
    """(n, 4, 4)"""
    chosen: NDArray[np.int64]
    """(k,) numbers of those that are asked about."""
    way: Array
    """(m,) places of the hand on its way back from the tool, the first at contact [m]."""


class _QueryKernels(NamedTuple):
    """`_GroupQueries` for compiled code."""

    held: CollisionKernel
    opened: CollisionKernel
    links: CollisionKernel
    tool_frame: int


@njit(cache=True, nogil=True)
def _all_free(kernel: CollisionKernel, frame: int, T_world_tools: Array, q: Array) -> bool:
    scratch = make_scratch(kernel)
    for k in range(T_world_tools.shape[0]):
        set_frame(kernel, frame, T_world_tools[k])
        if first_collision(kernel, q, scratch) >= 0:
            return False
    return True


@njit(cache=True, nogil=True)
def _reach(arm, grasps, queries, T_world_tools, q, out, faults):
    dh, T_base_world, lo, hi, first_joint = arm
    T_tool_flange, chosen, way = grasps
    held, opened, links, frame = queries
    closed, around, rest = (held, make_scratch(held)), (opened, make_scratch(opened)), (links, make_scratch(links))
    # The contact comes first, then the way back from it, then the lift.
    back, count = way.shape[0], way.shape[0] + T_world_tools.shape[0] - 1
    T_base_flanges, solutions = np.empty((count, 4, 4)), np.empty((count, 8, 6))
    for grasp in chosen:
        _place_flanges(T_base_world, T_world_tools, T_tool_flange[grasp], way, T_base_flanges)
        left = _passes(dh, lo, hi, T_base_flanges, back, solutions)
        faults[grasp] = _AWAY if left == 0 else _HAND
        if (
            left
            and _hand_free(around, frame, solutions[:back], left, T_world_tools[:1], q, first_joint)
            and _hand_free(closed, frame, solutions[:1], left, T_world_tools[:1], q, first_joint)
            and _hand_free(closed, frame, solutions[back:], left, T_world_tools[1:], q, first_joint)
        ):
            left = _links_free(rest, frame, solutions[:back], left, T_world_tools[:1], q, first_joint)
            left = _links_free(rest, frame, solutions[back:], left, T_world_tools[1:], q, first_joint)
            out[grasp] = left
            faults[grasp] = _LINKS if left == 0 else _NO_FAULT


@njit(cache=True, nogil=True)
def _place_flanges(T_base_world, T_world_tools, T_tool_flange, way, T_base_flanges):
    """Write where the flange is at the contact, on the way back from it, and along the lift."""
    back = way.shape[0]
    T_base_tool = np.empty((4, 4))
    for k in range(T_world_tools.shape[0]):
        multiply(T_base_world, T_world_tools[k], T_base_tool)
        multiply(T_base_tool, T_tool_flange, T_base_flanges[0 if k == 0 else back + k - 1])
    for k in range(1, back):
        T_base_flanges[k] = T_base_flanges[0]
        for i in range(3):
            T_base_flanges[k, i, 3] -= way[k] * T_base_flanges[0, i, 2]


@njit(cache=True, nogil=True)
def _hand_free(query, frame, solutions, branches, T_world_tools, q, first_joint):
    """Say whether the hand, which is where it is on all branches, is free at all places; the last tool pose stays."""
    kernel, scratch = query
    some = 0
    while not (branches >> some) & 1:
        some += 1
    for k in range(solutions.shape[0]):
        if k < T_world_tools.shape[0]:
            set_frame(kernel, frame, T_world_tools[k])
        q[first_joint : first_joint + 6] = solutions[k, some]
        if first_collision(kernel, q, scratch) >= 0:
            return False
    return True


@njit(cache=True, nogil=True)
def _links_free(query, frame, solutions, branches, T_world_tools, q, first_joint):
    """Return the branches whose links are free at all places; the last tool pose stays."""
    kernel, scratch = query
    left = branches
    for k in range(solutions.shape[0]):
        if k < T_world_tools.shape[0]:
            set_frame(kernel, frame, T_world_tools[k])
        for branch in range(8):
            if (left >> branch) & 1:
                q[first_joint : first_joint + 6] = solutions[k, branch]
                if first_collision(kernel, q, scratch) >= 0:
                    left &= ~(1 << branch)
        if left == 0:
            break
    return left


@njit(cache=True, nogil=True)
def _passes(dh, lo, hi, T_base_flanges, back, solutions):
    """Return the branches that reach all places continuously, with one winding within limits; write their positions.

    Places 1 to back - 1 lead from place 0 one way, the rest from it another way.
    """
    left = inverse_kinematics(dh, T_base_flanges[0], 0.0, solutions[0])
    # The far ends fail most often.
    count = T_base_flanges.shape[0]
    left &= inverse_kinematics(dh, T_base_flanges[back - 1], 0.0, solutions[back - 1])
    left &= inverse_kinematics(dh, T_base_flanges[count - 1], 0.0, solutions[count - 1])
    if left == 0:
        return 0
    for k in range(1, count):
        left &= inverse_kinematics(dh, T_base_flanges[k], 0.0, solutions[k])
        if left == 0:
            return 0
    for branch in range(8):
        if not (left >> branch) & 1:
            continue
        good = True
        for i in range(6):
            low = high = solutions[0, branch, i]
            for k in range(1, count):
                before = solutions[0 if k == back else k - 1, branch, i]
                step = wrap(solutions[k, branch, i] - before)
                good = good and abs(step) <= CONTINUITY
                solutions[k, branch, i] = before + step
                low, high = min(low, solutions[k, branch, i]), max(high, solutions[k, branch, i])
            turns = math.ceil((lo[i] - LIMIT_SLACK - low) / _TURN)
            good = good and high + _TURN * turns <= hi[i] + LIMIT_SLACK
        if not good:
            left &= ~(1 << branch)
    return left
