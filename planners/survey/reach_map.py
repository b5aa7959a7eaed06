"""Where above a table the hands reach: every place of a grid, from every way a hand may come."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.cell.arm import Arm
from planners.cell.cell import Cell
from planners.cell.hand import Gripper
from planners.collision.kernel import first_collision, make_scratch
from planners.collision.model import CollisionModel
from planners.geometry.pose import Array, Transform, frame_from_z, inverse, rotation_z, transform
from planners.hands.workcell import ArmKernel, Clearance
from planners.kinematics.forward import link_frames
from planners.kinematics.inverse import inverse_kinematics, multiply, within_limits
from planners.kinematics.joint_torque import torques_at_rest
from planners.progress import Progress, Report, silent

DIRECTIONS: Mapping[str, tuple[float, float, float]] = {
    "down": (0.0, 0.0, -1.0),
    "forward": (1.0, 0.0, 0.0),
    "back": (-1.0, 0.0, 0.0),
    "left": (0.0, 1.0, 0.0),
    "right": (0.0, -1.0, 0.0),
    "down and forward": (1.0, 0.0, -1.0),
    "down and back": (-1.0, 0.0, -1.0),
    "down and left": (0.0, 1.0, -1.0),
    "down and right": (0.0, -1.0, -1.0),
}
"""Ways in which a hand points, in the world; x is forward, y to the left."""


@dataclass(frozen=True)
class ReachMapSettings:
    """How finely a cell is looked at."""

    columns: int = 36
    """Places along the longer side of the table."""
    rolls: int = 8
    """Turns of a hand about the way it points, by equal steps."""
    height: float = 0.10
    """Of the middle of a hand's pads, or of its tip, above the table, in a cell of size 1 [m]: whatever is lower is
    hindered by the table itself, and depends on what lies there."""


@dataclass(frozen=True, eq=False)
class ReachMap:
    """What both arms reach above the table, each with the other arm at home."""

    x: Array
    """(n,) places along the world's x axis [m]."""
    y: Array
    """(m,) along its y axis [m]."""
    z: float
    """Of all places [m]."""
    reached: Mapping[str, NDArray[np.bool_]]
    """By arm, (n, m, d): whether the hand gets there pointing each of `DIRECTIONS`, in any turn about it."""
    mass: Mapping[str, Array]
    """By arm, (n, m): the largest mass that the hand may hold there at rest, 0 where it does not reach [kg]: what the
    payload leaves beside the hand, or less where a joint's torque ends earlier."""

    @cached_property
    def anyhow(self) -> Mapping[str, NDArray[np.bool_]]:
        """By arm, (n, m): whether the hand reaches a place pointing any way."""
        return {arm: np.asarray(found.any(axis=2)) for arm, found in self.reached.items()}

    @property
    def common(self) -> NDArray[np.bool_]:
        """(n, m): whether both hands reach a place, one at a time."""
        return np.logical_and.reduce(list(self.anyhow.values()))

    @property
    def dead(self) -> NDArray[np.bool_]:
        """(n, m): whether no hand reaches a place."""
        return ~np.logical_or.reduce(list(self.anyhow.values()))

    @property
    def area_of_place(self) -> float:
        """Which each place stands for [m^2]."""
        return float((self.x[1] - self.x[0]) * (self.y[1] - self.y[0]))

    def from_way(self, arm: str, way: str) -> NDArray[np.bool_]:
        """(n, m): whether an arm's hand reaches a place pointing one of `DIRECTIONS`."""
        return self.reached[arm][:, :, list(DIRECTIONS).index(way)]


def map_reach(cell: Cell, settings: ReachMapSettings | None = None, progress: Progress = silent) -> ReachMap:
    """Look at every place above the table.

    A place is reached where some posture within the joints' ranges has the hand there, clear of the arm itself, of the
    other arm at home and of everything in the cell by what planning keeps, fingers wide open.

    Args:
        cell: to be looked at.
        settings: how finely; None: the defaults.
        progress: told of each arm; may raise `PlanningCancelled`.
    """
    settings = settings or ReachMapSettings()
    x, y = _grid(cell, settings.columns)
    z = cell.table_top + cell.size * settings.height
    places = np.stack([*(axis.ravel() for axis in np.meshgrid(x, y, indexing="ij")), np.full(x.size * y.size, z)], 1)
    reached, mass = {}, {}
    looker = HandLooker(cell, turns_about(DIRECTIONS.values(), settings.rolls))
    for index, name in enumerate(cell.arms):
        progress(Report("reach", index, len(cell.arms), f"where the {name} arm reaches"))
        found, held = looker.look(name, places)
        reached[name] = found.reshape(len(x), len(y), -1)
        mass[name] = held.reshape(len(x), len(y))
    progress(Report("reach", len(cell.arms), len(cell.arms)))
    return ReachMap(x, y, z, reached, mass)


