"""Putting tool and objects of a suction-tool task where it says, at rest on what carries them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import numpy as np
from scipy.spatial import KDTree

from planners.cell.cell import Cell
from planners.contract.task_spec import ObjectToMove, SuctionToolTask
from planners.errors import SceneError, SceneFaults
from planners.geometry.convex import sorted_pair
from planners.geometry.pose import Array, Transform, from_pose7
from planners.scene.body import Body
from planners.scene.clashes import (
    BodyInCell,
    PlacedBody,
    first_overlap,
    placed_at_start,
    placed_body,
    raised,
    refuse_inside,
    refuse_overlaps,
)
from planners.scene.moved_object import MovedObject, symmetry_turns
from planners.scene.placements import box_top, in_hull, still_excess
from planners.scene.rest import Footing, LevelFace, Unsupported, find_footing, level_places, lowest_point
from planners.scene.shape_source import ShapeSource, mesh_solid
from planners.scene.solid import ExtrudedSolid
from planners.scene.standing import Fall, Standing, first_fall
from planners.scene.suction_tool import SuctionTool, check_tool, find_tool

RAISE = 1e-4
"""So far above what carries it, beyond what their drawings exceed them by, a body must be clear of it [m]."""
GOAL_OFF = 1e-3
"""So far off its goal may an object end, as certificates allow [m]."""
SAME_GOAL = 1e-4
"""A turned goal that settling moves by more does not rest [m or rad]."""


class ObjectsFall(SceneError):
    """Objects do not stand together; the member that places each of them is pointed at."""

    def __init__(self, fall: Fall, pointers: Mapping[str, str], when: str) -> None:
        pointer, *others = (pointers[name] for name in fall.names)
        super().__init__(pointer, f"{when}, {fall}", others=others)


@dataclass(frozen=True, eq=False)
class StillBodies:
    """What never moves: the cell's own bodies and the obstacles."""

    cell: tuple[PlacedBody, ...]
    """The cell's own."""
    bodies: tuple[PlacedBody, ...]
    """All of them."""
    places: tuple[LevelFace, ...]
    """Level places of all of them that others may rest on."""
    excess: dict[str, float]
    """By name, how far a body's convex shapes reach beyond it [m]."""

    @classmethod
    def of(cls, cell: Cell, obstacles: Sequence[Body]) -> Self:
        """Collect what stands in a cell."""
        own = tuple(placed_body(body, np.eye(4), None) for body in cell.bodies)
        bodies = list(own)
        places = [box_top(static) for static in cell.boxes]
        for still in cell.meshes:
            places += level_places(still.name, mesh_solid(still.mesh), still.T_world_mesh)
        for i, body in enumerate(obstacles):
            bodies.append(placed_body(body.collision_body(), body.T_world_body, f"/obstacles/{i}/pose"))
            places += level_places(body.name, body.solid, body.T_world_body)
        return cls(
            own, tuple(bodies), tuple(places), still_excess(cell) | {body.name: body.solid.excess for body in obstacles}
        )


def place_tool(
    task: SuctionToolTask, cell: Cell, still: StillBodies, shapes: ShapeSource, tools: Mapping[str, SuctionTool]
) -> SuctionTool:
    """Settle the tool where the task says, else in the cell's rest: standing on its cup, or lying.

    Args:
        task: names or describes it.
        cell: has the rest.
        still: what it may stand on.
        shapes: where meshes come from.
        tools: shipped ones that were loaded before; others are read from their files.

    Raises:
        SceneError: It is no tool, or does not rest.
    """
    T_world_tool = _tool_pose(task, cell)
    tool = find_tool(task.tool, cell, shapes, tools)
    check_tool(tool)
    footing = find_footing(tool.body.solid, T_world_tool, tool.com, still.places)
    if isinstance(footing, Unsupported):
        raise SceneError("/tool_pose", f"the tool {footing.reason}")
    if task.tool_pose is None:
        _refuse_unfit(tool.at(footing.T_world_body).body, cell, still)
    return replace(tool.at(footing.T_world_body), supports=footing.supports)


