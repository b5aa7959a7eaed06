"""From the files of a scan to a scene: the tool by its markers, the objects by their top facets (paper A, V.A)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.cell.asset_files import ToolFile
from planners.cell.cell import Cell
from planners.contract.scan_spec import Intrinsics, ScanSpec
from planners.contract.scene_document import (
    ObjectPart,
    PoseUncertainty,
    SceneDocument,
    SeenToolPart,
    SizeUncertainty,
    TablePart,
    UnrecognisedPart,
)
from planners.errors import SceneError
from planners.geometry import polygon
from planners.geometry.convex import ConvexShape
from planners.geometry.pose import Array, Transform, from_pose7, inverse, to_pose7
from planners.perception.camera import Camera
from planners.perception.depth_view import LARGEST_IMAGE, DepthView
from planners.perception.marker_board import BoardNotSeen, MarkerBoard, SeenBoard, find_board
from planners.perception.object_finder import KnownPlace, SeenTable, perceive_objects
from planners.perception.perceived_object import PerceivedObject
from planners.perception.perception_settings import PerceptionSettings
from planners.perception.preview import draw_preview
from planners.perception.scan_files import (
    LARGEST_ASPECT,
    NPY,
    SHORTEST_SIDE,
    ScanRefused,
    check_sides,
    read_cloud,
    read_colour,
    read_depth_png,
    read_npy,
)
from planners.perception.seen_points import SeenPoints
from planners.scene.suction_tool import find_tool, tool_file

PARTS = ("colour", "depth", "cloud")
"""Files that a scan can have."""
MOST_DEPTH_PIXELS = 4 * LARGEST_IMAGE
SEED = 0
"""Of the planes that are tried: the same scan gives the same scene."""


@dataclass(frozen=True, eq=False)
class PerceivedScene:
    """What a scan shows."""

    document: SceneDocument
    preview: bytes
    """A PNG picture with everything that was found drawn in."""
    points: SeenPoints | None
    """What was measured, thinned out; None: neither depth nor cloud."""


def perceive(
    scan: ScanSpec, files: Mapping[str, bytes], cell: Cell, settings: PerceptionSettings | None = None
) -> PerceivedScene:
    """Perceive the scene that the files of a scan show.

    Args:
        scan: what the files are.
        files: by the names of `PARTS`; those and only those that the scan describes.
        cell: where the cameras are.
        settings: of the perception of objects.

    Raises:
        ScanRefused: A file cannot be read or shows no table, or files and description do not fit together.
        SceneError: There is no such tool in the cell, or it has no markers.
    """
    _check_parts(scan, files)
    file = None if scan.tool is None else tool_file(scan.tool, cell)
    settings = settings or PerceptionSettings()
    notes: list[str] = []
    picture = read_colour(files["colour"]) if "colour" in files else None
    tool = None if picture is None or file is None else _find_tool(scan, file, picture, notes)
    place = _known_place(scan, cell, None if tool is None else tool[1])
    try:
        view = _view(scan, files)
        seen = None if view is None else perceive_objects(view, place, settings, np.random.default_rng(SEED))
    except ScanRefused as refused:
        # What looks at a view does not know whether an image or a cloud became it.
        raise ScanRefused("depth" if scan.cloud is None else "cloud", refused.detail) from refused
    document = SceneDocument(
        cell=scan.cell,
        external_id=scan.external_id,
        tool=None if tool is None else _tool_part(scan, *tool),
        table=None if seen is None else _table_part(seen, cell),
        objects=() if seen is None else tuple(_object_part(each) for each in seen.findings.objects),
        unrecognised=() if seen is None else tuple(
            UnrecognisedPart(reason=each.reason, outline=_rounded(each.outline), top=round(each.top, 6))
            for each in seen.findings.unrecognised
        ),
        notes=tuple(notes),
    )  # fmt: skip
    colour_camera = None if scan.colour is None else _camera(scan.colour.intrinsics, scan.colour.pose)
    board = None if tool is None else tool[0]
    preview = draw_preview(picture, colour_camera, board, None if tool is None else tool[1], seen)
    points = None if seen is None else SeenPoints.of(seen.view, seen.findings.owners)
    return PerceivedScene(document, preview, points)


def _check_parts(scan: ScanSpec, files: Mapping[str, bytes]) -> None:
    for part in PARTS:
        described, given = getattr(scan, part) is not None, part in files
        if described and not given:
            raise ScanRefused(part, f"the scan describes the part {part}, but there is no such file")
        if given and not described:
            raise ScanRefused(part, f"there is a file {part}, but the scan does not say what camera took it")


def _camera(intrinsics: Intrinsics, pose: tuple[float, ...]) -> Camera:
    k = intrinsics
    return Camera(k.fx, k.fy, k.cx, k.cy, from_pose7(pose), k.distortion)


def _view(scan: ScanSpec, files: Mapping[str, bytes]) -> DepthView | None:
    if scan.depth is not None:
        depth = _depth(files["depth"], scan.depth.unit)
        return DepthView.from_depth(depth, _camera(scan.depth.intrinsics, scan.depth.pose))
    if scan.cloud is None:
        return None
    points = read_cloud(files["cloud"], scan.cloud.unit)
    T_world_camera = from_pose7(scan.cloud.pose)
    if scan.cloud.frame == "world":
        T = inverse(T_world_camera)
        points = points @ T[:3, :3].T + T[:3, 3]
    # Rows and columns of other sides are no camera's image: a turning scanner's have many columns, and few rows.
    shorter, longer = sorted(points.shape[:2])
    if points.ndim == 3 and SHORTEST_SIDE <= shorter and longer <= LARGEST_ASPECT * shorter:
        return DepthView.from_organised(points, T_world_camera)
    return DepthView.from_points(points.reshape(-1, 3), T_world_camera)


def _depth(content: bytes, unit: float) -> Array:
    if not content.startswith(NPY):
        return read_depth_png(content, unit, MOST_DEPTH_PIXELS)
    numbers = read_npy(content, "depth")
    if numbers.ndim != 2:
        raise ScanRefused("depth", f"a depth image has rows and columns; its shape is {numbers.shape}")
    height, width = numbers.shape
    check_sides(width, height, MOST_DEPTH_PIXELS, "depth")
    return unit * numbers.astype(float)


def _find_tool(
    scan: ScanSpec, file: ToolFile, picture: NDArray[np.uint8], notes: list[str]
) -> tuple[SeenBoard, Transform] | None:
    assert scan.colour is not None
    markers = scan.markers or file.markers
    if markers is None:
        raise SceneError("/markers", f"no markers are stated in the file of the tool {scan.tool}; say which it has")
    board = MarkerBoard(markers.dictionary, markers.ids, markers.columns, markers.marker, markers.gap)
    seen = find_board(picture, _camera(scan.colour.intrinsics, scan.colour.pose), board)
    if isinstance(seen, BoardNotSeen):
        notes.append(f"the tool was not found: {seen.reason}")
        return None
    return seen, seen.T_world_board @ inverse(from_pose7(markers.pose))


def _known_place(scan: ScanSpec, cell: Cell, T_world_tool: Transform | None) -> KnownPlace:
    """Collect what is known: the cell's own bodies, the tool where it was seen, else in its rest."""
    (table,) = (box for box in cell.boxes if box.name == "table")
    workspace = polygon.rectangle(table.size[0], table.size[1]) + table.center[:2]
    bodies: list[ConvexShape] = [shape for body in cell.bodies if body.name != "table" for shape in body.shapes]
    if T_world_tool is None and cell.tool_rest is not None:
        T_world_tool = cell.tool_rest.T_world_tool
    if scan.tool is not None and T_world_tool is not None:
        solid = find_tool(scan.tool, cell).body.solid
        bodies += [part.placed(T_world_tool) for part in solid.convex_parts]
    return KnownPlace(cell.table_top, workspace, bodies)


