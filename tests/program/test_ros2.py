"""Programs for ROS 2: bags as `rosbags` reads them, by the definitions that are in them, against the plan."""

from __future__ import annotations

import io
import itertools
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from rosbags.highlevel import AnyReader
from scipy.interpolate import BPoly, CubicHermiteSpline

from planners.cell.cell import Cell, load_cell
from planners.geometry.convex import CollisionBody, ConvexShape, box, cylinder, prism
from planners.geometry.pose import Array, Transform, from_pose7, inverse, rotation_angle
from planners.kinematics.forward import link_frames
from planners.plan.plan import Plan
from planners.plan.scenery import ARMS
from planners.planning import certificate_of
from planners.program import NotExportable, ProgramTarget, Schedule, write_program
from planners.program.ros2 import write_ros2
from tests.collision.coal_scene import coal_geometry

TASKS = ("ab1", "domino_pile")
LIFTED = {"table", "frame"}
"""Roles of bodies that the URDF has."""


@dataclass(frozen=True)
class Said:
    time: int
    topic: str
    message: Any


@dataclass(frozen=True, eq=False)
class Unpacked:
    """A program as an integrator has it."""

    plan: Plan
    folder: Path
    said: list[Said]
    types: dict[str, str]
    model: pin.Model = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "model", pin.buildModelFromUrdf(str(self.folder / "cell.urdf"), mimic=True))

    def of(self, topic: str) -> list[Said]:
        return [each for each in self.said if each.topic == topic]

    @property
    def trajectories(self) -> dict[str, Any]:
        return json.loads((self.folder / "trajectories.json").read_text())

    @property
    def steps(self) -> list[dict[str, Any]]:
        return self.trajectories["steps"]

    def frame(self, name: str, joints: Mapping[str, float]) -> Transform:
        """Return `T_world_frame` as the URDF has it."""
        q, data = pin.neutral(self.model), self.model.createData()
        for joint, value in joints.items():
            q[self.model.joints[self.model.getJointId(joint)].idx_q] = value
        pin.framesForwardKinematics(self.model, data, q)
        return data.oMf[self.model.getFrameId(name)].homogeneous


@pytest.fixture(scope="module")
def unpacked(
    documents: dict[str, bytes], plans: dict[str, Plan], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Unpacked]:
    found = {}
    for name in TASKS:
        folder = tmp_path_factory.mktemp(name)
        packed = write_program(documents[name], load_cell(plans[name].cell.name), ProgramTarget.ROS2)
        with zipfile.ZipFile(io.BytesIO(packed)) as archive:
            archive.extractall(folder)
        # Of no store: types are those that the bag itself defines.
        with AnyReader([folder]) as reader:
            said = [
                Said(time, connection.topic, reader.deserialize(raw, connection.msgtype))
                for connection, time, raw in reader.messages()
            ]
            types = {connection.topic: connection.msgtype for connection in reader.connections}
            assert len(said) == reader.message_count
        found[name] = Unpacked(plans[name], folder, said, types)
    return found


def nanoseconds(time: Any) -> int:
    return time.sec * 1_000_000_000 + time.nanosec


def row(pose: Any) -> Array:
    """Return a pose or transform as `[x, y, z, w, x, y, z]`."""
    position = getattr(pose, "position", None) or pose.translation
    turn = getattr(pose, "orientation", None) or pose.rotation
    return np.array([position.x, position.y, position.z, turn.w, turn.x, turn.y, turn.z])


def assert_same_pose(pose: Array, expected: Array, atol: float) -> None:
    """Compare poses whose quaternions may be of either sign."""
    turn = pose[3:] * np.sign(pose[3:] @ expected[3:])
    np.testing.assert_allclose(np.append(pose[:3], turn), expected, atol=atol)


def trajectories(program: Unpacked) -> list[dict[str, Array]]:
    """Return by segment what both arms' trajectories say, as a plan has it; time in ns."""
    segments = []
    both = zip(*(program.of(f"/liftwright/{arm}/joint_trajectory") for arm in ARMS), strict=True)
    for left, right in both:
        assert left.message.joint_names + right.message.joint_names == program.plan.joint_names
        times = []
        for each in (left, right):
            begin = nanoseconds(each.message.header.stamp)
            assert begin == each.time
            times.append([begin + nanoseconds(point.time_from_start) for point in each.message.points])
        assert times[0] == times[1]
        told = {"time": np.array(times[0])}
        for name in ("positions", "velocities", "accelerations"):
            told[name] = np.hstack([[getattr(p, name) for p in each.message.points] for each in (left, right)])
        segments.append(told)
    return segments