class HandLooker:
    """Tells where the hands of a cell get to, in given turns."""

    def __init__(self, cell: Cell, turns: Array) -> None:
        """`turns` are (ways, rolls, 4, 4): a way counts as reached in any of its rolls."""
        arms = {name: (arm.dh, arm.T_world_base) for name, arm in cell.arms.items()}
        model = CollisionModel.build(arms, cell.collision_bodies(), cell.excluded_pairs)
        self._cell, self._turns = cell, turns
        clearance = Clearance.of(cell)
        self._query = model.scene({}, margin=clearance.margin, margins=clearance.within_arms(model.bodies))

    def look(self, arm: str, places: Array) -> tuple[NDArray[np.bool_], Array]:
        """Return whether a hand gets to places (p, 3) [m] each way (p, ways), and what it may hold there (p,) [kg]."""
        asked = self._cell.arms[arm]
        found, held = np.zeros((len(places), len(self._turns)), dtype=np.bool_), np.zeros(len(places))
        searched = ArmKernel.of(asked, 6 * list(self._cell.arms).index(arm)), self._query.kernel
        weighed = asked.weighed(self._cell.gravity), asked.torque_max, asked.spare_payload
        hands = np.ascontiguousarray(self._turns @ _tcp_to_flange(asked))
        _look(searched, weighed, self._cell.home, np.ascontiguousarray(places), hands, found, held)
        return found, held


def _grid(cell: Cell, columns: int) -> tuple[Array, Array]:
    """Return places over the table, as far from one another along x as along y, about."""
    center, size = cell.boxes[0].center, cell.boxes[0].size
    step = max(size[0], size[1]) / columns
    counts = [max(2, round(size[axis] / step)) for axis in range(2)]
    x, y = (center[axis] + size[axis] * ((np.arange(count) + 0.5) / count - 0.5) for axis, count in enumerate(counts))
    return x, y


def turns_about(ways: Iterable[Sequence[float] | Array], rolls: int) -> Array:
    """Return (d, rolls, 4, 4) of hands that point each of some ways, in every turn about it."""
    frames = []
    for way in ways:
        hint = np.array([0.0, 0.0, 1.0]) if abs(way[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
        upright = frame_from_z(np.array(way), hint)
        frames.append([transform(upright @ rotation_z(2.0 * math.pi * k / rolls)) for k in range(rolls)])
    return np.array(frames)


def _tcp_to_flange(arm: Arm) -> Transform:
    """Return `T_tcp_flange` of a stick, or of a gripper that is wide open."""
    hand = arm.hand
    return inverse(hand.T_flange_tcp(hand.width_max) if isinstance(hand, Gripper) else hand.T_flange_tcp)


@njit(cache=True, nogil=True)
def _look(searched, weighed, home, places, hands, found, held):
    (dh, T_base_world, lo, hi, first), kernel = searched
    scratch, q = make_scratch(kernel), home.copy()
    T_world_flange, T_base_flange, solutions = np.empty((4, 4)), np.empty((4, 4)), np.empty((8, 6))
    for p in range(places.shape[0]):
        for d in range(hands.shape[0]):
            for k in range(hands.shape[1]):
                T_world_flange[:] = hands[d, k]
                T_world_flange[:3, 3] += places[p]
                multiply(T_base_world, T_world_flange, T_base_flange)
                valid = inverse_kinematics(dh, T_base_flange, 0.0, solutions)
                for branch in range(8):
                    if not (valid >> branch) & 1 or not within_limits(solutions[branch], lo, hi):
                        continue
                    q[first : first + 6] = solutions[branch]
                    if first_collision(kernel, q, scratch) < 0:
                        found[p, d] = True
                        held[p] = max(held[p], _bearable(weighed, solutions[branch], places[p]))
                        if held[p] >= weighed[2]:
                            break
                if found[p, d] and held[p] >= weighed[2]:
                    break


@njit(cache=True, nogil=True)
def _bearable(weighed, q, point):
    """Return the largest mass that a hand holds at rest at a point, as far as payload and torques allow [kg]."""
    arm, torque_max, most = weighed
    frames, wrench, bare, loaded = np.empty((7, 4, 4)), np.zeros(6), np.empty(6), np.empty(6)
    link_frames(arm.dh, arm.T_world_base, q, frames)
    torques_at_rest(arm, frames, wrench, point, bare)
    wrench[:3] = -arm.gravity
    torques_at_rest(arm, frames, wrench, point, loaded)
    for i in range(6):
        a_kilogram = loaded[i] - bare[i]
        left = torque_max[i] - bare[i] if a_kilogram > 0.0 else torque_max[i] + bare[i]
        if a_kilogram != 0.0:
            most = min(most, max(0.0, left) / abs(a_kilogram))
    return most
