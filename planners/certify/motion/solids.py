"""Everything that can be hit, as python-fcl objects, and the signed distance between two of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import fcl
import numpy as np

from planners.certify.geometry.body_shape import ConvexPart
from planners.certify.motion.gap import largest_gap
from planners.certify.motion.robot_surfaces import LINKS, ArmSurfaces, GripperSurfaces, RobotSurfaces
from planners.certify.plan_view import MalformedDocument, PlanView
from planners.geometry.pose import Array, Transform, frame_from_z, transform
from planners.plan.scenery import ARMS, StickDocument

_SAME = 1e-6
"""Lengths that differ by less are one, of what a document rounds [m]."""
_THIN = 1e-7
"""Radius that stands for none: fcl's capsules must have one [m]."""
_MANY_AXES = 40_000
"""Pairs of edges beyond which a depth is bounded by the faces alone: larger than it is, never smaller."""


@dataclass(frozen=True)
class Frame:
    """What a solid moves with: a link of an arm, a part of a finger, or a body."""

    kind: str
    """"link", "finger" or "body"."""
    owner: str
    """The arm, or the body's name."""
    link: int = 0
    """Number of joints before the frame; 6 for fingers."""
    finger: int = 0
    part: str = ""


@dataclass(frozen=True, eq=False)
class ConvexSolid:
    """One convex solid, its coordinates those of its frame: a polytope, or a capsule."""

    name: str
    group: str
    """"link", "hand", "finger", "pad", "tip" for parts of an arm; the role for a body."""
    frame: Frame
    shape: fcl.CollisionObject
    core: fcl.CollisionObject | None
    """The capsule's axis; None for a polytope."""
    T_frame_shape: Transform
    """Identity for polytopes."""
    radius: float
    """Of a capsule, else 0 [m]."""
    points: Array
    """(k, 3) corners, or the ends of the capsule's axis [m]."""
    part: ConvexPart | None
    centre: Array
    """Of the bounding sphere [m]."""
    bound: float
    """Radius of the bounding sphere [m]."""
    corners: Array
    """(8, 3) of a bounding box [m]."""

    @cached_property
    def far(self) -> float:
        """How far any of its points is from the frame's origin, or more [m]."""
        return float(np.linalg.norm(self.centre)) + self.bound

    @property
    def arm(self) -> str | None:
        """The arm that the solid is part of, if any."""
        return None if self.frame.kind == "body" else self.frame.owner

    def place(self, T_world_frame: Transform, *, core: bool = False) -> fcl.CollisionObject:
        """Move the fcl object to a pose of its frame and return it."""
        T = T_world_frame if self.part is not None else T_world_frame @ self.T_frame_shape
        chosen = self.core if core and self.core is not None else self.shape
        chosen.setTransform(fcl.Transform(T[:3, :3], T[:3, 3]))
        return chosen


def polytope(name: str, group: str, frame: Frame, part: ConvexPart) -> ConvexSolid:
    """Make a solid of a convex part given in the solid's frame."""
    faces = np.column_stack([np.full(len(part.triangles), 3), part.triangles]).ravel()
    shape = fcl.CollisionObject(fcl.Convex(part.vertices, len(part.triangles), faces))
    return ConvexSolid(
        name, group, frame, shape, None, np.eye(4), 0.0, part.vertices, part, *_bounds(part.vertices, 0.0)
    )


def capsule(name: str, group: str, frame: Frame, ends: Array, radius: float) -> ConvexSolid:
    """Make a capsule around the segment between two points of the solid's frame, (2, 3) [m]."""
    axis = ends[1] - ends[0]
    length = float(np.linalg.norm(axis))
    direction = axis / length if length > 0 else np.array([0.0, 0.0, 1.0])
    hint = np.eye(3)[int(np.argmin(np.abs(direction)))]
    T_frame_shape = transform(frame_from_z(direction, hint), ends.mean(axis=0))
    shape = fcl.CollisionObject(fcl.Capsule(radius, length))
    core = fcl.CollisionObject(fcl.Capsule(_THIN, length))
    return ConvexSolid(name, group, frame, shape, core, T_frame_shape, radius, ends, None, *_bounds(ends, radius))


def _bounds(points: Array, radius: float) -> tuple[Array, float, Array]:
    low, high = points.min(axis=0) - radius, points.max(axis=0) + radius
    centre = (low + high) / 2
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    return (centre, float(np.linalg.norm(points - centre, axis=1).max()) + radius, corners)


def solids_of(plan: PlanView, surfaces: RobotSurfaces) -> list[ConvexSolid]:
    """Return all solids: both arms with their hands, then the bodies of the document."""
    solids: list[ConvexSolid] = []
    for arm in ARMS:
        known = surfaces[arm]
        for index, (link, hulls) in enumerate(zip(LINKS, known.links, strict=True)):
            solids += [polytope(f"{arm}_{link}", "link", Frame("link", arm, index), hull) for hull in hulls]
        flange = Frame("link", arm, 6)
        if known.sensor is not None:
            solids.append(polytope(f"{arm}_ft300", "hand", flange, known.sensor))
        if arm in plan.grippers:
            gripper = gripper_of(arm, surfaces)
            solids.append(polytope(f"{arm}_gripper_base", "hand", flange, gripper.base))
            solids += _fingers(arm, gripper)
        else:
            solids += _stick(arm, plan.sticks[arm], known)
    for body in plan.bodies.values():
        frame = Frame("body", body.name)
        solids += [polytope(body.name, body.role, frame, part) for part in body.shape.parts]
    return solids


