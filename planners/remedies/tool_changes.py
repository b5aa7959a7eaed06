"""Changes of a suction-tool task that may leave a way where there was none, the smallest of each kind first.

They concern the objects that the failed plan names, and obstacles if there is a plan without those. No screen says
beforehand which changes leave a way: a plan of one object is as fast as one.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cached_property, partial

import numpy as np
from pydantic import JsonValue

from planners.contract.problems import pad_beyond
from planners.contract.shapes import Cylinder
from planners.contract.task_spec import CustomTool, ObjectToMove, SuctionToolTask, ToolCup, ToolPart
from planners.geometry.pose import Array
from planners.plan.plan import Plan
from planners.plan.verdicts import Cause
from planners.remedies.change import (
    TaskChange,
    moved_pose,
    obstacle_moved,
    obstacle_out_of_the_way,
    obstacles_out_of_the_way,
    put,
    removed,
    stacked,
    standing_on_others,
    turning,
)
from planners.remedies.directions import (
    between_arms,
    heading,
    least_reach,
    straight_ways,
    straightest,
    told_move,
    way_to_best,
)
from planners.scene.standing import listed
from planners.scene.suction_tool import tool_file, tools_in
from planners.scene.tool_scene import SuctionToolScene

_WAYS = (0.05, 0.10, 0.20)
"""How far things are moved in a cell of size 1 [m]."""
_NEARER = (1.0, 0.8, 0.6, 0.3)
"""How near to where both arms reach best things are moved that are farther off, the least way first, as shares of an
arm's reach [1]."""
_NEAREST = 6
"""Obstacles that are taken away together, those nearest to a start or goal ..."""
_ALONE = 4
"""... and of these such as are taken away alone."""
_TURNS = tuple(math.radians(sign * angle) for angle in (45, 90) for sign in (1, -1))
_FIRST = 2
"""Changes of a kind that are tried together with those of another."""
_STRONGER = (1.5, 2.0, 3.0)
"""How many times the cup's force [1]."""
_PAD_HEIGHT = 0.01
"""Of a pad that is put before a tool whose shapes are narrower [m]."""
_OTHER_CUPS = (0.8, 0.6, 1.25)
"""How many times the cup's radius [1]."""
CUP_REASONS = (
    "heavier than the cup",
    "large as the pad",
    "can sit",
    "peel",
    "bends",
    "cup alone cannot hold",
    "flat enough to seal",
    "pad would reach over",
    "where the pad would be",
    "off the cup",
    "the cup.",
)
"""Words of causes for which another cup may help."""
_WEIGHT_REASONS = ("heavier than", "more of one hand", "cup alone cannot hold")
"""Words of causes that tell a weight [N] and what bears it."""
_SQUEEZE_REASONS = ("harder squeeze",)
"""Words of causes that tell the squeeze of fingers [N]."""
_PRESSED = (0.1, 0.3, 0.6)
"""How much more fingers press than the least that may help, as shares of what the gripper has left for that [1]."""
_LIGHTER = (1.0, 0.9, 0.8, 0.7, 0.6)
"""How much of what is borne an object weighs, the heaviest first [1]."""