def place_objects(
    given: Sequence[ObjectToMove], still: StillBodies, shapes: ShapeSource, faults: SceneFaults
) -> tuple[MovedObject, ...] | None:
    """Settle all objects, at the start and at their goals, each on what stands still or on other objects.

    What is wrong is added to `faults`: an object rests on nothing, its centre of mass is outside it, goals overlap, or
    objects would fall with what rests on them. None if objects could not be settled; goals of the others are looked at.
    """
    made = [faults.tried(partial(_body, one, f"/objects/{i}", shapes)) for i, one in enumerate(given)]
    bodies = [body for body in made if body is not None]
    if len(bodies) < len(made):
        return None
    starts = _settle_all(bodies, [body.T_world_body for body in bodies], still, _refuse_start, faults)
    goals = _settle_all(bodies, [from_pose7(one.goal_pose) for one in given], still, _refuse_goal, faults)
    settled = len(starts) == len(goals) == len(bodies)
    if settled:
        for i, body in enumerate(bodies):
            if _changes(body, starts[i], goals[i]) and (inside := goals[i].inside(body.com)) < GOAL_OFF:
                faults.add(_refuse_goal(i, body.name, _nearly_tips(inside)))
        faults.tried(lambda: _refuse_fall(bodies, starts, "pose", "at the start"))
        faults.tried(lambda: _refuse_fall(bodies, goals, "goal_pose", "at their goals"))
    at_goals = [
        placed_body(bodies[i].collision_body(), goals[i].T_world_body, f"/objects/{i}/goal_pose") for i in sorted(goals)
    ]
    there = {body.name for body in (*still.bodies, *at_goals)}
    supports = {bodies[i].name: tuple(filter(there.__contains__, goal.supports)) for i, goal in goals.items()}
    excess = still.excess | {body.name: body.solid.excess for body in bodies}
    when = "at its goal"
    faults.tried(lambda: refuse_inside(at_goals, still.cell, excess, when))
    faults.tried(lambda: refuse_overlaps_but_rest(at_goals, [*still.bodies, *at_goals], supports, excess, when))
    if not settled:
        return None
    pile = _GoalPile(bodies, [goals[i] for i in range(len(bodies))], at_goals, still, Standing(still.places))
    objects = []
    for i, one in enumerate(given):
        start, goal = starts[i], goals[i]
        body = replace(bodies[i], T_world_body=start.T_world_body)
        turns = pile.turns_at_rest(i, symmetry_turns(body.solid, one.goal_symmetry))
        objects.append(
            MovedObject(
                body=body,
                T_world_goal=goal.T_world_body,
                symmetry=one.goal_symmetry,
                goal_turns=turns,
                start_supports=start.supports,
                goal_supports=goal.supports,
                T_world_start_given=bodies[i].T_world_body,
                T_world_goal_given=from_pose7(one.goal_pose),
            )
        )
    return tuple(objects)


def refuse_overlaps_but_rest(
    group: Sequence[PlacedBody],
    others: Sequence[PlacedBody],
    supports: dict[str, tuple[str, ...]],
    excess: dict[str, float],
    when: str,
) -> None:
    """Check that bodies are clear of others; those that carry them must be clear once they are raised a little.

    Args:
        group: bodies.
        others: what they must be clear of; may contain them.
        supports: names of what carries each body of the group.
        excess: by name, how far convex shapes reach beyond a body [m]; not listed: not at all.
        when: ends the sentence that refuses.

    Raises:
        BodiesOverlap: Pairs overlap.
    """
    resting = frozenset(sorted_pair(name, support) for name, below in supports.items() for support in below)
    faults = SceneFaults()
    faults.tried(lambda: refuse_overlaps(group, [other for other in others if other not in group], resting, when))
    faults.tried(lambda: refuse_overlaps(group, group, resting, when))
    by_name = {other.name: other for other in (*others, *group)}
    for body in group:
        for support in supports[body.name]:
            height = RAISE + excess.get(body.name, 0.0) + excess.get(support, 0.0)
            faults.tried(partial(refuse_overlaps, [raised(body, height)], [by_name[support]], (), when))
    faults.raise_any()


def _body(given: ObjectToMove, pointer: str, shapes: ShapeSource) -> Body:
    shape, solid = shapes.find(given.shape, f"{pointer}/shape")
    com = solid.centroid if given.com is None else np.array(given.com)
    if not in_hull(solid, com):
        raise SceneError(f"{pointer}/com", f"the centre of mass is not inside {given.name}")
    return Body(given.name, "object", shape, solid, given.mass, com, from_pose7(given.pose), static=False)


def _tool_pose(task: SuctionToolTask, cell: Cell) -> Transform:
    if task.tool_pose is not None:
        return from_pose7(task.tool_pose)
    if cell.tool_rest is None:
        raise SceneError("/tool_pose", f"the cell {cell.name} has no tool rest; say where the tool is")
    return cell.tool_rest.T_world_tool


def _refuse_unfit(tool: Body, cell: Cell, still: StillBodies) -> None:
    """Refuse a tool that the cell's rest is too narrow for, if nobody has said to put it there."""
    try:
        refuse_inside([placed_at_start(tool, "/tool_pose")], still.cell, {tool.name: tool.solid.excess})
    except BodyInCell as unfit:
        detail = (
            f"the rest of {cell.name}, where a tool stands if nothing is said, does not take this one: {unfit.detail}"
        )
        raise SceneError("/tool_pose", f"{detail}; say where it stands, for instance on the table") from unfit


Refuse = Callable[[int, str, str], SceneError]


def _refuse_start(index: int, name: str, reason: str) -> SceneError:
    return SceneError(f"/objects/{index}/pose", f"{name} {reason}")


def _refuse_goal(index: int, name: str, reason: str) -> SceneError:
    return SceneError(f"/objects/{index}/goal_pose", f"at its goal, {name} {reason}")


