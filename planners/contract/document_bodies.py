"""The `bodies` of a plan document: everything in the scene, where it is at the start."""

from __future__ import annotations

from typing import Any

from planners.geometry.pose import to_pose7
from planners.scene.body import Body
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.tool_scene import SuctionToolScene


def document_bodies(scene: PlateLiftScene | SuctionToolScene) -> dict[str, dict[str, Any]]:
    """Return every body by name as JSON data: those of the cell first, then those of the task."""
    return {**scene.cell.body_documents(), **{body.name: _body_document(body) for body in scene.bodies()}}


def _body_document(body: Body) -> dict[str, Any]:
    return {
        "role": body.role,
        "shape": body.shape.model_dump(mode="json"),
        "mass": body.mass,
        "com": [float(value) for value in body.com],
        "pose": to_pose7(body.T_world_body),
        "static": body.static,
    }
