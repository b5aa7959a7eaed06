"""A collision model of bodies, and queries of it with movable frames placed and pairs chosen."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planners.collision.distance import Cores, PairIndices
from planners.collision.kernel import (
    RIGID,
    UPRIGHT,
    CollisionKernel,
    first_collisions,
)
from planners.collision.pairing import choose_pairs, pair_columns, pair_margins, used_shapes
from planners.collision.sweep import edge_collision, path_collision
from planners.errors import LiftwrightError
from planners.geometry.convex import CollisionBody, ConvexShape, NamePair, sorted_pair
from planners.geometry.pose import Array, Transform, transform


@dataclass(frozen=True, eq=False)
class Fixed:
    """At rest in the world."""

    T_world_body: Transform


@dataclass(frozen=True, eq=False)
class Attached:
    """Held by the flange of an arm."""

    arm: str
    T_flange_body: Transform


@dataclass(frozen=True, eq=False)
class Riding:
    """Rigid on another frame, like the cup on the plate."""

    frame: str
    T_parent_body: Transform


@dataclass(frozen=True, eq=False)
class Upright:
    """Axes of the world, origin at a point of another frame, like the cable above the cup."""

    frame: str
    point: Array
    """(3,), in that frame [m]."""


Placement = Fixed | Attached | Riding | Upright


PairChoice = Callable[[CollisionBody, CollisionBody], bool]
PairMask = NDArray[np.bool_]

_FLANGE = 6
_DRAWN_RIGHT = 1e-9
"""Bounding balls and boxes are drawn this much too large, beyond rounding [m]."""


class CollisionModelError(LiftwrightError):
    """A collision query names something the model does not have, or leaves a frame without a place."""


@dataclass(frozen=True)
class EdgeResult:
    """What a continuous query found."""

    free: bool
    fraction: float
    """Where along the edge, or path (by its edges: 2.25 is a quarter into the third), trouble was noticed; it need
    not be the first place. 1 (the number of edges) when free."""
    pair: int
    """Index for `CollisionQuery.pair_names`; -1 when free."""


@dataclass(frozen=True, eq=False)
class CollisionQuery:
    """Pairs to keep apart in one placement of the movable frames. Safe to share between threads."""

    model: CollisionModel
    kernel: CollisionKernel
    """For other compiled code (`planners.collision.kernel`, `.sweep`); treat its arrays as read-only."""
    pair_bodies: PairIndices
    """Index of the model's body pair of each of the kernel's shape pairs."""

    def first_collision(self, Q: Array) -> PairIndices:
        """Return, for each configuration (n, 6 per arm) [rad], the first pair within its margin, or -1: (n,)."""
        return first_collisions(self.kernel, np.ascontiguousarray(np.atleast_2d(Q), dtype=float))

    def edge(self, q_from: Array, q_to: Array) -> EdgeResult:
        """Check a straight joint motion, ends included (`planners.collision.sweep.edge_collision`)."""
        pair, fraction = edge_collision(self.kernel, np.array(q_from, dtype=float), np.array(q_to, dtype=float))
        return EdgeResult(pair < 0, fraction, pair)

    def path(self, Q: Array) -> EdgeResult:
        """Check the polyline through the configurations (n, 6 per arm) [rad], ends included."""
        pair, k, fraction = path_collision(self.kernel, np.ascontiguousarray(Q, dtype=float))
        return EdgeResult(pair < 0, k + fraction, pair)

    def pair_names(self, pair: int) -> NamePair:
        """Name the bodies of a pair that a query returned."""
        return self.model.pair_names[self.pair_bodies[pair]]

    def frame_index(self, frame: str) -> int:
        """Return the number of a frame in the kernel, for `planners.collision.kernel.set_frame`."""
        return self.model.frame_index(frame)

    def kernel_copy(self) -> CollisionKernel:
        """Return a kernel whose movable frames a caller may overwrite."""
        return self.kernel._replace(T_parent_follower=self.kernel.T_parent_follower.copy())


@dataclass(frozen=True, eq=False)
class CollisionModel:
    """Arms and convex bodies, prepared so that a scene is quick to set."""

    arms: tuple[str, ...]
    """In the order of their joints."""
    bodies: tuple[CollisionBody, ...]
    frames: tuple[str, ...]
    """Names by number, see `planners.collision.kernel`."""
    pair_names: tuple[NamePair, ...]
    """All body pairs that a scene may check."""
    pair_frames: PairIndices
    """(pairs, 2), the numbers of the frames of both bodies."""
    shape_pairs: PairIndices
    """(m, 2), all pairs of shapes of those bodies."""
    shape_pair_bodies: PairIndices
    """(m,), index in `pair_names`."""
    shapes: CollisionKernel
    """The kernel with no pairs and nothing placed: what all scenes share."""
    pair_index: Mapping[NamePair, int]
    """Sorted names of two bodies -> index in `pair_names`."""
    frame_numbers: Mapping[str, int]
    """Inverse of `frames`."""
    names: frozenset[str]
    """Of the bodies."""
    arm_drivers: PairIndices
    """(frames, 3), what drives each frame as in `CollisionKernel.drivers`; movable frames as if at rest."""

    @staticmethod
    def build(
        arms: Mapping[str, tuple[Array, Transform]],
        bodies: Sequence[CollisionBody],
        excluded: Iterable[NamePair] = (),
    ) -> CollisionModel:
        """Compile bodies into a model.

        Args:
            arms: name -> (DH table (6, 4) with columns a, alpha, d, theta0; `T_world_base`), in the order of joints.
            bodies: with unique names. A frame that is neither "world" nor "<arm>/i" is movable.
            excluded: pairs of names, in either order, that are never checked. Pairs in one frame never are.

        Raises:
            CollisionModelError: a name occurs twice, an excluded name is unknown, or a body has no shapes.
        """
        _check_bodies(bodies)
        frames = _frame_names(tuple(arms), bodies)
        skipped = {sorted_pair(*pair) for pair in excluded}
        names = frozenset(body.name for body in bodies)
        _check_names((name for pair in skipped for name in pair), names)
        body_pairs = [
            (i, j)
            for i, a in enumerate(bodies)
            for j, b in enumerate(bodies[i + 1 :], start=i + 1)
            if a.frame != b.frame and sorted_pair(a.name, b.name) not in skipped
        ]
        first_shape = np.cumsum([0, *(len(body.shapes) for body in bodies)])
        shape_pairs = [
            (s, t, k)
            for k, (i, j) in enumerate(body_pairs)
            for s in range(first_shape[i], first_shape[i + 1])
            for t in range(first_shape[j], first_shape[j + 1])
        ]
        rows = np.array(shape_pairs, dtype=np.int32).reshape(-1, 3)
        frame_of = np.array([frames.index(body.frame) for body in bodies], dtype=np.int32)
        pair_names = tuple((bodies[i].name, bodies[j].name) for i, j in body_pairs)
        return CollisionModel(
            arms=tuple(arms),
            bodies=tuple(bodies),
            frames=frames,
            pair_names=pair_names,
            pair_frames=frame_of[np.array(body_pairs, dtype=np.int32).reshape(-1, 2)],
            shape_pairs=np.ascontiguousarray(rows[:, :2]),
            shape_pair_bodies=np.ascontiguousarray(rows[:, 2]),
            shapes=_bare_kernel(arms, bodies, frames),
            pair_index={sorted_pair(*pair): k for k, pair in enumerate(pair_names)},
            frame_numbers={name: k for k, name in enumerate(frames)},
            names=names,
            arm_drivers=_arm_drivers(len(arms), len(frames)),
        )

    def with_bodies(self, bodies: Sequence[CollisionBody]) -> CollisionModel:
        """Return the model of the same bodies whose shapes have moved on their frames; pairs are taken over.

        Raises:
            CollisionModelError: names, frames or numbers of shapes differ from those of `self.bodies`, in order.
        """
        if [_outward(body) for body in bodies] != [_outward(body) for body in self.bodies]:
            raise CollisionModelError("the bodies differ in more than the places of their shapes")
        arms = dict(zip(self.arms, zip(self.shapes.dh, self.shapes.T_world_base, strict=True), strict=True))
        return replace(
            self,
            bodies=tuple(bodies),
            shapes=_bare_kernel(arms, bodies, self.frames),
        )

    def frame_index(self, frame: str) -> int:
        """Return the number of a frame.

        Raises:
            CollisionModelError: there is no such frame.
        """
        number = self.frame_numbers.get(frame)
        if number is None:
            raise CollisionModelError(f"no frame {frame!r}; there are {', '.join(self.frames)}")
        return number

    @property
    def movable_frames(self) -> tuple[str, ...]:
        """Frames that a scene has to place."""
        return self.frames[1 + 7 * len(self.arms) :]

    def pair_mask(self, only: PairChoice) -> PairMask:
        """Say for each of `pair_names` whether `only` chooses it: the quick form of `scene(only=...)`."""
        by_name = {body.name: body for body in self.bodies}
        return np.array([only(by_name[a], by_name[b]) for a, b in self.pair_names], dtype=bool)

    def scene(
        self,
        placements: Mapping[str, Placement | None],
        *,
        allowed: Iterable[NamePair] = (),
        margin: float = 0.0,
        margins: Mapping[NamePair, float] | None = None,
        only: PairChoice | PairMask | None = None,
    ) -> CollisionQuery:
        """Place the movable frames and choose the pairs to check.

        Args:
            placements: for every movable frame where it is, or None when its bodies are not there.
            allowed: pairs of names, in either order, that may touch: they are skipped.
            margin: all other pairs keep farther apart than this [m], at least 0.
            margins: other margins for some pairs of names. A negative one allows them to overlap by that much, as
                far as the normal of a face of either shows it.
            only: checks these pairs alone: a choice by bodies, or what `pair_mask` made of one.

        Raises:
            CollisionModelError: a frame is left out, follows one that is not there or itself, or a name is unknown.
        """
        allowed, margins = tuple(allowed), margins or {}
        _check_names((name for pair in (*allowed, *margins) for name in pair), self.names)
        chosen = self._chosen_pairs(placements, allowed, only)
        body_margins = np.full(len(self.pair_names), float(margin))
        for pair, value in margins.items():
            index = self.pair_index.get(sorted_pair(*pair))
            if index is not None:
                body_margins[index] = value
        followers, T_parent_follower, frame_drivers = self._follow(placements)
        rows = choose_pairs(self.shape_pairs, self.shape_pair_bodies, chosen)
        drivers = frame_drivers[self.shapes.shape_frame]
        pairs = pair_columns(self.shape_pairs, rows, drivers)
        margin_rows, reach = pair_margins(
            rows, self.shape_pair_bodies, body_margins, self.shape_pairs, self.shapes.spheres
        )
        shapes, arm_used = used_shapes(pairs, drivers, len(self.arms))
        kernel = self.shapes._replace(
            arm_used=arm_used,
            followers=followers,
            T_parent_follower=T_parent_follower,
            shapes=shapes,
            drivers=drivers,
            pairs=pairs,
            reach=reach,
            margin=margin_rows,
        )
        return CollisionQuery(self, kernel, self.shape_pair_bodies[rows])

    def _chosen_pairs(
        self,
        placements: Mapping[str, Placement | None],
        allowed: Iterable[NamePair],
        only: PairChoice | PairMask | None,
    ) -> PairMask:
        if only is None:
            chosen = np.ones(len(self.pair_names), dtype=bool)
        else:
            chosen = only.copy() if isinstance(only, np.ndarray) else self.pair_mask(only)
        for pair in allowed:
            index = self.pair_index.get(sorted_pair(*pair))
            if index is not None:
                chosen[index] = False
        absent = [frame for frame, placement in placements.items() if placement is None]
        if absent:
            gone = np.isin(self.frames, absent)
            chosen &= ~gone[self.pair_frames].any(axis=1)
        return chosen

    def _follow(self, placements: Mapping[str, Placement | None]) -> tuple[PairIndices, Array, PairIndices]:
        """Order the movable frames with parents first; also return what drives each frame, as in the kernel."""
        order = self._parents_first(placements)
        followers = np.empty((len(order), 3), dtype=np.int32)
        transforms = np.empty((len(order), 4, 4))
        drivers = self.arm_drivers.copy()
        for row, (frame, placement) in enumerate(order):
            child, parent = self.frame_index(frame), self.frame_index(_parent(placement))
            upright = isinstance(placement, Upright)
            followers[row] = child, parent, UPRIGHT if upright else RIGID
            transforms[row] = _offset(placement)
            drivers[child] = drivers[parent]
            if upright and drivers[parent, 0] >= 0:
                drivers[child, 2] = 1
        return followers, transforms, drivers

    def _parents_first(self, placements: Mapping[str, Placement | None]) -> list[tuple[str, Placement]]:
        waiting = dict(placements)
        if waiting.keys() != set(self.movable_frames):
            raise CollisionModelError(
                f"placements are given for {', '.join(sorted(waiting)) or 'no frame'}, "
                f"but the movable frames are {', '.join(self.movable_frames) or 'none'}"
            )
        absent = {frame for frame, placement in placements.items() if placement is None}
        order: list[tuple[str, Placement]] = []
        while waiting:
            ready = [frame for frame, placement in waiting.items() if _parent(placement) not in waiting]
            if not ready:
                raise CollisionModelError(f"these frames follow each other in a circle: {', '.join(waiting)}")
            for frame in ready:
                placement = waiting.pop(frame)
                if placement is not None:
                    if _parent(placement) in absent:
                        raise CollisionModelError(
                            f"the frame {frame!r} follows {_parent(placement)!r}, which is absent"
                        )
                    order.append((frame, placement))
        return order


def _arm_drivers(n_arms: int, n_frames: int) -> PairIndices:
    drivers = np.full((n_frames, 3), (-1, 0, 0), dtype=np.int32)
    for arm in range(n_arms):
        for joints in range(1, 7):
            drivers[1 + 7 * arm + joints] = (arm, joints, 0)
    return drivers


def _parent(placement: Placement | None) -> str:
    match placement:
        case Attached(arm=arm):
            return f"{arm}/{_FLANGE}"
        case Riding(frame=frame) | Upright(frame=frame):
            return frame
        case _:
            return "world"


def _offset(placement: Placement) -> Transform:
    match placement:
        case Fixed(T_world_body=T) | Attached(T_flange_body=T) | Riding(T_parent_body=T):
            return T
        case Upright(point=point):
            return transform(position=point)


def _outward(body: CollisionBody) -> tuple[str, str, int]:
    """Return name, frame and number of shapes: all of a body that a model's pairs depend on."""
    return body.name, body.frame, len(body.shapes)


