"""Bodies that overlap where a task puts them."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from planners.cell.cell import Cell
from planners.collision import overlap
from planners.errors import SceneError, SceneFaults
from planners.geometry.convex import CollisionBody, ConvexShape, sorted_pair
from planners.geometry.pose import Array, Transform
from planners.kinematics.forward import link_frames
from planners.scene.body import Body
from planners.scene.standing import listed

_ROUNDING = 1e-9
AT_START = "at the start"
MOST_STARTS = 32
"""So many starts of arms in cells are remembered, those that were asked for last [1]."""
TOUCHING = 1e-3
"""Two bodies that are no deeper in one another touch [m]; as far as a resting body may be off what carries it."""


GRAIN = 1e-4
"""Moves that would part bodies are told in multiples of it [m]."""
MOST_MEASURED = 8
"""Of so many overlaps at once it is told how deep they are and what parts them: with many parts it takes long [1]."""
MOST_LEFT = 6
"""Out of so many bodies a move may lead that would end in others else; out of more none is told."""
MOST_SOUGHT = 2
"""Of so many overlaps at once moves are told that end in nothing else; it takes longer still."""
_ARMS = "/start_positions"
_CUP = "/cup/position"
_OBSTACLES = "/obstacles/"
_AXES = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1)}
"""Directions in which a body may be told to move: never down, where something carries it."""


class BodiesOverlap(SceneError):
    """Two bodies touch or overlap; every member of the task that places one of them is pointed at."""

    def __init__(
        self, a: PlacedBody, b: PlacedBody, when: str, around: Sequence[PlacedBody] = (), *, measured: bool = True
    ) -> None:
        """Tell how deep they are in one another, and a move that parts them and ends in nothing of what is around.

        Args:
            a: one of them.
            b: the other one.
            when: ends the sentence.
            around: what else there is.
            measured: False: tell none of this, as it takes long.
        """
        pointer, *others = _pointers(a, b)
        met, apart = "touch or overlap", ""
        if measured:
            deep, apart = depth(a, b), _apart(a, b, around)
            met = f"overlap by {1e3 * deep:.4g} mm" if deep > _ROUNDING else "touch"
        super().__init__(pointer, f"{a.name} and {b.name} {met} {when}{apart}", others=others)


class BodyInCell(SceneError):
    """A body reaches into a part of the cell; the member of the task that places the body is pointed at."""

    def __init__(
        self,
        body: PlacedBody,
        part: PlacedBody,
        depth: float,
        when: str,
        around: Sequence[PlacedBody] = (),
        *,
        measured: bool = True,
    ) -> None:
        """Take the body, the part, how deep it is in it [m], and the rest as for `BodiesOverlap`."""
        detail = f"{body.name} is {1e3 * depth:.4g} mm deep in {part.name} {when}, more than {1e3 * TOUCHING:g} mm"
        super().__init__(body.pointer or "", f"{detail}{_apart(body, part, around) if measured else ''}")


def _pointers(a: PlacedBody, b: PlacedBody) -> tuple[str, ...]:
    """Return the members of the task that place either of two bodies, each once."""
    return tuple(dict.fromkeys(body.pointer for body in (a, b) if body.pointer is not None))


def _apart(a: PlacedBody, b: PlacedBody, around: Sequence[PlacedBody]) -> str:
    """Say a short move along an axis of the world that parts two bodies; nothing where none is known.

    It ends in nothing of what is around.
    """
    ways = [way for one, other in ((a, b), (b, a)) if (way := _way_out(one, other, around)) is not None]
    if not ways:
        return ""
    # The first one named moves, unless the other would have less far to go: up, as it lies above.
    way = min(ways, key=lambda way: way.far)
    told = f"; moved {1e3 * way.far:.1f} mm towards the world's {way.axis}"
    return f"{told}, {way.moves} is clear of {listed(way.clear_of)}"


@dataclass(frozen=True)
class _WayOut:
    moves: str
    axis: str
    far: float
    """[m]"""
    clear_of: tuple[str, ...]


def _way_out(body: PlacedBody, other: PlacedBody, around: Sequence[PlacedBody]) -> _WayOut | None:
    """Return the shortest move out of one body, and out of those in which it would end else."""
    # An arm has many links: what is clear of one may well be in the next.
    if body.pointer is None or _ARMS in (body.pointer, other.pointer):
        return None
    # A cup is moved on its plate only.
    axes = [axis for axis in _AXES if axis != "+z" or body.pointer != _CUP]
    directions = np.array([_AXES[axis] for axis in axes], dtype=float)
    left = [other]
    while len(left) <= MOST_LEFT:
        shapes = [shape for each in left for shape in each.shapes]
        found = overlap.shortest_way_out(body.shapes, shapes, directions, GRAIN)
        if found is None:
            return None
        there = _moved(body, found[1] * directions[found[0]])
        met = [
            each
            for _, each in _near([there], around, 0.0)
            if each not in left and _may_not_meet(body, each) and depth(there, each) > TOUCHING
        ]
        if not met:
            return _WayOut(body.name, axes[found[0]], found[1], tuple(dict.fromkeys(each.name for each in left)))
        left += met
    return None


def _may_not_meet(body: PlacedBody, other: PlacedBody) -> bool:
    """Tell whether two bodies must not be in one another: obstacles may, as they never move."""
    are_obstacles = all((each.pointer or "").startswith(_OBSTACLES) for each in (body, other))
    return body.name != other.name and not are_obstacles


@dataclass(frozen=True, eq=False)
class PlacedBody:
    """A body with its shapes in the world."""

    name: str
    pointer: str | None
    """The member of the task that says where it is; None for what belongs to the cell."""
    shapes: tuple[ConvexShape, ...]
    """In the world."""
    lowest: Array
    """(3,) lower corner of the box around it [m]."""
    highest: Array
    """(3,) upper corner of the box around it [m]."""


def placed_body(body: CollisionBody, T_world_frame: Array, pointer: str | None) -> PlacedBody:
    """Take a body from its frame to the world; `T_world_frame` is (4, 4)."""
    R, p = T_world_frame[:3, :3], T_world_frame[:3, 3]
    shapes = tuple(ConvexShape(shape.vertices @ R.T + p, shape.radius) for shape in body.shapes)
    lowest = np.min([shape.vertices.min(axis=0) - shape.radius for shape in shapes], axis=0)
    highest = np.max([shape.vertices.max(axis=0) + shape.radius for shape in shapes], axis=0)
    return PlacedBody(body.name, pointer, shapes, lowest, highest)


def placed_at_start(body: Body, pointer: str) -> PlacedBody:
    """Take a body of a scene to where it is at the start."""
    return placed_body(body.collision_body(), body.T_world_body, pointer)


def arm_frames(cell: Cell, positions: Array) -> dict[str, Transform]:
    """Return T_world_frame of all frames of both arms at joint `positions` (12,) [rad], by name."""
    frames: dict[str, Transform] = {}
    for arm, q in zip(("left", "right"), (positions[:6], positions[6:]), strict=True):
        poses = np.empty((7, 4, 4))
        link_frames(cell.arms[arm].dh, cell.arms[arm].T_world_base, np.ascontiguousarray(q), poses)
        frames |= {f"{arm}/{i}": poses[i] for i in range(7)}
    return frames


@dataclass(frozen=True, eq=False)
class CellAtStart:
    """A cell with its arms where tasks start: the same for most tasks, and half of what is to be checked of each."""

    fixed: tuple[PlacedBody, ...]
    """The cell's own bodies."""
    arms: tuple[PlacedBody, ...]
    """Links and hands of both arms."""
    overlap: tuple[PlacedBody, PlacedBody] | None
    """The first pair of these, one of an arm, that touches or overlaps and may not."""

    @staticmethod
    def of(cell: Cell, positions: Array, widths: Mapping[str, float]) -> CellAtStart:
        """Place both arms and hands at joint `positions` (12,) [rad] and finger openings `widths` [m], by arm."""
        return _cell_at_start(cell, tuple(positions.tolist()), tuple(sorted(widths.items())))

    def refuse_overlaps(self) -> None:
        """Check the arms against the cell, and against one another.

        Raises:
            BodiesOverlap: for the first pair that touches or overlaps.
        """
        if self.overlap is not None:
            raise BodiesOverlap(*self.overlap, AT_START)


