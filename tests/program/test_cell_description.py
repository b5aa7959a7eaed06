"""The URDF and SRDF of cells, as pinocchio reads them, against the cells."""

from __future__ import annotations

import itertools
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from planners.cell.cell import Cell, known_cells, load_cell
from planners.cell.hand import Gripper
from planners.geometry.convex import sorted_pair
from planners.geometry.pose import Array, Transform
from planners.kinematics.forward import link_frames
from planners.kinematics.joint_torque import joint_torques
from planners.plan.scenery import ARMS
from planners.program.cell_description import WORLD, CellDescription, roll_pitch_yaw
from tests.support.samples import sample

CELLS = known_cells()
VECTORS = sample(100, 1000)
DIRECTIONS = Rotation.random(20, rng=np.random.default_rng(6)).as_matrix()[:, 0]
"""Unit vectors."""


class Oracle:
    """A URDF in pinocchio, with joints by their names, those that mimic others included."""

    def __init__(self, description: CellDescription) -> None:
        self.model = pin.buildModelFromXML(description.urdf, mimic=True)
        self.data = self.model.createData()

    def place(self, positions: dict[str, float]) -> Array:
        q = pin.neutral(self.model)
        for name, value in positions.items():
            q[self.model.joints[self.model.getJointId(name)].idx_q] = value
        pin.framesForwardKinematics(self.model, self.data, q)
        return q

    def frame(self, name: str) -> Transform:
        return self.data.oMf[self.model.getFrameId(name)].homogeneous


@cache
def described(name: str) -> CellDescription:
    return CellDescription(load_cell(name), "liftwright_cell")


def drawn(cell: Cell, seed: int, count: int) -> list[dict[str, Array]]:
    rng = np.random.default_rng(seed)
    return [
        {name: rng.uniform(arm.position_min, arm.position_max) for name, arm in cell.arms.items()} for _ in range(count)
    ]


def by_name(cell: Cell, q: dict[str, Array]) -> dict[str, float]:
    return {
        joint: value
        for name, arm in cell.arms.items()
        for joint, value in zip(arm.joint_names, q[name].tolist(), strict=True)
    }


def frames_of(cell: Cell, q: dict[str, Array]) -> dict[str, Transform]:
    """Return `T_world_frame` of every frame of the collision model, by its name there."""
    frames = {"world": np.eye(4)}
    for name, arm in cell.arms.items():
        out = np.empty((7, 4, 4))
        link_frames(arm.dh, arm.T_world_base, q[name], out)
        frames |= {f"{name}/{i}": out[i] for i in range(7)}
    return frames


@pytest.mark.parametrize("name", CELLS)
def test_the_flanges_are_where_the_tables_have_them(name: str) -> None:
    cell, oracle = load_cell(name), Oracle(described(name))
    for q in drawn(cell, 0, VECTORS):
        oracle.place(by_name(cell, q))
        frames = frames_of(cell, q)
        for arm in ARMS:
            np.testing.assert_allclose(oracle.frame(f"{arm}_base"), frames[f"{arm}/0"], atol=1e-9)
            np.testing.assert_allclose(oracle.frame(f"{arm}_flange"), frames[f"{arm}/6"], atol=1e-9)


@pytest.mark.parametrize("name", CELLS)
def test_the_tcp_is_that_of_the_hand_at_every_opening(name: str) -> None:
    cell, description = load_cell(name), described(name)
    oracle, rng = Oracle(description), np.random.default_rng(1)
    for q in drawn(cell, 1, 20):
        positions, tcps = by_name(cell, q), {}
        for arm in ARMS:
            hand = cell.arms[arm].hand
            if isinstance(hand, Gripper):
                width = float(rng.uniform(0.0, hand.width_max))
                joint = description.finger_joints[arm]
                positions[joint.name] = joint.position(width)
                assert joint.limits[0] <= positions[joint.name] <= joint.limits[1]
                tcps[arm] = hand.T_flange_tcp(width)
            else:
                tcps[arm] = hand.T_flange_tcp
        oracle.place(positions)
        for arm, T_flange_tcp in tcps.items():
            expected = frames_of(cell, q)[f"{arm}/6"] @ T_flange_tcp
            np.testing.assert_allclose(oracle.frame(f"{arm}_tcp"), expected, atol=1e-9)