def _check_bodies(bodies: Sequence[CollisionBody]) -> None:
    seen: set[str] = set()
    for body in bodies:
        if body.name in seen:
            raise CollisionModelError(f"two bodies are named {body.name!r}")
        if not body.shapes:
            raise CollisionModelError(f"the body {body.name!r} has no shapes")
        seen.add(body.name)


def _check_names(names: Iterable[str], known: frozenset[str]) -> None:
    for name in names:
        if name not in known:
            raise CollisionModelError(f"no body {name!r}; there are {', '.join(sorted(known))}")


def _frame_names(arms: tuple[str, ...], bodies: Sequence[CollisionBody]) -> tuple[str, ...]:
    known = ["world", *(f"{arm}/{i}" for arm in arms for i in range(7))]
    for body in bodies:
        if body.frame not in known:
            known.append(body.frame)
    return tuple(known)


def _bare_kernel(
    arms: Mapping[str, tuple[Array, Transform]], bodies: Sequence[CollisionBody], frames: tuple[str, ...]
) -> CollisionKernel:
    """Lay the shapes of all bodies out in arrays."""
    shapes = [shape for body in bodies for shape in body.shapes]
    ends = np.cumsum([len(shape.vertices) for shape in shapes])
    counts = [len(shape.vertices) for shape in shapes]
    normals = [shape.face_normals for shape in shapes]
    normal_ends = np.cumsum([len(rows) for rows in normals])
    normal_counts = [len(rows) for rows in normals]
    shape_frame = [frames.index(body.frame) for body in bodies for _ in body.shapes]
    return CollisionKernel(
        cores=Cores(
            vertices=np.vstack([shape.vertices for shape in shapes]).astype(float),
            vertex_range=np.column_stack([ends - counts, ends]).astype(np.int32),
            normals=np.ascontiguousarray(np.vstack(normals)),
            normal_range=np.column_stack([normal_ends - normal_counts, normal_ends]).astype(np.int32),
        ),
        radius=np.array([shape.radius for shape in shapes], dtype=float),
        spheres=np.array([_bounding_sphere(shape) for shape in shapes]),
        boxes=np.array([_bounding_box(shape) for shape in shapes]),
        shape_frame=np.array(shape_frame, dtype=np.int32),
        dh=np.array([dh for dh, _ in arms.values()], dtype=float).reshape(-1, 6, 4),
        T_world_base=np.array([T for _, T in arms.values()], dtype=float).reshape(-1, 4, 4),
        arm_used=np.zeros(len(arms), dtype=np.int32),
        followers=np.empty((0, 3), dtype=np.int32),
        T_parent_follower=np.empty((0, 4, 4)),
        shapes=np.empty(0, dtype=np.int32),
        drivers=np.empty((0, 3), dtype=np.int32),
        pairs=np.empty((0, 4), dtype=np.int32),
        reach=np.empty(0),
        margin=np.empty((0, 2)),
    )


def _bounding_box(shape: ConvexShape) -> Array:
    low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    return np.concatenate([0.5 * (low + high), 0.5 * (high - low) + _DRAWN_RIGHT])


def _bounding_sphere(shape: ConvexShape) -> Array:
    """Return the (4,) centre and radius of a ball around a shape [m]."""
    return shape.ball + np.array([0.0, 0.0, 0.0, shape.radius + _DRAWN_RIGHT])