class ToolChanges:
    """The changes of one suction-tool task that has no plan."""

    def __init__(
        self,
        task: SuctionToolTask,
        build: Callable[[SuctionToolTask], SuctionToolScene],
        failed: Plan,
        solves: Callable[[TaskChange], bool],
    ) -> None:
        """Find out what the failed plan is about.

        Args:
            task: as it was planned.
            build: makes scenes of tasks.
            failed: its plan, with what it names.
            solves: plans the changed task, if that may still be tried.
        """
        self.task, self._build, self._failed, self._solves = task, build, failed, solves
        scene = build(task)
        self._scene, self._cell, self._middle = scene, scene.cell, between_arms(scene.cell)
        self._reach = least_reach(scene.cell)
        self._gravity = float(np.linalg.norm(scene.cell.gravity))
        self._above = standing_on_others(scene.obstacles)
        self._stacked = stacked(self._above)
        self._explanation = explanation = failed.explanation
        self._told = " ".join([explanation.summary, *(f"{cause.reason} {cause.where}" for cause in explanation.causes)])
        named = [each for each in task.objects if self._names(each.name)]
        self._objects = [(task.objects.index(each), each) for each in named or task.objects]

    def by_kind(self) -> list[Iterator[TaskChange | None]]:
        """Return the changes of every kind, each in order of size; kinds that concern what is told come first."""
        # Obstacles do not keep physics from carrying out a plan that is clear of them, unless it names them.
        obstacles = self._named_obstacles() if self._failed.outcome == "solved" else self._obstacles()
        return self._kinds(obstacles, self._limits(alone=True))

    def _kinds(
        self, obstacles: Iterator[TaskChange | None], limits: Iterator[TaskChange | None]
    ) -> list[Iterator[TaskChange | None]]:
        cup: list[Iterator[TaskChange | None]] = [self._cup_force(), self._cup_radius()]
        starts_moved, goals_moved = self._starts(), self._goals()
        places: list[Iterator[TaskChange | None]] = [
            self._goals_turned(),
            starts_moved,
            goals_moved,
            self._starts_turned(),
        ]
        poses = [(each.pose, each.goal_pose) for _, each in self._objects]
        starts, goals = (
            max(np.linalg.norm(way_to_best(self._cell, pose)) for pose in member) for member in zip(*poses, strict=True)
        )
        far_off: list[Iterator[TaskChange | None]] = []
        if max(starts, goals) > _NEARER[0] * self._reach:
            far_off = [goals_moved] if goals >= starts else [starts_moved, goals_moved]
            places = [kind for kind in places if kind not in far_off]
        rest: list[Iterator[TaskChange | None]] = [self._tool(), limits, self._lighter(), self._aside()]
        first = [obstacles] if self.task.obstacles else []
        about_cup = any(word in self._told for word in CUP_REASONS)
        others = [*first, *cup, *places, *rest] if about_cup else [*first, *places, *rest]
        # What is far off has to come nearer, most likely.
        return [*far_off, *others]

    def in_pairs(self) -> list[Iterator[TaskChange]]:
        """Return two changes at once, for where no single one helps: of different kinds, of each the first ones."""
        kinds = self._kinds(self._named_obstacles(), self._limits(alone=False))
        firsts = [list(itertools.islice((each for each in kind if each is not None), _FIRST)) for kind in kinds]
        return [
            self._of(both for pair in itertools.product(some, others) if (both := self._together(*pair)) is not None)
            for some, others in itertools.combinations(firsts, 2)
        ]

    def _together(self, one: TaskChange, other: TaskChange) -> TaskChange | None:
        """Return two changes of the task as one; None where one of them is lost beside the other."""
        values = {step.path: step.value for step in one.patch if step.op == "add"}
        merged = {
            step.path: put(step.path, _merged(self._stated(step.path), values[step.path], step.value))
            for step in other.patch
            if step.op == "add" and step.path in values
        }
        first = [step for step in one.patch if step.path not in merged]
        both = replace(one.then(other), patch=(*first, *(merged.get(step.path, step) for step in other.patch)))
        alone = [each.applied(self.task) for each in (one, other)]
        return None if both.applied(self.task) in alone else both

    def _stated(self, path: str) -> JsonValue:
        """Return a member that several kinds of changes write, as one would that changes nothing of it."""
        if path == "/tool":
            tool = self._description()
            return None if tool is None else tool.model_dump(mode="json")
        poses = {
            f"/objects/{index}/{member}": getattr(each, member)
            for index, each in self._objects
            for member in ("pose", "goal_pose")
        }
        return moved_pose(poses[path], np.zeros(2)) if path in poses else None

    def _names(self, name: str) -> bool:
        """Whether what is told names a thing, and not only another one whose name begins or ends alike."""
        return re.search(rf"(?<![\w-]){re.escape(name)}(?![\w-])", self._told) is not None

    def _of(self, changes: Iterable[TaskChange]) -> Iterator[TaskChange]:
        """Yield those of which there is a scene."""
        return (change for change in changes if change.built(self.task, self._build) is not None)

    # Objects and goals.

    def _starts(self) -> Iterator[TaskChange]:
        yield from self._of(self._moved("pose", "object_place", "Move {} {}."))

    def _goals(self) -> Iterator[TaskChange]:
        yield from self._of(self._moved("goal_pose", "goal_place", "Move the goal of {} {}."))

    def _moved(self, member: str, kind: str, sentence: str) -> Iterator[TaskChange]:
        """Move start or goal: towards the place that both arms reach best, and a little everywhere."""
        for near in (share * self._reach for share in _NEARER):
            for index, each in self._objects:
                way = way_to_best(self._cell, getattr(each, member))
                distance = float(np.linalg.norm(way))
                if distance > near:
                    yield self._shifted(index, each, member, kind, sentence, np.round(way * (1.0 - near / distance), 2))
        towards, left, right, away = straight_ways()
        for length in (self._cell.size * way for way in _WAYS):
            for index, each in self._objects:
                off = np.array(getattr(each, member)[:2]) - self._middle
                inwards, outwards = (right, left) if off @ left >= 0.0 else (left, right)
                for way in (inwards, towards, away, outwards):
                    yield self._shifted(index, each, member, kind, sentence, length * way)

    def _shifted(self, index: int, each: ObjectToMove, member: str, kind: str, sentence: str, way: Array) -> TaskChange:
        pose = getattr(each, member)
        told = sentence.format(each.name, told_move(way, pose))
        steps = (put(f"/objects/{index}/{member}", moved_pose(pose, way)),)
        return TaskChange(kind, told, steps, f"{each.name} {heading(way)}", float(np.linalg.norm(way)))

    def _starts_turned(self) -> Iterator[TaskChange]:
        yield from self._of(self._turned("pose", "object_yaw", "Turn {} by {}."))

    def _goals_turned(self) -> Iterator[TaskChange]:
        free = (self._any_turn(index, each) for index, each in self._objects if each.goal_symmetry == "none")
        yield from self._of(free)
        yield from self._of(self._turned("goal_pose", "goal_yaw", "Turn the goal of {} by {}."))

    def _any_turn(self, index: int, each: ObjectToMove) -> TaskChange:
        sentence = f"Let {each.name} come to its goal turned in any way that looks the same."
        return TaskChange("goal_yaw", sentence, (put(f"/objects/{index}/goal_symmetry", "shape"),))

    def _turned(self, member: str, kind: str, sentence: str) -> Iterator[TaskChange]:
        for angle in _TURNS:
            for index, each in self._objects:
                pose = moved_pose(getattr(each, member), np.zeros(2), angle)
                told = sentence.format(each.name, turning(angle))
                way = f"{each.name} {'counterclockwise' if angle > 0.0 else 'clockwise'}"
                yield TaskChange(kind, told, (put(f"/objects/{index}/{member}", pose),), way, abs(angle))

    def _aside(self) -> Iterator[TaskChange]:
        """Leave an object out of the task: somebody else puts it aside.

        Without one that is proven not to be moved the others can be, of course: that is no help.
        """
        proven = [] if self._failed.outcome == "not_found" else [each.name for _, each in self._objects]
        if len(self.task.objects) > 1:
            yield from self._of(
                TaskChange(
                    "object_aside",
                    f"Leave {each.name} out, and take it off the table.",
                    (removed(f"/objects/{index}"),),
                )
                for index, each in enumerate(self.task.objects)
                if each.name not in proven
            )

    def _lighter(self) -> Iterator[TaskChange]:
        """Have an object weigh what cup, fingers and hand bear of it, where they are told not to bear it."""
        for index, each in self._objects:
            excess = [
                cause.needed - cause.available
                for cause in self._explanation.causes
                if cause.where == each.name and any(words in cause.reason for words in _WEIGHT_REASONS)
                if cause.needed is not None and cause.available is not None and cause.unit == "N"
            ]
            if excess and each.mass is not None:
                too_much = max(excess) / self._gravity
                most = each.mass - too_much
                yield from self._of(self._of_mass(index, each, share * most, too_much) for share in _LIGHTER)

    def _of_mass(self, index: int, each: ObjectToMove, mass: float, too_much: float) -> TaskChange:
        """Have an object weigh less; by no more than `too_much` less is known not to help [kg]."""
        assert each.mass is not None
        mass = math.floor(100.0 * mass) / 100.0
        sentence = f"Make {each.name} lighter, or move it in parts: {mass:g} kg instead of {each.mass:g} kg."
        stated = each.mass

        def of(size: float) -> TaskChange:
            return self._of_mass(index, each, stated - size, too_much)

        steps = (put(f"/objects/{index}/mass", mass),)
        return TaskChange("mass", sentence, steps, each.name, stated - mass, too_much, of)

    # Obstacles.

    def _obstacles(self) -> Iterator[TaskChange | None]:
        """One obstacle taken away or changed, or several together; nothing where there is no plan without any."""
        near = self._near_obstacles()
        if not near or (len(near) > 1 and not self._solves(self._away(near))):
            return
        for one in near[:_ALONE]:
            if self._solves(self._away([one])):
                yield self._away([one])
                yield from self._smallest(self._heights(one))
                yield from self._smallest(self._obstacle_moved(one))
                return
        if len(near) > 1:
            few = self._fewest(near)
            bodies = {
                index: (self.task.obstacles[index], self._scene.obstacles[index].T_world_body)
                for index in few
                if index not in self._stacked
            }
            yield self._away(few)
            yield from self._smallest(obstacles_out_of_the_way(bodies, self._cell.table_top, self._cell.size))

    def _smallest(self, changes: Iterable[TaskChange]) -> Iterator[TaskChange | None]:
        """Yield the smallest change of one way that helps and the largest, from the smallest on; None where none does.

        The largest is planned first: where it does not help, no smaller one does.
        """
        *smaller, largest = [*self._of(changes)] or [None]
        if largest is None or not self._solves(largest):
            yield None
            return
        yield from itertools.islice((each for each in smaller if each is not None and self._solves(each)), 1)
        yield largest

    def _fewest(self, near: list[int]) -> list[int]:
        """Return the least first part of obstacles, in order, without which there is a plan, as without all of them."""
        known, enough = 1, len(near)
        while enough - known > 1:
            middle = (known + enough) // 2
            if self._solves(self._away(near[:middle])):
                enough = middle
            else:
                known = middle
        return sorted(near[:enough])

    def _named_obstacles(self) -> Iterator[TaskChange | None]:
        """Those that the failed plan names, each changed or taken away."""
        for index, each in enumerate(self.task.obstacles):
            if self._names(each.name):
                yield from self._obstacle_changed(index)

    def _near_obstacles(self) -> list[int]:
        """Return the numbers of some obstacles: those named come first, then those nearest to a start or goal."""
        spots = self._spots()

        def order(index: int) -> tuple[bool, float]:
            body = self._scene.obstacles[index]
            corners = body.solid.surface()[0] @ body.T_world_body[:3, :3].T + body.T_world_body[:3, 3]
            low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
            gaps = np.maximum(np.maximum(low - spots, spots - high), 0.0)
            return not self._names(body.name), float(np.linalg.norm(gaps, axis=1).min())

        return sorted(range(len(self.task.obstacles)), key=order)[:_NEAREST]

    def _away(self, numbers: list[int]) -> TaskChange:
        """Take obstacles away with what stands on them, the last one first, so that the others keep their numbers."""
        for number in (numbers := [*numbers]):
            numbers += [each for each in self._above.get(number, []) if each not in numbers]
        steps = tuple(removed(f"/obstacles/{index}") for index in sorted(numbers, reverse=True))
        names = listed([self.task.obstacles[index].name for index in sorted(numbers)])
        return TaskChange("obstacle", f"Take {names} away.", steps, size=math.inf)

    def _obstacle_changed(self, index: int) -> Iterator[TaskChange]:
        """Yield changes of the height and the place of an obstacle, in turns, and at last without it."""
        pairs = itertools.zip_longest(self._heights(index), self._obstacle_moved(index))
        yield from self._of(change for pair in pairs for change in pair if change is not None)
        yield from self._of([self._away([index])])

    def _heights(self, index: int) -> Iterator[TaskChange]:
        obstacle, T_world_body = self.task.obstacles[index], self._scene.obstacles[index].T_world_body
        if index in self._stacked:
            return iter(())
        return obstacle_out_of_the_way(index, obstacle, T_world_body, self._cell.table_top, self._cell.size)

    def _spots(self) -> Array:
        """Return where objects start and go to: (n, 2) [m, world]."""
        return np.array([pose[:2] for _, each in self._objects for pose in (each.pose, each.goal_pose)])

    def _obstacle_moved(self, index: int) -> Iterator[TaskChange]:
        """Move an obstacle away from the nearest start or goal."""
        if index in self._stacked:
            return
        obstacle = self.task.obstacles[index]
        place, spots = np.array(obstacle.pose[:2]), self._spots()
        off = place - spots[np.argmin(np.linalg.norm(spots - place, axis=1))]
        way = straightest(off)
        for length in _WAYS[1:]:
            yield obstacle_moved(index, obstacle, self._cell.size * length * way)

    # The tool and what bears it.

    def _tool(self) -> Iterator[TaskChange]:
        others = [name for name in tools_in(self._cell) if name != self.task.tool]
        yield from self._of(TaskChange("tool", f'Use the tool "{name}".', (put("/tool", name),)) for name in others)

    def _description(self) -> CustomTool | None:
        """Return what a task would say of the tool; None: it has meshes that no task can name."""
        tool = self.task.tool
        if isinstance(tool, CustomTool):
            return tool
        return tool_file(tool, self._cell).tool.as_task()

    def _cup_force(self) -> Iterator[TaskChange]:
        tool = self._description()
        if tool is None:
            return
        yield from self._of(_stronger_cup(tool, more * tool.cup.max_force) for more in _STRONGER)

    def _cup_radius(self) -> Iterator[TaskChange]:
        tool = self._description()
        if tool is None:
            return
        stated = tool.cup.radius
        for share in _OTHER_CUPS:
            radius = round(share * stated, 4)
            told = f"Use a cup of {1e3 * radius:.3g} mm radius instead of {1e3 * stated:.3g} mm."
            way, size = "larger" if share > 1.0 else "smaller", abs(share - 1.0)
            yield from self._of([_other_cup(tool, "cup_radius", told, {"radius": radius}, way, size)])

    def _limits(self, *, alone: bool) -> Iterator[TaskChange | None]:
        """More of what the arms' payloads and the gripper allow, where the task asks for less.

        Of what fingers press with it is as little as helps, if that is to help alone; all of it beside other changes.
        """
        if self.task.carry_force_limit is not None:
            sentence = "Let a hand carry all that its arm's payload leaves."
            yield from self._of([TaskChange("hand_limits", sentence, (put("/carry_force_limit", None),))])
        most = min(self._cell.gripper(arm).force_max for arm in self._cell.gripper_arms)
        if self.task.grip_force_limit < most:
            forces = map(self._pressing, self._finger_forces(most) if alone else [most])
            yield from self._smallest(forces) if alone else self._of(forces)

    def pressed_hardest(self) -> list[Iterator[TaskChange | None]]:
        """Return the change that has fingers press as hard as the gripper can, where plans are short of squeeze."""
        most = min(self._cell.gripper(arm).force_max for arm in self._cell.gripper_arms)
        if self.task.grip_force_limit >= most or not any(map(_is_short_of_squeeze, self._explanation.causes)):
            return []
        # Less would keep even less back.
        return [self._of([replace(self._pressing(most), of_size=None)])]

    def _finger_forces(self, most: float) -> list[float]:
        """Return what a finger may press with, up to the most that the gripper does [N]: whole newtons before that."""
        stated = self.task.grip_force_limit
        least = stated + self._missing_press
        between = {math.ceil(least + share * (most - least)) for share in _PRESSED}
        return [*sorted(force for force in between if stated < force < most), most]

    @cached_property
    def _missing_press(self) -> float:
        """How much more fingers have to press at least, as the plan tells [N]; 0: it does not.

        Of the ways of one object, each told with its own, the least may do, and all objects need one.
        """
        short = dict[str, float]()
        names = [each.name for _, each in self._objects]
        for cause in self._explanation.causes:
            if _is_short_of_squeeze(cause):
                named = str(cause.where) if cause.where in names else ""
                missing = (cause.needed or 0.0) - (cause.available or 0.0)
                short[named] = min(missing, short.get(named, math.inf))
        return max(0.0, *short.values(), 0.0)

    def _pressing(self, force: float) -> TaskChange:
        stated = self.task.grip_force_limit
        sentence = f"Let a finger press with up to {force:g} N instead of {stated:g} N."
        more = force - stated

        def of(size: float) -> TaskChange:
            return self._pressing(float(math.ceil(stated + size)))

        steps = (put("/grip_force_limit", force),)
        return TaskChange("hand_limits", sentence, steps, "press", more, self._missing_press, of)