def _tool_part(scan: ScanSpec, board: SeenBoard, T_world_tool: Transform) -> SeenToolPart:
    assert scan.tool is not None
    # The tool's origin is as far from the markers as an error of their orientation moves it.
    lever = float(np.linalg.norm(board.T_world_board[:3, 3] - T_world_tool[:3, 3]))
    position = math.hypot(board.position_std, lever * board.rotation_std)
    return SeenToolPart(
        name=scan.tool,
        pose=_pose(T_world_tool),
        uncertainty=PoseUncertainty(position=position, rotation=board.rotation_std),
        markers_at=_pose(board.T_world_board)[:3],
        markers=board.markers,
        error=board.error,
    )


def _table_part(seen: SeenTable, cell: Cell) -> TablePart:
    plane = seen.plane
    x, y, z = plane.T_world_table[:3, 3].tolist()
    a, b, c = plane.normal.tolist()
    (table,) = (box for box in cell.boxes if box.name == "table")
    height = plane.height_at(float(table.center[0]), float(table.center[1]))
    return TablePart(point=(x, y, z), normal=(a, b, c), height=height, deviation=plane.deviation, points=plane.points)


def _object_part(each: PerceivedObject) -> ObjectPart:
    told = each.uncertainty
    return ObjectPart(
        name=each.name,
        shape=each.shape,
        pose=_pose(each.T_world_object),
        uncertainty=SizeUncertainty(position=told.position, yaw=told.yaw, size=told.size),
        supported_by=each.supported_by,
        top_points=each.top_points,
        support_points=tuple((x, y, z) for x, y, z in np.round(each.support_points, 6).tolist()),
    )


def _pose(T: Transform) -> tuple[float, float, float, float, float, float, float]:
    x, y, z, qw, qx, qy, qz = to_pose7(T)
    return x, y, z, qw, qx, qy, qz


def _rounded(points: Array) -> tuple[tuple[float, float], ...]:
    return tuple((x, y) for x, y in np.round(points, 6).tolist())
