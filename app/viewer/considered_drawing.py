"""Places of the cup and grasps of the tool that were considered, as small signs coloured by why they fell."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from viser import SceneApi, SceneNodeHandle

from app.viewer.considered import LAST_LAYER, GraspNode, graph_of, layer_of, looked_at, nodes_of, reason_colours
from app.viewer.palette import code_rgb
from planners.geometry.pose import Array, Transform, from_pose7

PIN = 0.012
"""Length of a pin on an object's surface [m]."""
FORK = np.array(
    [
        [[0.0, -1.0, 0.0], [0.0, -1.0, -0.022]],
        [[0.0, 1.0, 0.0], [0.0, 1.0, -0.022]],
        [[0.0, -1.0, -0.022], [0.0, 1.0, -0.022]],
        [[0.0, 0.0, -0.022], [0.0, 0.0, -0.05]],
    ]
)
"""A hand as four lines in the TCP frame: x and z in metres, y in halves of its opening."""
THIN, THICK = 1.2, 2.6
"""Lines of what fell and of what is possible [pixels]."""


def draw_places(scene: SceneApi, parent: str, document: Mapping[str, Any], name: str) -> list[SceneNodeHandle]:
    """Pin the places of the cup that were considered to an object; `parent` is the node of its frame."""
    places = looked_at(document).get("places", {}).get(name, ())
    if not places:
        return []
    colours = np.array([_colour(document, place["reason"]) for place in places], dtype=np.uint8)
    points = np.array([place["point"] for place in places])
    tips = points + PIN * np.array([place["normal"] for place in places])
    pins = scene.add_line_segments(
        f"{parent}/places", np.stack([points, tips], axis=1), _ends(colours), thickness=2.0, thickness_units="screen"
    )
    heads = scene.add_point_cloud(f"{parent}/place_heads", tips, colours, point_size=0.004, point_shape="circle")
    return [pins, heads]


def draw_grasps(scene: SceneApi, root: str, document: Mapping[str, Any], name: str) -> list[SceneNodeHandle]:
    """Draw the grasps that were asked for with the tool on an object at its start, in the world."""
    graph = graph_of(document, name)
    layer = None if graph is None else layer_of(graph, LAST_LAYER)
    if graph is None or layer is None:
        return []
    T_world_tool = from_pose7(layer["tool_pose"])
    nodes = list(nodes_of(document, graph, layer))
    handles: list[SceneNodeHandle] = []
    for good, thickness in ((False, THIN), (True, THICK)):
        drawn = [node for node in nodes if (node.reason is None) is good]
        if drawn:
            lines = np.concatenate([_fork(document, T_world_tool, node) for node in drawn])
            colours = np.repeat([_colour(document, node.reason) for node in drawn], len(FORK), axis=0)
            handles.append(
                scene.add_line_segments(
                    f"{root}/{name}_{'possible' if good else 'rejected'}",
                    lines,
                    _ends(colours.astype(np.uint8)),
                    thickness=thickness,
                    thickness_units="screen",
                )
            )
    return handles


def _fork(document: Mapping[str, Any], T_world_tool: Transform, node: GraspNode) -> Array:
    grasps = document["statistics"]["considered"]["tool_grasps"]
    T = T_world_tool @ from_pose7(grasps["poses"][node.grasp])
    lines = FORK * (1.0, 0.5 * grasps["widths"][node.grasp], 1.0)
    return lines @ T[:3, :3].T + T[:3, 3]


def _colour(document: Mapping[str, Any], reason: str | None) -> tuple[int, int, int]:
    return code_rgb(reason_colours(document)[reason])


def _ends(colours: Array | np.ndarray) -> np.ndarray:
    """Return the colours of both ends of each line."""
    return np.repeat(colours[:, None, :], 2, axis=1)
