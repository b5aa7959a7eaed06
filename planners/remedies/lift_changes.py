"""Changes of a plate lift that leave a way where there was none, the smallest of each kind first.

Whether a change leaves a way is asked of the same graph as the lift itself: `PlateLiftPlanner.may_keep` finds a way of
held poses, or proves that none is left among the poses and holds of its sampling. Other forces leave poses, holds and
reach as they are, so that this takes a tenth of a plan. Which forces to ask for is told by program (5), relaxed at the
cut of the graph: at the states to which the search came and that it could not enter (`relaxed_balance`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np

from planners.balance.cone_program import ConeProgram
from planners.balance.relaxed_balance import least_shift
from planners.contract.shapes import Box
from planners.contract.task_change import PatchOperation
from planners.contract.task_spec import Obstacle, PlateLiftTask, Support
from planners.geometry.pose import Array, rotation_z
from planners.graph.search import DEAD
from planners.manipulation.cup_place import CupPlaceSearch
from planners.manipulation.graph.node_examiner import hands_of
from planners.manipulation.impasse import TOO_WEAK
from planners.manipulation.lift_attempts import NOT_WITHIN_TOLERANCES
from planners.manipulation.lift_settings import LiftSettings
from planners.manipulation.planner import PlateLiftPlanner
from planners.manipulation.reach.reach_memory import ReachMemory
from planners.manipulation.statics.lift_programs import hand_force_limit, payload_forces
from planners.progress import Progress
from planners.remedies.change import (
    Effort,
    TaskChange,
    moved_pose,
    numbers,
    obstacle_moved,
    obstacle_out_of_the_way,
    put,
    removed,
    stacked,
    standing_on_others,
    told_cup_place,
    turning,
)
from planners.remedies.directions import (
    heading,
    least_reach,
    straight_ways,
    straightest,
    told_move,
    told_way,
    way_to_best,
)
from planners.scene.lift_scene import PlateLiftScene

_CUT_STATES = 6
"""States at the cut of the graph whose programs are relaxed."""
_SHARE_OF_RESERVE = 0.5
"""Where there is no plan, a way has to keep back this part of the reserve asked for before a changed task is planned
[1]: where nothing at all is kept back, there seldom is a motion too."""
_MORE_FORCE = 4.0
"""A cup of so many times the stated one's force is asked for [1] ..."""
_BEYOND_NEEDED = 2.0
"""... or so many times the force without which robot and lifter do not bear the weight, if that is more [1] ..."""
_BEYOND_ALONE = 1.25
"""... or so many times that with which the lifter bears it alone: of a flat plate hands bear little [1] ..."""
_MOST_FORCE = 10.0
"""... but of no more than so many times the stated one's [1]."""
_FORCE_STEP = 0.5
_ROUNDING = 1e-9
"""How finely it is asked for [N]."""
_SHIFTS = (0.010, 0.020, 0.030, 0.050, 0.080)
"""How far the cup is moved straight on; like the distances below in a cell of size 1 [m]."""
_SCALES = (0.5, 0.75, 1.25, 1.5)
"""How much farther from the plate's centre of mass, or nearer, it is moved [1]."""
_TURNS = tuple(math.radians(sign * angle) for angle in (10, 20, 30, 45, 60, 90) for sign in (1, -1))
_WAYS = (0.05, 0.10)
"""How far the plate is moved straight on [m] ..."""
_TOWARDS_BEST = (0.5, 0.75, 1.0)
"""... and of the way to where both arms reach best, where that is farther than an arm reaches [1] ..."""
_OUT_OF_REACH_WAYS = tuple(0.1 * step for step in range(1, 10))
"""... but straight on where it is proven to be out of reach [m] ..."""
_OBSTACLE_WAYS = (0.05, 0.10, 0.20)
"""... and obstacles [m]."""
_WANT_OF_REACH = ("reach so far", "be brought there", "would touch", TOO_WEAK)
"""Words of causes for which another place of the plate may help, and other forces hardly."""
_STEPS_OF_ASKING = 1
"""What it takes to ask anything, besides what is reported then: see `Effort` ..."""
_STEPS_OF_REACH = 60
"""... and what the hands reach at another place, which is not reported as it is found."""
_STEPS_OF_CUP_PLACES = 150
"""What it takes to look where a stronger cup keeps most back."""
_IN_VAIN = 4
"""Other places of one kind that are asked in vain before other kinds have their turn [1]."""
_SQUEEZES = (1.5, 2.0, 4.0)
"""How much harder the gripper squeezes [1]."""
_TOLERANCES = (0.5, 0.1)
"""Shares of the tolerances of mass and centre of mass that are left [1]: nobody knows either exactly."""
_EDGES = 2
"""Edges of the table that the plate is moved to."""
_BOARDS = (0.03, 0.05)
"""Thickness of a board under the plate [m]."""
_FLUSH = 1e-3
"""A board that reaches no farther beyond the plate is as large as it [m]."""
_OTHER_LIFTERS = {
    "paper": "whose pad bears the more friction the more it pulls",
    "dexnet": "whose pad bears friction where it hardly pulls, too",
    "cable": "that hangs on a cable and cannot bend",
}
"""By name of the lifter's model: what none of the others does."""