@pytest.mark.parametrize("name", TASKS)
def test_all_files_are_there_and_the_topics_have_types_that_ros_knows(unpacked: dict[str, Unpacked], name: str) -> None:
    program = unpacked[name]
    files = {path.name for path in program.folder.iterdir()}
    assert files == {
        *("plan.mcap", "metadata.yaml", "trajectories.json", "cell.urdf", "cell.srdf", "joint_limits.yaml"),
        *("package.xml", "CMakeLists.txt", "README.txt", "plan.json", "meshes"),
    }
    readme = (program.folder / "README.txt").read_text()
    for topic, kind in program.types.items():
        package, _, message = kind.split("/")
        if program.of(topic):
            assert topic in readme
            assert f"{package}/{message}" in readme
    # What turns up in the URDF is in the package that it names.
    urdf = (program.folder / "cell.urdf").read_text()
    meshes = {path.name for path in (program.folder / "meshes").iterdir()}
    assert {each.split('"')[0] for each in urdf.split("/meshes/")[1:]} == meshes


@pytest.mark.parametrize("name", TASKS)
def test_trajectories_give_every_number_of_the_plan_again(unpacked: dict[str, Unpacked], name: str) -> None:
    program = unpacked[name]
    told = trajectories(program)
    for segment, mine, step in zip(program.plan.segments, told, program.steps, strict=True):
        np.testing.assert_allclose(mine["time"], 1e9 * segment.time, atol=0.51)
        joints = step["robot_trajectory"]["joint_trajectory"]
        assert joints["joint_names"] == program.plan.joint_names
        begin = joints["header"]["stamp"]
        for member in ("positions", "velocities", "accelerations"):
            np.testing.assert_array_equal(mine[member], getattr(segment, member))
            np.testing.assert_array_equal([point[member] for point in joints["points"]], getattr(segment, member))
        times = [
            1_000_000_000 * (begin["sec"] + after["sec"]) + begin["nanosec"] + after["nanosec"]
            for after in (point["time_from_start"] for point in joints["points"])
        ]
        assert times == mine["time"].tolist()


@pytest.mark.parametrize("name", TASKS)
def test_a_plan_rebuilt_from_the_bag_is_certified_as_the_plan_is(
    unpacked: dict[str, Unpacked], documents: dict[str, bytes], name: str
) -> None:
    program, document = unpacked[name], json.loads(documents[name])
    frames: dict[tuple[str, int], Array] = {
        (each.child_frame_id, nanoseconds(each.header.stamp)): row(each.transform)
        for said in program.of("/tf")
        for each in said.message.transforms
    }
    for segment, told in zip(document["segments"], trajectories(program), strict=True):
        for member in ("positions", "velocities", "accelerations"):
            segment[member] = told[member].tolist()
        segment["time"] = (1e-9 * told["time"]).tolist()
        for body in segment["body_poses"]:
            segment["body_poses"][body] = [frames[body, time].tolist() for time in told["time"].tolist()]
    cell = load_cell(program.plan.cell.name)
    rebuilt = certificate_of(json.dumps(document).encode(), cell)
    planned = program.plan.certificate
    assert rebuilt is not None
    assert planned is not None
    assert rebuilt.passed
    assert [each.name for each in rebuilt.checks] == [each.name for each in planned.checks]
    # Stamps are whole nanoseconds. A step that is one longer bends a cubic 6 v / h^2 times as much otherwise.
    bent = max(6e-9 * np.abs(each.velocities).max() / np.diff(each.time).min() ** 2 for each in program.plan.segments)
    for mine, its in zip(rebuilt.checks, planned.checks, strict=True):
        off = bent if mine.name == "joint_accelerations" else 1e-6
        margin = None if its.margin is None else pytest.approx(its.margin, rel=1e-5, abs=off)
        assert mine.margin == margin, mine.name


