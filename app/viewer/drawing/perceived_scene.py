"""A perceived scene, drawn with what was measured and the models that were fitted to it."""

from __future__ import annotations

import numpy as np
from viser import SceneNodeHandle

from app.viewer.drawing.body_drawing import Stage, add_frame, draw_body, hull_of_prism
from app.viewer.palette import rgb, vivid_tint
from planners.cell.cell import Cell
from planners.contract.scene_document import ObjectPart, SceneDocument, SeenToolPart, UnrecognisedPart
from planners.contract.shapes import InlineMesh
from planners.geometry.pose import Array, from_pose7
from planners.perception.seen_points import NOBODY, SeenPoints
from planners.scene.suction_tool import find_tool

LAYERS = ("points", "around", "models", "names", "tool", "robot")
"""What can be shown or hidden; all of it is shown at first."""
MODEL_OPACITY, LOST_OPACITY = 0.36, 0.25
POINT_SIZE, SMALL_POINT_SIZE = 0.0030, 0.0018
"""Of an object's points, and of all others, in a cell of size 1 [m]."""
AROUND_COLOUR = (150, 164, 180)
"""Of points that speak for no object."""
LIFTED = 0.0006
"""Points are drawn so far up, or the faces of the models they lie in would swallow half of them [m]."""
AXES_LENGTH = 0.09
"""Of the tool's frame, in a cell of size 1 [m]."""
NAME_GAP = 0.025
"""Between an object and its name, in a cell of size 1 [m]."""
SURE = 2.0
"""± is so many uncertainties of the document: 19 of 20 errors are smaller [1]."""


class SceneDrawing:
    """One perceived scene. Methods may be called from any one thread at a time."""

    layers = LAYERS

    def __init__(self, stage: Stage, root: str, document: SceneDocument, points: SeenPoints | None) -> None:
        """Draw what was perceived.

        Args:
            stage: with nothing on it but the cell that it was perceived in.
            root: name of the node that all others stand under, never used before in the server's life.
            document: what was perceived.
            points: what was measured; None: nothing was, or it was not kept.
        """
        scene, cell = stage.scene, stage.cell
        self._scene, self._root, self._stage, self._size = scene, root, stage, cell.size
        stage.set_up()
        for name, body in cell.body_documents().items():
            draw_body(scene, f"{root}/bodies/{name}", body.role, body.shape, body.pose)
        measured = points or _told_points(document)
        self._layers: dict[str, list[SceneNodeHandle]] = {
            "points": [self._add_points(index, measured) for index in range(len(document.objects))],
            "around": [self._add_points(NOBODY, measured)],
            "models": [
                *(self._add_model(index, part) for index, part in enumerate(document.objects)),
                *(self._add_lost(index, part, cell.table_top) for index, part in enumerate(document.unrecognised)),
            ],
            "names": [self._add_name(part) for part in document.objects],
            "tool": [] if document.tool is None else [self._add_tool(document.tool)],
        }
        self.body_position = _middle(document, cell)
        """The middle of what was found (3,), in the world [m]."""

    def set_layer(self, layer: str, visible: bool) -> None:
        """Show or hide one of `LAYERS`."""
        if layer == "robot":
            self._stage.show_robot(visible)
            return
        for handle in self._layers[layer]:
            handle.visible = visible

    def _add_points(self, owner: int, measured: SeenPoints) -> SceneNodeHandle:
        mine = measured.points[measured.owners == owner] + (0.0, 0.0, LIFTED)
        nobodys = owner == NOBODY
        return self._scene.add_point_cloud(
            f"{self._root}/points/{'around' if nobodys else owner}",
            mine.astype(np.float32),
            AROUND_COLOUR if nobodys else vivid_tint(owner),
            point_size=self._size * (SMALL_POINT_SIZE if nobodys else POINT_SIZE),
            point_shape="circle",
            point_shading="flat",
            precision="float32",
        )

    def _add_model(self, index: int, part: ObjectPart) -> SceneNodeHandle:
        name, ghost = f"{self._root}/models/{index}", (vivid_tint(index), MODEL_OPACITY)
        return draw_body(self._scene, name, "object", part.shape, part.pose, ghost=ghost)

    def _add_lost(self, index: int, part: UnrecognisedPart, table_top: float) -> SceneNodeHandle:
        """Draw what was not recognised as a prism round all of it, from the table up."""
        outline = np.array(part.outline)
        center, height = 0.5 * (outline.min(axis=0) + outline.max(axis=0)), max(0.002, part.top - table_top)
        vertices, faces = hull_of_prism(outline - center, height)
        shape = InlineMesh(type="mesh", vertices=vertices, faces=faces.tolist(), convex_parts=[vertices])
        name, pose = f"{self._root}/lost/{index}", [*center, table_top + 0.5 * height, 1.0, 0.0, 0.0, 0.0]
        return draw_body(self._scene, name, "obstacle", shape, pose, ghost=(rgb("limit"), LOST_OPACITY))

    def _add_name(self, part: ObjectPart) -> SceneNodeHandle:
        x, y, z = part.pose[:3]
        return self._scene.add_label(
            f"{self._root}/names/{part.name}",
            f"{part.name}   {size_words(part)}",
            position=(x, y, z + 0.5 * size_of(part)[2] + self._size * NAME_GAP),
            font_screen_scale=0.95,
            anchor="bottom-center",
        )

    def _add_tool(self, tool: SeenToolPart) -> SceneNodeHandle:
        name = f"{self._root}/tool"
        drawn = draw_body(self._scene, name, "tool", find_tool(tool.name, self._stage.cell).body.shape, tool.pose)
        add_frame(self._scene, f"{name}/frame", np.eye(4), axes_length=self._size * AXES_LENGTH)
        T_tool_world = np.linalg.inv(from_pose7(tool.pose))
        above = np.add(tool.markers_at, (0.0, 0.0, self._size * NAME_GAP))
        self._scene.add_label(
            f"{name}/name",
            tool.name,
            position=T_tool_world[:3, :3] @ above + T_tool_world[:3, 3],
            font_screen_scale=0.95,
            anchor="bottom-center",
        )
        return drawn


