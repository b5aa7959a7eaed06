"""A plan as a bag of ROS 2: what its controllers are sent, and what RViz and MoveIt show of it, on the plan's clock."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

import planners.program.ros2_messages as ros
from planners.contract.shapes import Box, Cylinder, InlineMesh, Prism
from planners.geometry.convex import NamePair, prism, sorted_pair
from planners.geometry.pose import Array
from planners.geometry.surface import Hull, hull_with_faces
from planners.plan.contacts import InertiaEntry
from planners.plan.plan import Plan
from planners.plan.scenery import ARMS, BodyDocument
from planners.plan.segment import Segment
from planners.program.cell_description import WORLD, CellDescription
from planners.program.schedule import Schedule, carried_by

NAME = "plan"
"""Of the bag, and of the file with its messages."""
BAG_VERSION: Final = 8
"""Of its metadata: Humble reads it, and so do those that came later."""
STEP, BODIES = "/liftwright/step", "/liftwright/bodies"
JOINT_STATES, TF, TF_STATIC, PLANNING_SCENE = "/joint_states", "/tf", "/tf_static", "/planning_scene"
IN_THE_URDF = ("table", "frame")
"""Roles of bodies that the cell has, and its URDF with it."""
_COLOURS = {
    "plate": (0.36, 0.55, 0.78, 1.0),
    "object": (0.85, 0.6, 0.32, 1.0),
    "tool": (0.3, 0.6, 0.5, 1.0),
    "obstacle": (0.75, 0.4, 0.4, 1.0),
    "cable": (0.3, 0.3, 0.3, 0.4),
}
_GREY = (0.6, 0.6, 0.6, 1.0)


def trajectory_topic(arm: str) -> str:
    """Return the topic of one arm's trajectories."""
    return f"/liftwright/{arm}/joint_trajectory"


def gripper_topic(arm: str) -> str:
    """Return the topic of the commands of one arm's gripper."""
    return f"/liftwright/{arm}/gripper"


def vacuum_topic(arm: str) -> str:
    """Return the topic by which the vacuum of the tool in one arm's hand goes on and off."""
    return f"/liftwright/{arm}/vacuum"


TOPICS = {
    **{trajectory_topic(arm): "trajectory_msgs/msg/JointTrajectory" for arm in ARMS},
    **{gripper_topic(arm): "control_msgs/msg/GripperCommand" for arm in ARMS},
    **{vacuum_topic(arm): "std_msgs/msg/Bool" for arm in ARMS},
    STEP: "std_msgs/msg/String",
    TF_STATIC: "tf2_msgs/msg/TFMessage",
    BODIES: "visualization_msgs/msg/MarkerArray",
    PLANNING_SCENE: "moveit_msgs/msg/PlanningScene",
    TF: "tf2_msgs/msg/TFMessage",
    JOINT_STATES: "sensor_msgs/msg/JointState",
}
"""Types of all topics there are; of messages at one time, those of an earlier topic come first."""
LATCHED = (TF_STATIC, BODIES)