@pytest.mark.parametrize("name", CELLS)
def test_the_shapes_are_those_of_the_collision_model_wherever_joints_and_fingers_are(name: str, tmp_path: Path) -> None:
    cell, description = load_cell(name), described(name)
    folder = tmp_path / "liftwright_cell"
    for path, content in description.meshes.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    (folder / "cell.urdf").write_text(description.urdf)
    oracle, rng = Oracle(description), np.random.default_rng(2)
    shapes = pin.buildGeomFromUrdf(
        oracle.model, str(folder / "cell.urdf"), pin.GeometryType.COLLISION, package_dirs=[str(tmp_path)]
    )
    placed = shapes.createData()
    for q in drawn(cell, 2, 3):
        widths = {arm: float(rng.uniform(0.0, cell.gripper(arm).width_max)) for arm in cell.gripper_arms}
        fingers = {each.name: each.position(widths[arm]) for arm, each in description.finger_joints.items()}
        at = oracle.place({**by_name(cell, q), **fingers})
        pin.updateGeometryPlacements(oracle.model, oracle.data, shapes, placed, at)
        # A link's geometries are told apart by a number behind its name.
        found: dict[str, list[tuple[Transform, pin.GeometryObject]]] = {}
        for geometry, T in zip(shapes.geometryObjects, placed.oMg, strict=True):
            found.setdefault(geometry.name.rpartition("_")[0], []).append((T.homogeneous, geometry))
        frames, bodies = frames_of(cell, q), cell.collision_bodies(widths)
        assert set(found) == {body.name for body in bodies}
        for body in bodies:
            T = frames[body.frame]
            farthest = [
                ((shape.vertices @ T[:3, :3].T + T[:3, 3]) @ DIRECTIONS.T).max(axis=0) + shape.radius
                for shape in body.shapes
            ]
            theirs = [_reach(T, geometry) for T, geometry in found[body.name]]
            # The numbers of an STL have single precision.
            np.testing.assert_allclose(np.max(theirs, axis=0), np.max(farthest, axis=0), atol=2e-6, err_msg=body.name)


def _reach(T: Transform, geometry: pin.GeometryObject) -> Array:
    """Return how far a geometry reaches along each of `DIRECTIONS`, from the world's origin."""
    local, offset = DIRECTIONS @ T[:3, :3], DIRECTIONS @ T[:3, 3]
    shape = geometry.geometry
    match type(shape).__name__:
        case "Box":
            return offset + np.abs(local) @ shape.halfSide
        case "Sphere":
            return offset + shape.radius
        case "Cylinder":
            return offset + shape.radius * np.hypot(*local[:, :2].T) + shape.halfLength * np.abs(local[:, 2])
        case _:
            return offset + (local @ _vertices(geometry.meshPath).T).max(axis=1)


@cache
def _vertices(path: str) -> Array:
    return np.asarray(trimesh.load_mesh(path).vertices)


@pytest.mark.parametrize("name", CELLS)
def test_the_joints_bear_what_they_bear_in_the_cell(name: str) -> None:
    cell, description = load_cell(name), described(name)
    oracle = Oracle(description)
    oracle.model.gravity.linear = cell.gravity
    for q in drawn(cell, 4, 10):
        at = oracle.place(by_name(cell, q))
        torques = pin.computeGeneralizedGravity(oracle.model, oracle.data, at)
        for arm in ARMS:
            mine = [torques[oracle.model.joints[oracle.model.getJointId(j)].idx_v] for j in cell.arms[arm].joint_names]
            rows, still = q[arm][None], np.zeros((1, 6))
            expected = joint_torques(
                cell.arms[arm].weighed(cell.gravity), rows, still, still, np.zeros((1, 6)), np.zeros((1, 3))
            )[0]
            np.testing.assert_allclose(mine, expected, atol=1e-9)


