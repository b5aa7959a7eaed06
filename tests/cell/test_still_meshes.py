"""What never moves may be meshes: hollows stay hollow, things stand on them, plans keep clear of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from planners import read_task, solve
from planners.cell import asset_shelf
from planners.cell.bundle import CellBundle
from planners.cell.cell import Cell
from planners.collision.distance import distance
from planners.contract.shapes import InlineMesh
from planners.errors import AssetError, SceneError
from planners.geometry.convex import ConvexShape
from planners.geometry.pose import from_pose7, rotation_z, to_pose7, transform
from planners.geometry.solid_mesh import SolidMesh, take_mesh
from planners.scene.scene import build_scene
from planners.survey.faults import check_cell
from tests.geometry.mesh_shapes import angle, file_of, in_angle
from tests.support.own_cell import station, written, zipped
from tests.support.samples import sample

SCALE = 4.0
YAW = 30.0
PLACE = [0.45, 0.62, 0.90]
"""On the table, 0.4 by 0.32 m, its notch towards the right arm."""
T_WORLD_ANGLE = transform(rotation_z(np.radians(YAW)), PLACE)


def own(tmp_path: Path, hands: tuple[str, str] = ("pushing_stick_ft300", "robotiq_2f85_ft300"), **more: Any) -> Cell:
    return bundle(hands=hands, **more).load(tmp_path)


def bundle(
    mesh: trimesh.Trimesh | None = None,
    kind: str = "stl",
    hands: tuple[str, str] = ("pushing_stick_ft300", "robotiq_2f85_ft300"),
    sunk: float = 0.0,
    **members: Any,
) -> CellBundle:
    """Return the station with an angle of steel on its table, its arms `sunk` into that [m]."""
    document = station(**members)
    for arm in document["mount"]["arms"].values():
        arm["position"][2] -= sunk
    for arm, hand in zip(("left", "right"), hands, strict=True):
        document["arms"][arm]["hand"] = hand
    placed = {"mesh": {"path": f"meshes/angle.{kind}", "scale": SCALE}, "position": PLACE, "rpy_deg": [0, 0, YAW]}
    document["mount"]["platform"] = {"angle": placed, "post": {"center": [-0.3, 0, 0.5], "size": [0.1, 0.1, 1.0]}}
    files = {"cell.yaml": written(document), f"meshes/angle.{kind}": file_of(mesh or angle(), kind)}
    return CellBundle.of_zip(zipped(files))


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "glb"])
def test_a_point_touches_a_mesh_where_it_is_inside_and_not_in_its_hollow(kind: str, tmp_path: Path) -> None:
    (body,) = (each for each in bundle(kind=kind).load(tmp_path).bodies if each.name == "platform_angle")
    points = np.random.default_rng(0).uniform([-0.02, -0.02, -0.01], [0.12, 0.10, 0.06], (400, 3))
    world = SCALE * points @ T_WORLD_ANGLE[:3, :3].T + T_WORLD_ANGLE[:3, 3]
    # STL, PLY and GLB hold single precision.
    near = [len(set(in_angle(point + 1e-5 * np.array(CORNERS)))) > 1 for point in points]
    for point, inside, unsure in zip(world, in_angle(points), near, strict=True):
        apart = min(distance(ConvexShape(point[None]), np.eye(4), shape, np.eye(4)) for shape in body.shapes)
        assert unsure or (apart <= 0.0) == inside


CORNERS = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]


def test_the_document_states_the_mesh_and_where_it_is_and_the_hash_is_of_every_vertex(tmp_path: Path) -> None:
    cell = own(tmp_path)
    body = cell.body_documents()["platform_angle"]
    assert isinstance(body.shape, InlineMesh)
    assert (body.role, body.static) == ("frame", True)
    np.testing.assert_allclose(body.pose, to_pose7(T_WORLD_ANGLE), atol=1e-9)
    assert trimesh.Trimesh(body.shape.vertices, body.shape.faces).volume == pytest.approx(SCALE**3 * angle().volume)
    other = angle(height=0.0501)
    assert bundle(mesh=other).load(tmp_path).hash != cell.hash == own(tmp_path).hash


def test_a_mesh_that_is_open_or_of_another_unit_is_told_with_file_and_member(tmp_path: Path) -> None:
    whole = angle()
    opened = trimesh.Trimesh(whole.vertices, whole.faces[1:], process=False)
    for mesh, sentence in ((opened, "the mesh is open"), (angle().apply_scale(1000.0), "is 400 m long")):
        with pytest.raises(AssetError) as refused:
            bundle(mesh=mesh).load(tmp_path)
        (fault,) = refused.value.faults
        assert (fault.file, fault.pointer) == ("cell.yaml", "/mount/platform/angle/mesh")
        assert sentence in fault.detail


def test_meshes_have_so_many_triangles_together_and_equal_ones_count_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    placed = {"mesh": {"path": "meshes/angle.stl", "scale": SCALE}, "position": PLACE, "rpy_deg": [0, 0, YAW]}
    other = {**placed, "mesh": {"path": "meshes/other.stl", "scale": SCALE}}

    def cell(*platform: dict[str, Any]) -> Cell:
        document = station()
        document["mount"]["platform"] = {f"part_{i}": each for i, each in enumerate(platform)}
        files = {f"meshes/{name}.stl": file_of(angle(), "stl") for name in ("angle", "other")}
        return CellBundle.of_zip(zipped({"cell.yaml": written(document), **files})).load(tmp_path)

    triangles = len(angle().faces)
    monkeypatch.setattr("planners.cell.cell.MOST_TRIANGLES", 2 * triangles - 1)
    first, *_, last = cell(*[placed] * 5, other).meshes
    assert first.mesh is not last.mesh
    with pytest.raises(AssetError, match=f"{2 * triangles} triangles together") as refused:
        cell(placed, other, placed)
    assert [fault.pointer for fault in refused.value.faults] == ["/mount/platform/part_2/mesh"]


FEWER = {"contact_density": 0.5, "hold_density": 0.5, "simulate": False}
"""Options: a graph with fewer poses and holds is searched in a few seconds, the whole one in a minute."""


def lift(options: Mapping[str, Any] = FEWER, **cup: Any) -> Any:
    return read_task(
        {
            "options": options,
            "kind": "plate_lift",
            "cell": "station",
            "plate": {"shape": {"type": "box", "size": [0.6, 0.4, 0.03]}, "mass": 6.0},
            "plate_pose": [0.6, 0.0, 0.915, 1, 0, 0, 0],
            "cup": {"position": [0.0, 0.08], "radius": 0.04, "max_force": 45, **cup},
        }
    )


@pytest.mark.slow
def test_a_lift_beside_a_mesh_is_planned_and_certified_with_it(tmp_path: Path) -> None:
    """The arms' bases are sunk into the table, and the lifter is another than the papers'."""
    cell = own(tmp_path, sunk=0.002, lifter={"cup_height": 0.05, "cable_radius": 0.012, "cable_length": 0.8})
    check_cell(cell)
    plan = solve(lift(sample(FEWER, {})), cells={"station": cell})
    assert (plan.outcome, plan.certificate and plan.certificate.passed) == ("solved", True)
    assert plan.bodies["platform_angle"].static


def test_things_stand_on_a_mesh_and_not_in_it(tmp_path: Path) -> None:
    rest = {"position": [0.4, -0.4], "clearance": 0.024, "height": 0.050, "thickness": 0.005}
    cell = own(tmp_path, hands=("robotiq_2f85_ft300", "robotiq_2f85_ft300"), tool_rest=rest)
    top = PLACE[2] + SCALE * 0.05
    on_it = T_WORLD_ANGLE @ [SCALE * 0.05, SCALE * 0.01, 0.0, 1.0]
    size = 0.06
    box = {"name": "box", "shape": {"type": "box", "size": [size] * 3}, "mass": 0.2}
    goal = [*on_it[:2], top + 0.5 * size, 1, 0, 0, 0]

    def scene(start: list[float]) -> Any:
        task = {
            "kind": "suction_tool", "cell": "station", "tool": "long_symmetric",
            "objects": [{**box, "pose": start, "goal_pose": [0.6, -0.3, 0.9 + 0.5 * size, 1, 0, 0, 0]}],
        }  # fmt: skip
        return build_scene(read_task(task), {"station": cell})

    (placed,) = scene(goal).objects
    np.testing.assert_allclose(placed.body.T_world_body, from_pose7(goal), atol=1e-6)
    with pytest.raises(SceneError, match="platform_angle"):
        scene([*on_it[:2], 0.9 + 0.5 * size, 1, 0, 0, 0])


def test_a_lifter_lifts_no_more_than_its_cell_says_and_is_as_large(tmp_path: Path) -> None:
    cell = own(tmp_path, lifter={"cup_height": 0.06, "cable_length": 0.8, "max_force": 40.0})
    with pytest.raises(SceneError, match="40 N at most, not 45 N") as refused:
        build_scene(lift(), {"station": cell})
    assert refused.value.pointers == ("/cup/max_force",)
    cup = build_scene(lift(max_force=40.0), {"station": cell}).cup
    assert (cup.body.shape.height, cup.cable_length) == (0.06, 0.8)


def test_a_solid_is_covered_once_in_a_folder_and_again_if_what_was_kept_is_broken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    covered: list[int] = []

    def counted(content: bytes, *rest: Any) -> SolidMesh:
        covered.append(len(content))
        return take_mesh(content, *rest)

    monkeypatch.setattr(asset_shelf, "take_mesh", counted)
    first, second = own(tmp_path), own(tmp_path)
    assert len(covered) == 1
    (kept,) = tmp_path.glob("*/.solids/*.json")
    kept.write_bytes(kept.read_bytes()[:100])
    third = own(tmp_path)
    assert len(covered) == 2
    assert first.hash == second.hash == third.hash
    for again in (second, third):
        for known, solid in zip(first.meshes[0].mesh.parts, again.meshes[0].mesh.parts, strict=True):
            assert np.array_equal(known, solid)
