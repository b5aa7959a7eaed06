"""Seeded depth images of objects on the table of the cell, with what is true of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planners.geometry.pose import Array, Transform, rotation_z, transform
from planners.perception.camera import Camera
from planners.perception.perceived_object import PerceivedObject
from tests.support.depth_camera import (
    TABLE_CENTER,
    TABLE_SIZE,
    TABLE_TOP,
    Block,
    DepthNoise,
    Thing,
    can,
    cylinder,
    depth_image,
    floor,
    overhead_camera,
    table,
)

TISSUE_BOX = (0.240, 0.115, 0.060)
DOMINO = (0.130, 0.070, 0.020)
CAN = (0.0661, 0.0661, 0.1222)
GAP = 0.03
"""Between objects that do not stand on one another, at least [m]."""


@dataclass(frozen=True, eq=False)
class TrueObject:
    """An object that was put on the table."""

    kind: str
    """"box" or "cylinder"."""
    size: tuple[float, float, float]
    """The longer side first; of a cylinder its diameter twice and its height."""
    T_world_object: Transform
    is_can: bool = False

    def thing(self) -> Thing:
        if self.is_can:
            return can(self.T_world_object)
        if self.kind == "cylinder":
            return cylinder(0.5 * self.size[0], self.size[2], self.T_world_object)
        return Block(self.size, self.T_world_object)

    @property
    def reach(self) -> float:
        return 0.5 * math.hypot(*self.size[:2])


@dataclass(frozen=True, eq=False)
class Frame:
    """A depth image and the truth."""

    depth: Array
    camera: Camera
    objects: tuple[TrueObject, ...]


@dataclass(frozen=True)
class Errors:
    """How far an object was perceived from what it is."""

    center: float
    """Distance in the plane [m]."""
    yaw: float | None
    """[rad]; None where it has no meaning."""
    sides: float
    """The worse of both sides, or of the diameter [m]."""
    height: float
    """[m]"""
    told: Mapping[str, tuple[float, ...]]
    """Every number's error in uncertainties that were told of it [1], by what it is a number of."""


def on_table(x: float, y: float, height: float, yaw: float = 0.0, above: float = 0.0) -> Transform:
    """Return the pose of an object of a height that stands on the table, or `above` it."""
    return transform(rotation_z(yaw), [x, y, TABLE_TOP + above + 0.5 * height])


def frames(count: int, seed: int, noise: DepthNoise | None = None) -> Iterator[Frame]:
    """Yield frames of three to six objects that stand apart, seen by cameras that hang a little differently."""
    for index in range(count):
        yield frame(np.random.default_rng([seed, index]), noise)


def frame(rng: np.random.Generator, noise: DepthNoise | None = None) -> Frame:
    """Return one frame: tissue boxes, dominoes, cans, other boxes and cylinders, the odd one on another."""
    camera = overhead_camera(
        position=(0.45 + rng.uniform(-0.08, 0.08), rng.uniform(-0.08, 0.08), 2.25 + rng.uniform(-0.05, 0.05)),
        tilt=math.radians(rng.uniform(-5.0, 5.0)),
        roll=rng.uniform(-math.pi, math.pi),
    )
    objects: list[TrueObject] = []
    for _ in range(int(rng.integers(3, 7))):
        one = _placed(_drawn(rng), objects, rng)
        if one is not None:
            objects.append(one)
    if rng.random() < 0.3:
        objects += _on_top(objects, rng)
    return seen(objects, camera, rng, noise)


def seen(
    objects: Sequence[TrueObject],
    camera: Camera,
    rng: np.random.Generator,
    noise: DepthNoise | None = None,
    others: Sequence[Thing] = (),
) -> Frame:
    """Return the frame of objects and of other things on the table."""
    things = [table(), floor(), *(one.thing() for one in objects), *others]
    return Frame(depth_image(things, camera, rng, noise), camera, tuple(objects))


