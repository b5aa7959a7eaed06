"""Whether bodies that rest on one another stand, all of them together.

What rests on a body presses on it: a domino that sticks out over an edge stands alone, and falls with another one on
its overhang. Bodies stand if upward forces at the corners of all contacts balance every one of them. Friction and walls
are left out. Both could only hold what is refused here, never make fall what stands.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from planners.geometry.pose import Array, Transform
from planners.scene.body import Body
from planners.scene.rest import (
    REST_GAP,
    TIP_SLACK,
    Footing,
    LevelFace,
    Unsupported,
    beyond,
    find_footing,
    level_places,
    lowest_point,
)

_ROUNDING = 1e-5
"""A body whose centre of mass would have to be shifted by less than this to be balanced is [m]."""
_MOVES = 1e-6
"""Part of the largest motion that counts as moving in a fall [1]."""
_NEAR = 2.0 * REST_GAP
"""Places farther from a body's lowest corner than this do not carry it [m]."""


@dataclass(frozen=True)
class Fall:
    """Bodies that do not stand."""

    names: tuple[str, ...]
    reason: str
    """Said of them: "would tip over: …"."""

    def __str__(self) -> str:
        """Return the sentence."""
        return f"{listed(self.names)} {self.reason}"


def first_fall(bodies: Sequence[Body], footings: Sequence[Footing]) -> Fall | None:
    """Return the first of the piles, in the order given, that falls; None where all stand.

    Args:
        bodies: with their masses.
        footings: of each body, alone on what carries it; what is named there and is none of the bodies never moves.
    """
    for pile in _piles(bodies, footings):
        if len(pile) > 1:
            fall = _fall([bodies[i] for i in pile], [footings[i] for i in pile])
            if fall is not None:
                return fall
    return None


class Standing:
    """Decides of many arrangements of the same bodies whether they stand, and keeps what arrangements share."""

    def __init__(self, still: Sequence[LevelFace]) -> None:
        """Take the level places of what never moves."""
        self._still = _Ground(np.array([place.height for place in still]), tuple(still), b"", -np.inf)
        self._grounds: dict[tuple[str, bytes], _Ground] = {}
        self._footings: dict[tuple[object, ...], Footing | Unsupported] = {}

    def fall(self, arrangement: Mapping[str, tuple[Body, Transform]]) -> Fall | None:
        """Return what would fall of bodies at their poses, by name; None where all stand."""
        bodies, footings = [], []
        grounds = {name: self._ground(body, T) for name, (body, T) in arrangement.items()}
        for name, (body, T) in arrangement.items():
            others = [self._still, *(ground for other, ground in grounds.items() if other != name)]
            footing = self._footing(body, T, others)
            if isinstance(footing, Unsupported):
                return Fall((name,), footing.reason)
            bodies.append(body)
            footings.append(footing)
        return first_fall(bodies, footings)

    def _ground(self, body: Body, T_world_body: Transform) -> _Ground:
        key = body.name, T_world_body.tobytes()
        if key not in self._grounds:
            places = level_places(body.name, body.solid, T_world_body)
            lowest = lowest_point(body.solid, T_world_body)
            self._grounds[key] = _Ground(np.array([place.height for place in places]), tuple(places), key[1], lowest)
        return self._grounds[key]

    def _footing(self, body: Body, T_world_body: Transform, others: Sequence[_Ground]) -> Footing | Unsupported:
        own = body.name, T_world_body.tobytes()
        # A thin body's top may be as near to this one's bottom although it lies on it.
        lowest = self._grounds[own].lowest
        under = [ground for ground in others if ground.lowest < lowest and ground.has(lowest)]
        key = (*own, *((ground.places[0].name, ground.pose) for ground in under))
        if key not in self._footings:
            places = [place for ground in under for place in ground.places]
            self._footings[key] = find_footing(body.solid, T_world_body, body.com, places)
        return self._footings[key]