def _is_short_of_squeeze(cause: Cause) -> bool:
    return any(words in cause.reason for words in _SQUEEZE_REASONS) and cause.unit == "N"


def _merged(stated: JsonValue, one: JsonValue, other: JsonValue) -> JsonValue:
    """Return a member that two changes write as both together have it; where both write one part, as the second does.

    Args:
        stated: the member before.
        one: after the first change alone.
        other: after the second change alone.
    """
    if isinstance(one, dict) and isinstance(other, dict) and isinstance(stated, dict):
        names = [*one, *(name for name in other if name not in one)]
        return {name: _merged(stated.get(name), one.get(name), other.get(name)) for name in names}
    if isinstance(one, list) and isinstance(other, list) and isinstance(stated, list):
        if len(stated) == len(one) == len(other):
            return [_merged(*each) for each in zip(stated, one, other, strict=True)]
    return one if other == stated else other


def _stronger_cup(tool: CustomTool, force: float) -> TaskChange:
    """Give a tool a cup that pulls with a force [N], to a tenth of a newton."""
    stated, force = tool.cup.max_force, round(force, 1)
    told = f"Use a cup, or a vacuum, that pulls with {force:g} N instead of {stated:g} N."
    change = _other_cup(tool, "cup_force", told, {"max_force": force}, "stronger", force)
    return replace(change, none=stated, of_size=partial(_stronger_cup, tool))