@pytest.mark.parametrize("name", CELLS)
def test_limits_and_home_are_those_of_the_cell(name: str) -> None:
    cell, description = load_cell(name), described(name)
    model = Oracle(description).model
    states = ElementTree.fromstring(description.srdf).findall("group_state")
    homes = {
        joint.get("name"): float(joint.get("value", "nan"))
        for state in states
        if (state.get("group"), state.get("name")) == ("both", "home")
        for joint in state.findall("joint")
    }
    assert list(homes) == list(cell.joint_names)
    np.testing.assert_array_equal(list(homes.values()), cell.home)
    for arm in cell.arms.values():
        for i, joint in enumerate(arm.joint_names):
            its = model.joints[model.getJointId(joint)]
            assert model.lowerPositionLimit[its.idx_q] == arm.position_min[i]
            assert model.upperPositionLimit[its.idx_q] == arm.position_max[i]
            assert model.upperVelocityLimit[its.idx_v] == arm.velocity_max[i]
            assert model.upperEffortLimit[its.idx_v] == arm.torque_max[i]


@pytest.mark.parametrize("name", CELLS)
def test_two_links_are_never_checked_if_the_collision_model_never_checks_them(name: str) -> None:
    cell, srdf = load_cell(name), ElementTree.fromstring(described(name).srdf)
    named = [each.attrib for each in srdf.findall("disable_collisions")]
    disabled = {sorted_pair(each["link1"], each["link2"]) for each in named}
    assert len(disabled) == len(named)
    for a, b in itertools.combinations(cell.collision_bodies(), 2):
        assert (sorted_pair(a.name, b.name) in disabled) == (
            a.frame == b.frame or sorted_pair(a.name, b.name) in cell.excluded_pairs
        )


@pytest.mark.parametrize("name", CELLS)
def test_groups_and_hands_name_links_and_joints_that_there_are(name: str) -> None:
    description = described(name)
    srdf, urdf = ElementTree.fromstring(description.srdf), ElementTree.fromstring(description.urdf)
    links = {each.get("name") for each in urdf.findall("link")}
    joints = {each.get("name") for each in urdf.findall("joint")}
    groups = {each.get("name"): each for each in srdf.findall("group")}
    assert links == set(description.links)
    assert set(groups) == {"left", "right", "both", "left_hand", "right_hand"}
    assert {each.get("name") for each in groups["both"]} == {"left", "right"}
    for arm in ARMS:
        (chain,) = groups[arm]
        assert {chain.get("base_link"), chain.get("tip_link")} == {f"{arm}_base", f"{arm}_flange"} <= links
        hand = {each.get("name") for each in groups[f"{arm}_hand"]}
        assert hand <= links
        assert {*description.hand_links(arm), f"{arm}_tcp"} <= hand
    for end in srdf.findall("end_effector"):
        assert {end.get("group"), end.get("parent_group")} <= set(groups)
        assert end.get("parent_link") in links
    assert {joint.get("name") for joint in srdf.iter("joint")} <= joints
    # Everything hangs on the world, once.
    children = [each.get("link") for each in urdf.iter("child")]
    assert len(children) == len(set(children))
    assert set(children) == links - {WORLD}


def test_any_rotation_is_made_of_its_angles_near_a_right_pitch_too() -> None:
    rng = np.random.default_rng(5)
    pitches = [0.5 * np.pi + sign * 10.0**-digits for digits in range(1, 18) for sign in (-1, 1)]
    turns = [*Rotation.random(200, rng=rng).as_matrix()]
    turns += [Rotation.from_euler("xyz", [rng.uniform(-3, 3), p, rng.uniform(-3, 3)]).as_matrix() for p in pitches]
    turns += [
        np.array(rows, dtype=float) for rows in ([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], [[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    ]
    for R in turns:
        roll, pitch, yaw = roll_pitch_yaw(R)
        np.testing.assert_allclose(pin.rpy.rpyToMatrix(roll, pitch, yaw), R, atol=1e-12)
