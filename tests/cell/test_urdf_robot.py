"""Robots from URDFs: the same kinematics, masses and shapes that pinocchio reads out of them."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from planners.cell import urdf_robot
from planners.cell.arm import Robot, load_robot
from planners.cell.asset_shelf import AssetShelf
from planners.cell.bundle import LONGEST_TEXT
from planners.cell.urdf_robot import RobotFigures, UrdfRobot, robot_from_urdf
from planners.certify import load_surfaces
from planners.errors import AssetError
from planners.geometry.pose import transform
from planners.kinematics.arm_kind import ArmKind, arm_kind
from planners.kinematics.forward import flange_pose, link_frames
from tests.cell.urdf_arms import UrdfArm, industrial, ur5e

FIGURES = RobotFigures(name="mine", root="l0", tip="tip", payload=5.0, acceleration=(5.0,) * 6)
TURNED = transform(Rotation.from_euler("xyz", [0.3, -1.1, 2.0]).as_matrix(), [0.2, -0.1, 0.3])
SIDEWAYS = transform(Rotation.from_euler("xyz", [0.0, math.pi / 2, 0.7]).as_matrix(), [0.0, 0.0, 0.3])
TURNED_ROUND = tuple(
    ((tuple(-x for x in axis) if i in (2, 4) else axis), point) for i, (axis, point) in enumerate(ur5e().axes)
)
"""A UR5e whose elbow and second wrist joint turn the other way."""
ARMS = {
    "ur5e": (ur5e(), ArmKind.PARALLEL_AXES),
    "ur5e, joints turned round": (replace(ur5e(), axes=TURNED_ROUND), ArmKind.PARALLEL_AXES),
    "ur5e, frames on the joints": (ur5e(seed=None), ArmKind.PARALLEL_AXES),
    "ur5e in a root aslant": (ur5e(T_root_base=TURNED, seed=1), ArmKind.PARALLEL_AXES),
    "ur5e in a root on its side": (ur5e(T_root_base=SIDEWAYS, seed=2), ArmKind.PARALLEL_AXES),
    "industrial": (industrial(), ArmKind.SPHERICAL_WRIST),
    "industrial, frames on the joints": (industrial(seed=None), ArmKind.SPHERICAL_WRIST),
    "industrial in a root aslant": (industrial(T_root_base=TURNED, seed=3), ArmKind.SPHERICAL_WRIST),
}


def no_files(path: str) -> None:
    return None


def described(arm: UrdfArm, resolve=no_files, folder="", **figures) -> UrdfRobot:
    return robot_from_urdf(arm.write(), replace(FIGURES, **figures), resolve, folder)


def loaded(found: UrdfRobot, tmp_path) -> Robot:
    """Write a robot's file and read it as a cell does."""
    (tmp_path / "robots").mkdir(exist_ok=True)
    (tmp_path / "robots" / "mine.yaml").write_text(found.file.model_dump_json(exclude_none=True))
    return load_robot("mine", AssetShelf((tmp_path,)))


class Model:
    """What pinocchio reads."""

    def __init__(self, arm: UrdfArm) -> None:
        text = arm.write().decode()
        self.model = pin.buildModelFromXML(text)
        self.data = self.model.createData()

    def frame(self, q, name: str) -> np.ndarray:
        pin.framesForwardKinematics(self.model, self.data, q)
        return self.data.oMf[self.model.getFrameId(name)].homogeneous


@pytest.mark.parametrize("name", ARMS)
def test_the_flange_is_where_pinocchio_has_it_in_any_posture(name, tmp_path):
    arm, kind = ARMS[name]
    found = described(arm)
    robot, model, rng = loaded(found, tmp_path), Model(arm), np.random.default_rng(0)
    assert arm_kind(robot.dh) is kind
    for q in rng.uniform(-math.pi, math.pi, (1000, 6)):
        ours = flange_pose(robot.dh, robot.T_mount_base, q)
        np.testing.assert_allclose(ours, model.frame(q, "tip"), atol=1e-9)
    assert max(found.deviation) < 1e-7
    assert found.notes == ()