@pytest.mark.parametrize("name", TASKS)
def test_everything_that_is_shown_is_where_the_plan_has_it_at_every_sample(
    unpacked: dict[str, Unpacked], name: str
) -> None:
    program = unpacked[name]
    shown = {body for body, described in program.plan.bodies.items() if described.role not in LIFTED}
    fixed = {
        each.child_frame_id: row(each.transform) for s in program.of("/tf_static") for each in s.message.transforms
    }
    loose: dict[str, Array] = {}
    joints: dict[str, float] = {}
    seen = 0
    for time, group in itertools.groupby(program.said, key=lambda said: said.time):
        for said in group:
            if said.topic == "/tf":
                for each in said.message.transforms:
                    assert (each.header.frame_id, nanoseconds(each.header.stamp)) == ("world", time)
                    assert each.child_frame_id not in fixed
                    loose[each.child_frame_id] = row(each.transform)
            elif said.topic == "/joint_states":
                assert nanoseconds(said.message.header.stamp) == time
                assert len(said.message.velocity) in (0, len(said.message.name))
                joints |= zip(said.message.name, said.message.position.tolist(), strict=True)
        moment = program.plan.at(1e-9 * time)
        assert {*fixed, *loose} == shown
        for body, at in {**fixed, **loose}.items():
            # Half a nanosecond on the way at 0.5 m/s.
            assert_same_pose(at, moment.body_poses[body], atol=2e-9)
        np.testing.assert_allclose([joints[j] for j in program.plan.joint_names], moment.positions, atol=2e-9)
        for arm, width in moment.widths.items():
            if seen % 20 == 0:
                pads = [program.frame(f"{arm}_pad_{finger}", joints) for finger in (0, 1)]
                thickness = load_cell(program.plan.cell.name).gripper(arm).pad_size[1]
                apart = np.linalg.norm(pads[1][:3, 3] - pads[0][:3, 3]) - thickness
                assert apart == pytest.approx(width, abs=1e-8)
        seen += 1
    assert seen == sum(len(segment.time) - 1 for segment in program.plan.segments) + 1


@pytest.mark.parametrize("name", TASKS)
def test_every_shape_is_shown_in_the_frame_of_its_body(unpacked: dict[str, Unpacked], name: str) -> None:
    program = unpacked[name]
    (said,) = program.of("/liftwright/bodies")
    markers = {each.header.frame_id: each for each in said.message.markers}
    assert set(markers) == {body for body, each in program.plan.bodies.items() if each.role not in LIFTED}
    assert len({(each.ns, each.id) for each in markers.values()}) == len(markers)
    (first, *_) = program.of("/planning_scene")
    solids = {each.id: each for each in first.message.world.collision_objects}
    solids |= {each.object.id: each.object for each in first.message.robot_state.attached_collision_objects}
    assert set(solids) == set(markers)
    for body, marker in markers.items():
        shape, scale = program.plan.bodies[body].shape, marker.scale
        assert row(marker.pose).tolist() == [0, 0, 0, 1, 0, 0, 0]
        sizes = (scale.x, scale.y, scale.z)
        if shape.type == "box":
            assert (marker.type, sizes) == (1, shape.size)
            assert solids[body].primitives[0].dimensions.tolist() == list(shape.size)
        elif shape.type == "cylinder":
            assert (marker.type, sizes) == (3, (2 * shape.radius, 2 * shape.radius, shape.height))
            assert solids[body].primitives[0].dimensions.tolist() == [shape.height, shape.radius]
        else:
            assert (marker.type, sizes) == (11, (1.0, 1.0, 1.0))
            drawn = {(p.x, p.y, p.z) for p in marker.points}
            assert {(p.x, p.y, p.z) for p in solids[body].meshes[0].vertices} == drawn


@pytest.mark.parametrize("name", TASKS)
def test_the_planning_scene_has_bodies_on_the_flanges_that_carry_them_and_elsewhere_where_they_lie(
    unpacked: dict[str, Unpacked], name: str
) -> None:
    """Differences are applied as MoveIt does it: what is let go stays where it is, then what is said of it counts."""
    program = unpacked[name]
    scenes = program.of("/planning_scene")
    placed: dict[str, Array] = {}
    attached: dict[str, tuple[str, Array]] = {}
    carried = 0
    for segment in program.plan.segments:
        begin = round(1e9 * float(segment.time[0]))
        while scenes and scenes[0].time <= begin:
            scene = scenes.pop(0).message
            assert scene.is_diff
            assert scene.robot_state.is_diff
            for each in scene.robot_state.attached_collision_objects:
                if each.object.operation == 0:
                    assert each.object.header.frame_id == each.link_name
                    placed.pop(each.object.id, None)
                    attached[each.object.id] = (each.link_name, row(each.object.pose))
                else:
                    del attached[each.object.id]
                    placed[each.object.id] = np.full(7, np.nan)
            for each in scene.world.collision_objects:
                assert each.header.frame_id == "world"
                assert (each.id in placed) == (each.operation == 3)
                placed[each.id] = row(each.pose)
        moment = program.plan.at(float(segment.time[0]))
        joints = dict(zip(program.plan.joint_names, segment.positions[0].tolist(), strict=True))
        for body, pose in placed.items():
            assert_same_pose(pose, moment.body_poses[body], atol=1e-8)
        for body, (link, pose) in attached.items():
            off = inverse(from_pose7(moment.body_poses[body])) @ program.frame(link, joints) @ from_pose7(pose)
            assert np.linalg.norm(off[:3, 3]) < 2e-4
            assert rotation_angle(np.eye(3), off[:3, :3]) < np.radians(0.05)
        riding = {body for body, _ in segment.rides}
        on_arms = {body for body, ride in segment.rides if ride.to in ARMS}
        while more := {body for body, ride in segment.rides if ride.to in on_arms} - on_arms:
            on_arms |= more
        assert set(attached) == on_arms <= riding
        carried += len(attached)
    assert carried


