"""Hands: the gripper's linkage against the published URDF, its frames and table, and the stick."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from planners.cell.asset_shelf import shipped_shelf
from planners.cell.hand import WidthError, load_hand
from planners.geometry.pose import rotation_x
from tests.cell.cell_probe import GRIPPER_URDF, gripper_hulls, mesh_origins, moved, obj_vertices, outside
from tests.kinematics.arm_oracle import published_urdf

WIDTHS = [0.0, 0.013, 0.04, 0.0731, 0.085]
MESHES = "grippers/robotiq_2f_85/meshes/collision/robotiq_arg2f_85_{}.obj"


@pytest.fixture(scope="module")
def gripper():
    return load_hand("robotiq_2f85_ft300", shipped_shelf())


@pytest.fixture(scope="module")
def jaws():
    return load_hand("jaws_140_ft300", shipped_shelf())


@pytest.fixture(scope="module")
def pusher():
    return load_hand("pushing_stick_ft300", shipped_shelf())


def vertices_by_name(bodies):
    return {body.name: body.shapes[0].vertices for body in bodies}


@pytest.mark.parametrize("width", WIDTHS)
def test_inner_faces_of_the_pads_are_as_far_apart_as_the_gripper_is_open_with_the_tcp_in_their_middle(gripper, width):
    pads = vertices_by_name(gripper.bodies("right", width))
    T_tcp_flange = np.linalg.inv(gripper.T_flange_tcp(width))
    minus, plus = (moved(T_tcp_flange, pads[f"right_pad_{finger}"]) for finger in (0, 1))
    assert minus[:, 1].max() == pytest.approx(-width / 2, abs=1e-12)
    assert plus[:, 1].min() == pytest.approx(width / 2, abs=1e-12)
    np.testing.assert_allclose(minus.mean(axis=0) + plus.mean(axis=0), 0.0, atol=1e-12)
    for pad in (minus, plus):
        np.testing.assert_allclose(np.ptp(pad, axis=0), [0.022, 0.00635, 0.0375], atol=1e-12)


@pytest.mark.parametrize("width", [0.0, 0.05, 0.14])
def test_jaws_slide_as_far_as_they_open_and_nothing_else_of_them_moves(jaws, width):
    closed, open_ = (vertices_by_name(jaws.bodies("right", at)) for at in (0.0, width))
    for finger, side in ((0, -1.0), (1, 1.0)):
        for part in ("pad", "carriage", "blade"):
            name = f"right_pad_{finger}" if part == "pad" else f"right_finger_{finger}_{part}"
            np.testing.assert_allclose(open_[name] - closed[name], [[0.0, side * width / 2, 0.0]] * 8, atol=1e-12)
            assert (side * closed[name][:, 1]).min() >= -1e-12, "closed fingers do not overlap"
    for name in ("right_gripper_base", "right_ft300"):
        np.testing.assert_array_equal(open_[name], closed[name])
    pads = np.concatenate([open_[f"right_pad_{finger}"] for finger in (0, 1)])
    np.testing.assert_allclose(jaws.T_flange_tcp(width)[:3, 3], pads.mean(axis=0), atol=1e-12)


@pytest.mark.parametrize("q", [0.02, 0.2, 0.5, 0.8])
def test_opening_and_height_of_the_pads_are_the_published_formulas(gripper, q):
    """Rounded as printed: 0.0054057 + 0.0376 cos q - 0.043 sin q, 0.087324 + 0.0376 sin q + 0.043 cos q."""
    width = 2 * (0.0054057 + 0.0376 * math.cos(q) - 0.043 * math.sin(q))
    height = 0.087324 + 0.0376 * math.sin(q) + 0.043 * math.cos(q)
    assert gripper.fingers.angle(width) == pytest.approx(q, abs=1e-5)
    assert gripper.T_flange_tcp(width)[2, 3] == pytest.approx(0.0484 + height, abs=1e-6)


def test_the_tcp_has_the_axes_of_the_flange(gripper, pusher):
    np.testing.assert_array_equal(gripper.T_flange_tcp(0.04)[:3, :3], np.eye(3))
    np.testing.assert_array_equal(pusher.T_flange_tcp[:3, :3], np.eye(3))


@pytest.mark.parametrize("width", WIDTHS)
def test_every_part_is_where_the_published_urdf_puts_its_mesh(gripper, width):
    """The URDF's base is turned by 1.57 instead of a right angle, so its frame after that turn is the reference."""
    model = pin.buildModelFromXML(published_urdf(GRIPPER_URDF), mimic=True)
    data, origins = model.createData(), mesh_origins(GRIPPER_URDF)
    pin.framesForwardKinematics(model, data, np.array([gripper.fingers.angle(width)]))
    T_inertia_urdf = data.oMf[model.getFrameId("base_link_inertia")].inverse()
    T_flange_inertia = np.eye(4)
    T_flange_inertia[2, 3] = 0.0484
    directions = np.random.default_rng(0).normal(size=(3, 40))
    hulls = gripper_hulls(gripper, width)
    for finger, side in enumerate(("left", "right")):
        for part in ("outer_knuckle", "outer_finger", "inner_finger", "inner_knuckle"):
            link = f"{side}_{part}"
            T_inertia_link = (T_inertia_urdf * data.oMf[model.getFrameId(link)]).homogeneous
            T_flange_mesh = T_flange_inertia @ T_inertia_link @ origins[link]
            published = moved(T_flange_mesh, obj_vertices(MESHES.format(part), 0.001)) @ directions
            ours = hulls[f"finger_{finger}_{part}"] @ directions
            np.testing.assert_allclose(ours.max(axis=0), published.max(axis=0), atol=1e-8)
        pad = T_inertia_urdf * data.oMf[model.getFrameId(f"{side}_inner_finger_pad")]
        center = moved(T_flange_inertia, pad.translation[None])[0]
        np.testing.assert_allclose(hulls[f"pad_{finger}"].mean(axis=0), center, atol=1e-9)
    base = moved(T_flange_inertia, obj_vertices(MESHES.format("base_link"))) @ directions
    np.testing.assert_allclose((hulls["gripper_base"] @ directions).max(axis=0), base.max(axis=0), atol=1e-9)


