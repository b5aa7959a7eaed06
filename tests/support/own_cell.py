"""A cell that is not shipped: two UR10e on a table of 1.2 by 2 m, one with a gripper and one with a stick."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from typing import Any


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
