"""Two UR3e arms of random convex links over a table, with a plate, a cup and a cable: a cell without its assets."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull

from planners.collision.model import Attached, CollisionModel, Fixed, Placement, Riding, Upright
from planners.geometry.convex import CollisionBody, ConvexShape, box, capsule, cylinder
from planners.geometry.pose import Array, Transform, rotation_x, rotation_z, transform

UR3E = np.array(
    [
        [0.0, math.pi / 2, 0.15185, 0.0],
        [-0.24355, 0.0, 0.0, 0.0],
        [-0.2132, 0.0, 0.0, 0.0],
        [0.0, math.pi / 2, 0.13105, 0.0],
        [0.0, -math.pi / 2, 0.08535, 0.0],
        [0.0, 0.0, 0.0921, 0.0],
    ]
)
BASES: dict[str, Transform] = {
    "left": transform(rotation_x(math.radians(-135)), [0.0, 0.258485, 1.610515]),
    "right": transform(rotation_x(math.radians(135)) @ rotation_z(math.pi), [0.0, -0.258485, 1.610515]),
}
HOME = np.radians([15, -60, -120, -180, -120, 0, -15, -120, 120, 0, 120, 180])
ARMS = {name: (UR3E, T) for name, T in BASES.items()}
BOXES = {
    "table": ((0.45, 0, 1.082), (0.4, 0.915, 0.012)),
    "foot": ((0.18, 0, 0.105), (0.61, 0.41, 0.105)),
    "trunk": ((0, 0, 0.4445), (0.321, 0.321, 0.2345)),
    "column": ((0, 0, 0.8895), (0.05, 0.05, 0.6795)),
    "shoulders": ((0, 0, 1.619), (0.1, 0.275, 0.05)),
    "ear_left": ((0, 0.3, 1.669), (0.1, 0.029, 0.021)),
    "ear_right": ((0, -0.3, 1.669), (0.1, 0.029, 0.021)),
    "frame_0": ((-0.35, 0.6, 1.2), (0.03, 0.03, 1.2)),
    "frame_1": ((-0.35, -0.6, 1.2), (0.03, 0.03, 1.2)),
    "frame_2": ((-0.35, 0, 2.37), (0.03, 0.6, 0.03)),
}
LINKS = ("base", "shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
SPANS = (
    ((0, 0, 0), (0, 0, 0.09), 0.065),
    ((0, 0, 0), (0, -0.03, 0), 0.06),
    ((0.0, 0, 0.12), (0.24355, 0, 0.12), 0.055),
    ((0.0, 0, 0.03), (0.2132, 0, 0.03), 0.045),
    ((0, 0, 0), (0, -0.05, 0), 0.04),
    ((0, 0, 0), (0, 0.04, 0), 0.04),
    ((0, 0, -0.04), (0, 0, 0), 0.032),
)
"""Ends and radius of the rod that each link's hull is drawn around, in the link's frame."""


def sphere(center: Sequence[float], radius: float) -> ConvexShape:
    """Return the ball about a point [m]."""
    return ConvexShape(np.array([center], dtype=float), radius)


def convex_hull(points: Array) -> ConvexShape:
    """Return the hull of (n, 3) points that span a volume [m]."""
    return ConvexShape(points[ConvexHull(points).vertices])


def random_hull(rng: np.random.Generator, start: Array, end: Array, radius: float, n: int = 60) -> ConvexShape:
    """Return a hull of about `n` vertices around a rod."""
    directions = rng.normal(size=(n, 3))
    directions *= radius / np.linalg.norm(directions, axis=1)[:, None]
    along = rng.integers(0, 2, size=(n, 1)).astype(float)
    return convex_hull((1 - along) * np.asarray(start) + along * np.asarray(end) + directions)


def arm_bodies(rng: np.random.Generator, arm: str) -> list[CollisionBody]:
    """Return links, sensor and a hand of several parts."""
    bodies = [
        CollisionBody(f"{arm}_{name}", arm, f"{arm}/{i}", (random_hull(rng, np.array(a), np.array(b), r),))
        for i, (name, (a, b, r)) in enumerate(zip(LINKS, SPANS, strict=True))
    ]
    flange = f"{arm}/6"

    def add(name: str, *shapes: ConvexShape) -> None:
        bodies.append(CollisionBody(f"{arm}_{name}", arm, flange, shapes))

    add("ft300", cylinder(0.0375, 0.0484).placed(transform(position=[0, 0, 0.0242])))
    if arm == "left":
        add("stick", capsule((0, 0, 0.06), (0, 0, 0.28), 0.01))
        add("tip", ConvexShape(np.array([[0, 0, 0.2944]]), 0.01))
        return bodies
    add("gripper_base", random_hull(rng, np.array([0, 0, 0.08]), np.array([0, 0, 0.11]), 0.04))
    for finger, sign in ((0, -1), (1, 1)):
        for part in range(4):
            rod = np.array([[0, sign * 0.03, 0.12 + 0.015 * part], [0, sign * 0.045, 0.14 + 0.015 * part]])
            add(f"finger_{finger}_{part}", random_hull(rng, rod[0], rod[1], 0.012, 40))
        add(f"pad_{finger}", box([0.022, 0.008, 0.0375]).placed(transform(position=[0, sign * 0.046, 0.21])))
    return bodies


def build_model(seed: int = 0) -> CollisionModel:
    """Return the whole cell: some forty shapes and five hundred pairs."""
    rng = np.random.default_rng(seed)
    bodies = [*arm_bodies(rng, "left"), *arm_bodies(rng, "right")]
    for name, (center, half) in BOXES.items():
        shape = box(2 * np.array(half)).placed(transform(position=center))
        bodies.append(CollisionBody(name, "cell", "world", (shape,)))
    bodies += [
        CollisionBody("plate", "plate", "plate", (box([0.3, 0.3, 0.04]),)),
        CollisionBody("cup", "cup", "cup", (cylinder(0.0175, 0.03),)),
        CollisionBody("cable", "cable", "cable", (capsule((0, 0, 0.03), (0, 0, 1.1), 0.01),)),
    ]
    return CollisionModel.build(ARMS, bodies, excluded_pairs(bodies))


def excluded_pairs(bodies: list[CollisionBody]) -> set[tuple[str, str]]:
    """Return neighbours along each arm, and what the bases are bolted to."""
    pairs = {("plate", "cup"), ("plate", "cable"), ("cup", "cable"), ("plate", "table")}
    for arm in BASES:
        for i in range(6):
            pairs.add((f"{arm}_{LINKS[i]}", f"{arm}_{LINKS[i + 1]}"))
        # The wrist is so short that these overlap in every configuration.
        pairs |= {(f"{arm}_wrist_1", f"{arm}_wrist_3"), (f"{arm}_upper_arm", f"{arm}_base")}
        for body in bodies:
            if body.frame == f"{arm}/6":
                pairs |= {(f"{arm}_wrist_2", body.name), (f"{arm}_wrist_1", body.name)}
            if body.group == "cell":
                pairs |= {(f"{arm}_base", body.name), (f"{arm}_shoulder", body.name)}
    for body in bodies:
        if body.group == "cell":
            pairs |= {(body.name, other) for other in ("plate", "cup", "cable")}
    return pairs


def resting() -> dict[str, Placement | None]:
    """Place the plate at rest on the table, the cup on it and the cable above."""
    return {
        "plate": Fixed(transform(rotation_z(0.35), [0.3, 0.0, 1.114])),
        "cup": Riding("plate", transform(position=[0.03, 0.02, 0.035])),
        "cable": Upright("cup", np.array([0.0, 0.0, 0.02])),
    }


def held() -> dict[str, Placement | None]:
    """Place the plate in the right hand."""
    return {**resting(), "plate": Attached("right", transform(position=[0.0, 0.0, 0.36]))}
