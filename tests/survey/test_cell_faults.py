"""What is wrong with a cell: found and told in millimetres, as far as things really overlap."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from planners.cell.bundle import CellBundle
from planners.cell.cell import Cell, known_cells, load_cell
from planners.errors import AssetError
from planners.geometry.convex import CollisionBody, ConvexShape, box, capsule, cylinder
from planners.geometry.pose import transform
from planners.survey.faults import (
    _signed_distance,
    check_cell,
    doubts_about,
    load_checked,
    meetings_at_home,
    surveyed,
)
from tests.cell.cell_probe import cell_frames, fcl_distance, fcl_object
from tests.support.own_cell import JAWS, furnished, furnished_files, own_robot, station, written, zipped


def bundle(**mount: object) -> CellBundle:
    document = station()
    for path, value in mount.items():
        holder = document["mount"]
        *way, last = path.split("__")
        for step in way:
            holder = holder[step]
        holder[last] = value
    return CellBundle.of_text(written(document))


def own(tmp_path: Path, **mount: object) -> Cell:
    return bundle(**mount).load(tmp_path)


@pytest.mark.parametrize("name", known_cells())
def test_nothing_is_wrong_with_the_shipped_cells(name: str) -> None:
    check_cell(load_cell(name))


@pytest.mark.parametrize("depth", [0.004, 0.021, -0.007, -0.2])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_boxes_that_overlap_by_so_much_are_told_so(depth: float, axis: int) -> None:
    one, other = box([0.3, 0.4, 0.5]), box([0.2, 0.6, 0.5])
    position = np.zeros(3)
    position[axis] = 0.5 * (np.ptp(one.vertices[:, axis]) + np.ptp(other.vertices[:, axis])) - depth
    for T in (np.eye(4), transform(None, [0.3, -0.2, 0.1])):
        assert _signed_distance(one, T, other, T @ transform(None, position)) == pytest.approx(-depth, abs=1e-6)


def test_what_carries_balls_is_measured_with_them() -> None:
    stick, table = capsule([0.0, 0.0, 0.0], [0.0, 0.0, 0.3], 0.02), box([1.0, 1.0, 0.1])
    for height in (0.10, 0.06):
        T = transform(None, [0.0, 0.0, height])
        assert _signed_distance(stick, T, table, np.eye(4)) == pytest.approx(height - 0.05 - 0.02, abs=1e-6)
    deep: ConvexShape = cylinder(0.1, 0.2)
    assert _signed_distance(deep, transform(None, [0.0, 0.0, 0.12]), table, np.eye(4)) == pytest.approx(-0.03, abs=1e-6)


@pytest.mark.slow
def test_a_table_that_stands_in_the_arms_is_named_with_as_many_millimetres_as_fcl_finds(tmp_path: Path) -> None:
    """As long as it only touches; how deep it then is grows with the table."""
    lowest = own(tmp_path)
    frames = cell_frames(lowest, lowest.home)
    reaching = [body for body in lowest.collision_bodies() if body.frame not in ("world", "left/0", "right/0")]
    parts = [CollisionBody(body.name, body.group, body.frame, (shape,)) for body in reaching for shape in body.shapes]
    table = next(body for body in lowest.bodies if body.name == "table")
    gap = min(fcl_distance(fcl_object(part, frames[part.frame]), fcl_object(table, np.eye(4))) for part in parts)
    assert gap > 0.01
    for overlap in (-0.001, 0.002, 0.010):
        raised = own(tmp_path, table__center=[0.60, 0.0, 0.88 + gap + overlap], table__size=[1.2, 2.0, 0.04])
        found = [meeting for meeting in meetings_at_home(raised) if "table" in meeting.bodies]
        assert min(meeting.distance for meeting in found) == pytest.approx(-overlap, abs=1e-4)
        with pytest.raises(AssetError) as caught:
            check_cell(raised)
        word = "apart; planning keeps 3.0 mm" if overlap < 0 else f"overlap by {1e3 * overlap:.1f} mm"
        assert any(word in fault.detail and fault.pointer.endswith("home_deg") for fault in caught.value.faults)


WRONG = {
    "a joint at home beyond its range": (
        {"arms__left__home_deg": [60, -120, 190, -90, -90, 0]},
        "/mount/arms/left/home_deg/2",
        "190 degrees are beyond elbow_joint's range, -180 to 180",
    ),
    "a base in the table": (
        {"arms__right__position": [0.0, -0.35, 0.87]},
        "/mount/arms/right/position",
        "30.0 mm deep",
    ),
    "hands that meet": (
        {"arms__left__position": [0.0, -0.35, 0.90]},
        "/mount/arms/left/home_deg",
        "overlap by",
    ),
}


@pytest.mark.parametrize(("mount", "pointer", "detail"), WRONG.values(), ids=WRONG.keys())
def test_what_nothing_can_be_planned_in_is_refused_at_its_member(
    mount: dict[str, object], pointer: str, detail: str, tmp_path: Path
) -> None:
    with pytest.raises(AssetError) as caught:
        load_checked(bundle(**mount), tmp_path)
    assert any(fault.pointer == pointer and detail in fault.detail for fault in caught.value.faults)
    # All was one document.
    assert {fault.file for fault in caught.value.faults} == {""}


@pytest.mark.parametrize("gravity", [[0, 0, 9.81], [0, 0, 0], [1.0, 0, -9.81], [0.05, 0, -9.81], [0, 0, -300]])
def test_gravity_points_down(gravity: list[float], tmp_path: Path) -> None:
    for given, file in (
        (CellBundle.of_text(written(station(gravity=gravity))), ""),
        (CellBundle.of_zip(zipped({"cell.json": written(station(gravity=gravity))})), "cell.json"),
    ):
        with pytest.raises(AssetError) as caught:
            load_checked(given, tmp_path)
        assert (file, "/gravity") in {(each.file, each.pointer) for each in caught.value.faults}


def told(given: CellBundle, tmp_path: Path) -> set[tuple[str, str]]:
    with pytest.raises(AssetError) as caught:
        load_checked(given, tmp_path)
    return {(fault.file, fault.pointer) for fault in caught.value.faults}


def test_faults_of_all_stages_are_told_at_once_where_they_stand_in_what_was_given(tmp_path: Path) -> None:
    """Gravity up, a joint beyond its range, an open mesh, a hand that is too heavy, and a URDF that is none."""
    files, document = furnished_files(), furnished()
    document["gravity"] = [0, 0, 9.81]
    document["mount"]["arms"]["left"]["home_deg"][0] += 360
    document["arms"]["right"]["hand"] = {**JAWS, "mass": 50.0}
    box = trimesh.creation.box((0.05, 0.05, 0.8))
    files["meshes/fence.stl"] = trimesh.Trimesh(box.vertices, box.faces[:-1]).export(file_type="stl")
    all_in_one = {
        ("cell.yaml", "/gravity"),
        ("cell.yaml", "/mount/arms/left/home_deg/0"),
        ("cell.yaml", "/mount/platform/fence/mesh"),
        ("cell.yaml", "/arms/right/hand"),
    }
    assert told(CellBundle.of_zip(zipped({**files, "cell.yaml": written(document)})), tmp_path) == all_in_one
    # With the arm from a URDF, nobody knows where its home is.
    document["arms"]["left"] = {"robot": "industrial", "hand": JAWS}
    document["arms"]["right"] = {"robot": own_robot(), "hand": {**JAWS, "mass": 50.0, "name": "heavy"}}
    document["mount"]["arms"]["right"]["home_deg"][0] -= 360
    files |= {"cell.yaml": written(document), "arm/arm.urdf": files["arm/arm.urdf"].replace(b"2.5", b"-4")}
    assert told(CellBundle.of_zip(zipped(files)), tmp_path) == all_in_one - {
        ("cell.yaml", "/mount/arms/left/home_deg/0")
    } | {("cell.yaml", "/mount/arms/right/home_deg/0"), ("arm/arm.urdf", "")}


def test_faults_of_all_parts_are_told_at_once_whatever_else_is_missing(tmp_path: Path) -> None:
    document = furnished()
    document["gravity"][2] = math.nan
    document["mount"]["table"]["size"][1] = math.inf
    document["arms"]["left"]["robot"]["payload"] = -1.0
    document["arms"]["right"]["hand"]["sensor"]["rate"] = "fast"
    document["arms"]["right"]["hand"]["mass"] = 0
    del document["mount"]["frame"]
    assert told(CellBundle.of_text(written(document)), tmp_path) == {
        ("", "/gravity/2"),
        ("", "/mount/table/size/1"),
        ("", "/mount/frame"),
        ("", "/arms/left/robot/payload"),
        ("", "/arms/right/hand/sensor/rate"),
        ("", "/arms/right/hand/mass"),
    }


def test_a_part_of_which_something_is_told_is_not_missed(tmp_path: Path) -> None:
    """Nor is a shipped one of its name taken."""
    files = furnished_files()
    document = json.loads(files["cell.yaml"])
    document["arms"]["left"]["robot"] = "ur10e"
    files |= {"cell.yaml": written(document), "robots/ur10e.yaml": b"name: ur10e\nurdf: nowhere.urdf"}
    pointers = {pointer for _, pointer in told(CellBundle.of_zip(zipped(files)), tmp_path)}
    assert pointers == {"/root", "/tip", "/payload", "/acceleration"}


def in_millimetres(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: each if name in ("rpy_deg", "home_deg") else in_millimetres(each) for name, each in value.items()}
    return [in_millimetres(each) for each in value] if isinstance(value, list) else 1000.0 * value


def with_one_arm_in_millimetres(mount: dict[str, Any]) -> dict[str, Any]:
    x, y, z = mount["arms"]["right"]["position"]
    return {**mount, "arms": {**mount["arms"], "right": {**mount["arms"]["right"], "position": [x, 1000.0 * y, z]}}}


REST = {"clearance": 0.02, "height": 0.05, "thickness": 0.005}
UNLIKELY: dict[str, tuple[dict[str, Any], str, str]] = {
    "all in millimetres": (
        {"mount": in_millimetres(station()["mount"])},
        "/mount/table/size",
        "all lengths in metres?",
    ),
    "an arm in millimetres": (
        {"mount": with_one_arm_in_millimetres(station()["mount"])},
        "/mount/arms/right/position",
        "all lengths in metres?",
    ),
    "a tool rest beside the table": ({"tool_rest": {"position": [5, 5], **REST}}, "/tool_rest/position", "x 0 to 1.2"),
    "forces the wrong way round": ({"hand": {"force_range": [100, 10]}}, "/arms/right/hand/force_range", "least force"),
    "more force than there is": ({"hand": {"squeeze": 500}}, "/arms/right/hand/squeeze", "10 to 100 N"),
    "a centre of mass far away": ({"hand": {"com": 90}}, "/arms/right/hand/com", "ends at 0.21 m"),
    "links in millimetres": ({"radius": 80}, "/arms/left/robot/links", "base, shoulder"),
}


@pytest.mark.parametrize(("members", "pointer", "detail"), UNLIKELY.values(), ids=UNLIKELY.keys())
def test_what_is_seldom_meant_is_refused_in_one_line(
    members: dict[str, Any], pointer: str, detail: str, tmp_path: Path
) -> None:
    document = {**furnished(), **members}
    document["mount"]["platform"] = {}
    document["arms"]["right"]["hand"] |= document.pop("hand", {})
    if radius := document.pop("radius", None):
        for link in document["arms"]["left"]["robot"]["links"]:
            for each in link["cylinders"]:
                each["radius"] = radius
    with pytest.raises(AssetError) as caught:
        load_checked(CellBundle.of_text(written(document)), tmp_path)
    assert [detail in fault.detail for fault in caught.value.faults if fault.pointer == pointer] == [True]
    if not members.keys() & {"mount", "radius"}:
        assert len(caught.value.faults) == 1
    if "radius" in members:
        assert not any("overlap" in fault.detail for fault in caught.value.faults)


def test_a_cell_whose_hands_reach_nothing_of_the_table_is_refused(tmp_path: Path) -> None:
    far = bundle(table__center=[2.4, 0.0, 0.88])
    cell = load_checked(far, tmp_path)
    with pytest.raises(AssetError, match="no hand reaches any place 100 mm above it") as caught:
        surveyed(cell, far)
    assert [(fault.file, fault.pointer) for fault in caught.value.faults] == [("", "/mount/table")]


def test_a_home_that_looks_like_radians_is_noted() -> None:
    cell = load_cell("dual_ur3e_lift")
    assert doubts_about(cell) == []
    arms = {name: replace(arm, home=np.radians(home)) for (name, arm), home in zip(
        cell.arms.items(), ([1.57, -1.57, 1.57, 0, 0, 0], [0.0] * 6), strict=True
    )}  # fmt: skip
    (note,) = doubts_about(replace(cell, arms=arms))
    assert note.startswith("the left arm's home_deg")


def test_two_grippers_of_a_cell_are_equal(tmp_path: Path) -> None:
    def cell_with(right: str) -> CellBundle:
        hands = {"left": "robotiq_2f85_ft300", "right": right}
        arms = {arm: {"robot": "ur3e", "hand": hand} for arm, hand in hands.items()}
        rest = {"position": [0.22, 0.0], "clearance": 0.024, "height": 0.050, "thickness": 0.005}
        return CellBundle.of_text(
            written({"name": "pair", "gravity": [0, 0, -9.81], "mount": "dual_column", "arms": arms, "tool_rest": rest})
        )

    load_checked(cell_with("robotiq_2f85_ft300"), tmp_path)
    with pytest.raises(AssetError) as caught:
        load_checked(cell_with("jaws_140_ft300"), tmp_path)
    assert "/arms/right/hand" in {fault.pointer for fault in caught.value.faults}