@lru_cache(maxsize=MOST_STARTS)
def _cell_at_start(cell: Cell, positions: tuple[float, ...], widths: tuple[tuple[str, float], ...]) -> CellAtStart:
    frames = arm_frames(cell, np.array(positions))
    moving = (body for body in cell.collision_bodies(dict(widths)) if body.frame != "world")
    arms = tuple(placed_body(body, frames[body.frame], _ARMS) for body in moving)
    fixed = tuple(placed_body(body, np.eye(4), None) for body in cell.bodies)
    apart = first_overlap(arms, fixed, cell.excluded_pairs)
    return CellAtStart(fixed, arms, apart or first_overlap(arms, arms, cell.excluded_pairs))


def raised(body: PlacedBody, height: float) -> PlacedBody:
    """Return a body moved straight up by `height` [m]."""
    return _moved(body, np.array([0.0, 0.0, height]))


def _moved(body: PlacedBody, by: Array) -> PlacedBody:
    shapes = tuple(ConvexShape(shape.vertices + by, shape.radius) for shape in body.shapes)
    return PlacedBody(body.name, body.pointer, shapes, body.lowest + by, body.highest + by)


def refuse_overlaps(
    group: Sequence[PlacedBody],
    others: Sequence[PlacedBody],
    allowed: Container[tuple[str, str]] = (),
    when: str = AT_START,
) -> None:
    """Check every body of one group against every body of another, and tell of all that overlap.

    Args:
        group: Bodies.
        others: Bodies; may be the same list, then each pair is met once.
        allowed: Sorted pairs of names that may touch.
        when: Ends the sentence that refuses.

    Raises:
        BodiesOverlap: Pairs touch or overlap; the first of them, in the order given, is told first.
    """
    faults = SceneFaults()
    for a, b in _overlaps(group, others, allowed):
        # An arm that is in a box is so with many links: it takes long to measure them all, and one of them is told.
        if not faults.tells_of(*_pointers(a, b)):
            around = [*group, *others] if len(faults) < MOST_SOUGHT else []
            faults.add(BodiesOverlap(a, b, when, around, measured=len(faults) < MOST_MEASURED))
    faults.raise_any()