def _other_cup(
    tool: CustomTool, kind: str, sentence: str, members: dict[str, float], way: str, size: float
) -> TaskChange:
    """Describe a tool in full, with another cup; what follows from the cup's force follows from the new one."""
    cup = {"radius": tool.cup.radius, "max_force": tool.cup.max_force, "mu": tool.cup.mu}
    # As it is not told in a task that was read whether it says kappa itself.
    is_default = math.isclose(ToolCup.model_validate(cup).kappa, tool.cup.kappa, rel_tol=1e-6)
    own = {} if is_default else {"kappa": tool.cup.kappa}
    parts, other = tool.shapes, ToolCup.model_validate({**cup, **own, **members})
    if pad_beyond(tool.model_copy(update={"cup": other})) > pad_beyond(tool):
        # Its rim must not touch anything either.
        pad = Cylinder(type="cylinder", radius=other.radius, height=_PAD_HEIGHT)
        parts = (*parts, ToolPart(shape=pad, pose=(0.0, 0.0, 0.5 * _PAD_HEIGHT, 1.0, 0.0, 0.0, 0.0)))
    described = {
        **tool.model_dump(mode="json"),
        "shapes": [part.model_dump(mode="json") for part in parts],
        "cup": {**cup, **own, **members},
    }
    return TaskChange(kind, sentence, (put("/tool", described),), way, size)
