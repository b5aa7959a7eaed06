"""Time and memory that perception takes at its limits: each scan is read and perceived in a process of its own."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from app.cli.scene_command import ScanFiles, read_scan_files
from planners.cell.cell import load_cell
from planners.contract.scan_spec import read_scan
from planners.contract.strict_json import parse_json
from planners.geometry.pose import Array
from planners.perception.camera import Camera
from planners.perception.perceive import MOST_DEPTH_PIXELS, perceive
from planners.perception.scan_files import MOST_PIXELS, MOST_POINTS, ScanRefused
from tests.benchmarks.tasks import Note
from tests.support.depth_camera import NOISELESS, overhead_camera
from tests.support.scan_frames import depth_png, described, shipped
from tests.support.table_frames import TISSUE_BOX, TrueObject, on_table, seen

ROOT = Path(__file__).resolve().parents[2]
PLY = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
NOISE = 0.0015
"""Of a depth [m]."""
FAR_TOO_MANY = 50_000_000
"""Points [1]."""
Scan = tuple[dict[str, Any], dict[str, bytes]]


@dataclass(frozen=True)
class Bound:
    """What one scan took."""

    sent: float
    """Size of its files [MB]."""
    seconds: float
    """CPU time [s]."""
    base: float
    """Memory of the process that has perceived a small scan before [MB] ..."""
    peak: float
    """... and at most, with the files of this one in it [MB]."""
    outcome: str
    """How many objects were found, or why the scan was refused."""


def measure_bounds(note: Note, share: float = 1.0) -> dict[str, Bound]:
    """Measure every scan at a share of its full size."""
    bounds = {}
    for name in CASES:
        note(f"perception: {name}")
        bounds[name] = measure_apart(name, share)
    return bounds


def measure_apart(name: str, share: float = 1.0) -> Bound:
    """Measure a scan, at a share of its size, in a process of its own."""
    description, files = CASES[name](share)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "scan.json").write_text(json.dumps(description))
        for part, content in files.items():
            (Path(folder) / f"{part}.npy").write_bytes(content)
        del files
        command = [sys.executable, "-m", "tests.benchmarks.bench_perception_bounds", folder]
        told = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return Bound(**json.loads(told.splitlines()[-1]))


def _measure_here(folder: str) -> Bound:
    _perceived(ScanFiles(json.dumps(shipped().description).encode(), dict(shipped().files)))
    base, begun = _peak(), time.process_time()
    scan = read_scan_files([folder])
    outcome = _perceived(scan)
    sent = 1e-6 * sum(map(len, scan.files.values()))
    return Bound(sent, time.process_time() - begun, base, _peak(), outcome)


def _perceived(scan: ScanFiles) -> str:
    described_scan = read_scan(parse_json(scan.description))
    try:
        document = perceive(described_scan, scan.files, load_cell(described_scan.cell)).document
    except ScanRefused as refused:
        return str(refused)
    return f"{len(document.objects)} objects"


def _peak() -> float:
    """Return the most memory that this process ever had [MB]; the system's `ru_maxrss` counts its parent's too."""
    status = Path("/proc/self/status").read_text()
    return 1024e-6 * int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")))


def _view(pixels: float) -> tuple[Array, Camera]:
    """Return a depth image of three boxes with nearly so many pixels: a small one's repeated, each with noise."""
    camera = overhead_camera()
    places = ((0.3, 0.3), (0.3, -0.3), (0.5, 0.0))
    boxes = [TrueObject("box", TISSUE_BOX, on_table(x, y, TISSUE_BOX[2], 0.3)) for x, y in places]
    rng = np.random.default_rng(0)
    small = seen(boxes, camera, rng, NOISELESS).depth
    scale = float(np.sqrt(pixels / small.size))
    height, width = (int(scale * length) for length in small.shape)
    depth = np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_NEAREST), dtype=float)
    x, y = width / small.shape[1], height / small.shape[0]
    cx, cy = x * (camera.cx + 0.5) - 0.5, y * (camera.cy + 0.5) - 0.5
    depth += NOISE * rng.standard_normal(depth.shape)
    return depth, Camera(x * camera.fx, y * camera.fy, cx, cy, camera.T_world_camera)


def _cloud(count: float) -> tuple[Array, dict[str, Any]]:
    depth, camera = _view(count)
    rays = camera.rays(depth.shape[1], depth.shape[0])
    points = np.dstack([rays * depth[..., None], depth])
    return points, {"tool": None, "cloud": {"pose": described(camera)["pose"]}}


def _depth_image(share: float) -> Scan:
    depth, camera = _view(share * MOST_DEPTH_PIXELS)
    return {"tool": None, "depth": described(camera)}, {"depth": depth_png(depth)}


def _picture(share: float) -> Scan:
    """A picture of noise: nothing packs worse, or looks more like markers."""
    side = int(np.sqrt(share * MOST_PIXELS))
    noise = np.random.default_rng(0).integers(0, 256, (side, side, 3)).astype(np.uint8)
    content = cv2.imencode(".jpg", noise, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    intrinsics = {"fx": 938.0, "fy": 938.0, "cx": 639.5, "cy": 359.5}
    return {"colour": {"intrinsics": intrinsics, "pose": [0.3, 0, 1.7, 0, 1, 0, 0]}}, {"colour": content}


def _heap(share: float) -> Scan:
    points, description = _cloud(share * MOST_POINTS)
    rows = points.reshape(-1, 3)[np.random.default_rng(0).permutation(points.size // 3)].astype("<f4")
    return description, {"cloud": PLY.format("binary_little_endian", len(rows)).encode() + rows.tobytes()}


def _organised(share: float) -> Scan:
    points, description = _cloud(share * MOST_POINTS)
    stream = io.BytesIO()
    np.save(stream, points)
    return description, {"cloud": stream.getvalue()}


def _text(share: float) -> Scan:
    points, description = _cloud(share * MOST_POINTS)
    stream = io.BytesIO()
    np.savetxt(stream, points.reshape(-1, 3), fmt="%.4f")
    return description, {"cloud": PLY.format("ascii", points.size // 3).encode() + stream.getvalue()}


def _far_too_many(share: float) -> Scan:
    del share
    _, description = _cloud(1e5)
    return description, {"cloud": PLY.format("binary_little_endian", FAR_TOO_MANY).encode() + bytes(12_000_000)}


CASES: Mapping[str, Callable[[float], Scan]] = {
    "depth image": _depth_image,
    "picture of noise": _picture,
    "heap of points": _heap,
    "organised cloud": _organised,
    "cloud as text": _text,
    "50 million points": _far_too_many,
}


if __name__ == "__main__":
    print(json.dumps(_measure_here(sys.argv[1]).__dict__))
