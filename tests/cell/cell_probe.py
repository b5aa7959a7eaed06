"""What the tests of the cell measure with: python-fcl, pinocchio, and the published files."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from functools import lru_cache

import fcl
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from planners.cell.asset_shelf import read_hand_file, shipped_shelf
from planners.cell.cell import Cell
from planners.cell.hand import Gripper
from planners.geometry.convex import CollisionBody, ConvexShape, box
from planners.geometry.surface import hull_with_faces
from planners.kinematics.forward import link_frames
from tests.kinematics.arm_oracle import MODELS, published_urdf

ARM_URDF = "arms/ur3e/ur3e.urdf"
GRIPPER_URDF = "grippers/robotiq_2f_85/urdf/robotiq_2f_85.urdf"


def mesh_origins(path: str) -> dict[str, np.ndarray]:
    """Return `T_link_mesh` of each link that has a mesh."""
    origins = {}
    for link in ET.fromstring(published_urdf(path)).iter("link"):
        origin = link.find("visual/origin")
        if origin is not None and link.find("visual/geometry/mesh") is not None:
            xyz, rpy = (np.array(origin.get(key, "0 0 0").split(), dtype=float) for key in ("xyz", "rpy"))
            origins[link.get("name")] = pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz).homogeneous
    return origins


def obj_vertices(path: str, scale: float = 1.0) -> np.ndarray:
    """Read the vertices of a mesh of airo-models."""
    lines = (MODELS / path).read_text().splitlines()
    return scale * np.array([line.split()[1:4] for line in lines if line.startswith("v ")], dtype=float)


def moved(T_a_b: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def gripper_hulls(gripper: Gripper, width: float) -> dict[str, np.ndarray]:
    """Return all corners (n, 3) of base, pads and finger parts, in the flange frame, named as in `Gripper.bodies`."""
    meshes = read_hand_file(shipped_shelf().find("hands", gripper.name)).meshes
    points = {"gripper_base": np.add(shipped_shelf().hull_points(meshes.base), [0.0, 0.0, gripper.base_height])}
    for finger, frames in enumerate(gripper._finger_frames(width)):
        points[f"pad_{finger}"] = moved(frames["pad"], box(gripper.pad_size).vertices)
        for name in gripper.finger_parts:
            points[f"finger_{finger}_{name}"] = moved(frames[name], shipped_shelf().hull_points(getattr(meshes, name)))
    return points


def outside(points: np.ndarray, of: np.ndarray) -> np.ndarray:
    """Return how far each point is beyond the farthest face plane of the hull of other points (negative inside)."""
    planes = ConvexHull(of).equations
    return (points @ planes[:, :3].T + planes[:, 3]).max(axis=1)


def cell_frames(cell: Cell, q: np.ndarray) -> dict[str, np.ndarray]:
    """Return `T_world_frame` of all frames at twelve joint positions."""
    frames = {"world": np.eye(4)}
    for i, (name, arm) in enumerate(cell.arms.items()):
        links = np.empty((7, 4, 4))
        link_frames(arm.dh, arm.T_world_base, np.ascontiguousarray(q[6 * i : 6 * i + 6]), links)
        frames |= {f"{name}/{k}": T for k, T in enumerate(links)}
    return frames


def fcl_object(body: CollisionBody, T_world_frame: np.ndarray) -> fcl.CollisionObject:
    """Return a body's only shape where its frame is."""
    (shape,) = body.shapes
    geometry, center = _geometry(shape)
    rotation = T_world_frame[:3, :3]
    return fcl.CollisionObject(geometry, fcl.Transform(rotation, rotation @ center + T_world_frame[:3, 3]))


def _geometry(shape: ConvexShape) -> tuple[fcl.CollisionGeometry, np.ndarray]:
    return _geometry_of(shape.vertices.tobytes(), shape.radius)


@lru_cache(maxsize=2000)
def _geometry_of(corners: bytes, radius: float) -> tuple[fcl.CollisionGeometry, np.ndarray]:
    """Return the geometry of a shape; the same links are looked at in very many places."""
    points = np.frombuffer(corners).reshape(-1, 3)
    if len(points) == 2:
        start, end = points
        assert np.allclose(np.cross(end - start, [0.0, 0.0, 1.0]), 0.0), "capsules of a hand lie along z"
        return fcl.Capsule(radius, float(np.linalg.norm(end - start))), 0.5 * (start + end)
    assert radius == 0.0
    vertices, faces = hull_with_faces(points)
    flat = np.column_stack([np.full(len(faces), 3), faces]).ravel()
    return fcl.Convex(vertices, len(faces), flat), np.zeros(3)


def fcl_distance(a: fcl.CollisionObject, b: fcl.CollisionObject) -> float:
    """Return the distance of two objects, not positive when they collide."""
    return fcl.distance(a, b, fcl.DistanceRequest(), fcl.DistanceResult())
