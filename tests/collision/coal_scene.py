"""The same scene in coal, with forward kinematics of its own: what the kernel is asked to agree with."""

from __future__ import annotations

import coal
import numpy as np

from planners.collision.model import Attached, CollisionModel, Fixed, Placement, Riding, Upright
from planners.geometry.convex import ConvexShape
from planners.geometry.pose import Array, Transform, rotation_x, rotation_z, transform
from tests.collision.synthetic_cell import BASES, UR3E


def world_frames(q: Array, placements: dict[str, Placement | None]) -> dict[str, Transform]:
    """Return `T_world_frame` of all frames by plain matrix products."""
    frames: dict[str, Transform] = {"world": np.eye(4)}
    for k, (arm, T) in enumerate(BASES.items()):
        frames[f"{arm}/0"] = T
        for i, (a, alpha, d, theta0) in enumerate(UR3E):
            joint = transform(rotation_z(q[6 * k + i] + theta0), [0, 0, d])
            T = T @ joint @ transform(rotation_x(alpha), [a, 0, 0])
            frames[f"{arm}/{i + 1}"] = T
    for _ in placements:
        for name, placement in placements.items():
            match placement:
                case Fixed(T_world_body=T):
                    frames[name] = T
                case Attached(arm=arm, T_flange_body=T):
                    frames[name] = frames[f"{arm}/6"] @ T
                case Riding(frame=parent, T_parent_body=T) if parent in frames:
                    frames[name] = frames[parent] @ T
                case Upright(frame=parent, point=point) if parent in frames:
                    frames[name] = transform(position=frames[parent][:3] @ np.append(point, 1.0))
                case _:
                    pass
    return frames


class CoalScene:
    """All shape pairs of a model, asked one by one."""

    def __init__(self, model: CollisionModel, placements: dict[str, Placement | None]) -> None:
        self.placements = placements
        self.shapes = [(body.frame, shape) for body in model.bodies for shape in body.shapes]
        self.geometries = [coal_geometry(shape) for _, shape in self.shapes]
        self.centers = np.array([shape.vertices.mean(axis=0) for _, shape in self.shapes])
        self.reaches = np.array(
            [
                np.linalg.norm(shape.vertices - center, axis=1).max() + shape.radius
                for (_, shape), center in zip(self.shapes, self.centers, strict=True)
            ]
        )
        self.request = coal.DistanceRequest()
        self.request.gjk_tolerance = 1e-8
        self.result = coal.DistanceResult()

    def distances(self, q: Array, pairs: Array, within: float) -> Array:
        """Return the distance of each shape pair (p, 2); inf where balls around them are more than `within` apart."""
        frames = world_frames(q, self.placements)
        poses = [frames[frame] for frame, _ in self.shapes]
        centers = np.array([T[:3, :3] @ c + T[:3, 3] for T, c in zip(poses, self.centers, strict=True)])
        a, b = pairs[:, 0], pairs[:, 1]
        gaps = np.linalg.norm(centers[a] - centers[b], axis=1) - self.reaches[a] - self.reaches[b]
        found = np.full(len(pairs), np.inf)
        for k in np.flatnonzero(gaps <= within):
            found[k] = self._distance(a[k], b[k], poses)
        return found

    def _distance(self, a: int, b: int, poses: list[Transform]) -> float:
        self.result.clear()
        placed = []
        grown = 0.0
        for shape in (a, b):
            geometry, T_shape_geometry, radius = self.geometries[shape]
            T = poses[shape] @ T_shape_geometry
            placed += [geometry, coal.Transform3s(T[:3, :3], T[:3, 3])]
            grown += radius
        return coal.distance(*placed, self.request, self.result) - grown


def coal_geometry(shape: ConvexShape) -> tuple[coal.CollisionGeometry, Transform, float]:
    """Return coal's geometry, where it stands in the shape's frame, and how much it is still to be grown."""
    if len(shape.vertices) == 1:
        return coal.Sphere(shape.radius), transform(position=shape.vertices[0]), 0.0
    if len(shape.vertices) == 2:
        start, end = shape.vertices
        along = end - start
        length = float(np.linalg.norm(along))
        # The synthetic scene has its rods along z.
        assert abs(along[2]) == length
        return coal.Capsule(shape.radius, length), transform(position=0.5 * (start + end)), 0.0
    points = coal.StdVec_Vec3s()
    points.extend(list(shape.vertices))
    return coal.ConvexBase.convexHull(points, True, "Qt"), np.eye(4), shape.radius