def gripper_of(arm: str, surfaces: RobotSurfaces) -> GripperSurfaces:
    """Return the gripper that an arm is known to have.

    Raises:
        MalformedDocument: The document has a gripper where the cell has a stick.
    """
    gripper = surfaces[arm].gripper
    if gripper is None:
        raise MalformedDocument(f"/cell/hands/{arm}/kind", "the cell has no gripper there")
    return gripper


def _fingers(arm: str, gripper: GripperSurfaces) -> list[ConvexSolid]:
    solids = []
    for finger in (0, 1):
        for part, hull in gripper.finger_parts.items():
            name = f"{arm}_pad_{finger}" if part == "pad" else f"{arm}_finger_{finger}_{part}"
            group = "pad" if part == "pad" else "finger"
            solids.append(polytope(name, group, Frame("finger", arm, 6, finger, part), hull))
    return solids


def _stick(arm: str, stated: StickDocument, known: ArmSurfaces) -> list[ConvexSolid]:
    """Return the stick as the cell has it, and beyond its neck the tip, which may touch.

    Raises:
        MalformedDocument: The document has its tip elsewhere, or the cell has a gripper there.
    """
    stick, pointer = known.stick, f"/cell/hands/{arm}"
    if stick is None:
        raise MalformedDocument(f"{pointer}/kind", "the cell has no stick there")
    tip = np.array([0.0, 0.0, stick.tip])
    off = max(float(np.abs(stated.T_flange_tip[:3, 3] - tip).max()), abs(stated.tip_radius - stick.tip_radius))
    if off > _SAME:
        raise MalformedDocument(f"{pointer}/tcp", "the cell has the stick's tip elsewhere, or larger or smaller")
    start, neck = (np.array([0.0, 0.0, height]) for height in (known.sensor_length, stick.neck))
    flange = Frame("link", arm, 6)
    return [
        capsule(f"{arm}_stick", "hand", flange, np.array([start, neck]), stick.stick_radius),
        capsule(f"{arm}_tip", "tip", flange, np.array([neck, tip]), stick.tip_radius),
    ]


def signed_distance(a: ConvexSolid, T_world_a: Transform, b: ConvexSolid, T_world_b: Transform) -> float:
    """Return the distance between two solids [m], or minus how deep they are in one another; never more than it is."""
    return separation(a, T_world_a, b, T_world_b)[0]


def separation(a: ConvexSolid, T_world_a: Transform, b: ConvexSolid, T_world_b: Transform) -> tuple[float, Array]:
    """Return the signed distance between two solids, never more than it is [m], and the direction along which it is.

    The direction is a unit vector of the world, from a to b.

    Fcl's distances can be a third too large. So fcl is only asked for a direction, and the answer is the gap between
    the solids along it, which no error of fcl's can make larger than the distance. Where the gap is much smaller than
    what fcl says, the direction is bettered first.
    """
    way = _way(a.place(T_world_a), b.place(T_world_b))
    if way is None and (a.part is None or b.part is None):
        way = _way(a.place(T_world_a, core=True), b.place(T_world_b, core=True))
    found = (-math.inf, np.zeros(3))
    if way is not None:
        found = largest_gap(way, a.points, T_world_a, b.points, T_world_b, a.radius + b.radius)
    return found if found[0] > 0.0 else max(found, _best_gap(a, T_world_a, b, T_world_b), key=lambda pair: pair[0])


def _way(a: fcl.CollisionObject, b: fcl.CollisionObject) -> Array | None:
    """Return the way from a to b where fcl has them nearest; None where it has them touch."""
    result = fcl.DistanceResult()
    if fcl.distance(a, b, fcl.DistanceRequest(True), result) <= 0.0:
        return None
    on_a, on_b = (np.asarray(point, dtype=float) for point in result.nearest_points)
    way = on_b - on_a
    return way if float(way @ way) > 0.0 else None


def _best_gap(a: ConvexSolid, T_world_a: Transform, b: ConvexSolid, T_world_b: Transform) -> tuple[float, Array]:
    """Return the largest gap along all separating axes of the hulls of both solids' points [m], and the axis.

    If they overlap it is minus the shortest way out of one another; with too many edges to try all, minus more.
    """
    R = T_world_b[:3, :3].T @ T_world_a[:3, :3]
    p = T_world_b[:3, :3].T @ (T_world_a[:3, 3] - T_world_b[:3, 3])
    edges_a, edges_b = _edges(a) @ R.T, _edges(b)
    axes = [_normals(a) @ R.T, _normals(b)]
    if len(edges_a) * len(edges_b) <= _MANY_AXES:
        crosses = np.cross(edges_a[:, None], edges_b[None]).reshape(-1, 3)
        lengths = np.linalg.norm(crosses, axis=1)
        axes.append(crosses[lengths > 1e-6] / lengths[lengths > 1e-6, None])
    directions = np.vstack(axes)
    if not len(directions):
        return -a.radius - b.radius, np.array([0.0, 0.0, 1.0])
    along_a, along_b = directions @ (a.points @ R.T + p).T, directions @ b.points.T
    forward = along_b.min(axis=1) - along_a.max(axis=1)
    backward = along_a.min(axis=1) - along_b.max(axis=1)
    gaps = np.maximum(forward, backward)
    best = int(np.argmax(gaps))
    axis = T_world_b[:3, :3] @ directions[best]
    return float(gaps[best]) - a.radius - b.radius, axis if forward[best] >= backward[best] else -axis


def _normals(solid: ConvexSolid) -> Array:
    return np.zeros((0, 3)) if solid.part is None else solid.part.planes[:, :3]


def _edges(solid: ConvexSolid) -> Array:
    if solid.part is not None:
        return solid.part.edges
    axis = solid.points[1] - solid.points[0]
    length = math.sqrt(float(axis @ axis))
    return (axis / length)[None] if length > 0 else np.zeros((0, 3))
