"""Scans as files: what a service is sent, made from simulated cameras; run it to draw the shipped scans anew."""

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from planners.cell.asset_shelf import shipped_tool
from planners.cell.cell import load_cell
from planners.contract.scan_spec import MarkersSpec
from planners.geometry.pose import Array, Transform, rotation_z, to_pose7, transform
from planners.perception.camera import Camera
from planners.perception.marker_board import MarkerBoard
from tests.support.colour_camera import eye_camera, looking_at, studio, window_round
from tests.support.depth_camera import TABLE_CENTER, TABLE_SIZE, TABLE_TOP, Block, Thing, cylinder, overhead_camera
from tests.support.table_frames import CAN, DOMINO, TISSUE_BOX, Frame, TrueObject, on_table, seen

SHIPPED = Path(__file__).resolve().parents[2] / "assets" / "scans"
QUARTER = 0.5 * math.pi
MILLIMETRE = 0.001


@dataclass(frozen=True, eq=False)
class Scan:
    """A scan with the truth."""

    description: dict[str, Any]
    files: Mapping[str, bytes]
    objects: tuple[TrueObject, ...]
    T_world_tool: Transform | None = None

    def form(self) -> dict[str, tuple[str, bytes, str]]:
        """Return the scan as a client sends it."""
        described = json.dumps(self.description).encode()
        return {"scan": ("scan.json", described, "application/json")} | {
            name: (name, content, "application/octet-stream") for name, content in self.files.items()
        }


def depth_png(depth: Array) -> bytes:
    """Return a depth image in millimetres as a PNG of 16 bits."""
    numbers = np.nan_to_num(np.rint(depth / MILLIMETRE)).astype(np.uint16)
    return cv2.imencode(".png", numbers, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()


def described(camera: Camera) -> dict[str, Any]:
    """Return a camera as a scan describes it."""
    k = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy}
    return {"intrinsics": k, "pose": to_pose7(camera.T_world_camera)}


def depth_scan(frame: Frame, **members: Any) -> Scan:
    """Return the scan that a frame is, without a picture."""
    return Scan({"depth": described(frame.camera), **members}, {"depth": depth_png(frame.depth)}, frame.objects)


def tool_in_rest(T_world_tool: Transform) -> list[Thing]:
    """Return the long symmetric tool and its rest as a depth camera sees them."""
    walls = [box for box in load_cell("dual_ur3e_tool").boxes if box.name.startswith("tool_rest")]
    rest = [Block(tuple(box.size), transform(position=box.center)) for box in walls]

    def at(z: float) -> Transform:
        return T_world_tool @ transform(position=[0.0, 0.0, z])

    tool: list[Thing] = [cylinder(0.0175, 0.060, at(0.030)), Block((0.018, 0.017, 0.173), at(0.1465))]
    return [*rest, *tool, cylinder(0.0175, 0.012, at(0.239)), Block((0.045, 0.045, 0.005), at(0.2475))]


def tool_board() -> tuple[MarkerBoard, MarkersSpec]:
    """Return the board of the long symmetric tool."""
    markers = shipped_tool("long_symmetric").markers
    assert markers is not None
    return MarkerBoard(markers.dictionary, markers.ids, markers.columns, markers.marker, markers.gap), markers


PILES: Mapping[str, tuple[str, tuple[float, float, float], Sequence[tuple[float, float]]]] = {
    "tissue_boxes": ("box", TISSUE_BOX, ((0.30, 0.30), (0.30, -0.30), (0.47, 0.30))),
    "dominoes": ("box", DOMINO, ((0.30, 0.30), (0.30, -0.30), (0.47, 0.30))),
    "cans": ("cylinder", CAN, ((0.30, 0.30), (0.30, -0.30))),
}
"""Kind, size and places on the table of the objects of each shipped scan [m]."""


def pile(name: str = "tissue_boxes", seed: int = 1) -> Scan:
    """Return a scan of some objects of one kind and of the tool in its rest, each image cut to what matters."""
    kind, size, places = PILES[name]
    rng = np.random.default_rng(seed)
    objects = [
        TrueObject(kind, size, on_table(x, y, size[2], QUARTER + rng.uniform(-0.1, 0.1)), is_can=size == CAN)
        for x, y in places
    ]
    T_world_tool = transform(rotation_z(0.15), [0.221, 0.001, TABLE_TOP])
    frame = seen(objects, overhead_camera(), rng, others=tool_in_rest(T_world_tool))
    depth, depth_camera = _cut(frame.depth, frame.camera, (80, 90, 352, 220))
    picture, eye = _picture_of_tool(T_world_tool, rng)
    files = {"depth": depth_png(depth), "colour": cv2.imencode(".png", picture)[1].tobytes()}
    description = {
        "external_id": name,
        "cell": "dual_ur3e_tool",
        "tool": "long_symmetric",
        "colour": described(eye),
        "depth": described(depth_camera),
    }
    return Scan(description, files, tuple(objects), T_world_tool)


def shipped(name: str = "tissue_boxes") -> Scan:
    """Return a scan that is shipped."""
    folder = SHIPPED / name
    files = {part: (folder / f"{part}.png").read_bytes() for part in ("colour", "depth")}
    return Scan(json.loads((folder / "scan.json").read_text()), files, ())


def _picture_of_tool(T_world_tool: Transform, rng: np.random.Generator) -> tuple[Array, Camera]:
    board, markers = tool_board()
    T_world_board = T_world_tool @ transform(position=markers.pose[:3])
    with tempfile.TemporaryDirectory() as folder, studio(Path(folder)) as opened:
        opened.box(TABLE_SIZE, transform(position=TABLE_CENTER), (0.6, 0.5, 0.4))
        opened.box((0.045, 0.045, 0.005), T_world_board @ transform(position=[0, 0, -0.003]), (0.9, 0.9, 0.9))
        opened.board(board, T_world_board)
        camera = eye_camera(looking_at(T_world_board[:3, 3], 0.35, 0.3, 1.0, 0.5))
        corners = np.vstack(list(board.corners().values())) @ T_world_board[:3, :3].T + T_world_board[:3, 3]
        window = window_round(camera, corners)
        return _cut(opened.picture(camera, rng, window=window), camera, window)


def _cut(image: Array, camera: Camera, window: tuple[int, int, int, int]) -> tuple[Array, Camera]:
    """Return a part of an image, and the camera that would have taken it."""
    left, top, width, height = window
    part = np.ascontiguousarray(image[top : top + height, left : left + width])
    return part, Camera(camera.fx, camera.fy, camera.cx - left, camera.cy - top, camera.T_world_camera)


def main(folder: Path) -> None:
    for name in PILES:
        scan = pile(name)
        (folder / name).mkdir(parents=True, exist_ok=True)
        (folder / name / "scan.json").write_text(json.dumps(scan.description, indent=2) + "\n")
        for part, content in scan.files.items():
            (folder / name / f"{part}.png").write_bytes(content)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else SHIPPED)
