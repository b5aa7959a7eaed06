"""Collision queries of the full cell, beside coal (through pinocchio and pair by pair) and python-fcl."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from time import process_time

import fcl
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from planners.cell.cell import Cell, load_cell
from planners.collision.model import CollisionModel, CollisionQuery, Fixed, Riding, Upright
from planners.geometry.convex import CollisionBody, ConvexShape, box, capsule, cylinder
from planners.geometry.pose import Array, Transform, rotation_x, rotation_z, transform
from planners.kinematics.forward import link_frames

CONFIGURATIONS, COAL_CONFIGURATIONS, FCL_CONFIGURATIONS, EDGES = 20_000, 500, 40, 2_000
EDGE_LENGTH = 0.3
"""Of an edge of both arms [rad]."""
SPREAD = 1.0
"""Of configurations about home [rad]."""
AGREED = [("plate", "table"), ("plate", "cup"), ("plate", "cable"), ("cup", "cable")]
Movable = Mapping[str, tuple[str, Transform]]
PLACEMENTS = {
    "plate": Fixed(transform(rotation_z(0.35), [0.3, 0.0, 1.1145])),
    "cup": Riding("plate", transform(position=[0.03, 0.02, 0.035])),
    "cable": Upright("cup", np.array([0.0, 0.0, 0.02])),
}


def measure() -> dict[str, float]:
    """Return CPU microseconds per configuration and edge, rates, and verdicts on which the engines differ."""
    cell = load_cell("dual_ur3e_lift")
    model = _model(cell)
    query = model.scene(PLACEMENTS, allowed=AGREED)
    rng = np.random.default_rng(0)
    home = np.concatenate([arm.home for arm in cell.arms.values()])
    mixed = home + rng.uniform(-SPREAD, SPREAD, size=(CONFIGURATIONS, 12))
    verdicts = query.first_collision(mixed) >= 0
    free = mixed[~verdicts]
    starts = free[:EDGES]
    steps = rng.normal(size=starts.shape)
    ends = starts + EDGE_LENGTH * steps / np.linalg.norm(steps, axis=1)[:, None]
    query.edge(starts[0], ends[0])
    coal, fcl_scene = PinocchioScene(cell, query), FclScene(cell, query)
    free_us = _microseconds(lambda: query.first_collision(free), len(free))
    return {
        "shapes": float(len(query.kernel.shapes)),
        "pairs": float(len(query.kernel.pairs)),
        "free_share": float(1.0 - verdicts.mean()),
        "free_us": free_us,
        "free_per_second": 1e6 / free_us,
        "mixed_us": _microseconds(lambda: query.first_collision(mixed), len(mixed)),
        "coal_broadphase_free_us": _each(coal.broadphase, free[:COAL_CONFIGURATIONS]),
        "coal_pairs_free_us": _each(coal.all_pairs, free[:COAL_CONFIGURATIONS]),
        "fcl_pairs_free_us": _each(fcl_scene.all_pairs, free[:FCL_CONFIGURATIONS]),
        "edge_us": _microseconds(lambda: [query.edge(a, b) for a, b in zip(starts, ends, strict=True)], len(starts)),
        "scene_us": _microseconds(lambda: [model.scene(PLACEMENTS, allowed=AGREED) for _ in range(500)], 500),
        "build_us": _microseconds(lambda: _model(cell), 1),
        "coal_differs": _differing(coal.broadphase, mixed[:COAL_CONFIGURATIONS], verdicts),
        "fcl_differs": _differing(fcl_scene.all_pairs, mixed[:FCL_CONFIGURATIONS], verdicts),
    }


def _model(cell: Cell) -> CollisionModel:
    bodies = [
        *cell.collision_bodies({"right": 0.045}),
        CollisionBody("plate", "plate", "plate", (box([0.3, 0.3, 0.04]),)),
        CollisionBody("cup", "cup", "cup", (cylinder(0.0175, 0.03),)),
        CollisionBody("cable", "cable", "cable", (capsule((0, 0, 0.03), (0, 0, 1.1), 0.01),)),
    ]
    arms = {name: (arm.dh, arm.T_world_base) for name, arm in cell.arms.items()}
    return CollisionModel.build(arms, bodies, cell.excluded_pairs)


class PinocchioScene:
    """The query's shapes and pairs in pinocchio, its arms rebuilt from their DH tables.

    `movable` says in which frame and where in it other bodies are (`PLACEMENTS` unless told); nothing comes nearer than
    `margin`.
    """

    def __init__(self, cell: Cell, query: CollisionQuery, movable: Movable | None = None, margin: float = 0.0) -> None:
        self.model = pin.Model()
        geometry = pin.GeometryModel()
        holders = {"world": (0, np.eye(4)), **(_movable_frames() if movable is None else {})}
        for name, arm in cell.arms.items():
            joint, T = 0, arm.T_world_base
            holders[f"{name}/0"] = (0, T)
            for i, (a, alpha, d, theta0) in enumerate(arm.dh):
                T_joint = pin.SE3(T @ transform(rotation_z(theta0)))
                joint = self.model.addJoint(joint, pin.JointModelRZ(), T_joint, f"{name}_{i}")
                T = transform(rotation_x(alpha), [a, 0.0, d])
                holders[f"{name}/{i + 1}"] = (joint, T)
        for name, (frame, T_frame_body) in (movable or {}).items():
            joint, T = holders[frame]
            holders[name] = (joint, T @ T_frame_body)
        for number, (frame, shape) in enumerate(_framed_shapes(query)):
            joint, T = holders[frame]
            local, T_shape = _coal_geometry(shape)
            geometry.addGeometryObject(pin.GeometryObject(str(number), joint, pin.SE3(T @ T_shape), local))
        for a, b in query.kernel.pairs[:, :2].tolist():
            geometry.addCollisionPair(pin.CollisionPair(a, b))
        self.geometry = geometry
        self.data, self.geometry_data = self.model.createData(), pin.GeometryData(geometry)
        for request in self.geometry_data.collisionRequests:
            request.security_margin = margin
        self.manager = pin.BroadPhaseManager_NaiveCollisionManager(self.model, geometry, self.geometry_data)

    def broadphase(self, q: Array) -> bool:
        """Whether anything collides, culled by boxes."""
        return pin.computeCollisions(self.model, self.data, self.manager, q, True)

    def all_pairs(self, q: Array) -> bool:
        """Whether anything collides, pair by pair in C++."""
        return pin.computeCollisions(self.model, self.data, self.geometry, self.geometry_data, q, True)


class FclScene:
    """The query's shapes and pairs in python-fcl, pair by pair."""

    def __init__(self, cell: Cell, query: CollisionQuery) -> None:
        self.cell = cell
        self.pairs = query.kernel.pairs[:, :2].tolist()
        shapes = _framed_shapes(query)
        self.frames = [frame for frame, _ in shapes]
        self.objects: list[fcl.CollisionObject] = []
        self.offsets: list[Transform] = []
        for _, shape in shapes:
            geometry, offset = _fcl_geometry(shape)
            self.objects.append(fcl.CollisionObject(geometry))
            self.offsets.append(offset)

    def all_pairs(self, q: Array) -> bool:
        """Whether anything collides."""
        poses = {"world": np.eye(4), **{name: T for name, (_, T) in _movable_frames().items()}}
        for k, (name, arm) in enumerate(self.cell.arms.items()):
            frames = np.empty((7, 4, 4))
            link_frames(arm.dh, arm.T_world_base, q[6 * k : 6 * k + 6], frames)
            poses |= {f"{name}/{i}": frames[i] for i in range(7)}
        for item, frame, offset in zip(self.objects, self.frames, self.offsets, strict=True):
            T = poses[frame] @ offset
            item.setTransform(fcl.Transform(T[:3, :3], T[:3, 3]))
        request, result = fcl.CollisionRequest(), fcl.CollisionResult()
        return any(fcl.collide(self.objects[a], self.objects[b], request, result) > 0 for a, b in self.pairs)