def _told_points(document: SceneDocument) -> SeenPoints:
    """Return the few points that the document itself tells of each object."""
    told = [(index, part.support_points) for index, part in enumerate(document.objects)]
    points = np.array([point for _, some in told for point in some], dtype=float).reshape(-1, 3)
    owners = np.repeat([index for index, _ in told], [len(some) for _, some in told])
    return SeenPoints(points, owners.astype(np.int16))


def _middle(document: SceneDocument, cell: Cell) -> Array:
    """Return the middle of the objects, or else of the tool, or of the cell's table."""
    places = [part.pose[:3] for part in document.objects] or [tool.pose[:3] for tool in (document.tool,) if tool]
    (table,) = (box for box in cell.boxes if box.name == "table")
    return np.mean(places, axis=0) if places else np.array([*table.center[:2], cell.table_top])


def size_of(part: ObjectPart) -> tuple[float, float, float]:
    """Return an object's full lengths along its axes [m]."""
    shape = part.shape
    return shape.size if shape.type == "box" else (2.0 * shape.radius, 2.0 * shape.radius, shape.height)


def size_words(part: ObjectPart) -> str:
    """Say how large an object is, with the largest of what its sides may be off."""
    off = SURE * max(part.uncertainty.size)
    return f"{length_words(part, size_of(part), 0)} ± {1e3 * off:.1f} mm"


def length_words(part: ObjectPart, lengths: tuple[float, ...], digits: int) -> str:
    """Write lengths along an object's axes [mm]; of a cylinder its diameter once."""
    if part.shape.type == "box":
        return " × ".join(f"{1e3 * length:.{digits}f}" for length in lengths)
    return f"Ø {1e3 * lengths[0]:.{digits}f} × {1e3 * lengths[2]:.{digits}f}"
