"""Grips and pushes that a task gives itself, instead of generated ones: checked, and put exactly onto the plate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planners.contract.task_spec import GripSpec, PlateLiftOptions, PushSpec
from planners.errors import SceneError
from planners.geometry.pose import Array
from planners.scene.body import Plate
from planners.scene.hand import Gripper

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


def settle_grips(options: PlateLiftOptions, plate: Plate, gripper: Gripper) -> tuple[GivenGrip, ...] | None:
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


def settle_pushes(options: PlateLiftOptions, plate: Plate) -> tuple[GivenPush, ...] | None:
    """Put given pushes onto the faces they mean; None if there is no list.

    Raises:
        SceneError: naming the push that is not on one face of the plate, or not inside the push cone.
    """
    if options.pushes is None:
        return None
    return tuple(_push(push, plate, f"/options/pushes/{i}") for i, push in enumerate(options.pushes))


def _grip(grip: GripSpec, plate: Plate, pointer: str) -> GivenGrip:
    x, y, z = grip.position
    if plate.solid.depth((x, y, 0.0)) < 0.0:
        raise SceneError(f"{pointer}/position", "the point between the pads is not inside the plate")
    if abs(z) > SURFACE_SLACK:
        raise SceneError(f"{pointer}/position", f"the point is {abs(1e3 * z):.4g} mm from midway between the faces")
    if abs(grip.approach[2]) > math.sin(DIRECTION_SLACK):
        raise SceneError(f"{pointer}/approach", "the gripper must approach in the plate's plane")
    return GivenGrip(np.array([x, y, 0.0]), _unit([grip.approach[0], grip.approach[1], 0.0]))


def _push(push: PushSpec, plate: Plate, pointer: str) -> GivenPush:
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
    """Return the angle between two unit vectors [rad]."""
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))