def first_overlap(
    group: Sequence[PlacedBody], others: Sequence[PlacedBody], allowed: Container[tuple[str, str]] = ()
) -> tuple[PlacedBody, PlacedBody] | None:
    """Return the first pair, in the order given, that touches or overlaps, as `refuse_overlaps` checks them."""
    return next(_overlaps(group, others, allowed), None)


def _overlaps(
    group: Sequence[PlacedBody], others: Sequence[PlacedBody], allowed: Container[tuple[str, str]]
) -> Iterator[tuple[PlacedBody, PlacedBody]]:
    pairs = _near(group, others, 0.0)
    return ((a, b) for a, b in pairs if sorted_pair(a.name, b.name) not in allowed and gap(a, b) <= 0.0)


def refuse_inside(
    bodies: Sequence[PlacedBody],
    cell: Sequence[PlacedBody],
    excess: Mapping[str, float],
    when: str = AT_START,
) -> None:
    """Check that bodies that a task places do not reach into what belongs to the cell; they may touch it.

    This holds for all of them alike. What is to move has to be clear besides of all that does not carry it, which is
    `refuse_overlaps`.

    Args:
        bodies: what a task places.
        cell: bodies of the cell.
        excess: by name, how far convex shapes reach beyond a body of either kind [m]; not listed: not at all.
        when: ends the sentence that refuses.

    Raises:
        BodyInCell: Pairs are deeper in one another than `TOUCHING`; the first of them, in the order given, is told
            first.
    """
    faults = SceneFaults()
    for body, part in _near(bodies, cell, 0.0):
        if faults.tells_of(body.pointer):
            continue
        allowed = TOUCHING + excess.get(body.name, 0.0) + excess.get(part.name, 0.0) + _ROUNDING
        if _box_depth(body, part) > allowed and (deep := depth(body, part)) > allowed:
            around = [*bodies, *cell] if len(faults) < MOST_SOUGHT else []
            faults.add(BodyInCell(body, part, deep, when, around, measured=len(faults) < MOST_MEASURED))
    faults.raise_any()


def _box_depth(a: PlacedBody, b: PlacedBody) -> float:
    """Return the shortest way along an axis by which the box around a body gets out of the other's [m].

    The bodies get out of one another by it too: they are no deeper in one another.
    """
    return float(min((a.highest - b.lowest).min(), (b.highest - a.lowest).min()))


def depth(a: PlacedBody, b: PlacedBody) -> float:
    """Return how deep two bodies are in one another [m]: the shortest way out of the deepest of their shapes; or 0."""
    return overlap.depth(a.shapes, b.shapes)


def gaps_below(
    bodies: Sequence[PlacedBody], within: float, pairs: Container[tuple[str, str]]
) -> dict[tuple[str, str], float]:
    """Return the gaps [m] of those sorted pairs of names that are closer together than `within` [m]."""
    near = ((a, b) for a, b in _near(bodies, bodies, within) if sorted_pair(a.name, b.name) in pairs)
    gaps = {sorted_pair(a.name, b.name): gap(a, b) for a, b in near}
    return {names: width for names, width in gaps.items() if width < within}


def gap(a: PlacedBody, b: PlacedBody) -> float:
    """Return how far two bodies are apart [m]; not above 0 where they touch or overlap."""
    return overlap.gap(a.shapes, b.shapes)


def _near(
    group: Sequence[PlacedBody], others: Sequence[PlacedBody], within: float
) -> Iterator[tuple[PlacedBody, PlacedBody]]:
    """Yield the pairs whose boxes are no farther apart; of a list with itself each pair once."""
    if not group or not others:
        return
    low, high = np.array([b.lowest for b in group]), np.array([b.highest for b in group])
    other_low, other_high = np.array([b.lowest for b in others]), np.array([b.highest for b in others])
    near = np.all((low[:, None] <= other_high[None] + within) & (other_low[None] <= high[:, None] + within), axis=2)
    if group is others:
        near = np.triu(near, k=1)
    yield from ((group[i], others[j]) for i, j in np.argwhere(near))
