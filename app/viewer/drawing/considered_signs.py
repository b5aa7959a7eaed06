"""What a suction-tool planner looked at, as signs: cup places and grasps of the tool, coloured by why they fell."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from viser import SceneApi, SceneNodeHandle

from app.viewer.palette import GOOD_COLOUR, REASON_COLOURS, code_rgb
from planners.geometry.pose import Array, Transform, from_pose7
from planners.plan.considered import Considered, RegraspGraph, RegraspLayer

DRAWN_LAYER = "suction"
"""The layer whose grasps are drawn and counted: the tool on the object at its start."""
PIN, HEAD = 0.012, 0.004
"""Length of a pin on an object's surface, and size of its head, in a cell of size 1 [m]."""
FORK = np.array(
    [
        [[0.0, -1.0, 0.0], [0.0, -1.0, -0.022]],
        [[0.0, 1.0, 0.0], [0.0, 1.0, -0.022]],
        [[0.0, -1.0, -0.022], [0.0, 1.0, -0.022]],
        [[0.0, 0.0, -0.022], [0.0, 0.0, -0.05]],
    ]
)
"""A hand as four lines in the TCP frame: x and z in metres, in a cell of size 1; y in halves of its opening."""
THIN, THICK = 1.2, 2.6
"""Lines of what fell and of what is possible [pixels]."""


def reason_colours(considered: Considered) -> dict[str | None, str]:
    """Return a colour for each reason that appears, the most frequent first; None is for what did not fall."""
    counts: Counter[str] = Counter()
    for places in considered.places.values():
        counts.update(place.reason for place in places if place.reason is not None)
    for graph in considered.regrasp_graphs:
        for layer in graph.layers:
            counts.update({reason: len(nodes) for reason, nodes in layer.rejected.items()})
        counts.update(edge.reason for edge in graph.edges if edge.reason is not None)
    colours: dict[str | None, str] = {None: GOOD_COLOUR}
    for index, (reason, _) in enumerate(counts.most_common()):
        colours[reason] = REASON_COLOURS[min(index, len(REASON_COLOURS) - 1)]
    return colours


@dataclass(frozen=True)
class AskedGrasp:
    """A grasp of the tool, and why it fell; None: it is possible."""

    grasp: int
    reason: str | None


def told_graph(considered: Considered, name: str) -> RegraspGraph | None:
    """Return the regrasp graph of an object: the one that moved it, else the last one that was tried."""
    mine = [graph for graph in considered.regrasp_graphs if graph.object == name]
    moved = [graph for graph in mine if graph.moved]
    return (moved or mine or [None])[-1]


def _layer(considered: Considered, name: str) -> RegraspLayer | None:
    graph = told_graph(considered, name)
    layers = () if graph is None else graph.layers
    return next((layer for layer in layers if layer.layer == DRAWN_LAYER), None)


def asked_grasps(considered: Considered, name: str) -> Iterator[AskedGrasp]:
    """Yield the grasps that were asked for with the tool on an object at its start, the rejected ones first."""
    layer, count = _layer(considered, name), len(considered.tool_grasps.widths)
    if layer is None:
        return
    for reason, nodes in layer.rejected.items():
        yield from (AskedGrasp(node % count, reason) for node in nodes)
    yield from (AskedGrasp(node % count, None) for node in layer.possible)


def draw_places(
    scene: SceneApi, node: str, considered: Considered, name: str, cell_size: float
) -> list[SceneNodeHandle]:
    """Pin the places of the cup that were considered to an object, below a node that has its frame."""
    places = considered.places.get(name, ())
    if not places:
        return []
    colours = _colours(considered, [place.reason for place in places])
    points = np.array([place.point for place in places])
    tips = points + cell_size * PIN * np.array([place.normal for place in places])
    pins = scene.add_line_segments(
        f"{node}/pins", np.stack([points, tips], axis=1), _ends(colours), thickness=2.0, thickness_units="screen"
    )
    heads = scene.add_point_cloud(f"{node}/heads", tips, colours, point_size=cell_size * HEAD, point_shape="circle")
    return [pins, heads]


def draw_grasps(
    scene: SceneApi, node: str, considered: Considered, name: str, cell_size: float
) -> list[SceneNodeHandle]:
    """Draw the grasps that were asked for with the tool on an object at its start, below a node at the origin."""
    layer = _layer(considered, name)
    if layer is None:
        return []
    T_world_tool = from_pose7(layer.tool_pose)
    asked = list(asked_grasps(considered, name))
    handles: list[SceneNodeHandle] = []
    for good, thickness in ((False, THIN), (True, THICK)):
        drawn = [each for each in asked if (each.reason is None) is good]
        if drawn:
            colours = _colours(considered, [each.reason for each in drawn])
            handles.append(
                scene.add_line_segments(
                    f"{node}/{'possible' if good else 'rejected'}",
                    np.concatenate([_fork(considered, T_world_tool, each.grasp, cell_size) for each in drawn]),
                    _ends(np.repeat(colours, len(FORK), axis=0)),
                    thickness=thickness,
                    thickness_units="screen",
                )
            )
    return handles


def _fork(considered: Considered, T_world_tool: Transform, grasp: int, cell_size: float) -> Array:
    grasps = considered.tool_grasps
    T = T_world_tool @ from_pose7(grasps.poses[grasp])
    lines = FORK * (cell_size, 0.5 * grasps.widths[grasp], cell_size)
    return lines @ T[:3, :3].T + T[:3, 3]


def _colours(considered: Considered, reasons: Iterable[str | None]) -> np.ndarray:
    """Return the colour of each reason (n, 3)."""
    by_reason = reason_colours(considered)
    return np.array([code_rgb(by_reason[reason]) for reason in reasons], dtype=np.uint8)


def _ends(colours: np.ndarray) -> np.ndarray:
    """Return the colours of both ends of each line (n, 2, 3)."""
    return np.repeat(colours[:, None, :], 2, axis=1)