@pytest.mark.parametrize("name", TASKS)
def test_fingers_and_vacuum_are_commanded_as_each_step_begins(unpacked: dict[str, Unpacked], name: str) -> None:
    program = unpacked[name]
    cell, told = load_cell(program.plan.cell.name), 0
    for step, its in zip(Schedule.of(program.plan).steps, program.steps, strict=True):
        begin = round(1e9 * step.begin)
        assert its["words"] == step.words
        assert f"{step.number}: {step.words}" in {
            s.message.data for s in program.of("/liftwright/step") if s.time == begin
        }
        for arm in ARMS:
            mine, data = step.arms[arm], its[arm]
            assert data["payload"] == {"mass": mine.load.mass, "com": list(mine.load.com)}
            assert (data["width"], data["squeeze"], data["vacuum"]) == (mine.width, mine.squeeze, mine.vacuum)
            vacuum = [s.message.data for s in program.of(f"/liftwright/{arm}/vacuum") if s.time == begin]
            assert vacuum == ([] if mine.vacuum is None else [mine.vacuum])
            grips = [s.message for s in program.of(f"/liftwright/{arm}/gripper") if s.time == begin]
            begins = step.number == 1 and mine.width is None
            opens = program.trajectories["openings"].get(arm) if begins else None
            assert len(grips) == (mine.width is not None or opens is not None)
            for grip in grips:
                pads = [program.frame(f"{arm}_pad_{f}", {f"{arm}_finger": grip.position}) for f in (0, 1)]
                apart = np.linalg.norm(pads[1][:3, 3] - pads[0][:3, 3]) - cell.gripper(arm).pad_size[1]
                wanted = mine.width if opens is None else opens["width"]
                assert apart == pytest.approx(wanted, abs=1e-9)
                assert grip.max_effort == (mine.squeeze or 0.0)
                assert grip.position == (data["finger_position"] if opens is None else opens["finger_position"])
                told += 1
    assert told == len(program.of("/liftwright/left/gripper")) + len(program.of("/liftwright/right/gripper")) > 0
    if name == "domino_pile":
        assert program.of("/liftwright/left/vacuum") + program.of("/liftwright/right/vacuum")


@pytest.mark.parametrize("name", TASKS)
def test_a_quintic_through_the_samples_is_as_near_as_the_page_says(unpacked: dict[str, Unpacked], name: str) -> None:
    program = unpacked[name]
    stated = float((program.folder / "README.txt").read_text().partition("within ")[2].split()[0])
    farthest = 0.0
    for segment in program.plan.segments:
        derivatives = np.stack([segment.positions, segment.velocities, segment.accelerations], axis=1)
        quintic = BPoly.from_derivatives(segment.time, derivatives)
        cubic = CubicHermiteSpline(segment.time, segment.positions, segment.velocities)
        # Between two samples they are farthest apart near the middle.
        middles = (segment.time[:-1, None] + np.diff(segment.time)[:, None] * np.linspace(0.3, 0.7, 9)).ravel()
        farthest = max(farthest, float(np.abs(quintic(middles) - cubic(middles)).max()))
    assert 0.4 * stated < farthest < 1.05 * stated


def test_the_same_plan_gives_the_same_bytes(unpacked: dict[str, Unpacked]) -> None:
    program = unpacked["ab1"]
    for name, content in write_ros2(program.plan, load_cell(program.plan.cell.name)).items():
        assert (program.folder / name).read_bytes() == (content.encode() if isinstance(content, str) else content)


def test_a_body_does_not_take_the_name_of_a_link(plans: dict[str, Plan]) -> None:
    plan = plans["ab1"]
    bodies = {**plan.bodies, "left_tcp": plan.bodies["cup"]}
    with pytest.raises(NotExportable, match="left_tcp would name a body and a link"):
        write_ros2(plan.model_copy(update={"bodies": bodies}), load_cell(plan.cell.name))


