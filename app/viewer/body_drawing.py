"""A body of a plan document in a scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import trimesh
from viser import FrameHandle, SceneApi

from app.viewer.nodes import add_frame
from app.viewer.palette import BODIES, Rgb, rgb
from planners.geometry.pose import Array, from_pose7
from planners.geometry.surface import hull_with_faces

EDGE_DARKENING = 0.62
OUTLINED = ("plate", "object", "support", "obstacle", "table")
"""Roles whose edges are drawn."""
TRANSLUCENT = {"plate": 0.8, "object": 0.85}
"""Opacity of roles through which the forces inside must be seen."""
LIP_HEIGHT = 0.009
"""Of the cup at the end of a tool [m]."""
CUP_PROFILE = np.array(
    [[1.0, 0.0], [1.0, 0.06], [0.72, 0.26], [0.86, 0.34], [0.60, 0.52], [0.60, 0.80], [0.34, 0.84], [0.34, 1.0]]
)
"""Radius and height of a bellows cup's outline, in radii of its lip and in its height."""


def draw_body(
    scene: SceneApi,
    name: str,
    body: Mapping[str, Any],
    *,
    ghost: tuple[Rgb, float] | None = None,
    tint: Rgb | None = None,
) -> FrameHandle:
    """Add a body under a frame of its own, where it is at the start.

    Args:
        scene: where to add it.
        name: of the frame.
        body: an entry of a plan document's `bodies`.
        ghost: colour and opacity instead of those of its role.
        tint: colour instead of that of its role.
    """
    frame = add_frame(scene, name, from_pose7(body["pose"]))
    colour, opacity = ghost or (tint or BODIES[body["role"]], TRANSLUCENT.get(body["role"]))
    vertices, faces, round_ = _surface(body)
    scene.add_mesh_simple(
        f"{name}/surface",
        vertices,
        faces,
        color=colour,
        opacity=opacity,
        flat_shading=not round_,
        side="double" if body["role"] == "cup" else "front",
        cast_shadow=ghost is None,
        receive_shadow=ghost is None,
    )
    if body["role"] in OUTLINED and not round_:
        scene.add_line_segments(
            f"{name}/edges",
            _sharp_edges(vertices, faces),
            np.array(colour) * EDGE_DARKENING / 255.0,
            thickness=1.5,
            thickness_units="screen",
        )
    if body["role"] == "tool" and ghost is None:
        _draw_lip(scene, f"{name}/lip", vertices)
    return frame


def _draw_lip(scene: SceneApi, name: str, tool: Array) -> None:
    """Draw a cup round the lower end of a tool, whose origin is the centre of its lip."""
    lowest = tool[tool[:, 2] < LIP_HEIGHT]
    radius = 1.06 * float(np.hypot(lowest[:, 0], lowest[:, 1]).max(initial=0.0))
    if radius > 0.0:
        scene.add_cylinder(
            name, radius=radius, height=LIP_HEIGHT, color=rgb("suction"), position=(0.0, 0.0, 0.5 * LIP_HEIGHT)
        )


def _surface(body: Mapping[str, Any]) -> tuple[Array, np.ndarray, bool]:
    """Return vertices, faces, and whether the surface is round."""
    shape = body["shape"]
    match shape["type"]:
        case "box":
            mesh = trimesh.creation.box(shape["size"])
            return mesh.vertices, mesh.faces, False
        case "cylinder" if body["role"] == "cup":
            return *_cup(shape["radius"], shape["height"]), True
        case "cylinder":
            mesh = trimesh.creation.cylinder(shape["radius"], shape["height"], sections=40)
            return mesh.vertices, mesh.faces, True
        case "prism":
            outline, half = np.array(shape["outline"], dtype=float), 0.5 * shape["height"]
            corners = np.vstack([np.column_stack([outline, np.full(len(outline), z)]) for z in (-half, half)])
            return *hull_with_faces(corners), False
        case _:
            return np.array(shape["vertices"], dtype=float), np.array(shape["faces"]), False


def _cup(radius: float, height: float) -> tuple[Array, np.ndarray]:
    """Return a bellows cup whose lip is at the lower end of its cylinder."""
    profile = CUP_PROFILE * (radius, height) - (0.0, 0.5 * height)
    mesh = trimesh.creation.revolve(np.vstack([profile, [0.0, 0.5 * height]]), sections=40)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def _sharp_edges(vertices: Array, faces: np.ndarray) -> Array:
    """Return the edges (n, 2, 3) at which the surface bends."""
    mesh = trimesh.Trimesh(vertices, faces, process=True)
    sharp = mesh.face_adjacency_edges[mesh.face_adjacency_angles > np.radians(20.0)]
    return np.asarray(mesh.vertices[sharp], dtype=float)
