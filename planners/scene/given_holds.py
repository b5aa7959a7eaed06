"""Grips and pushes that a task gives itself, instead of generated ones."""

from __future__ import annotations

import math

import numpy as np

from planners.contract.task_spec import GripSpec, PlateLiftOptions, PushSpec
from planners.errors import SceneError
from planners.geometry.pose import Array
from planners.scene.body import Plate

SURFACE_SLACK = 1e-3
"""How far a push may be from the face it is on [m]."""
DIRECTION_SLACK = math.radians(1.0)
"""How far a given direction may be off the plate's plane or a face's normal [rad]."""


def check_given_holds(options: PlateLiftOptions, plate: Plate) -> None:
    """Refuse grips that are not in the plate and pushes that are not on its surface.

    Raises:
        SceneError: naming the member that is wrong.
    """
    for i, grip in enumerate(options.grips or ()):
        _check_grip(grip, plate, f"/options/grips/{i}")
    for i, push in enumerate(options.pushes or ()):
        _check_push(push, plate, f"/options/pushes/{i}")


def _check_grip(grip: GripSpec, plate: Plate, pointer: str) -> None:
    if plate.solid.depth(grip.position) < -SURFACE_SLACK:
        raise SceneError(f"{pointer}/position", "the point between the pads is not inside the plate")
    if abs(grip.approach[2]) > math.sin(DIRECTION_SLACK):
        raise SceneError(f"{pointer}/approach", "the gripper must approach in the plate's plane")


def _check_push(push: PushSpec, plate: Plate, pointer: str) -> None:
    normals = _normals_at(np.array(push.position), plate)
    if not normals:
        raise SceneError(f"{pointer}/position", "the point is not on the plate's surface")
    if max(float(normal @ push.normal) for normal in normals) < math.cos(DIRECTION_SLACK):
        raise SceneError(f"{pointer}/normal", "the normal must point into the plate, square to the face at the point")
    if float(np.dot(push.direction, push.normal)) <= 0.0:
        raise SceneError(f"{pointer}/direction", "the stick must point into the plate")


def _normals_at(point: Array, plate: Plate) -> list[Array]:
    """Return the inward normals of the faces that a point in the plate's frame lies on."""
    if plate.solid.depth(point) < -SURFACE_SLACK:
        return []
    faces = plate.solid.flat_faces()
    return [-face.normal for face in faces if abs(float(face.normal @ (point - face.corners[0]))) <= SURFACE_SLACK]