def _settle_all(
    bodies: Sequence[Body], poses: Sequence[Transform], still: StillBodies, refuse: Refuse, faults: SceneFaults
) -> dict[int, Footing]:
    """Settle bodies from the bottom up, each on what stands still and on those below it.

    Returns:
        The footings by number. Those that rest on nothing have none and are added to `faults`; not what rests on them.
    """
    places = list(still.places)
    footings: dict[int, Footing] = {}
    for i in sorted(range(len(bodies)), key=lambda i: lowest_point(bodies[i].solid, poses[i])):
        body = bodies[i]
        footing = find_footing(body.solid, poses[i], body.com, places)
        if isinstance(footing, Unsupported):
            faults.add(refuse(i, body.name, footing.reason))
            places += level_places(body.name, body.solid, poses[i])
        else:
            footings[i] = footing
            places += level_places(body.name, body.solid, footing.T_world_body)
    return footings


def _refuse_fall(bodies: Sequence[Body], footings: Mapping[int, Footing], member: str, when: str) -> None:
    fall = first_fall(bodies, [footings[i] for i in range(len(bodies))])
    if fall is not None:
        pointers = {body.name: f"/objects/{i}/{member}" for i, body in enumerate(bodies)}
        raise ObjectsFall(fall, pointers, when)


@dataclass(frozen=True, eq=False)
class _GoalPile:
    """All objects at their goals, one of which may be turned."""

    bodies: Sequence[Body]
    footings: Sequence[Footing]
    placed: Sequence[PlacedBody]
    still: StillBodies
    standing: Standing

    def turns_at_rest(self, index: int, turns: Array) -> Array:
        """Return those turns (k, 4, 4) of a goal after which all objects stand, and are clear of one another."""
        body, footing = self.bodies[index], self.footings[index]
        places = [*self.still.places, *self._places_of_others(index)]
        under = [place for place in places if place.name in footing.supports]

        def is_kept(turn: Transform) -> bool:
            T = footing.T_world_body @ turn
            return _changes_nothing(body, turn) or (self._rests(index, T, under) and self._is_clear(index, T))

        return np.array([turns[0], *filter(is_kept, turns[1:])])

    def _rests(self, index: int, T_world_body: Transform, under: Sequence[LevelFace]) -> bool:
        """Tell whether a turned object rests where it is on what is under it, and all others with it."""
        body = self.bodies[index]
        footing = find_footing(body.solid, T_world_body, body.com, under)
        if isinstance(footing, Unsupported) or float(np.abs(footing.T_world_body - T_world_body).max()) > SAME_GOAL:
            return False
        if footing.inside(body.com) < min(GOAL_OFF, self.footings[index].inside(body.com)):
            return False
        goals = {one.name: (one, at.T_world_body) for one, at in zip(self.bodies, self.footings, strict=True)}
        return self.standing.fall(goals | {body.name: (body, T_world_body)}) is None

    def _is_clear(self, index: int, T_world_body: Transform) -> bool:
        """Tell whether a turned object overlaps nothing: raised off what carries it, as what it carries is off it."""
        body = self.bodies[index]
        turned = placed_body(body.collision_body(), T_world_body, None)
        beside, above = [*self.still.bodies], []
        for other, placed, footing in zip(self.bodies, self.placed, self.footings, strict=True):
            if body.name in footing.supports:
                above.append(raised(placed, RAISE + body.solid.excess + other.solid.excess))
            elif other is not body:
                beside.append(placed)
        lifted = raised(turned, RAISE + body.solid.excess)
        return first_overlap([lifted], beside) is None and first_overlap([turned], above) is None

    def _places_of_others(self, index: int) -> list[LevelFace]:
        return [
            place
            for i, (body, footing) in enumerate(zip(self.bodies, self.footings, strict=True))
            if i != index
            for place in level_places(body.name, body.solid, footing.T_world_body)
        ]


def _changes(body: Body, start: Footing, goal: Footing) -> bool:
    """Tell whether any corner of a body is elsewhere at its goal."""
    corners, _ = body.solid.surface()
    moved = goal.T_world_body - start.T_world_body
    return float(np.abs(corners @ moved[:3, :3].T + moved[:3, 3]).max()) > SAME_GOAL


def _nearly_tips(inside: float) -> str:
    return (
        f"would be about to tip over: its centre of mass is {1e3 * max(inside, 0.0):.2g} mm inside the edge of what "
        f"carries it, and an object may end {1e3 * GOAL_OFF:g} mm off its goal"
    )


def _changes_nothing(body: Body, turn: Transform) -> bool:
    """Tell whether a turn takes the body's shape and its centre of mass to themselves."""
    if isinstance(body.solid, ExtrudedSolid) and body.solid.is_round:
        return True
    corners, _ = body.solid.surface()
    farthest, _ = KDTree(corners).query(corners @ turn[:3, :3].T + turn[:3, 3])
    moved = np.linalg.norm(turn[:3, :3] @ body.com + turn[:3, 3] - body.com)
    return max(float(np.max(farthest)), float(moved)) <= SAME_GOAL * float(np.ptp(corners, axis=0).max())
