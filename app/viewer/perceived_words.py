"""What the page tells of a perceived scene beside its drawing: sizes and poses with their uncertainties; as JSON."""

from __future__ import annotations

import math
from typing import Any

from app.viewer.palette import MEANINGS, vivid_tint
from planners.contract.scene_document import ObjectPart, SceneDocument, SeenToolPart, TablePart
from planners.geometry.pose import from_pose7
from planners.perception.seen_points import SeenPoints

SURE = 2.0
"""± is so many uncertainties of the document: 19 of 20 errors are smaller [1]."""


def tell_perceived(scene_id: str, document: SceneDocument, points: SeenPoints | None) -> dict[str, Any]:
    """Return all the page needs of a perceived scene but its drawing."""
    return {
        "id": scene_id,
        "title": document.external_id or scene_id[:8],
        "subtitle": _subtitle(document),
        "highlights": _highlights(document, points),
        "objects": [_object(index, part) for index, part in enumerate(document.objects)],
        "tool": None if document.tool is None else _tool(document.tool),
        "table": None if document.table is None else _table(document.table),
        "unrecognised": [
            {"reason": part.reason, "place": _top_words(part.top, document.table)} for part in document.unrecognised
        ],
        "unrecognised_colour": MEANINGS["limit"][0],
        "notes": list(document.notes),
    }


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


def _highlights(document: SceneDocument, points: SeenPoints | None) -> list[list[str]]:
    rows = [["objects", str(len(document.objects))]]
    if document.unrecognised:
        rows.append(["not recognised", str(len(document.unrecognised))])
    if points is not None:
        rows.append(["points shown", f"{len(points.points):,}"])
    rows.append(["cell", document.cell])
    return rows


def _object(index: int, part: ObjectPart) -> dict[str, Any]:
    told = part.uncertainty
    x, y, z = part.pose[:3]
    shape = "box" if part.shape.type == "box" else "cylinder"
    rows = [
        ["size", f"{_lengths(part, size_of(part), 1)} mm"],
        ["", f"± {_lengths(part, tuple(SURE * std for std in told.size), 1)} mm"],
        ["centre", f"{1e3 * x:.1f}, {1e3 * y:.1f}, {1e3 * z:.1f} mm"],
        ["", f"± {', '.join(f'{1e3 * SURE * std:.1f}' for std in told.position)} mm"],
    ]
    if shape == "box":
        T = from_pose7(part.pose)
        yaw = math.degrees(math.atan2(T[1, 0], T[0, 0]))
        rows.append(["yaw", f"{yaw:.1f}° ± {math.degrees(SURE * told.yaw):.1f}°"])
    rows += [["stands on", part.supported_by.replace("_", " ")], ["found from", f"{part.top_points:,} points"]]
    return {
        "name": part.name,
        "shape": shape,
        "colour": "#{:02x}{:02x}{:02x}".format(*vivid_tint(index)),
        "rows": rows,
    }


def _lengths(part: ObjectPart, lengths: tuple[float, ...], digits: int) -> str:
    """Write lengths along an object's axes [mm]; of a cylinder its diameter once."""
    if part.shape.type == "box":
        return " × ".join(f"{1e3 * length:.{digits}f}" for length in lengths)
    return f"Ø {1e3 * lengths[0]:.{digits}f} × {1e3 * lengths[2]:.{digits}f}"


def _tool(tool: SeenToolPart) -> dict[str, Any]:
    x, y, z = tool.pose[:3]
    position, rotation = (SURE * std for std in (tool.uncertainty.position, tool.uncertainty.rotation))
    rows = [
        ["cup's lip", f"{1e3 * x:.1f}, {1e3 * y:.1f}, {1e3 * z:.1f} mm"],
        ["", f"± {1e3 * position:.1f} mm, ± {math.degrees(rotation):.2f}°"],
        ["lean", f"{math.degrees(math.acos(min(1.0, from_pose7(tool.pose)[2, 2]))):.1f}°"],
        ["markers", ", ".join(map(str, tool.markers))],
        ["off their places", f"{tool.error:.2f} px"],
    ]
    return {"name": tool.name, "rows": rows}


def _table(table: TablePart) -> list[list[str]]:
    return [
        ["height", f"{1e3 * table.height:.1f} mm"],
        ["lean", f"{math.degrees(math.acos(min(1.0, table.normal[2]))):.2f}°"],
        ["noise of a point", f"{1e3 * table.deviation:.1f} mm"],
    ]


def _top_words(top: float, table: TablePart | None) -> str:
    return f"up to {1e3 * (top - (0.0 if table is None else table.height)):.0f} mm above the table"
