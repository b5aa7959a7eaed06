"""A perceived scene: drawn with what was measured and the models that were fitted to it, and told beside that."""

from __future__ import annotations

import math

import numpy as np
from viser import SceneNodeHandle

from app.viewer.body_drawing import Stage, add_frame, draw_body, hull_of_prism
from app.viewer.description import Row
from app.viewer.palette import MEANINGS, rgb, vivid_tint
from planners.cell.cell import Cell
from planners.contract.scene_document import ObjectPart, SceneDocument, SeenToolPart, TablePart, UnrecognisedPart
from planners.contract.shapes import InlineMesh
from planners.contract.strict_model import StrictModel
from planners.geometry.pose import Array, from_pose7
from planners.perception.seen_points import NOBODY, SeenPoints
from planners.scene.suction_tool import load_tool

LAYERS = ("points", "around", "models", "names", "tool", "robot")
"""What can be shown or hidden; all of it is shown at first."""
MODEL_OPACITY, LOST_OPACITY = 0.36, 0.25
POINT_SIZE, SMALL_POINT_SIZE = 0.0030, 0.0018
"""Of an object's points, and of all others [m]."""
AROUND_COLOUR = (150, 164, 180)
"""Of points that speak for no object."""
LIFTED = 0.0006
"""Points are drawn so far up, or the faces of the models they lie in would swallow half of them [m]."""
AXES_LENGTH = 0.09
"""Of the tool's frame [m]."""
NAME_GAP = 0.025
"""Between an object and its name [m]."""
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
        self._scene, self._root, self._stage = scene, root, stage
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
            point_size=SMALL_POINT_SIZE if nobodys else POINT_SIZE,
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
            position=(x, y, z + 0.5 * size_of(part)[2] + NAME_GAP),
            font_screen_scale=0.95,
            anchor="bottom-center",
        )

    def _add_tool(self, tool: SeenToolPart) -> SceneNodeHandle:
        name = f"{self._root}/tool"
        drawn = draw_body(self._scene, name, "tool", load_tool(tool.name).body.shape, tool.pose)
        add_frame(self._scene, f"{name}/frame", np.eye(4), axes_length=AXES_LENGTH)
        T_tool_world = np.linalg.inv(from_pose7(tool.pose))
        self._scene.add_label(
            f"{name}/name",
            tool.name,
            position=T_tool_world[:3, :3] @ np.array(tool.markers_at) + T_tool_world[:3, 3] + (0.0, 0.0, NAME_GAP),
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


class ObjectDescription(StrictModel):
    """What the page tells of one object."""

    name: str
    shape: str
    colour: str
    rows: list[Row]


class PerceivedToolDescription(StrictModel):
    """What the page tells of the tool."""

    name: str
    rows: list[Row]


class UnrecognisedDescription(StrictModel):
    """What the page tells of something that is no object it knows."""

    reason: str
    place: str


class PerceivedDescription(StrictModel):
    """All the page needs of a perceived scene but its drawing."""

    id: str
    title: str
    subtitle: str
    highlights: list[Row]
    objects: list[ObjectDescription]
    tool: PerceivedToolDescription | None
    table: list[Row] | None
    unrecognised: list[UnrecognisedDescription]
    unrecognised_colour: str
    notes: list[str]


def describe_perceived(
    scene_id: str, document: SceneDocument, points: SeenPoints | None, cell: str
) -> PerceivedDescription:
    """Return what the page tells; sizes and poses with their uncertainties, and its cell by name."""
    return PerceivedDescription(
        id=scene_id,
        title=document.external_id or scene_id[:8],
        subtitle=_subtitle(document),
        highlights=_highlights(document, points, cell),
        objects=[_object(index, part) for index, part in enumerate(document.objects)],
        tool=None if document.tool is None else _tool(document.tool),
        table=None if document.table is None else _table(document.table),
        unrecognised=[
            UnrecognisedDescription(reason=part.reason, place=_top_words(part.top, document.table))
            for part in document.unrecognised
        ],
        unrecognised_colour=MEANINGS["limit"][0],
        notes=list(document.notes),
    )


def size_of(part: ObjectPart) -> tuple[float, float, float]:
    """Return an object's full lengths along its axes [m]."""
    shape = part.shape
    return shape.size if shape.type == "box" else (2.0 * shape.radius, 2.0 * shape.radius, shape.height)


def size_words(part: ObjectPart) -> str:
    """Say how large an object is, with the largest of what its sides may be off."""
    off = SURE * max(part.uncertainty.size)
    return f"{_lengths(part, size_of(part), 0)} ± {1e3 * off:.1f} mm"


def _subtitle(document: SceneDocument) -> str:
    boxes = sum(part.shape.type == "box" for part in document.objects)
    found = [_count(boxes, "box", "boxes"), _count(len(document.objects) - boxes, "cylinder", "cylinders")]
    lost = len(document.unrecognised)
    words = " and ".join(each for each in found if each) or "no object"
    tool = "" if document.tool is None else ", the tool"
    return f"Perceived: {words}{tool}" + (f"; {lost} not recognised" if lost else "")


def _count(number: int, one: str, many: str) -> str:
    return "" if number == 0 else f"{number} {one if number == 1 else many}"


def _highlights(document: SceneDocument, points: SeenPoints | None, cell: str) -> list[Row]:
    rows: list[Row] = [("objects", str(len(document.objects)))]
    if document.unrecognised:
        rows.append(("not recognised", str(len(document.unrecognised))))
    if points is not None:
        rows.append(("points shown", f"{len(points.points):,}"))
    rows.append(("cell", cell))
    return rows


def _object(index: int, part: ObjectPart) -> ObjectDescription:
    told = part.uncertainty
    x, y, z = part.pose[:3]
    shape = "box" if part.shape.type == "box" else "cylinder"
    rows: list[Row] = [
        ("size", f"{_lengths(part, size_of(part), 1)} mm"),
        ("", f"± {_lengths(part, tuple(SURE * std for std in told.size), 1)} mm"),
        ("centre", f"{1e3 * x:.1f}, {1e3 * y:.1f}, {1e3 * z:.1f} mm"),
        ("", f"± {', '.join(f'{1e3 * SURE * std:.1f}' for std in told.position)} mm"),
    ]
    if shape == "box":
        T = from_pose7(part.pose)
        yaw = math.degrees(math.atan2(T[1, 0], T[0, 0]))
        rows.append(("yaw", f"{yaw:.1f}° ± {math.degrees(SURE * told.yaw):.1f}°"))
    rows += [("stands on", part.supported_by.replace("_", " ")), ("found from", f"{part.top_points:,} points")]
    colour = "#{:02x}{:02x}{:02x}".format(*vivid_tint(index))
    return ObjectDescription(name=part.name, shape=shape, colour=colour, rows=rows)


def _lengths(part: ObjectPart, lengths: tuple[float, ...], digits: int) -> str:
    """Write lengths along an object's axes [mm]; of a cylinder its diameter once."""
    if part.shape.type == "box":
        return " × ".join(f"{1e3 * length:.{digits}f}" for length in lengths)
    return f"Ø {1e3 * lengths[0]:.{digits}f} × {1e3 * lengths[2]:.{digits}f}"


def _tool(tool: SeenToolPart) -> PerceivedToolDescription:
    x, y, z = tool.pose[:3]
    position, rotation = (SURE * std for std in (tool.uncertainty.position, tool.uncertainty.rotation))
    rows: list[Row] = [
        ("cup's lip", f"{1e3 * x:.1f}, {1e3 * y:.1f}, {1e3 * z:.1f} mm"),
        ("", f"± {1e3 * position:.1f} mm, ± {math.degrees(rotation):.2f}°"),
        ("lean", f"{math.degrees(math.acos(min(1.0, from_pose7(tool.pose)[2, 2]))):.1f}°"),
        ("markers", ", ".join(map(str, tool.markers))),
        ("off their places", f"{tool.error:.2f} px"),
    ]
    return PerceivedToolDescription(name=tool.name, rows=rows)


def _table(table: TablePart) -> list[Row]:
    return [
        ("height", f"{1e3 * table.height:.1f} mm"),
        ("lean", f"{math.degrees(math.acos(min(1.0, table.normal[2]))):.2f}°"),
        ("noise of a point", f"{1e3 * table.deviation:.1f} mm"),
    ]


def _top_words(top: float, table: TablePart | None) -> str:
    return f"up to {1e3 * (top - (0.0 if table is None else table.height)):.0f} mm above the table"