def write_bag(schedule: Schedule, description: CellDescription) -> dict[str, bytes]:
    """Return the files of a bag: `plan.mcap` and `metadata.yaml`."""
    store, order = ros.message_types(), {topic: i for i, topic in enumerate(TOPICS)}
    with TemporaryDirectory(prefix="liftwright-bag-") as folder:
        place = Path(folder) / NAME
        writer = Writer(place, version=BAG_VERSION, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            connections = {
                topic: writer.add_connection(
                    topic,
                    kind,
                    typestore=store,
                    offered_qos_profiles=[ros.LATCHED_QOS if topic in LATCHED else ros.QOS],
                )
                for topic, kind in TOPICS.items()
            }
            for time, topic, said in sorted(_Recorder(schedule, description).said(), key=lambda m: (m[0], order[m[1]])):
                writer.write(connections[topic], time, store.serialize_cdr(said, TOPICS[topic]))
        return {path.name: path.read_bytes() for path in sorted(place.iterdir())}


def segment_times(segment: Segment) -> list[int]:
    """Return the samples' times on the plan's clock, in whole nanoseconds."""
    return [ros.nanoseconds(time) for time in segment.time.tolist()]


@dataclass(frozen=True, eq=False)
class _Carried:
    """How a body is at the begin of a segment: on a flange, or in the world."""

    arm: str | None
    """Whose flange; None: the world."""
    pose: Array
    """(4, 4) on the flange, or (7,) in the world."""
    touched_by: tuple[str, ...]
    """Links of hands that may touch it, while it is on a flange."""

    def is_as(self, other: _Carried) -> bool:
        mine, theirs = (each.arm for each in (self, other))
        return mine == theirs and self.touched_by == other.touched_by and np.array_equal(self.pose, other.pose)


@dataclass(frozen=True, eq=False)
class _Recorder:
    schedule: Schedule
    description: CellDescription

    @property
    def plan(self) -> Plan:
        return self.schedule.plan

    def said(self) -> Iterator[tuple[int, str, Any]]:
        """Yield what is said, with time [ns] and topic, in no order."""
        yield from self._bodies()
        yield from self._commands()
        yield from self._joints()
        yield from self._frames()
        yield from self._scenes()

    @cached_property
    def _shown(self) -> dict[str, BodyDocument]:
        """Bodies that the URDF does not have."""
        return {name: body for name, body in self.plan.bodies.items() if body.role not in IN_THE_URDF}

    def _bodies(self) -> Iterator[tuple[int, str, Any]]:
        static = [ros.transform_of_row(0, name, body.pose, WORLD) for name, body in self._shown.items() if body.static]
        if static:
            yield 0, TF_STATIC, ros.message("tf2_msgs/TFMessage", transforms=static)
        markers = [_marker(i, name, body) for i, (name, body) in enumerate(self._shown.items())]
        yield 0, BODIES, ros.message("visualization_msgs/MarkerArray", markers=markers)

    def _commands(self) -> Iterator[tuple[int, str, Any]]:
        for step, segment in zip(self.schedule.steps, self.plan.segments, strict=True):
            times = segment_times(segment)
            yield times[0], STEP, ros.message("std_msgs/String", data=f"{step.number}: {step.words}")
            for i, arm in enumerate(ARMS):
                mine = slice(6 * i, 6 * i + 6)
                rows = (each[:, mine] for each in (segment.positions, segment.velocities, segment.accelerations))
                yield times[0], trajectory_topic(arm), ros.joint_trajectory(self.plan.joint_names[mine], times, *rows)
                does = step.arms[arm]
                width = self.schedule.openings.get(arm) if step is self.schedule.steps[0] else None
                width = width if does.width is None else does.width
                if width is not None:
                    position = self.description.finger_joints[arm].position(width)
                    command = ros.message(
                        "control_msgs/GripperCommand", position=position, max_effort=does.squeeze or 0.0
                    )
                    yield times[0], gripper_topic(arm), command
                if does.vacuum is not None:
                    yield times[0], vacuum_topic(arm), ros.message("std_msgs/Bool", data=does.vacuum)

    def _joints(self) -> Iterator[tuple[int, str, Any]]:
        fingers = self.description.finger_joints
        for index, segment in enumerate(self.plan.segments):
            for i, time in enumerate(segment_times(segment)):
                if i == 0 and index > 0:
                    continue
                joints = dict(zip(self.plan.joint_names, segment.positions[i].tolist(), strict=True))
                yield time, JOINT_STATES, ros.joint_state(time, joints, segment.velocities[i])
                # Fingers have no velocities in a plan, and a message has one for each joint or for none.
                if fingers:
                    widths = {
                        joint.name: joint.position(float(segment.gripper_width[arm][i]))
                        for arm, joint in fingers.items()
                    }
                    yield time, JOINT_STATES, ros.joint_state(time, widths)

    def _frames(self) -> Iterator[tuple[int, str, Any]]:
        """Yield where bodies are that are not static: those that move at every sample, the others once a segment."""
        moved: Sequence[str] = ()
        for segment in self.plan.segments:
            begun = self.plan.at(float(segment.time[0])).body_poses
            for i, time in enumerate(segment_times(segment)):
                poses = {name: rows[i] for name, rows in segment.body_poses.items()}
                if i == 0:
                    # Those that moved up to here were told of at this very time.
                    loose = (name for name, body in self._shown.items() if not body.static and name not in moved)
                    poses = {name: poses.get(name, begun[name]) for name in loose}
                if poses:
                    frames = [ros.transform_of_row(time, name, row, WORLD) for name, row in poses.items()]
                    yield time, TF, ros.message("tf2_msgs/TFMessage", transforms=frames)
            moved = [*segment.body_poses]

    def _scenes(self) -> Iterator[tuple[int, str, Any]]:
        """Yield what changes of the planning scene: all of it at the begin, then what is attached, let go or moved."""
        before: dict[str, _Carried] = {}
        allowed_before: frozenset[NamePair] = frozenset()
        for index, segment in enumerate(self.plan.segments):
            now, times, allowed = self._carrying(segment), segment_times(segment), self._allowed(index)
            changed = {name: how for name, how in now.items() if name not in before or not how.is_as(before[name])}
            if changed or allowed != allowed_before:
                scene = self._scene(times[0], changed, before)
                if allowed != allowed_before:
                    scene.allowed_collision_matrix = self._matrix(allowed)
                yield times[0], PLANNING_SCENE, scene
            for i, time in enumerate(times[1:], start=1):
                loose = {
                    name: _Carried(None, rows[i], ())
                    for name, rows in segment.body_poses.items()
                    if now[name].arm is None
                }
                if loose:
                    yield time, PLANNING_SCENE, self._scene(time, loose, now)
                    now |= loose
            before, allowed_before = now, allowed

    def _allowed(self, index: int) -> frozenset[NamePair]:
        """Return which links and bodies may touch in a segment: those that the cell never checks, and what bears what.

        What rests is not checked against what never moves. At the ends of a segment it is as its neighbours have it.
        """
        pairs = {*self.description.cell.excluded_pairs}
        cables = [name for name, body in self._shown.items() if body.role == "cable"]
        # The lifter's cable is in the way of arms only.
        pairs |= {sorted_pair(cable, name) for cable in cables for name in self._shown if name != cable}
        for segment in self.plan.segments[max(index - 1, 0) : index + 2]:
            held = [(grip.arm, grip.body) for grip in segment.grips]
            held += [] if segment.push is None else [(segment.push.arm, segment.push.body)]
            held += [(ride.to, body) for body, ride in segment.rides]
            resting = [name for name in self._shown if name not in segment.body_poses]
            pairs |= {sorted_pair(box.name, name) for box in self.description.cell.still for name in resting}
            borne = (each for each in segment.contacts if not isinstance(each, InertiaEntry))
            for by, body in [*held, *((each.by, each.body) for each in borne)]:
                touching = self.description.hand_links(by) if by in ARMS else (by,)
                pairs |= {sorted_pair(link, body) for link in touching}
        return frozenset(pairs)

    def _matrix(self, allowed: frozenset[NamePair]) -> Any:
        """Return the matrix of what may touch: all of it, since MoveIt replaces what it had."""
        names = sorted({*self._shown, *(name for pair in allowed for name in pair)})
        rows = [
            ros.message("moveit_msgs/AllowedCollisionEntry", enabled=[sorted_pair(a, b) in allowed for b in names])
            for a in names
        ]
        return ros.message("moveit_msgs/AllowedCollisionMatrix", entry_names=names, entry_values=rows)

    def _carrying(self, segment: Segment) -> dict[str, _Carried]:
        """Return how every body is at the begin of a segment."""
        poses = self.plan.at(float(segment.time[0])).body_poses
        poses |= {name: rows[0] for name, rows in segment.body_poses.items()}
        found = {name: _Carried(None, poses[name], ()) for name in self._shown}
        for arm in reversed(ARMS):
            for body, T_flange_body in carried_by(arm, segment):
                hands = {arm, *(grip.arm for grip in segment.grips if grip.body == body)}
                if segment.push is not None and segment.push.body == body:
                    hands.add(segment.push.arm)
                links = chain.from_iterable(self.description.hand_links(hand) for hand in sorted(hands))
                found[body] = _Carried(arm, T_flange_body, tuple(links))
        return found

    def _scene(self, time: int, changed: dict[str, _Carried], before: dict[str, _Carried]) -> Any:
        """Return the difference of a planning scene at a time [ns]."""
        attached, placed = [], []
        for name, how in changed.items():
            was = before.get(name)
            if how.arm is not None:
                attached.append(self._attached(time, name, how.arm, how))
                continue
            if was is not None and was.arm is not None:
                gone = ros.message("moveit_msgs/CollisionObject", id=name, operation=ros.REMOVE)
                attached.append(
                    ros.message("moveit_msgs/AttachedCollisionObject", link_name=f"{was.arm}_flange", object=gone)
                )
            solid = {} if was is not None else _solid(self.plan.bodies[name])
            placed.append(
                ros.message(
                    "moveit_msgs/CollisionObject",
                    header=ros.header(time, WORLD),
                    id=name,
                    pose=ros.pose_of_row(how.pose),
                    operation=ros.ADD if was is None else ros.MOVE,
                    **solid,
                )
            )
        state = ros.message("moveit_msgs/RobotState", attached_collision_objects=attached, is_diff=True)
        world = ros.message("moveit_msgs/PlanningSceneWorld", collision_objects=placed)
        model = self.description.cell.name
        return ros.message(
            "moveit_msgs/PlanningScene", robot_model_name=model, robot_state=state, world=world, is_diff=True
        )

    def _attached(self, time: int, name: str, arm: str, how: _Carried) -> Any:
        link, body = f"{arm}_flange", self.plan.bodies[name]
        return ros.message(
            "moveit_msgs/AttachedCollisionObject",
            link_name=link,
            object=ros.message(
                "moveit_msgs/CollisionObject",
                header=ros.header(time, link),
                id=name,
                pose=ros.pose(how.pose),
                operation=ros.ADD,
                **_solid(body),
            ),
            touch_links=how.touched_by,
            weight=body.mass or 0.0,
        )


def _surface(shape: Prism | InlineMesh) -> Hull:
    """Return vertices (n, 3) [m] and triangles (m, 3) of a shape."""
    if isinstance(shape, InlineMesh):
        return shape.vertices, np.array(shape.faces, dtype=np.int64)
    return hull_with_faces(prism(shape.outline, shape.height).vertices)


def _solid(body: BodyDocument) -> dict[str, Any]:
    """Return the members of a `moveit_msgs/CollisionObject` that say what shape it has."""
    shape, here = body.shape, [ros.pose(np.eye(4))]
    if isinstance(shape, Box):
        solid = ros.message("shape_msgs/SolidPrimitive", type=ros.BOX, dimensions=shape.size)
        return {"primitives": [solid], "primitive_poses": here}
    if isinstance(shape, Cylinder):
        sizes = shape.height, shape.radius
        solid = ros.message("shape_msgs/SolidPrimitive", type=ros.CYLINDER, dimensions=sizes)
        return {"primitives": [solid], "primitive_poses": here}
    vertices, faces = _surface(shape)
    triangles = [ros.message("shape_msgs/MeshTriangle", vertex_indices=face) for face in faces]
    mesh = ros.message("shape_msgs/Mesh", triangles=triangles, vertices=[ros.point(each) for each in vertices])
    return {"meshes": [mesh], "mesh_poses": here}


def _marker(index: int, name: str, body: BodyDocument) -> Any:
    """Return the marker of a body, in the frame of that name."""
    shape = body.shape
    red, green, blue, opaque = _COLOURS.get(body.role, _GREY)
    sizes, points, kind = (1.0, 1.0, 1.0), [], ros.TRIANGLES_MARKER
    if isinstance(shape, Box):
        kind, sizes = ros.CUBE_MARKER, shape.size
    elif isinstance(shape, Cylinder):
        kind, sizes = ros.CYLINDER_MARKER, (2.0 * shape.radius, 2.0 * shape.radius, shape.height)
    else:
        vertices, faces = _surface(shape)
        points = [ros.point(corner) for corner in vertices[faces.ravel()]]
    return ros.message(
        "visualization_msgs/Marker",
        header=ros.header(0, name),
        ns=body.role,
        id=index,
        type=kind,
        pose=ros.pose(np.eye(4)),
        scale=ros.vector(sizes),
        color=ros.message("std_msgs/ColorRGBA", r=red, g=green, b=blue, a=opaque),
        frame_locked=True,
        points=points,
    )