@dataclass(frozen=True, eq=False)
class _Ground:
    """The level places of one body where it is, or of all that never move."""

    heights: Array
    places: tuple[LevelFace, ...]
    pose: bytes
    lowest: float
    """How far down it reaches in the world [m]."""

    def has(self, height: float) -> bool:
        """Tell whether one of the places may be touched by what is lowest at a height [m]."""
        return bool(np.any(np.abs(self.heights - height) <= _NEAR))


def _piles(bodies: Sequence[Body], footings: Sequence[Footing]) -> Iterator[list[int]]:
    """Yield the bodies that are joined by resting on one another, as indices in order."""
    numbers = {body.name: i for i, body in enumerate(bodies)}
    pile = list(range(len(bodies)))
    for i, footing in enumerate(footings):
        for j in (numbers[name] for name in footing.supports if name in numbers):
            old, new = max(pile[i], pile[j]), min(pile[i], pile[j])
            pile = [new if each == old else each for each in pile]
    for root in sorted(set(pile)):
        yield [i for i, each in enumerate(pile) if each == root]


def _fall(bodies: Sequence[Body], footings: Sequence[Footing]) -> Fall | None:
    """Look for forces f >= 0 at all points such that A f = b: of every body sum 1 and moment 0, in its own weights.

    What is left of b is, by Farkas' lemma, the motion in which they fall: no contact resists it, and weights drive it.
    """
    centers = np.array(
        [(footing.T_world_body @ [*body.com, 1.0])[:2] for body, footing in zip(bodies, footings, strict=True)]
    )
    masses = np.array([body.mass for body in bodies])
    rows = _rows(bodies, footings, centers, masses)
    needed = np.tile([1.0, 0.0, 0.0], len(bodies))
    forces, missing = nnls(rows, needed, maxiter=30 * rows.shape[1])
    if missing <= _ROUNDING:
        return None
    motion = np.linalg.norm((needed - rows @ forces).reshape(-1, 3), axis=1)
    falling = [i for i, size in enumerate(motion) if size > _MOVES * motion.max()]
    return Fall(tuple(bodies[i].name for i in falling), _why(falling, bodies, footings, centers, masses))


def _rows(bodies: Sequence[Body], footings: Sequence[Footing], centers: Array, masses: Array) -> Array:
    """Return A: (3 n, k), force and moments about the centre of mass of each body, over its mass."""
    numbers = {body.name: i for i, body in enumerate(bodies)}
    points = np.vstack([footing.points for footing in footings])
    above = np.repeat(np.arange(len(bodies)), [len(footing.points) for footing in footings])
    below = np.array([numbers.get(name, -1) for footing in footings for name in footing.by])
    rows = np.zeros((len(bodies), 3, len(points)))
    for carried, sign in ((above, 1.0), (below, -1.0)):
        known = np.flatnonzero(carried >= 0)
        body = carried[known]
        rows[body, 0, known] = sign / masses[body]
        rows[body, 1:, known] = (sign / masses[body])[:, None] * (points[known] - centers[body])
    return rows.reshape(3 * len(bodies), len(points))


def _why(
    falling: Sequence[int], bodies: Sequence[Body], footings: Sequence[Footing], centers: Array, masses: Array
) -> str:
    """Say of falling bodies how far their common centre of mass is beyond what carries them, where it is."""
    if len(falling) == 1:
        return "would tip over under what rests on it"
    names = {bodies[i].name for i in falling}
    contacts = [contact for i in falling for contact in zip(footings[i].points, footings[i].by, strict=True)]
    points = np.array([point for point, by in contacts if by not in names]).reshape(-1, 2)
    outside = beyond(points, np.average(centers[falling], axis=0, weights=masses[falling]))
    if not TIP_SLACK < outside < np.inf:
        return "would tip over together, though each would stand alone"
    return f"would tip over together: their common centre of mass is {1e3 * outside:.4g} mm beyond what carries them"


def listed(names: Sequence[str]) -> str:
    """Return names in a row, at least one, as in "a, b and c"."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