@pytest.mark.parametrize("name", ["ur5e", "industrial in a root aslant"])
def test_links_weigh_and_are_where_pinocchio_has_them(name, tmp_path):
    arm, _ = ARMS[name]
    robot, model, rng = loaded(described(arm), tmp_path), Model(arm), np.random.default_rng(1)
    text = arm.write().decode()
    geometry = pin.buildGeomFromUrdfString(model.model, text, pin.GeometryType.COLLISION)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * [0.05, 0.04, 0.03]
    frames = np.empty((7, 4, 4))
    for q in rng.uniform(-math.pi, math.pi, (5, 6)):
        link_frames(robot.dh, robot.T_mount_base, q, frames)
        pin.forwardKinematics(model.model, model.data, q)
        placed = geometry.createData()
        pin.updateGeometryPlacements(model.model, model.data, geometry, placed)
        for i, link in enumerate(robot.links):
            T = placed.oMg[geometry.getGeometryId(f"l{i}_0")].homogeneous
            expected = corners @ T[:3, :3].T + T[:3, 3]
            ours = link.points @ frames[i][:3, :3].T + frames[i][:3, 3]
            order = np.lexsort(expected.round(5).T), np.lexsort(ours.round(5).T)
            np.testing.assert_allclose(ours[order[1]], expected[order[0]], atol=3e-7)
        for i, (mass, *com) in enumerate(robot.masses, start=1):
            assert mass == pytest.approx(model.model.inertias[i].mass)
            expected = model.data.oMi[i].act(model.model.inertias[i].lever)
            np.testing.assert_allclose(frames[i][:3, :3] @ com + frames[i][:3, 3], expected, atol=1e-9)


def test_limits_are_the_urdfs(tmp_path):
    robot = loaded(described(ur5e()), tmp_path)
    np.testing.assert_allclose(robot.position_min, -2.9)
    np.testing.assert_allclose(robot.position_max, 2.5)
    np.testing.assert_allclose(robot.velocity_max, 3.1)
    np.testing.assert_allclose(robot.torque_max, 120.0)
    np.testing.assert_allclose(robot.acceleration_max, 5.0)
    assert robot.payload == 5.0


def test_the_certificate_reads_the_same_pieces(tmp_path):
    robot = loaded(described(industrial()), tmp_path)
    from assets import assets_folder

    read = load_surfaces({"left": ("mine", "robotiq_2f85_ft300")}, [tmp_path, assets_folder()])["left"]
    for ours, theirs in zip(robot.links, read.links, strict=True):
        for piece, part in zip(ours.pieces, theirs, strict=True):
            assert {tuple(corner) for corner in piece} == {tuple(corner) for corner in part.vertices}


@pytest.mark.parametrize("digits", [4, 2])
def test_rounded_right_angles_are_taken_as_right_and_it_is_told_how_far_that_moves_the_flange(digits, tmp_path):
    """Links turned by 1.5708, or by 1.57, as many descriptions have them."""
    arm = ur5e(square=True, digits=digits)
    found = described(arm)
    robot, model, rng = loaded(found, tmp_path), Model(arm), np.random.default_rng(2)
    farthest = 0.0
    for q in rng.uniform(-math.pi, math.pi, (500, 6)):
        away = flange_pose(robot.dh, robot.T_mount_base, q) - model.frame(q, "tip")
        farthest = max(farthest, float(np.linalg.norm(away[:3, 3])))
    assert 1e-7 < farthest < 1.3 * found.deviation[0] < 5e-3
    assert any("taken as exact" in note for note in found.notes)


