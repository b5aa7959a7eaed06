"""Plan documents small enough to reckon with by hand."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

from planners.scene.cell import Cell, load_cell


def contact(sample: int, by: str, kind: str, force: tuple[float, float, float], **members: Any) -> dict[str, Any]:
    """Return a contact on the plate at the origin, its normal up."""
    return {
        "sample": sample,
        "body": "plate",
        "by": by,
        "finger": None,
        "kind": kind,
        "point": [0.0, 0.0, 1.1],
        "normal": [0.0, 0.0, 1.0],
        "wrench": [*force, 0.0, 0.0, 0.0],
        "mu": 0.5,
        "limit": 20.0,
        **members,
    }


def segment(start: float, n: int, **members: Any) -> dict[str, Any]:
    """Return a segment of `n` samples a tenth of a second apart in which nothing moves."""
    return {
        "kind": "transit",
        "movers": ["left"],
        "contact_state": None,
        "hold": None,
        "time": [start + 0.1 * i for i in range(n)],
        "positions": np.zeros((n, 12)).tolist(),
        "velocities": np.zeros((n, 12)).tolist(),
        "accelerations": np.zeros((n, 12)).tolist(),
        "gripper_width": {"right": [0.085] * n},
        "attached": {},
        "body_poses": {},
        "contacts": [],
        **members,
    }


@pytest.fixture(scope="session")
def cell() -> Cell:
    return load_cell("dual_ur3e_lift")


@pytest.fixture
def document(cell: Cell) -> dict[str, Any]:
    """Return a plan without segments."""
    plate = {
        "role": "plate",
        "shape": {"type": "box", "size": [0.3, 0.3, 0.04]},
        "mass": 4.0,
        "com": [0.0, 0.0, 0.0],
        "pose": [0.3, 0.0, 1.114, 1.0, 0.0, 0.0, 0.0],
        "static": False,
    }
    task = {
        "kind": "plate_lift",
        "external_id": "by hand",
        "plate": {"mass": 4.0, "shape": plate["shape"]},
        "cup": {"max_force": 20.0},
        "start_positions": None,
    }
    return {
        "schema_version": "1.0",
        "id": "0" * 32,
        "task": task,
        "outcome": "infeasible",
        "explanation": {"summary": "nothing was planned", "causes": []},
        "cell": copy.deepcopy(cell.document()),
        "bodies": {**cell.body_documents(), "plate": plate},
        "segments": [],
        "certificate": None,
        "simulation": None,
        "statistics": {"total_seconds": None, "stages": [], "graph": {}, "search": {}, "rejections": {}},
    }
