"""Cells that are not shipped: two UR10e at a table with gripper and stick, and one all of whose parts are own."""

from __future__ import annotations

import copy
import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import trimesh

from planners.cell.asset_shelf import AssetShelf, read_robot_file, shipped_shelf
from planners.cell.cell import Cell, read_cell
from tests.cell.urdf_arms import INDUSTRIAL_AXES, INDUSTRIAL_TIP, UrdfArm


def load_cell_file(path: Path) -> Cell:
    """Load a cell; what it names is in the folder that `cells/` stands in, or shipped."""
    return read_cell(path, AssetShelf((path.parent.parent, *shipped_shelf().folders)))


def station(**members: Any) -> dict[str, Any]:
    """Return its description as one document; `members` replace those of the cell."""
    return {
        "name": "station",
        "gravity": [0, 0, -9.81],
        "mount": {
            "arms": {
                "left": {
                    "position": [0.0, 0.35, 0.90],
                    "rpy_deg": [0, 0, 0],
                    "home_deg": [60, -120, 120, -90, -90, 0],
                },
                "right": {
                    "position": [0.0, -0.35, 0.90],
                    "rpy_deg": [0, 0, 0],
                    "home_deg": [-60, -60, -120, -90, 90, 0],
                },
            },
            "table": {"center": [0.60, 0.0, 0.88], "size": [1.2, 2.0, 0.04]},
            "platform": {},
            "frame": {"profile": 0.06, "height": 2.4, "columns": []},
        },
        "arms": {
            "left": {"robot": "ur10e", "hand": "pushing_stick_ft300"},
            "right": {"robot": "ur10e", "hand": "robotiq_2f85_ft300"},
        },
        **members,
    }


def station_files() -> dict[str, bytes]:
    """Return its description as files in the layout of the assets folder."""
    cell = station()
    mount = {"name": "station_mount", **cell.pop("mount")}
    cell["mount"] = mount["name"]
    return {"cells/station.yaml": written(cell), "mounts/station_mount.yaml": written(mount)}


JAWS: dict[str, Any] = {
    "name": "own_jaws",
    "kind": "jaws",
    "sensor": {
        "name": "own_sensor",
        "radius": 0.04,
        "length": 0.04,
        "mass": 0.4,
        "force_max": 200.0,
        "torque_max": 10.0,
        "rate": 500.0,
        "force_noise": 0.2,
        "torque_noise": 0.01,
    },
    "mass": 0.8,
    "com": 0.09,
    "force_range": [10.0, 100.0],
    "squeeze": 50.0,
    "width_max": 0.10,
    "pad_size": [0.022, 0.008, 0.040],
    "pad_height": 0.150,
    "base": {"center": [0, 0, 0.05], "size": [0.08, 0.12, 0.10]},
    "finger": {"blade": {"center": [0, 0.014, 0.135], "size": [0.025, 0.012, 0.07]}},
}
"""A gripper of one's own on a sensor of one's own."""
INDUSTRIAL: dict[str, Any] = {
    "name": "industrial",
    "urdf": "arm/arm.urdf",
    "root": "l0",
    "tip": "tip",
    "payload": 12.0,
    "acceleration": [5.0, 5.0, 5.0, 8.0, 8.0, 8.0],
}
"""An arm that is described by a URDF."""


def own_robot() -> dict[str, Any]:
    """Return a robot of one's own by its table: a UR10e under another name."""
    robot = read_robot_file(shipped_shelf().find("robots", "ur10e")).model_dump(mode="json", exclude_none=True)
    return {**robot, "name": "own_robot"}


def furnished() -> dict[str, Any]:
    """Return the station with a robot, a hand and a sensor of its own in the document, and a fence that is a mesh."""
    document = station()
    document["arms"] = {
        "left": {"robot": own_robot(), "hand": "pushing_stick_ft300"},
        "right": {"robot": "own_robot", "hand": copy.deepcopy(JAWS)},
    }
    fence = {"mesh": {"path": "meshes/fence.stl"}, "position": [-0.5, 1.2, 0.4], "rpy_deg": [0, 0, 0]}
    document["mount"]["platform"] = {"fence": fence}
    return document


def furnished_files() -> dict[str, bytes]:
    """Return that cell with its mesh, its left arm from a URDF that has the same mesh."""
    document = furnished()
    document["arms"]["right"]["robot"] = document["arms"]["left"]["robot"]
    document["arms"]["left"]["robot"] = INDUSTRIAL["name"]
    # Its base is a box about its origin.
    document["mount"]["arms"]["left"]["position"][2] += 0.03
    link = '<mesh filename="package://arm/link.stl"/>'
    return {
        "cell.yaml": written(document),
        "robots/industrial.yaml": written(INDUSTRIAL),
        "arm/arm.urdf": UrdfArm(INDUSTRIAL_AXES, INDUSTRIAL_TIP, shape=link).write(),
        "arm/link.stl": trimesh.creation.box((0.05, 0.04, 0.03)).export(file_type="stl"),
        "meshes/fence.stl": trimesh.creation.box((0.05, 0.05, 0.8)).export(file_type="stl"),
    }


def written(document: Mapping[str, Any]) -> bytes:
    """Return a document as JSON, which is YAML too."""
    return json.dumps(document, indent=1).encode()


def zipped(files: Mapping[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    """Return files as a zip."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return packed.getvalue()
