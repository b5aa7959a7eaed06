"""Hard objects and goals, each told in `hard_objects.yaml`: planned and certified, or refused with the reason."""

from __future__ import annotations

import itertools
import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import trimesh
import yaml

from planners.certify import CellReference, RobotSurfaces, load_surfaces
from planners.contract.task_spec import read_task
from planners.geometry.pose import rotation_x, rotation_y, rotation_z, to_pose7, transform
from planners.geometry.solid_mesh import take_mesh
from planners.planning import plan
from planners.progress import silent
from planners.regrasp.grasps.handovers import HandoverDatabase
from planners.scene.scene import build_scene
from tests.geometry.mesh_shapes import angle
from tests.support.documents import certified
from tests.support.samples import told
from tests.support.tool_plans import reference_of_the_tool_cell

TABLE = 1.094
"""Height of the table [m]."""
CASES = yaml.load((Path(__file__).parents[1] / "problems" / "hard_objects.yaml").read_text(), yaml.CSafeLoader)
ABOUT = {"x": rotation_x, "y": rotation_y, "z": rotation_z}
FRUSTUM = trimesh.convex.convex_hull(
    [[s * x, s * y, z] for s, z in ((0.06, 0.0), (0.03, 0.08)) for x in (-1, 1) for y in (-1, 1)]
)
ANGLE = angle().apply_scale([2.0, 2.0, 1.0])
"""Its legs are 40 mm wide."""
MESHES = {"frustum": FRUSTUM, "angle": ANGLE}


@pytest.fixture(scope="module")
def surfaces() -> RobotSurfaces:
    return load_surfaces()


@pytest.fixture(scope="module")
def known() -> CellReference:
    return reference_of_the_tool_cell()


def placed(place: list[float], turned: tuple[str, float] = ("z", 0.0)) -> list[float]:
    axis, degrees = turned
    return to_pose7(transform(ABOUT[axis](math.radians(degrees)), [place[0], place[1], place[2] + TABLE]))


def shape_of(given: dict[str, Any]) -> dict[str, Any]:
    if "mesh" in given:
        return {"type": "mesh", "upload": given["mesh"]}
    if "round" in given:
        return dict(zip(("type", "radius", "height"), ("cylinder", *given["round"]), strict=True))
    return {"type": "box", "size": given["size"]}


def object_of(given: dict[str, Any]) -> dict[str, Any]:
    com = MESHES[given["mesh"]].center_mass.tolist() if "mesh" in given else [0.0, 0.0, 0.0]
    symmetry = {"goal_symmetry": given["symmetry"]} if "symmetry" in given else {}
    return symmetry | {
        "name": given["name"],
        "shape": shape_of(given),
        "mass": given.get("mass", 0.15),
        "com": com,
        "pose": placed(given["pose"]),
        "goal_pose": placed(given["goal"], given.get("turned", ("z", 0.0))),
    }


def body_of(case: dict[str, Any]) -> dict[str, Any]:
    obstacles = [
        {"name": each["name"], "shape": shape_of(each), "pose": placed(each["pose"])}
        for each in case.get("obstacles", ())
    ]
    objects = [object_of(given) for given in case["objects"]]
    return json.loads(json.dumps({"kind": "suction_tool", "objects": objects, "obstacles": obstacles}))


def planned(body: dict[str, Any], handovers: HandoverDatabase) -> dict[str, Any]:
    task = read_task(body)
    uploads = {name: take_mesh(mesh.export(file_type="stl"), "stl") for name, mesh in MESHES.items()}
    scene = build_scene(task, uploads=uploads.get)
    ticks = itertools.count()
    document = plan(task, scene, silent, lambda: float(next(ticks)), lambda *_: handovers).document()
    return document | {"id": "probe", "software": {"name": "liftwright", "version": "0", "commit": None}}


@pytest.mark.parametrize("case", told(CASES))
def test_a_hard_object_is_planned_and_certified_or_refused_with_the_reason(
    case: dict[str, Any], long_handovers: HandoverDatabase, surfaces: RobotSurfaces, known: CellReference
) -> None:
    document = planned(body_of(case), long_handovers)
    explanation = document["explanation"]
    assert document["outcome"] == case["outcome"], explanation
    certificate = certified(document, surfaces, known)
    # What was not found claims nothing.
    assert (certificate is None) == (document["outcome"] == "not_found")
    assert certificate is None or {check.name: check.where for check in certificate.failures} == {}
    told = " ".join([explanation["summary"], *(cause["reason"] for cause in explanation["causes"])])
    for words in case.get("says", ()):
        assert words in told
    if "stopovers" in case:
        moves = Counter(document["statistics"]["considered"]["order"])
        assert moves.total() - len(moves) == case["stopovers"]
    if document["outcome"] != "solved":
        assert explanation["causes"]
        assert document["segments"] == []
