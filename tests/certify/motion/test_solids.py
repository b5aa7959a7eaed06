"""Surfaces and distances against the cell, coal and brute force."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from planners.cell.arm import load_robot
from planners.cell.asset_shelf import AssetShelf, shipped_shelf
from planners.cell.cell import Cell
from planners.cell.hand import Gripper, Pusher, load_hand
from planners.certify import RobotSurfaces
from planners.certify.geometry.body_shape import box, convex_part
from planners.certify.motion.collision import can_meet
from planners.certify.motion.kinematics import ArmKinematics
from planners.certify.motion.robot_surfaces import LINKS, load_surfaces
from planners.certify.motion.solids import ConvexSolid, Frame, _stick, capsule, gripper_of, polytope, signed_distance
from planners.certify.plan_view import MalformedDocument
from planners.geometry.pose import Array, Transform, rotation_from_vector, transform
from tests.cell.cell_probe import gripper_hulls

Distance = Callable[[ConvexSolid, Transform, ConvexSolid, Transform], float]
FRAME = Frame("body", "test")


def random_pose(rng: np.random.Generator, reach: float) -> Transform:
    return transform(rotation_from_vector(rng.normal(size=3) * 2), rng.uniform(-reach, reach, size=3))


def random_solid(rng: np.random.Generator) -> ConvexSolid:
    if rng.uniform() < 0.3:
        return capsule("capsule", "test", FRAME, rng.normal(size=(2, 3)) * 0.05, float(rng.uniform(0.01, 0.04)))
    return polytope("hull", "test", FRAME, convex_part(rng.normal(size=(12, 3)) * 0.05))


@pytest.mark.slow
def test_distances_are_coals_and_never_larger(true_distance: Distance) -> None:
    rng = np.random.default_rng(2)
    apart = 0
    for _ in range(2000):
        a, b = random_solid(rng), random_solid(rng)
        T_a, T_b = random_pose(rng, 0.15), random_pose(rng, 0.15)
        known = true_distance(a, T_a, b, T_b)
        ours = signed_distance(a, T_a, b, T_b)
        assert (ours > 0) == (known > 0)
        if known > 0:
            apart += 1
            assert known * 0.97 - 1e-5 <= ours <= known + 2e-6
    assert 500 < apart < 1950


def test_a_depth_is_the_shortest_way_out() -> None:
    """Moved by its depth, and no less, along some direction the hulls are apart (over many directions)."""
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(20000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    seen = 0
    while seen < 30:
        a, b = (polytope("hull", "test", FRAME, convex_part(rng.normal(size=(8, 3)) * 0.05)) for _ in range(2))
        T_a, T_b = random_pose(rng, 0.05), random_pose(rng, 0.05)
        depth = -signed_distance(a, T_a, b, T_b)
        if depth <= 0:
            continue
        seen += 1
        p, q = (solid.points @ T[:3, :3].T + T[:3, 3] for solid, T in ((a, T_a), (b, T_b)))
        ways = (directions @ p.T).max(axis=1) - (directions @ q.T).min(axis=1)
        assert depth <= ways.min() + 1e-9
        assert depth >= ways.min() * 0.9 - 1e-3


def test_links_are_where_the_cell_has_them(cell: Cell, surfaces: RobotSurfaces) -> None:
    """The cell reads the meshes in another way; its bodies enclose them closely."""
    for arm in cell.arms.values():
        for body, (hull,) in zip(arm.link_bodies(), surfaces[arm.name].links, strict=True):
            assert body.name.removeprefix(f"{arm.name}_") in LINKS
            assert_encloses(
                np.vstack([s.vertices for s in body.shapes]), max(s.radius for s in body.shapes), hull.vertices
            )


@pytest.mark.parametrize("robot", shipped_shelf().names("robots"))
def test_links_of_every_shipped_arm_are_read_alike(robot: str) -> None:
    """Of the prisms around cylinders one has more sides than the other: at most 0.9 % of a radius of 0.15 m."""
    read = load_surfaces({"left": (robot, "robotiq_2f85_ft300")})["left"]
    for ours, theirs in zip(load_robot(robot, shipped_shelf()).links, read.links, strict=True):
        for shape, hull in zip(ours.shapes, theirs, strict=True):
            assert_encloses(shape.vertices, 1.4e-3, hull.vertices)


@pytest.mark.parametrize(
    ("was", "now"),
    [
        ("position: [0.425, 0, 0.138]", "position: [0.425, 0, 0.438]"),
        ("rpy_deg: [90, 0, -90]", "rpy_deg: [90, 30, -90]"),
        ("path: arms/ur5e/collision/", "scale: 0.5, path: arms/ur5e/collision/"),
    ],
)
def test_links_of_a_changed_copy_of_a_shipped_arm_are_where_the_copy_has_them(
    was: str, now: str, tmp_path: Path
) -> None:
    given = (shipped_shelf().folders[0] / "robots" / "ur5e.yaml").read_text()
    assert was in given
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "mine.yaml").write_text(given.replace("name: ur5e", "name: mine", 1).replace(was, now))
    shelf = AssetShelf((tmp_path, *shipped_shelf().folders))
    read = load_surfaces({"left": ("mine", "robotiq_2f85_ft300")}, shelf.folders)["left"]
    for ours, theirs in zip(load_robot("mine", shelf).links, read.links, strict=True):
        for shape, hull in zip(ours.shapes, theirs, strict=True):
            assert_encloses(shape.vertices, 1.4e-3, hull.vertices)
            assert_encloses(hull.vertices, 0.02, shape.vertices)


def test_fingers_are_where_the_cell_has_them(cell: Cell, surfaces: RobotSurfaces) -> None:
    gripper = cell.arms["right"].hand
    assert isinstance(gripper, Gripper)
    known = gripper_of("right", surfaces)
    for width in (0.0, 0.02, 0.04, 0.085):
        hulls = gripper_hulls(gripper, width)
        for finger in (0, 1):
            for part, hull in known.finger_parts.items():
                T = known.finger_poses(part, finger, np.array([width]))[0]
                name = f"pad_{finger}" if part == "pad" else f"finger_{finger}_{part}"
                points = hull.vertices @ T[:3, :3].T + T[:3, 3]
                assert_encloses(hulls[name], 2e-5, points)
                assert_encloses(points, 2e-5, hulls[name])


def test_pads_have_the_height_and_gap_that_were_measured(surfaces: RobotSurfaces) -> None:
    """facts: gap = 2 (0.0054057 + 0.0376 cos q - 0.043 sin q), height = 0.087324 + 0.0376 sin q + 0.043 cos q."""
    q = np.linspace(0.0, 0.8, 50)
    gaps = 2 * (0.0054057 + 0.0376 * np.cos(q) - 0.043 * np.sin(q))
    heights = 0.0484 + 0.087324 + 0.0376 * np.sin(q) + 0.043 * np.cos(q)
    known = gripper_of("right", surfaces)
    assert known.fingers.largest_width == pytest.approx(gaps[0], abs=1e-6)
    np.testing.assert_allclose(known.pad_height(gaps), heights, atol=1e-6)
    for finger, side in ((0, -1.0), (1, 1.0)):
        inner = side * known.finger_poses("pad", finger, gaps)[:, 1, 3] - 0.00635 / 2
        np.testing.assert_allclose(2 * inner, gaps, atol=1e-6)


def test_a_stick_is_as_thick_and_its_tip_as_long_as_the_cell_has_them(tmp_path: Path) -> None:
    given = (shipped_shelf().folders[0] / "hands" / "pushing_stick_ft300.yaml").read_text()
    thick = given.replace("stick_radius: 0.010", "stick_radius: 0.030").replace(
        "tip_length: 0.010", "tip_length: 0.004"
    )
    thick = thick.replace("name: pushing_stick_ft300", "name: thick_stick")
    (tmp_path / "hands").mkdir()
    (tmp_path / "hands" / "thick_stick.yaml").write_text(thick)
    shelf = AssetShelf((tmp_path, *shipped_shelf().folders))
    for name in ("pushing_stick_ft300", "thick_stick"):
        hand = load_hand(name, shelf)
        assert isinstance(hand, Pusher)
        known = load_surfaces({"left": ("ur3e", name)}, shelf.folders)["left"]
        for ours, theirs in zip((hand.stick, hand.tip), _stick("left", hand.document(), known), strict=True):
            np.testing.assert_allclose(theirs.points, ours.vertices, atol=1e-12)
            assert theirs.radius == ours.radius
    with pytest.raises(MalformedDocument, match="tip elsewhere"):
        _stick("left", hand.document().model_copy(update={"tip_radius": 0.012}), known)


@pytest.mark.parametrize("name", ["pushing_stick_ft300", "robotiq_2f85_ft300", "jaws_140_ft300"])
def test_a_hand_without_a_sensor_begins_at_the_flange_for_cell_and_certificate(name: str, tmp_path: Path) -> None:
    given = (shipped_shelf().folders[0] / "hands" / f"{name}.yaml").read_text()
    (tmp_path / "hands").mkdir()
    (tmp_path / "hands" / "bare.yaml").write_text(
        given.replace("sensor: ft300\n", "").replace(f"name: {name}", "name: bare")
    )
    shelf = AssetShelf((tmp_path, *shipped_shelf().folders))
    bare, whole = load_hand("bare", shelf), load_hand(name, shelf)
    known = load_surfaces({"left": ("ur3e", "bare")}, shelf.folders)["left"]
    assert bare.sensor is None
    assert whole.sensor is not None
    assert known.sensor is None
    length = float(whole.sensor.vertices[:, 2].max())
    if isinstance(bare, Pusher):
        assert {body.name for body in bare.bodies("left")} == {"left_stick", "left_tip"}
        for ours, theirs in zip((bare.stick, bare.tip), _stick("left", bare.document(), known), strict=True):
            np.testing.assert_allclose(theirs.points, ours.vertices, atol=1e-12)
        return
    assert isinstance(whole, Gripper)
    bodies = {body.name: body for body in bare.bodies("left", bare.width_max)}
    assert "left_ft300" not in bodies
    assert bare.base_height == 0.0
    down = np.array([0.0, 0.0, length])
    np.testing.assert_allclose(bare.T_flange_tcp(0.05)[:3, 3] + down, whole.T_flange_tcp(0.05)[:3, 3], atol=1e-12)
    assert known.gripper is not None
    (base,) = bodies["left_gripper_base"].shapes
    assert_encloses(base.vertices, base.radius, known.gripper.base.vertices)


def test_no_base_is_asked_of_what_it_is_bolted_to() -> None:
    cube = box(np.ones(3)).parts[0]
    base, shoulder = (polytope("link", "link", Frame("link", "left", i), cube) for i in (0, 1))
    for role, asked in (("table", False), ("frame", False), ("obstacle", True), ("plate", True)):
        body = polytope(role, role, Frame("body", role), cube)
        assert can_meet(base, body, frozenset({"table", "frame", "obstacle"})) == asked
        assert can_meet(shoulder, body, frozenset({"table", "frame", "obstacle"}))


def test_jaws_are_where_the_cell_has_them() -> None:
    hand = load_hand("jaws_140_ft300", shipped_shelf())
    assert isinstance(hand, Gripper)
    known = gripper_of("right", load_surfaces({"right": ("ur3e", "jaws_140_ft300")}))
    assert known.fingers.largest_width == hand.width_max
    for width in (0.0, 0.03, 0.14):
        drawn = {body.name: body.shapes[0].vertices for body in hand.bodies("right", width)}
        assert_same_hull(drawn["right_gripper_base"], known.base.vertices)
        assert known.pad_height(np.array([width]))[0] == pytest.approx(hand.T_flange_tcp(width)[2, 3])
        for finger in (0, 1):
            for part, hull in known.finger_parts.items():
                T = known.finger_poses(part, finger, np.array([width]))[0]
                name = f"right_pad_{finger}" if part == "pad" else f"right_finger_{finger}_{part}"
                assert_same_hull(drawn[name], hull.vertices @ T[:3, :3].T + T[:3, 3])


@pytest.mark.parametrize("name", ["robotiq_2f85_ft300", "jaws_140_ft300"])
def test_no_point_of_a_finger_moves_or_is_farther_than_is_said(name: str) -> None:
    known = gripper_of("right", load_surfaces({"right": ("ur3e", name)}))
    widths = np.random.default_rng(0).uniform(0.0, known.fingers.largest_width, 60)
    for part, hull in known.finger_parts.items():
        poses = known.finger_poses(part, 1, widths)
        points = np.einsum("nij,pj->npi", poses[:, :3, :3], hull.vertices) + poses[:, None, :3, 3]
        moved = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1)
        turned = Rotation.from_matrix(poses[1:, :3, :3] @ poses[:-1, :3, :3].transpose(0, 2, 1)).magnitude()
        assert (moved <= known.fingers.travel(widths) + 1e-12).all()
        assert (turned <= known.fingers.turns(widths) + 1e-9).all()
        assert np.linalg.norm(points, axis=2).max() <= known.extent


def assert_same_hull(ours: Array, theirs: Array) -> None:
    assert_encloses(ours, 0.0, theirs)
    assert_encloses(theirs, 0.0, ours)


def assert_encloses(outer: Array, radius: float, points: Array) -> None:
    hull = ConvexHull(outer)
    assert (points @ hull.equations[:, :3].T + hull.equations[:, 3]).max() <= radius + 2e-5


def test_links_hang_together_in_any_pose(surfaces: RobotSurfaces, cell: Cell) -> None:
    """Neighbours across a joint overlap or touch closely: each hull is in the frame that carries it."""
    arm = cell.arms["right"]
    frames = ArmKinematics(arm.dh, arm.T_world_base).frames(np.random.default_rng(4).uniform(-3, 3, size=(20, 6)))
    solids = [polytope(name, "link", FRAME, hull) for name, (hull,) in zip(LINKS, surfaces["right"].links, strict=True)]
    for poses in frames:
        for i in range(6):
            assert signed_distance(solids[i], poses[i], solids[i + 1], poses[i + 1]) < 0.004


def test_edges_of_a_box_are_its_three_axes() -> None:
    assert {tuple(np.abs(edge)) for edge in box(np.array([1.0, 2.0, 3.0])).parts[0].edges} == set(map(tuple, np.eye(3)))