@dataclass(frozen=True, eq=False)
class Solid:
    """A convex part of a link or body, in coal."""

    name: str
    geometry: coal.CollisionGeometry
    T_world_geometry: Transform
    grown: float
    center: Array
    reach: float

    @classmethod
    def of(cls, name: str, shape: ConvexShape, T: Transform) -> Solid:
        geometry, T_shape_geometry, grown = known_geometry(shape)
        ball = shape.ball
        return cls(name, geometry, T @ T_shape_geometry, grown, T[:3, :3] @ ball[:3] + T[:3, 3], ball[3] + shape.radius)

    def gap(self, other: Solid) -> float:
        """Return the distance to another one, or less where they are far apart [m]."""
        apart = float(np.linalg.norm(self.center - other.center)) - self.reach - other.reach
        if apart > 0.0:
            return apart
        poses = [coal.Transform3s(T[:3, :3], T[:3, 3]) for T in (self.T_world_geometry, other.T_world_geometry)]
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        return (
            coal.distance(self.geometry, poses[0], other.geometry, poses[1], request, result) - self.grown - other.grown
        )


@cache
def known_geometry(shape: ConvexShape) -> tuple[coal.CollisionGeometry, Transform, float]:
    return coal_geometry(shape)


@cache
def links_of(cell: Cell, widths: tuple[tuple[str, float], ...]) -> tuple[CollisionBody, ...]:
    return cell.collision_bodies(dict(widths))


def convex_parts(shape: Any) -> list[ConvexShape]:
    if shape.type == "box":
        return [box(shape.size)]
    if shape.type == "cylinder":
        return [cylinder(shape.radius, shape.height)]
    if shape.type == "prism":
        return [prism(shape.outline, shape.height)]
    return [ConvexShape(part) for part in shape.convex_parts]


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.slow
def test_what_touches_in_a_step_may_do_so_in_its_planning_scene(unpacked: dict[str, Unpacked], name: str) -> None:
    """All that MoveIt checks: links against links and bodies, and bodies on a flange against everything."""
    program, allowed, attached, touched = unpacked[name], set[tuple[str, str]](), set[str](), 0
    plan, scenes = program.plan, program.of("/planning_scene")
    cell = load_cell(plan.cell.name)
    shapes = {body: convex_parts(d.shape) for body, d in plan.bodies.items() if d.role not in LIFTED}
    for segment in plan.segments:
        while scenes and scenes[0].time <= round(1e9 * float(segment.time[0])):
            scene = scenes.pop(0).message
            names = scene.allowed_collision_matrix.entry_names
            if names:
                enabled = np.array([entry.enabled for entry in scene.allowed_collision_matrix.entry_values])
                np.testing.assert_array_equal(enabled, enabled.T)
                allowed = {(names[i], names[j]) for i, j in zip(*np.nonzero(enabled), strict=True)}
            for each in scene.robot_state.attached_collision_objects:
                (attached.add if each.object.operation == 0 else attached.discard)(each.object.id)
        for sample in (0, len(segment.time) // 2, len(segment.time) - 1):
            frames = {"world": np.eye(4)}
            for i, (arm, described) in enumerate(cell.arms.items()):
                out = np.empty((7, 4, 4))
                q = np.ascontiguousarray(segment.positions[sample, 6 * i : 6 * i + 6])
                link_frames(described.dh, described.T_world_base, q, out)
                frames |= {f"{arm}/{k}": out[k] for k in range(7)}
            begun = plan.at(float(segment.time[0])).body_poses
            poses = {
                body: segment.body_poses[body][sample] if body in segment.body_poses else begun[body] for body in shapes
            }
            widths = {arm: float(rows[sample]) for arm, rows in segment.gripper_width.items()}
            links = [
                Solid.of(link.name, part, frames[link.frame])
                for link in links_of(cell, tuple(widths.items()))
                for part in link.shapes
            ]
            bodies = [Solid.of(body, part, from_pose7(poses[body])) for body, parts in shapes.items() for part in parts]
            held = [body for body in bodies if body.name in attached]
            for a, b in itertools.chain(
                itertools.combinations(links, 2), itertools.product(links, bodies), itertools.product(held, bodies)
            ):
                if a.name != b.name and a.gap(b) <= 0.0:
                    assert (a.name, b.name) in allowed, (a.name, b.name, segment.kind, sample)
                    touched += 1
    assert touched
