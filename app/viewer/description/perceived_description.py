"""What is told of a perceived scene: what was found, where, how large, and how far that may be off."""

from __future__ import annotations

import math

from app.viewer.description.plan_description import Row
from app.viewer.drawing.perceived_scene import SURE, length_words, size_of
from app.viewer.palette import MEANINGS, vivid_tint
from planners.contract.scene_document import ObjectPart, SceneDocument, SeenToolPart, TablePart
from planners.contract.strict_model import StrictModel
from planners.geometry.pose import from_pose7
from planners.perception.seen_points import SeenPoints


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
        ("size", f"{length_words(part, size_of(part), 1)} mm"),
        ("", f"± {length_words(part, tuple(SURE * std for std in told.size), 1)} mm"),
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
