"""Putting plate, support, cup and given holds of a plate lift where its task says."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from planners.cell.cell import CellLifter
from planners.cell.hand import Gripper
from planners.contract.shapes import Cylinder, Mesh
from planners.contract.task_spec import (
    GripSpec,
    LifterCup,
    PlateLiftOptions,
    PlateLiftTask,
    PushSpec,
    Support,
)
from planners.errors import SceneError
from planners.geometry import polygon
from planners.geometry.convex import CollisionBody, capsule
from planners.geometry.pose import Array, Transform, frame_from_z, from_pose7, transform
from planners.scene.body import Body, PlateBody
from planners.scene.placements import CONTAINMENT_SLACK
from planners.scene.rest import (
    REST_TILT,
    LevelFace,
    face_tilt,
    footprint,
    gaps,
    lowest_face,
    overhang,
    reaches,
    rests_level,
    scalar_last_hint,
    settled,
    upper_surface,
    why_apart,
)
from planners.scene.shape_source import ShapeSource
from planners.scene.solid import solid_of

SUPPORT_SHAPES = ("box", "cylinder", "prism")
"""The types of shapes that a plate may lie on."""
LEAST_CUP_STEP = 0.005
"""Places of a cup are not told apart more finely [m]."""
_PLACES_ACROSS = 5
"""Places of a cup along the longer side of a plate."""
_ON_THE_EDGE = 1e-6
"""Share of a step by which the outermost of them may miss the edge."""


def place_support(support: Support, table: LevelFace, shapes: ShapeSource) -> Body:
    """Settle the support on the table; its centre must be over it, or it would tip."""
    if isinstance(support.shape, Mesh):
        detail = "plates are not lifted off meshes yet"
        raise SceneError("/support/shape/type", detail, list(SUPPORT_SHAPES))
    stated, solid = shapes.find(support.shape, "/support/shape")
    body = Body("support", "support", stated, solid, None, np.zeros(3), from_pose7(support.pose), static=True)
    face = lowest_face(body.solid, body.T_world_body)
    if not rests_level(face, body.T_world_body, table.height):
        raise SceneError("/support/pose", _why_not_level("the support", body, table))
    T_world_support = settled(face, body.T_world_body, table.height)
    corners = footprint(face, T_world_support)
    if overhang(polygon.centroid(corners)[None], table) > 0.0:
        raise SceneError("/support/pose", "the centre of the support is not over the table")
    return replace(body, T_world_body=T_world_support)


def place_plate(task: PlateLiftTask, support: Body | None, table: LevelFace) -> tuple[PlateBody, LevelFace]:
    """Settle the plate on the support or the table, and return it with the surface it rests on."""
    given = task.plate
    solid = solid_of(given.shape)
    com = solid.centroid if given.com is None else np.array(given.com)
    T_world_plate = from_pose7(task.plate_pose)
    plate = PlateBody("plate", "plate", given.shape, solid, given.mass, com, T_world_plate, static=False)
    if plate.solid.depth(com) < -CONTAINMENT_SLACK:
        raise SceneError("/plate/com", "the centre of mass is not inside the plate")
    if T_world_plate[2, 2] <= 0.0:
        detail = "the plate lies upside down or on its side: its +z must point up"
        raise SceneError("/plate_pose", detail + scalar_last_hint(T_world_plate))
    surface = _surface_below(plate, support, table)
    face = plate.solid.flat_faces()[0]
    if not rests_level(face, T_world_plate, surface.height):
        raise SceneError("/plate_pose", _why_not_level("the plate", plate, surface))
    T_world_plate = settled(face, T_world_plate, surface.height)
    _check_footprint(footprint(face, T_world_plate), surface)
    return replace(plate, T_world_body=T_world_plate), surface


def _surface_below(plate: PlateBody, support: Body | None, table: LevelFace) -> LevelFace:
    """Return the surface nearest to the plate's bottom face."""
    surfaces = [table]
    if support is not None:
        top = upper_surface("support", support.solid, support.T_world_body)
        if top is None:
            raise SceneError("/support/pose", "the support has no level face on top")
        surfaces.insert(0, top)
    face = plate.solid.flat_faces()[0]
    return min(surfaces, key=lambda surface: float(np.abs(gaps(face, plate.T_world_body, surface.height)).max()))


def _why_not_level(who: str, body: Body, surface: LevelFace) -> str:
    face = lowest_face(body.solid, body.T_world_body)
    tilt = face_tilt(face, body.T_world_body)
    if tilt > REST_TILT:
        degrees = math.degrees(tilt)
        hint = scalar_last_hint(body.T_world_body)
        return f"{who} is tilted by {degrees:.3g} degrees; a resting face is level within 0.1 degrees{hint}"
    why = why_apart(face, body.T_world_body, surface.height, f"the {surface.name}")
    z = body.T_world_body[2, 3] - float(gaps(face, body.T_world_body, surface.height).mean())
    return f"{who} {why}; flat on the {surface.name} its z is {z:.6g}"