def errors(perceived: PerceivedObject, true: TrueObject) -> Errors:
    """Return how far an object was perceived from what it is."""
    T, T_true = perceived.T_world_object, true.T_world_object
    size = _size(perceived)
    off = np.abs(np.array(size) - true.size)
    yaw = None
    if true.kind == "box" and true.size[0] > 1.15 * true.size[1]:
        turn = _yaw(T) - _yaw(T_true)
        yaw = abs((turn + 0.5 * math.pi) % math.pi - 0.5 * math.pi)
    told = perceived.uncertainty
    moved = np.abs(T[:3, :3].T @ (T_true[:3, 3] - T[:3, 3])) / told.position
    sides = off[:2] / told.size[:2]
    in_told = {
        "centre": tuple(moved.tolist()),
        "sides": tuple(sides.tolist()) if true.kind == "box" else (float(sides[0]),),
        "height": (float(off[2] / told.size[2]),),
        "yaw": () if yaw is None else (yaw / told.yaw,),
    }
    return Errors(float(np.linalg.norm(T[:2, 3] - T_true[:2, 3])), yaw, float(off[:2].max()), float(off[2]), in_told)


def matched(
    perceived: Sequence[PerceivedObject], true: Sequence[TrueObject], within: float = 0.03
) -> tuple[list[tuple[PerceivedObject, TrueObject]], list[PerceivedObject], list[TrueObject]]:
    """Return pairs whose centres are near each other, what was invented and what was missed."""
    pairs, missed, left = [], [], list(perceived)
    for one in true:
        near = [
            each for each in left if np.linalg.norm(each.T_world_object[:3, 3] - one.T_world_object[:3, 3]) < within
        ]
        if near:
            best = min(
                near, key=lambda each: float(np.linalg.norm(each.T_world_object[:3, 3] - one.T_world_object[:3, 3]))
            )
            left.remove(best)
            pairs.append((best, one))
        else:
            missed.append(one)
    return pairs, left, missed


def _size(perceived: PerceivedObject) -> tuple[float, float, float]:
    shape = perceived.shape
    return shape.size if shape.type == "box" else (2.0 * shape.radius, 2.0 * shape.radius, shape.height)


def _yaw(T: Transform) -> float:
    return math.atan2(T[1, 0], T[0, 0])


def _drawn(rng: np.random.Generator) -> tuple[str, tuple[float, float, float], bool]:
    draw = rng.integers(0, 5)
    if draw == 0:
        return "box", TISSUE_BOX, False
    if draw == 1:
        return "box", DOMINO, False
    if draw == 2:
        return "cylinder", CAN, True
    if draw == 3:
        sides = sorted(rng.uniform(0.05, 0.25, 2), reverse=True)
        return "box", (float(sides[0]), float(sides[1]), float(rng.uniform(0.02, 0.15))), False
    diameter = float(rng.uniform(0.05, 0.16))
    return "cylinder", (diameter, diameter, float(rng.uniform(0.03, 0.15))), False


def _placed(
    drawn: tuple[str, tuple[float, float, float], bool], objects: Sequence[TrueObject], rng: np.random.Generator
) -> TrueObject | None:
    kind, size, is_can = drawn
    reach = 0.5 * math.hypot(*size[:2])
    for _ in range(50):
        x = float(
            rng.uniform(TABLE_CENTER[0] - 0.5 * TABLE_SIZE[0] + reach, TABLE_CENTER[0] + 0.5 * TABLE_SIZE[0] - reach)
        )
        y = float(rng.uniform(-0.36 + reach, 0.36 - reach))
        if all(np.hypot(*(one.T_world_object[:2, 3] - [x, y])) > one.reach + reach + GAP for one in objects):
            return TrueObject(kind, size, on_table(x, y, size[2], rng.uniform(-math.pi, math.pi)), is_can)
    return None


def _on_top(objects: Sequence[TrueObject], rng: np.random.Generator) -> list[TrueObject]:
    """Put a domino on the first object that is large enough."""
    for one in objects:
        if one.kind == "box" and min(one.size[:2]) > 0.1 and one.size[0] > 0.16:
            x, y = one.T_world_object[:2, 3]
            above = one.size[2]
            return [
                TrueObject(
                    "box", DOMINO, on_table(float(x), float(y), DOMINO[2], rng.uniform(-math.pi, math.pi), above)
                )
            ]
    return []