@pytest.mark.parametrize("width", WIDTHS)
def test_parts_of_few_vertices_contain_their_hulls_and_not_much_more(gripper, width):
    bodies = vertices_by_name(gripper.bodies("right", width))
    hulls = gripper_hulls(gripper, width)
    assert set(bodies) == {f"right_{name}" for name in hulls} | {"right_ft300"}
    for name, hull in hulls.items():
        vertices = bodies[f"right_{name}"]
        assert len(vertices) <= 60
        assert outside(hull, of=vertices).max() < 1e-12
        assert outside(vertices, of=hull).max() < (1.5e-3 if name == "gripper_base" else 0.3e-3)


@pytest.mark.parametrize("width", WIDTHS)
def test_only_pads_reach_the_plane_of_what_is_held(gripper, width):
    """The other parts of a finger stay a millimetre behind the inner face of their pad, in all of its reach."""
    for body in gripper.bodies("right", width):
        vertices = body.shapes[0].vertices
        if "finger" in body.name:
            beside_pad = vertices[:, 2] > gripper.T_flange_tcp(width)[2, 3] - gripper.pad_size[2] / 2
            assert (np.abs(vertices[beside_pad, 1]) > width / 2 + 1e-3).all()


def test_the_tcp_table_is_right_to_a_hundredth_of_a_millimetre_between_its_rows(gripper):
    table = gripper.tcp_table
    assert (table[0, 0], table[-1, 0]) == (0.0, gripper.width_max)
    for width in np.linspace(0.0, gripper.width_max, 997):
        interpolated = np.interp(width, table[:, 0], table[:, 1])
        assert interpolated == pytest.approx(gripper.T_flange_tcp(width)[2, 3], abs=1e-5)
    assert table[:, 1].max() - table[:, 1].min() == pytest.approx(0.014, abs=0.5e-3)


@pytest.mark.parametrize("width", [-1e-6, 0.0851, math.nan])
def test_an_opening_the_gripper_does_not_have_is_refused(gripper, width):
    with pytest.raises(WidthError, match="robotiq_2f85_ft300 cannot open"):
        gripper.bodies("right", width)


@pytest.mark.parametrize("hand", ["gripper", "pusher"])
def test_the_sensor_is_a_cylinder_around_the_published_one(request, hand):
    sensor = request.getfixturevalue(hand).sensor.vertices
    assert (sensor[:, 2].min(), sensor[:, 2].max()) == pytest.approx((0.0, 0.0484), abs=1e-12)
    angles = np.linspace(0.0, 2 * math.pi, 720)
    circle = 0.0375 * np.column_stack([np.cos(angles), np.sin(angles), np.full(720, 0.02 / 0.0375)])
    assert outside(circle, of=sensor).max() < 1e-12
    assert np.linalg.norm(sensor[:, :2], axis=1).max() < 0.0375 * 1.01


def test_the_pole_of_the_tip_is_the_published_distance_from_the_flange(pusher):
    assert pusher.T_flange_tcp[2, 3] + pusher.tip_radius == pytest.approx(0.3044)
    np.testing.assert_allclose(pusher.tip.vertices[:, 2].max(), pusher.T_flange_tcp[2, 3])
    assert pusher.tip.radius == pusher.tip_radius


def test_tip_and_stick_leave_nothing_of_the_stick_uncovered(pusher):
    np.testing.assert_array_equal(pusher.tip.vertices[0], pusher.stick.vertices[1])
    assert pusher.stick.vertices[0, 2] <= pusher.sensor.vertices[:, 2].max()


@pytest.mark.parametrize("tilt", np.radians([0.0, 30.0, 60.0, 70.0]))
def test_a_plane_that_the_tip_touches_is_clear_of_the_rest_of_the_hand(pusher, tilt):
    normal = rotation_x(tilt) @ [0.0, 0.0, 1.0]
    contact = pusher.T_flange_tcp[:3, 3] + pusher.tip_radius * normal

    def gap(shape):
        return float((normal @ contact - shape.vertices @ normal).min() - shape.radius)

    assert gap(pusher.tip) == pytest.approx(0.0, abs=1e-12)
    assert gap(pusher.stick) > 3e-3
    assert gap(pusher.sensor) > 3e-3