def _check_footprint(corners: Array, surface: LevelFace) -> None:
    """Refuse a plate whose bottom face, (k, 2) seen from above, is not wholly on its surface."""
    beyond = overhang(corners, surface)
    if beyond == 0.0:
        return
    if surface.name == "support" and polygon.area(corners) > polygon.area(surface.outline):
        raise SceneError("/support/shape", "the support is smaller than the plate: its whole bottom face must rest")
    detail = f"the plate's bottom face sticks out {1e3 * beyond:.4g} mm over the edge of the {surface.name}"
    if surface.name == "table":
        detail += f", which {reaches(surface)}"
    raise SceneError("/plate_pose", detail)


@dataclass(frozen=True, eq=False)
class SuctionCup:
    """A cup that sits on the plate's top face from the first sample to the last."""

    T_plate_cup: Transform
    """Contact frame: origin in the pad's centre, z into the plate, x the plate's x, y = z cross x."""
    position: Array
    """(2,) pad centre on the top face, in plate axes [m]."""
    radius: float
    """[m]"""
    max_force: float
    """Largest suction force [N]."""
    mu: float
    kappa: float
    """[N], see the suction model."""
    body: Body
    """Cylinder on the top face; its frame is at mid-height, with the plate's axes."""
    T_plate_cup_body: Transform
    """Where `body` rides on the plate."""
    cable: Body
    """Vertical cylinder that follows the cup's top and never tilts; its frame is at mid-height, with world axes."""
    cable_anchor: Array
    """(3,) lower end of the cable in the plate's frame: the centre of the cup's top [m]."""
    cable_length: float
    """[m]"""

    def cable_collision_body(self) -> CollisionBody:
        """Return the cable for collision queries in the upright frame "cable_end", with its lower end at the origin.

        A capsule around the cylinder: it is longer by its radius at both ends, where cup and trolley are.
        """
        axis = capsule([0.0, 0.0, 0.0], [0.0, 0.0, self.cable_length], self._cable_radius)
        return CollisionBody(self.cable.name, "cable", "cable_end", (axis,))

    @property
    def _cable_radius(self) -> float:
        assert isinstance(self.cable.shape, Cylinder)
        return self.cable.shape.radius


def cup_places(plate: PlateBody, radius: float, step: float) -> list[tuple[float, float]]:
    """Return places of a cup all over the plate's top face, in plate axes [m], the nearest to its centre of mass first.

    They are a square lattice about the middle of the outline, so that a plate that looks the same when it is turned or
    mirrored has places that do. There are none where the pad is larger than the plate.

    Args:
        plate: to put it on.
        radius: of the pad, all of which has to be on the plate [m].
        step: between neighbours along the plate's axes [m].
    """
    middle, room = polygon.centroid(plate.outline), _room(plate, radius)
    rows = [step * np.arange(-count, count + 1) for count in (room / step + _ON_THE_EDGE).astype(int)]
    places = middle + np.array([(x, y) for x in rows[0] for y in rows[1]])
    return cup_places_on(plate, radius, places)


def cup_step(plate: PlateBody, radius: float) -> float:
    """Return how far apart places of a cup are of which some are found all over a plate [m]."""
    return max(LEAST_CUP_STEP, 2.0 * float(_room(plate, radius).max()) / (_PLACES_ACROSS - 1))


def _room(plate: PlateBody, radius: float) -> Array:
    """Return how far a pad may be off the middle of a plate (2,) along its axes at most [m]."""
    return np.maximum(np.abs(plate.outline - polygon.centroid(plate.outline)).max(axis=0) - radius, 0.0)


def cup_places_on(plate: PlateBody, radius: float, places: Array) -> list[tuple[float, float]]:
    """Return those of the places (n, 2) at which all of the pad is on the plate, in whole millimetres.

    The nearest to the plate's centre of mass comes first.
    """
    rounded = np.round(places, 3) + 0.0
    inside = rounded[polygon.depth_inside(plate.outline, rounded) >= radius - CONTAINMENT_SLACK]
    off = np.round(np.linalg.norm(inside - plate.com[:2], axis=1), 6)
    return [(float(x), float(y)) for x, y in inside[np.lexsort((inside[:, 1], inside[:, 0], off))]]


def place_cup(cup: LifterCup, plate: PlateBody, lifter: CellLifter) -> SuctionCup:
    """Put the cup on the plate where the plate is at the start."""
    x, y = cup.place
    T_plate_cup = transform(frame_from_z([0.0, 0.0, -1.0], [1.0, 0.0, 0.0]), [x, y, plate.top])
    T_plate_cup_body = transform(position=[x, y, plate.top + 0.5 * lifter.cup_height])
    anchor = np.array([x, y, plate.top + lifter.cup_height])
    T_world_cable = transform(position=plate.T_world_body[:3, :3] @ anchor + plate.T_world_body[:3, 3])
    T_world_cable[2, 3] += 0.5 * lifter.cable_length
    pad = Cylinder(type="cylinder", radius=cup.radius, height=lifter.cup_height)
    rope = Cylinder(type="cylinder", radius=lifter.cable_radius, height=lifter.cable_length)
    return SuctionCup(
        T_plate_cup=T_plate_cup,
        position=np.array([x, y]),
        radius=cup.radius,
        max_force=cup.max_force,
        mu=cup.mu,
        kappa=cup.kappa,
        body=_massless("cup", pad, plate.T_world_body @ T_plate_cup_body),
        T_plate_cup_body=T_plate_cup_body,
        cable=_massless("cable", rope, T_world_cable),
        cable_anchor=anchor,
        cable_length=lifter.cable_length,
    )