class LiftChanges:
    """The changes of one plate lift that has no plan."""

    def __init__(
        self,
        task: PlateLiftTask,
        build: Callable[[PlateLiftTask], PlateLiftScene],
        settings: LiftSettings,
        effort: Effort,
        progress: Progress,
        memory: ReachMemory | None = None,
        *,
        place_is_open: bool = False,
    ) -> None:
        """Sample the lift as it is; where it ends is searched for when that is first asked.

        Args:
            task: as it was planned.
            build: makes scenes of tasks.
            settings: with which it was planned.
            effort: what asking may take.
            progress: may raise `PlanningCancelled`; counts what is reported to it.
            memory: of the reach in changed lifts, for whoever plans them.
            place_is_open: whether the task, as it was posted, left the cup's place to the planner.
        """
        self._place_is_open = place_is_open
        self.task, self._build, self._effort, self._progress = task, build, effort, progress
        self._memory = memory
        self._asked = settings
        self._settings = replace(settings, reserve=0.0, most_reserve=False, full=False)
        self._kept = _SHARE_OF_RESERVE * settings.reserve
        self.scene = build(task)
        self._stacked = stacked(standing_on_others(self.scene.obstacles))
        self._planner = self._planner_of(self.scene)
        self._rotation = self.scene.T_world_plate[:2, :2]
        """Takes directions on the plate to the world."""

    def by_kind(self, chief: str = "", *, whole_reserve: bool = False) -> list[Iterator[TaskChange | None]]:
        """Return the changes of every kind; kinds that concern what is short come first.

        Each kind's are in order of size, but that of tolerances that are blamed: there the largest is the likeliest.

        Args:
            chief: the first reason that the failed plan names; empty: it names none.
            whole_reserve: whether a way has to keep back all that is asked for before a changed task is planned, not
                only a share of it.
        """
        planner = self._planner
        if whole_reserve:
            self._kept = self._asked.reserve
        forces = [self._cup_force(), self._hands(), self._lifter()]
        if not planner.capacity().suffices:
            # Where the cup may sit anywhere, it sits where the least force does.
            return [self._with_forces(self._best_cup_places()), *forces[1:]] if self._place_is_open else forces
        if planner.out_of_reach() is not None:
            return [self._plate_place()]
        if planner.proof(explained=False) is not None:
            return []
        if self._is_too_thin:
            return [self._board(), self._to_the_edge(), self._given_holds()]
        return self._where_it_ends(chief, forces)

    def _where_it_ends(
        self, chief: str, forces: list[Iterator[TaskChange | None]]
    ) -> list[Iterator[TaskChange | None]]:
        """Return the changes of a lift that may be within reach and force, by where its graph ends."""
        cup, places, far_off = self._cup_place(), [self._plate_turned(), self._plate_place()], self._is_far_off
        if far_off:
            places.reverse()
        if NOT_WITHIN_TOLERANCES in chief:
            kinds = [self._tolerances(blamed=True), cup, *forces, *places, self._board(), self._given_holds()]
            return [*kinds[:1], self._obstacles(), *kinds[1:]] if self._without_obstacles else kinds
        if self._without_obstacles:
            return [self._obstacles(), cup, *places]
        if self._is_held:
            # It is the arms that find no way: other forces change nothing for them.
            return [*places, self._board(), cup, self._given_holds()]
        if self._planner.search is not None and not self._planner.search.graph.starts:
            # No hand comes to the plate at rest, whatever it bears.
            return [self._board(), *places, self._given_holds()]
        rest = [self._tolerances(), self._board(), self._given_holds()]
        if far_off:
            # It has to come nearer, most likely.
            return [places[0], cup, *forces, places[1], *rest]
        if any(words in chief for words in _WANT_OF_REACH):
            return [*places, cup, *forces, *rest]
        cup_force, hands, lifter = forces
        # Where no hold bears the plate, what the task itself forbids the hands is asked at once.
        return [hands, cup, cup_force, lifter, *places, *rest] if chief else [cup, *forces, *places, *rest]

    def in_pairs(self) -> list[Iterator[TaskChange | None]]:
        """Return two changes at once, for where no single one helps: other places with other forces."""
        if self._is_too_thin:
            return self._on_a_board()
        if not self._planner.capacity().suffices:
            return [] if self._place_is_open else [self._with_forces(self._best_cup_places())]
        if self._planner.proof(explained=False) is not None:
            return []
        return [self._with_forces(each) for each in (self._first_cup_places(), self._first_plate_places())]

    def _on_a_board(self) -> list[Iterator[TaskChange | None]]:
        """Return changes of a thin plate's cup on a board: where hands have room, what they bear decides."""
        board = next(map(self._on_board, self._boards), None)
        lifted = None if board is None else board.applied(self.task)
        if board is None or lifted is None or self._effort.ended or board.built(self.task, self._build) is None:
            return []
        self._effort.take(_STEPS_OF_REACH)
        other = LiftChanges(
            lifted,
            self._build,
            self._asked,
            self._effort,
            self._progress,
            self._memory,
            place_is_open=self._place_is_open,
        )
        if other._is_too_thin or other._planner.out_of_reach() is not None:
            return []
        # Where robot and lifter bear less than the plate weighs, no place of the cup helps.
        kinds = [other._cup_place()] if other._planner.capacity().suffices else []
        return [_after(board, each) for each in (*kinds, other._cup_force())]

    def _first_cup_places(self) -> Iterator[TaskChange]:
        """Places of the cup that differ most from the stated one: on the other sides of the plate."""
        offset = np.array(self.task.cup.place) - self.scene.plate.com[:2]
        quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
        return self._cup_moved([turned - offset for turned in (-offset, quarter @ offset, -quarter @ offset)])

    def _first_plate_places(self) -> Iterator[TaskChange]:
        for angle in (math.radians(90), math.radians(-90), math.radians(45), math.radians(-45)):
            yield self._turned(angle)
        if self.task.support is None:
            yield self._on_board(self._boards[0])

    def _best_cup_places(self) -> Iterator[TaskChange]:
        """Places where the strongest cup that is asked for keeps most back: a heavy plate seldom allows many."""
        steps = self._most_force_steps
        strongest = self.task if steps < 1 else self._stronger(steps).applied(self.task)
        if strongest is None or self._effort.ended:
            return
        cup = strongest.cup.model_copy(update={"position": None})
        anywhere = strongest.model_copy(update={"cup": cup})
        self._effort.tried.add("cup_place")
        self._effort.take(_STEPS_OF_CUP_PLACES)
        spent = self._effort.spent
        search = CupPlaceSearch(anywhere, self._build, self._asked, self._progress)
        candidates = search.candidates(self._build(strongest))
        # All places have one reach, and it is the places that are counted, not what is asked at each.
        self._effort.spent = spent
        for place in candidates:
            if place.leaves_a_way:
                yield self._cup_at(place.position)

    def _with_forces(self, firsts: Iterator[TaskChange]) -> Iterator[TaskChange]:
        """Follow each change by the least force of the cup with which it leaves a way."""
        for first in firsts:
            changed = first.applied(self.task)
            if changed is None or self._effort.ended or first.built(self.task, self._build) is None:
                continue
            self._effort.take(_STEPS_OF_REACH)
            other = LiftChanges(changed, self._build, self._asked, self._effort, self._progress, self._memory)
            yield from (first.then(second) for second in itertools.islice(other._cup_force(), 1))

    # Asking.

    def _planner_of(self, scene: PlateLiftScene) -> PlateLiftPlanner:
        return PlateLiftPlanner(scene, self._settings, self._progress, self._memory)

    def _leaves_a_way(self, change: TaskChange, *, forces: bool, kept: float | None = None) -> bool:
        """Ask whether a change leaves a way of held poses.

        Args:
            change: of the task.
            forces: whether nothing but forces and the cup's place is changed: what the cup meets at its new place is
                left to whoever plans the changed task.
            kept: what the way has to keep back [1]; None: a share of the reserve that the task asks for.
        """
        scene = None if self._effort.ended else change.built(self.task, self._build)
        if scene is None:
            return False
        self._effort.trying = change.kind
        self._effort.tried.add(change.kind)
        planner = self._planner.with_limits(scene) if forces else self._planner_of(scene)
        self._effort.take(_STEPS_OF_ASKING)
        if planner.proof(explained=False) is not None or not planner.fits:
            return False
        if not forces:
            self._effort.take(_STEPS_OF_REACH)
        return planner.may_keep(self._kept if kept is None else kept, low=True)

    def _of(self, changes: Iterable[TaskChange], *, forces: bool) -> Iterator[TaskChange | None]:
        """Yield those that leave a way; None whenever some were asked in vain, so that other kinds have their turn."""
        in_vain = 0
        for change in changes:
            if self._leaves_a_way(change, forces=forces):
                yield change
            elif not forces:
                in_vain += 1
                if in_vain % _IN_VAIN == 0:
                    yield None

    @property
    def _is_too_thin(self) -> bool:
        """Whether a hand has no room beside the plate at rest, whatever it bears and wherever the cup sits."""
        return self._planner.sampling.prism.height <= self._planner.sampling.least_thickness

    @cached_property
    def _is_held(self) -> bool:
        """Whether the task as it is has a way of held poses already."""
        if self._effort.ended or not self._planner.fits:
            return False
        self._effort.take(_STEPS_OF_ASKING)
        return self._planner.may_keep(self._kept, low=True)

    @cached_property
    def _cut(self) -> list[ConeProgram]:
        """Programs (5) of the states that the search could not enter for want of balance, nearest to the goal first.

        The plate is at a pose next to one that was come to, held as it was there; the hands reach it.
        """
        if self._is_held or self._planner.search is None:
            return []
        search = self._planner.search
        graph, balance, poses = search.graph, search.balance, search.sampling.poses.poses
        come_to = np.zeros(graph.graph.node_count, bool)
        come_to[graph.reachable()] = True
        ends = graph.edge_nodes[come_to[graph.edge_nodes].sum(axis=1) == 1]
        beyond = np.unique(ends[~come_to[ends]])
        fallen = beyond[graph.knowledge.status[beyond] == DEAD]
        tilts = np.array([np.linalg.norm(poses[graph.node_pose[node]].tilt) for node in fallen])
        programs = []
        for node in fallen[np.argsort(-tilts, kind="stable")][:_CUT_STATES]:
            pose = poses[graph.node_pose[node]]
            hands = hands_of(*graph.hold_of(int(node)))
            programs.append(balance.program(pose.T_world_plate, pose.contact_points, hands))
        return programs

    # Forces.

    def _cup_force(self) -> Iterator[TaskChange]:
        """A stronger cup: as a larger force never does harm, the least that leaves a way is found by halving."""
        known, least = 0, self._most_force_steps
        if least < 1 or not self._leaves_a_way(self._stronger(least), forces=True):
            return
        while least - known > 1:
            middle = (known + least) // 2
            if self._leaves_a_way(self._stronger(middle), forces=True):
                least = middle
            else:
                known = middle
        # A way of held poses may still be none for the arms.
        more = (least, math.ceil(1.5 * least), 2 * least)
        too_little = self._stronger(known).size
        stronger = (self._stronger(steps) for steps in dict.fromkeys(more) if steps <= self._steps_of_lifter)
        yield from (replace(change, none=too_little) for change in stronger)

    @property
    def _most_force_steps(self) -> int:
        """By how many steps the strongest cup that is asked for is stronger than the stated one; 0: none is."""
        capacity, stated = self._planner.capacity(), self.task.cup.max_force
        # What the cup carries is proportional to its force, whatever the lifter's model.
        needed = (capacity.needed - capacity.gripper - capacity.pusher) / capacity.cup
        alone = capacity.needed / capacity.cup
        most = min(max(_MORE_FORCE, _BEYOND_NEEDED * needed, _BEYOND_ALONE * alone), _MOST_FORCE)
        return int(min(max(2, math.ceil((most - 1.0) * stated / _FORCE_STEP)), self._steps_of_lifter))

    @property
    def _steps_of_lifter(self) -> float:
        """By how many steps a cup may be stronger than the stated one: the cell's lifter bears no more."""
        most = self.scene.cell.lifter.max_force
        if math.isinf(most):
            return most
        return math.floor((most + _ROUNDING) / _FORCE_STEP) - math.floor(self.task.cup.max_force / _FORCE_STEP)

    def _stronger(self, steps: int) -> TaskChange:
        stated = self.task.cup.max_force
        whole = math.floor(stated / _FORCE_STEP)
        force = round((whole + steps) * _FORCE_STEP, 3)

        def of(force: float) -> TaskChange:
            return self._stronger(round(force / _FORCE_STEP) - whole)

        sentence = f"Use a cup, or a vacuum, that pulls with {force:g} N instead of {stated:g} N."
        steps_of_patch = (put("/cup/max_force", force),)
        return TaskChange("cup_force", sentence, steps_of_patch, "stronger", force, stated, of)

    def _cup_place(self) -> Iterator[TaskChange | None]:
        yield from self._of(self._cup_places(), forces=True)

    def _cup_places(self) -> Iterator[TaskChange]:
        """Places where the relaxed programs want the cup, and around the stated one and the centre of mass."""
        stated, com = np.array(self.task.cup.place), self.scene.plate.com[:2]
        offset = stated - com
        wanted = [least_shift(program) for program in self._cut]
        shifts = [scale * np.array(shift) for shift in wanted if shift is not None for scale in (1.0, 1.3)]
        shifts += [(scale - 1.0) * offset for scale in _SCALES]
        quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
        shifts += [turned - offset for turned in (-offset, quarter @ offset, -quarter @ offset)]
        shifts += [
            self.scene.cell.size * length * way @ self._rotation for length in _SHIFTS for way in straight_ways()
        ]
        yield from self._cup_moved(shifts)

    def _cup_moved(self, shifts: Iterable[Array]) -> Iterator[TaskChange]:
        """Move the cup by shifts in plate axes [m], the least first."""
        stated = np.array(self.task.cup.place)
        rounded = {tuple(np.round(stated + shift, 3).tolist()) for shift in shifts} - {tuple(stated.tolist())}
        for place in sorted(rounded, key=lambda place: (float(np.linalg.norm(place - stated)), place)):
            if told_way(self._rotation @ (place - stated)):
                yield self._cup_at(place)

    def _cup_at(self, place: tuple[float, float]) -> TaskChange:
        """Put the cup at a place in plate axes [m]; a way from the stated one is told where the task stated one."""
        shift = self._rotation @ (np.array(place) - np.array(self.task.cup.place))
        way = told_way(shift)
        at = told_cup_place(place)
        moves = way and not self._place_is_open
        sentence = f"Move the cup {way}, to {at}." if moves else f"Put the cup at {at}."
        steps = (put("/cup/position", numbers(np.array(place))),)
        return TaskChange("cup_place", sentence, steps, heading(shift), float(np.linalg.norm(shift)))

    def _hands(self) -> Iterator[TaskChange | None]:
        """All that the arms' payloads and the gripper allow, where the task asks for less."""
        stated, scene = self.task.hand_force_limit, self.scene
        hand = scene.cell.gripper(scene.cell.gripper_arms[0])
        payloads = payload_forces(scene.cell)
        most = math.ceil(10.0 * max(payloads)) / 10.0
        limits = {"normal": max(stated.normal, most), "net": max(stated.net, most)}
        asked = hand_force_limit(scene)
        if asked.normal < most or min(asked.grip, asked.push) < min(payloads):
            yield from self._of([self._limits(limits, stated.squeeze)], forces=True)
        if scene.squeeze is not None:
            harder = {min(round(more * scene.squeeze), hand.force_max) for more in _SQUEEZES} - {scene.squeeze}
            yield from self._of((self._limits(limits, squeeze) for squeeze in sorted(harder)), forces=True)

    def _limits(self, limits: dict[str, float], squeeze: float | None) -> TaskChange:
        told = "" if squeeze is None else f", and let the gripper squeeze with {squeeze:g} N"
        sentence = f"Let the hands bear all that the arms' payloads leave: {limits['net']:g} N each at most{told}."
        steps = (put("/hand_force_limit", {**limits, "squeeze": squeeze}),)
        return TaskChange("hand_limits", sentence, steps, "more", squeeze or 0.0)

    def _lifter(self) -> Iterator[TaskChange | None]:
        others = [name for name in _OTHER_LIFTERS if name != self.task.lifter_model]
        yield from self._of((_other_lifter(name) for name in others), forces=True)

    def _tolerances(self, *, blamed: bool = False) -> Iterator[TaskChange | None]:
        """Smaller tolerances; where they are blamed, the smallest first.

        The plate as stated has a plan then, which keeps nothing back: no more is asked of a way with smaller ones.
        """
        mass, com = self.task.plate.mass_tolerance, self.task.plate.com_tolerance
        if not mass and not com:
            return
        for share in sorted(_TOLERANCES, reverse=not blamed):
            change = replace(_known_better(mass * share, com * share), way="better", size=1.0 - share)
            if self._leaves_a_way(change, forces=True, kept=0.0 if blamed else None):
                yield change

    # Places.

    def _plate_turned(self) -> Iterator[TaskChange | None]:
        turns = (
            replace(self._turned(angle), way="counterclockwise" if angle > 0.0 else "clockwise", size=abs(angle))
            for angle in _TURNS
        )
        yield from self._of(turns, forces=False)

    def _plate_place(self) -> Iterator[TaskChange | None]:
        places = (
            TaskChange(
                "plate_place",
                f"Move the plate {self._told_move(way)}.",
                self._plate_moved(way),
                heading(way),
                float(np.linalg.norm(way)),
            )
            for way in self._plate_ways()
        )
        yield from self._of(places, forces=False)

    def _turned(self, angle: float) -> TaskChange:
        return TaskChange("plate_yaw", f"Turn the plate by {turning(angle)}.", self._plate_moved(np.zeros(2), angle))

    def _plate_ways(self) -> list[Array]:
        """Return ways (2,) for the plate [m], the least first: straight on, and towards where both arms reach best."""
        lengths = _WAYS if self._planner.out_of_reach() is None else _OUT_OF_REACH_WAYS
        ways = [self.scene.cell.size * length * way for length in lengths for way in straight_ways()]
        if self._is_far_off:
            ways += [np.round(share * self._way_to_best, 2) for share in _TOWARDS_BEST]
        return sorted(ways, key=lambda way: round(float(np.linalg.norm(way)), 6))

    @cached_property
    def _way_to_best(self) -> Array:
        """The way (2,) of the plate's centre of mass to where both arms reach best [m]."""
        plate = self.scene.plate
        return way_to_best(
            self.scene.cell, (plate.T_world_body[:3, :3] @ plate.com + plate.T_world_body[:3, 3]).tolist()
        )

    @property
    def _is_far_off(self) -> bool:
        return float(np.linalg.norm(self._way_to_best)) > least_reach(self.scene.cell)

    def _told_move(self, way: Array) -> str:
        return told_move(way, self.task.plate_pose)

    def _plate_moved(self, way: Array, turn: float = 0.0) -> tuple[PatchOperation, ...]:
        """Move and turn the plate with the board that it lies on: the plate stays where it is on that."""
        steps = [put("/plate_pose", moved_pose(self.task.plate_pose, way, turn))]
        support = self.task.support
        if support is not None:
            beside = np.subtract(support.pose[:2], self.task.plate_pose[:2])
            swung = rotation_z(turn)[:2, :2] @ beside - beside
            steps.append(put("/support/pose", moved_pose(support.pose, way + swung, turn)))
        return tuple(steps)

    def _board(self) -> Iterator[TaskChange | None]:
        """A board under a plate that hands cannot get beside on the bare table, or one as large as the plate."""
        yield from self._of(map(self._on_board, self._boards), forces=False)

    @property
    def _boards(self) -> tuple[float, ...]:
        """Thickness [m] of the boards that help, the thinnest first; none where one as large as the plate is there."""
        if self.task.support is None:
            return tuple(self.scene.cell.size * board for board in _BOARDS)
        given = self.scene.support_top - self.scene.cell.table_top
        return (given,) if self.scene.surface_beyond > _FLUSH else ()

    def _on_board(self, thickness: float) -> TaskChange:
        """Put the plate on a board of its own outline: hands come beside its edges, lower than the plate."""
        shape, top = self.task.plate.shape, self.scene.cell.table_top + thickness
        size = {"size": [*shape.size[:2], round(thickness, 9)]} if isinstance(shape, Box) else {"height": thickness}
        x, y, z, *turn = self.task.plate_pose
        board = [x, y, round(top - 0.5 * thickness, 9), *turn]
        support = Support.model_validate({"shape": {**shape.model_dump(mode="json"), **size}, "pose": board})
        raised = round(z + top - self.scene.support_top, 9)
        sentence = (
            f"Put the plate on a board of {1e3 * thickness:.0f} mm that is as large as it is, so that hands come "
            "beside it."
        )
        steps = (
            put("/support", support.model_dump(mode="json")),
            put("/plate_pose", [x, y, raised, *turn]),
        )
        return TaskChange("support", sentence, steps, "thicker", thickness)

    def _to_the_edge(self) -> Iterator[TaskChange | None]:
        """The plate on the table, a side at the nearest of its edges, so that a hand comes to it from beyond."""
        table, plate = self.scene.cell.boxes[0], self.scene.plate
        corners = plate.outline @ self._rotation.T + plate.T_world_body[:2, 3]
        low, high = table.center[:2] - 0.5 * table.size[:2], table.center[:2] + 0.5 * table.size[:2]
        beyond = ((-1.0, corners.min(axis=0) - low), (1.0, high - corners.max(axis=0)))
        ways = [sign * gap * axis for sign, gaps in beyond for gap, axis in zip(gaps, np.eye(2), strict=True)]
        nearest = sorted((way for way in ways if np.linalg.norm(way) > 0.0), key=lambda way: float(np.linalg.norm(way)))
        yield from self._of(
            (self._at_the_edge(way) for way in nearest[:_EDGES]),
            forces=False,
        )

    def _at_the_edge(self, way: Array) -> TaskChange:
        moved = f"Move the plate {self._told_move(way)}, at the edge of the table"
        if self.task.support is None:
            return TaskChange("plate_place", f"{moved}.", self._plate_moved(way))
        x, y, z, *turn = self.task.plate_pose
        lowered = (x, y, z - (self.scene.support_top - self.scene.cell.table_top), *turn)
        steps = (put("/support", None), put("/plate_pose", moved_pose(lowered, way)))
        return TaskChange("plate_place", f"{moved}, without the support.", steps)

    def _given_holds(self) -> Iterator[TaskChange | None]:
        options = self.task.options
        given = [name for name in ("grips", "pushes") if getattr(options, name) is not None]
        if given:
            sentence = f"Leave out the given {' and '.join(given)}: let the planner choose them."
            steps = tuple(put(f"/options/{name}", None) for name in given)
            yield from self._of([TaskChange("holds", sentence, steps)], forces=False)

    # Obstacles.

    @cached_property
    def _without_obstacles(self) -> bool:
        """Whether there is a way with all obstacles taken away."""
        if not self.task.obstacles:
            return False
        return self._leaves_a_way(TaskChange("obstacle", "", (put("/obstacles", []),)), forces=False, kept=0.0)

    def _obstacles(self) -> Iterator[TaskChange | None]:
        """An obstacle moved or taken away, or two taken away; nothing where that leaves no way."""
        for index, obstacle in enumerate(self.task.obstacles):
            gone = TaskChange(
                "obstacle", f"Take {obstacle.name} away.", (removed(f"/obstacles/{index}"),), size=math.inf
            )
            if self._leaves_a_way(gone, forces=False, kept=0.0):
                yield gone
                yield from self._obstacle_changed(index, obstacle)
                return
        pairs = itertools.combinations(range(len(self.task.obstacles)), 2)
        for one, other in pairs:
            names = f"{self.task.obstacles[one].name} and {self.task.obstacles[other].name}"
            steps = (removed(f"/obstacles/{other}"), removed(f"/obstacles/{one}"))
            both = TaskChange("obstacle", f"Take {names} away.", steps)
            if self._leaves_a_way(both, forces=False, kept=0.0):
                yield both
                return

    def _obstacle_changed(self, index: int, obstacle: Obstacle) -> Iterator[TaskChange]:
        """Change the height of an obstacle, or move it straight away from the plate, in turns: as much of either."""
        ways = self._obstacle_height(index, obstacle), self._obstacle_moved(index, obstacle)
        pairs = itertools.zip_longest(*map(self._smallest, ways))
        yield from (change for pair in pairs for change in pair if change is not None)

    def _smallest(self, changes: Iterable[TaskChange]) -> Iterator[TaskChange]:
        """Yield those of one way that leave a way, the smallest first; none where the largest does not."""
        *smaller, largest = [*changes] or [None]
        if largest is not None and self._leaves_a_way(largest, forces=False):
            yield from (each for each in smaller if each is not None and self._leaves_a_way(each, forces=False))
            yield largest

    def _obstacle_height(self, index: int, obstacle: Obstacle) -> Iterator[TaskChange]:
        if index in self._stacked:
            return iter(())
        T_world_body = self.scene.obstacles[index].T_world_body
        return obstacle_out_of_the_way(index, obstacle, T_world_body, self.scene.cell.table_top, self.scene.cell.size)

    def _obstacle_moved(self, index: int, obstacle: Obstacle) -> Iterator[TaskChange]:
        """Move an obstacle straight away from the plate."""
        if index in self._stacked:
            return
        way = straightest(np.array(obstacle.pose[:2]) - self.scene.T_world_plate[:2, 3])
        for length in _OBSTACLE_WAYS:
            yield obstacle_moved(index, obstacle, self.scene.cell.size * length * way)


def _after(first: TaskChange, seconds: Iterator[TaskChange | None]) -> Iterator[TaskChange | None]:
    """Yield each of several changes after a first one, in their order of ways and sizes."""
    for second in seconds:
        yield None if second is None else replace(first.then(second), way=second.way, size=second.size)


def _other_lifter(name: str) -> TaskChange:
    sentence = f'Use a lifter {_OTHER_LIFTERS[name]}: the lifter model "{name}".'
    return TaskChange("lifter_model", sentence, (put("/lifter_model", name),))


def _known_better(mass: float, com: float) -> TaskChange:
    known = f"its mass to {100 * mass:.2g} % and its centre of mass to {1e3 * com:.2g} mm"
    sentence = f"Weigh and measure the plate: know {known}."
    steps = (put("/plate/mass_tolerance", mass), put("/plate/com_tolerance", com))
    return TaskChange("tolerances", sentence, steps)