def _movable_frames() -> dict[str, tuple[int, Transform]]:
    """Where the plate, cup and cable of `PLACEMENTS` stand in the world, held by joint 0."""
    T_world_plate = PLACEMENTS["plate"].T_world_body
    T_world_cup = T_world_plate @ PLACEMENTS["cup"].T_parent_body
    top = T_world_cup[:3] @ np.append(PLACEMENTS["cable"].point, 1.0)
    return {"plate": (0, T_world_plate), "cup": (0, T_world_cup), "cable": (0, transform(position=top))}


def _framed_shapes(query: CollisionQuery) -> list[tuple[str, ConvexShape]]:
    return [(body.frame, shape) for body in query.model.bodies for shape in body.shapes]


def _capsule_frame(shape: ConvexShape) -> tuple[float, Transform]:
    """Return the length of a rod and its frame, z along it."""
    along = shape.vertices[1] - shape.vertices[0]
    length = float(np.linalg.norm(along))
    rotation, _ = np.linalg.qr(np.column_stack([along, np.eye(3)[:, np.argsort(np.abs(along))[:2]]]))
    z = along / length
    x = rotation[:, 1]
    return length, transform(np.column_stack([x, np.cross(z, x), z]), shape.vertices.mean(axis=0))


def _coal_geometry(shape: ConvexShape) -> tuple[object, Transform]:
    if len(shape.vertices) == 1:
        return pin.coal.Sphere(shape.radius), transform(position=shape.vertices[0])
    if len(shape.vertices) == 2:
        length, T = _capsule_frame(shape)
        return pin.coal.Capsule(shape.radius, length), T
    points = pin.coal.StdVec_Vec3s()
    points.extend(list(shape.vertices))
    hull = pin.coal.ConvexBase.convexHull(points, True, "Qt")
    hull.setSweptSphereRadius(shape.radius)
    return hull, np.eye(4)


def _fcl_geometry(shape: ConvexShape) -> tuple[fcl.CollisionGeometry, Transform]:
    """Return python-fcl's geometry; it cannot grow a hull, so the millimetre of a grown one is left out."""
    if len(shape.vertices) == 1:
        return fcl.Sphere(shape.radius), transform(position=shape.vertices[0])
    if len(shape.vertices) == 2:
        length, T = _capsule_frame(shape)
        return fcl.Capsule(shape.radius, length), T
    faces = ConvexHull(shape.vertices).simplices
    listed = np.column_stack([np.full(len(faces), 3), faces]).ravel().astype(np.int32)
    return fcl.Convex(shape.vertices, len(faces), listed), np.eye(4)


def _microseconds(work: Callable[[], object], count: int) -> float:
    started = process_time()
    work()
    return 1e6 * (process_time() - started) / count


def _each(check: Callable[[Array], bool], Q: Array) -> float:
    return _microseconds(lambda: [check(q) for q in Q], len(Q))


def _differing(check: Callable[[Array], bool], Q: Array, verdicts: Array) -> float:
    return float(sum(check(q) != verdict for q, verdict in zip(Q, verdicts, strict=False)))