def _massless(name: Literal["cup", "cable"], shape: Cylinder, T_world_body: Transform) -> Body:
    # The lifter bears its own weight: the plate does not feel cup and cable.
    return Body(name, name, shape, solid_of(shape), None, np.zeros(3), T_world_body, static=False)


SURFACE_SLACK = 1e-3
"""How far from midway between the faces a grip, or from its face a push may be; and, the other way round, how far a
push has to be from the next face [m]."""
DIRECTION_SLACK = math.radians(1.0)
"""How far a given direction may be off the plate's plane, a face's normal or the push cone [rad]."""
PUSH_CONE = math.radians(70.0)
"""Largest angle between a stick and the contact normal [rad]; our choice."""


@dataclass(frozen=True, eq=False)
class GivenGrip:
    """A grip in the plate's frame: fingers on top and bottom, exactly."""

    position: Array
    """(3,) midway between the faces [m]."""
    approach: Array
    """(3,) unit, in the plate's plane."""


@dataclass(frozen=True, eq=False)
class GivenPush:
    """A push in the plate's frame, exactly on one face."""

    point: Array
    """(3,) [m]"""
    normal: Array
    """(3,) unit, into the plate."""
    axis: Array
    """(3,) unit, along the stick towards its tip."""


def settle_grips(options: PlateLiftOptions, plate: PlateBody, gripper: Gripper) -> tuple[GivenGrip, ...] | None:
    """Put given grips midway between the plate's faces, where they are antipodal; None if there is no list.

    Raises:
        SceneError: naming the grip that is not in the plate or not in its plane, or the list if the gripper does not
            open so far.
    """
    if options.grips is None:
        return None
    if plate.height > gripper.width_max:
        detail = f"the plate is {1e3 * plate.height:.4g} mm thick, the gripper opens {1e3 * gripper.width_max:.4g} mm"
        raise SceneError("/options/grips", detail)
    return tuple(_grip(grip, plate, f"/options/grips/{i}") for i, grip in enumerate(options.grips))


def settle_pushes(options: PlateLiftOptions, plate: PlateBody) -> tuple[GivenPush, ...] | None:
    """Put given pushes onto the faces they mean; None if there is no list.

    Raises:
        SceneError: naming the push that is not on one face of the plate, or not inside the push cone.
    """
    if options.pushes is None:
        return None
    return tuple(_push(push, plate, f"/options/pushes/{i}") for i, push in enumerate(options.pushes))


def _grip(grip: GripSpec, plate: PlateBody, pointer: str) -> GivenGrip:
    x, y, z = grip.position
    if plate.solid.depth((x, y, 0.0)) < 0.0:
        raise SceneError(f"{pointer}/position", "the point between the pads is not inside the plate")
    if abs(z) > SURFACE_SLACK:
        raise SceneError(f"{pointer}/position", f"the point is {abs(1e3 * z):.4g} mm from midway between the faces")
    if abs(grip.approach[2]) > math.sin(DIRECTION_SLACK):
        raise SceneError(f"{pointer}/approach", "the gripper must approach in the plate's plane")
    return GivenGrip(np.array([x, y, 0.0]), _unit([grip.approach[0], grip.approach[1], 0.0]))


def _push(push: PushSpec, plate: PlateBody, pointer: str) -> GivenPush:
    point = np.array(push.position)
    faces = plate.solid.flat_faces()
    outside = np.array([face.normal @ (point - face.corners[0]) for face in faces])
    near = np.flatnonzero(np.abs(outside) <= SURFACE_SLACK)
    if np.any(outside > SURFACE_SLACK) or len(near) == 0:
        raise SceneError(f"{pointer}/position", "the point is not on the plate's surface")
    if len(near) > 1:
        raise SceneError(f"{pointer}/position", "the point is on an edge of the plate; a push needs one face")
    normal = -faces[near[0]].normal
    if _angle(normal, np.array(push.normal)) > DIRECTION_SLACK:
        raise SceneError(f"{pointer}/normal", "the normal must point into the plate, square to the face at the point")
    axis = np.array(push.direction)
    if _angle(axis, normal) > PUSH_CONE + DIRECTION_SLACK:
        limit = math.degrees(PUSH_CONE)
        raise SceneError(
            f"{pointer}/direction", f"the stick must point into the plate, within {limit:.0f}° of the normal"
        )
    return GivenPush(point + outside[near[0]] * normal, normal, _unit(axis))


def _unit(direction: Sequence[float] | Array) -> Array:
    vector = np.array(direction, dtype=float)
    return vector / np.linalg.norm(vector)


def _angle(a: Array, b: Array) -> float:
    """Return the angle between two unit vectors (3,) [rad]."""
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))