SHAPES = {
    "cylinder": ('<cylinder radius="0.05" length="0.3"/>', trimesh.creation.cylinder(0.05, 0.3)),
    "sphere": ('<sphere radius="0.07"/>', trimesh.creation.icosphere(4, 0.07)),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_round_shapes_lie_within_the_pieces_that_stand_for_them(shape, tmp_path):
    written, solid = SHAPES[shape]
    robot = loaded(described(ur5e(shape=written)), tmp_path)
    for link in robot.links:
        hull = ConvexHull(link.points)
        middle = link.points.mean(axis=0)
        # However a link's frame is turned, no face of the piece is nearer to its middle than the solid's surface.
        assert hull.volume > solid.volume
        nearest = (-hull.equations[:, :3] @ middle - hull.equations[:, 3]).min()
        assert nearest == pytest.approx(min(solid.extents) / 2.0, rel=5e-3)


def mesh_stl() -> bytes:
    return trimesh.creation.box((100.0, 80.0, 60.0)).export(file_type="stl")


PATHS = {
    "package://arm_support/meshes/a.stl": "arm_support/meshes/a.stl",
    "package://arm_support/meshes/b.stl": "meshes/b.stl",
    "../meshes/c.stl": "meshes/c.stl",
    "d.STL": "urdf/d.STL",
}


@pytest.mark.parametrize("name", PATHS)
def test_a_mesh_is_found_by_package_or_beside_the_urdf_and_scaled(name, tmp_path):
    files = {PATHS[name]: mesh_stl()}
    arm = ur5e(shape=f'<mesh filename="{name}" scale="0.001 0.001 0.001"/>')
    robot = loaded(described(arm, files.get, "urdf"), tmp_path)
    box = loaded(described(ur5e()), tmp_path)
    for ours, expected in zip(robot.links, box.links, strict=True):
        np.testing.assert_allclose(np.sort(ours.points, axis=0), np.sort(expected.points, axis=0), atol=2e-7)


@pytest.mark.parametrize(
    "name",
    ["../../etc/passwd.stl", "/etc/passwd.stl", "file:///etc/passwd.stl", "package://../../x.stl", "a\\..\\b.stl"],
)
def test_a_mesh_outside_the_folder_is_not_asked_for(name):
    asked: list[str] = []

    def resolve(path: str) -> None:
        asked.append(path)

    with pytest.raises(AssetError, match="not there"):
        described(ur5e(shape=f'<mesh filename="{name}"/>'), resolve, "urdf")
    assert all(".." not in path and not path.startswith("/") and ":" not in path for path in asked)


def test_masses_and_torques_may_be_given_and_lie_in_the_middle_of_the_shapes(tmp_path):
    arm = ur5e(mass=0.0, limit='lower="-2.9" upper="2.5" velocity="3.1" effort="0"')
    given = described(arm, mass=(3.0, 2.0, 2.0, 1.0, 1.0, 0.5), torque=(100.0,) * 6)
    robot = loaded(given, tmp_path)
    np.testing.assert_allclose(robot.masses[:, 0], [3.0, 2.0, 2.0, 1.0, 1.0, 0.5])
    for link, row in zip(robot.links[1:], robot.masses, strict=True):
        np.testing.assert_allclose(row[1:], link.points.mean(axis=0), atol=1e-7)
    np.testing.assert_allclose(robot.torque_max, 100.0)


def test_what_is_fixed_to_a_link_is_part_of_it_and_what_hangs_on_the_tip_is_not(tmp_path):
    cover = (
        '<link name="cover"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>'
        '<joint name="c" type="fixed"><parent link="l2"/><child link="cover"/></joint>'
        '<link name="hand"><collision><geometry><sphere radius="1.0"/></geometry></collision></link>'
        '<joint name="h" type="fixed"><parent link="tip"/><child link="hand"/></joint>'
        '<link name="lever"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>'
        '<joint name="v" type="revolute"><parent link="l1"/><child link="lever"/></joint>'
    )
    found = described(ur5e(more=cover))
    assert [len(link.pieces) for link in loaded(found, tmp_path).links] == [1, 1, 2, 1, 1, 1, 1]
    assert any("'hand' hangs on the tip" in note for note in found.notes)
    assert any("'lever' moves on 'l1'" in note for note in found.notes)


def test_a_joint_without_an_end_is_given_a_turn_to_either_side():
    found = described(ur5e(kinds=("continuous",) * 6, limit='velocity="3" effort="50"'))
    assert all(joint.position_deg == (-360.0, 360.0) for joint in found.file.joints)
    assert len(found.notes) == 6


SEVENTH = (((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)),)


@pytest.mark.slow
def test_a_hull_of_very_many_corners_is_thinned_and_still_encloses_the_link(monkeypatch):
    """The meshes of makers have more corners than a file of a cell has room for."""
    points = np.random.default_rng(5).normal(size=(4000, 3))
    points *= np.array([0.12, 0.10, 0.08]) / np.linalg.norm(points, axis=1)[:, None]
    files = {"a.stl": trimesh.convex.convex_hull(points).export(file_type="stl")}
    arm = ur5e(shape='<mesh filename="a.stl"/>')
    thinned = described(arm, files.get).file
    monkeypatch.setattr(urdf_robot, "MOST_CORNERS", 10**9)
    whole = described(arm, files.get).file
    assert len(json.dumps(thinned.model_dump(mode="json"), indent=1)) < LONGEST_TEXT / 10
    for few, all_of_it in zip(thinned.links, whole.links, strict=True):
        hull, corners = ConvexHull(few.pieces[0]), np.array(all_of_it.pieces[0])
        assert len(few.pieces[0]) <= 60 < 3000 < len(corners)
        assert (hull.equations[:, :3] @ corners.T + hull.equations[:, 3:]).max() < 1e-6
        assert hull.volume < 1.1 * ConvexHull(corners).volume


def test_everything_that_is_wrong_with_a_urdf_is_told_at_once():
    """As makers publish some: neither torques nor masses, and here meshes are missing too."""
    limit = 'lower="-1" upper="1" velocity="1" effort="0"'
    with pytest.raises(AssetError) as caught:
        described(ur5e(mass=0.0, limit=limit, shape='<mesh filename="a.stl"/>'))
    told = [fault.detail for fault in caught.value.faults]
    assert [sum(words in each for each in told) for words in ("effort must", "no mass is", "is not there")] == [6, 6, 7]
    with pytest.raises(AssetError) as caught:
        described(ur5e(limit='lower="x" upper="1" velocity="1" effort="1"', shape="<capsule/>"))
    assert len(caught.value.faults) == 6 + 7


def test_an_axis_is_read_of_joints_that_move():
    """Exporters write an axis 0 0 0 on joints that are fixed."""
    flat = '<axis xyz="0 0 0"/>'
    fixed = '<link name="x"/><joint name="f" type="fixed"><parent link="l6"/><child link="x"/>' + flat + "</joint>"
    assert described(ur5e(more=fixed)).file == described(ur5e()).file
    with pytest.raises(AssetError, match="axis: xyz must not be 0 0 0"):
        described(ur5e(more=fixed.replace("fixed", "revolute")))


def test_angles_that_are_most_likely_in_degrees_are_noted():
    notes = described(ur5e(limit='lower="-170" upper="170" velocity="90" effort="1"')).notes
    assert sum("a URDF has radians; are these degrees?" in note for note in notes) == 12


WRONG = {
    "seven joints": (replace(ur5e(), axes=(*ur5e().axes, *SEVENTH), kinds=("revolute",) * 7), "7 joints turn"),
    "five joints": (replace(ur5e(), axes=ur5e().axes[:5]), "5 joints turn between 'l0' and 'tip'"),
    "a joint that slides": (ur5e(kinds=(*("revolute",) * 5, "prismatic")), "joint 'j6': type 'prismatic'"),
    "a wrist aslant": (
        replace(
            industrial(), axes=(*industrial().axes[:4], ((0.6, 0.8, 0.0), (0.9, 0.0, 0.435)), industrial().axes[5])
        ),
        "joints j1, j2, j3, j4, j5, j6: the arm has neither",
    ),
    "a tip on its side": (
        replace(ur5e(), T_base_tip=ur5e().T_base_tip @ transform(Rotation.from_euler("y", 1.0).as_matrix())),
        "tip: its x axis must be square",
    ),
    "no masses": (ur5e(mass=0.0), "no mass is stated"),
    "no shapes": (ur5e(shape=""), "no shape is stated"),
    "no effort": (ur5e(limit='lower="-1" upper="1" velocity="1" effort="0"'), "effort must be greater than 0"),
    "no range": (ur5e(limit='velocity="1" effort="1"'), "lower and upper are required"),
    "a range the wrong way round": (ur5e(limit='lower="1" upper="-1" velocity="1" effort="1"'), "lower must be less"),
    "an effort of no motor": (
        ur5e(limit='lower="-1" upper="1" velocity="1" effort="100000"'),
        "effort must be greater",
    ),
    "a speed in degrees": (
        ur5e(limit='lower="-1" upper="1" velocity="360" effort="1"'),
        "a URDF has radians; are these degrees",
    ),
    "a range beyond all turns": (ur5e(limit='lower="50" upper="60" velocity="1" effort="1"'), "further than 540 deg"),
    "a heavy link": (ur5e(mass=1e5), "'l1': mass: must be less than or equal to 10000"),
    "a joint that follows another": (ur5e(joint_more='<mimic joint="j1"/>'), "mimic: it follows 'j1'"),
    "far too many shapes": (
        ur5e(link_more='<collision><geometry><sphere radius="1"/></geometry></collision>' * 300),
        "the arm has 307 shapes; at most 200",
    ),
    "a shape of kilometres": (ur5e(shape='<box size="1e5 1 1"/>'), "farther than 1000 m"),
    "not a number": (ur5e(limit='lower="nan" upper="1" velocity="1" effort="1"'), "lower: must be 1 number, not 'nan'"),
    "a flat box": (ur5e(shape='<box size="1 0 1"/>'), "lengths must be greater than 0"),
    "an unknown shape": (ur5e(shape="<capsule/>"), "must be one of box, cylinder, sphere, mesh"),
    "a mesh of another format": (ur5e(shape='<mesh filename="a.dae"/>'), "of the kinds STL, PLY, OBJ, GLB"),
    "a mesh that is not there": (ur5e(shape='<mesh filename="a.stl"/>'), "looked for at a.stl"),
    "a link that is not there": (
        ur5e(more='<joint name="x" type="fixed"><parent link="l1"/><child link="z"/></joint>'),
        "joint 'x': there is no link 'z'",
    ),
    "two joints above a link": (
        ur5e(more='<joint name="x" type="fixed"><parent link="l1"/><child link="l4"/></joint>'),
        "hangs on another joint already",
    ),
    "a circle": (
        ur5e(more='<joint name="x" type="fixed"><parent link="tip"/><child link="l0"/></joint>'),
        "go round in a circle",
    ),
    "a link twice": (ur5e(more='<link name="l1"/>'), "link 'l1': is there twice"),
    "not expanded": (ur5e(more='<x:macro xmlns:x="http://ros.org/wiki/xacro"/>'), "expand it first"),
}


@pytest.mark.parametrize("case", WRONG.values(), ids=WRONG.keys())
def test_what_is_wrong_is_told_by_name(case):
    arm, message = case
    with pytest.raises(AssetError, match=message.replace("(", r"\(")):
        described(arm)


@pytest.mark.parametrize(
    "content",
    [b"", b"<robot", b"<sdf/>", b"\xff\xfe\x00", b'<!DOCTYPE r [<!ENTITY a "b">]><robot>&a;</robot>', b"<robot/>"],
)
def test_what_is_no_urdf_is_refused(content):
    with pytest.raises(AssetError, match="URDF"):
        robot_from_urdf(content, FIGURES, no_files)


@pytest.mark.parametrize(
    ("figures", "message"),
    [
        ({"root": "x"}, "root: there is no link 'x'"),
        ({"tip": "l0", "root": "tip"}, "does not hang on"),
        ({"acceleration": (1.0,)}, "acceleration: must be 6"),
    ],
)
def test_figures_that_do_not_fit_are_refused(figures, message):
    with pytest.raises(AssetError, match=message):
        described(ur5e(), **figures)
