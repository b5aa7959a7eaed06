"""A cell as ROS describes robots: URDF with its meshes, and SRDF. RViz and MoveIt then show the cell of the plan.

Every body of the collision model is a link of the same name, with the same convex shapes; links in between, which have
no shape, carry the frames of a plan document: `<arm>_base`, `<arm>_flange`, `<arm>_tcp`. URDF turns a link about an
axis of its own frame. So what row i of an arm's table says stands behind joint i and before joint i + 1.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import trimesh
import yaml

from planners.cell.arm import Arm
from planners.cell.cell import Cell, StaticBox
from planners.cell.hand import FINGER_SIDES, Gripper, Jaws, Linkage, Pusher
from planners.geometry.convex import ConvexShape
from planners.geometry.pose import Array, Transform, frame_from_z, rotation_x, rotation_z, transform
from planners.geometry.surface import hull_with_faces
from planners.plan.scenery import ARMS

WORLD = "world"
STROKE_TIME = 1.0
"""In which the fingers of a URDF go all their way: a cell does not say how fast they are [s]."""
_COLOURS = {
    "arm": "0.62 0.65 0.68 1",
    "hand": "0.25 0.27 0.3 1",
    "table": "0.75 0.68 0.58 1",
    "frame": "0.5 0.5 0.52 1",
}


@dataclass(frozen=True, eq=False)
class FingerJoint:
    """The joint of a URDF that opens and closes a gripper; what else moves of the fingers mimics it."""

    name: str
    fingers: Linkage | Jaws
    width_max: float
    """[m]"""

    def position(self, width: float) -> float:
        """Return where the joint is at a distance of the pads' inner faces [m]: in rad of a crank, in m of jaws."""
        return self.fingers.angle(width) if isinstance(self.fingers, Linkage) else 0.5 * width

    @property
    def limits(self) -> tuple[float, float]:
        """Its least and greatest position, in either order of opening."""
        ends = self.position(0.0), self.position(self.width_max)
        return min(ends), max(ends)


@dataclass(frozen=True)
class _WrittenJoint:
    """A joint that moves, about or along an axis."""

    name: str
    kind: str
    axis: str
    lower: float
    upper: float
    velocity: float
    effort: float
    mimics: tuple[str, float] | None = None
    """Another joint, and how many times its position this one has."""


@dataclass(frozen=True, eq=False)
class _Inertial:
    mass: float
    T_part_com: Transform
    inertia: Array
    """(3, 3) about the centre of mass, in its axes [kg m^2]."""


@dataclass(frozen=True, eq=False)
class _WrittenLink:
    """A link with the joint that it hangs on."""

    name: str
    parent: str
    T_parent_part: Transform
    motion: _WrittenJoint | None = None
    """None: it is fixed."""
    T_part_shape: Transform | None = None
    """Where the frame of the shapes is; None: where the link's is."""
    shapes: Sequence[ConvexShape | StaticBox] = ()
    colour: str = "arm"
    inertial: _Inertial | None = None


@dataclass(frozen=True, eq=False)
class CellDescription:
    """A cell for RViz and MoveIt."""

    cell: Cell
    package: str
    """The ROS package in which meshes are looked for."""

    @cached_property
    def _parts(self) -> tuple[_WrittenLink, ...]:
        return tuple(_parts(self.cell))

    @property
    def links(self) -> tuple[str, ...]:
        """Names of all links, `WORLD` first."""
        return (WORLD, *(part.name for part in self._parts))

    @cached_property
    def finger_joints(self) -> Mapping[str, FingerJoint]:
        """By arm, of those that carry a gripper."""
        return {arm: _finger_joint(arm, self.cell.gripper(arm)) for arm in self.cell.gripper_arms}

    def hand_links(self, arm: str) -> tuple[str, ...]:
        """Return the links of a hand that have a shape."""
        return tuple(body.name for body in self.cell.arms[arm].hand_bodies(None))

    @cached_property
    def meshes(self) -> dict[str, bytes]:
        """Convex shapes as STL, by the path in the package [m]."""
        files = {}
        for part in self._parts:
            for path, shape in zip(_mesh_paths(part), part.shapes, strict=True):
                if path is not None and isinstance(shape, ConvexShape):
                    exported = trimesh.Trimesh(*hull_with_faces(shape.vertices), process=False).export(file_type="stl")
                    assert isinstance(exported, bytes)
                    files[path] = exported
        return files

    @cached_property
    def urdf(self) -> str:
        """The URDF (http://wiki.ros.org/urdf/XML): all links hang on `WORLD`."""
        robot = Element("robot", name=self.cell.name)
        for name, colour in _COLOURS.items():
            SubElement(SubElement(robot, "material", name=name), "color", rgba=colour)
        SubElement(robot, "link", name=WORLD)
        for part in self._parts:
            self._write_link(robot, part)
            _write_joint(robot, part)
        return _written(robot)

    @cached_property
    def srdf(self) -> str:
        """The SRDF (http://wiki.ros.org/srdf): groups, hands, states, and which links are never checked."""
        robot = Element("robot", name=self.cell.name)
        for arm in ARMS:
            group = SubElement(robot, "group", name=arm)
            SubElement(group, "chain", base_link=f"{arm}_base", tip_link=f"{arm}_flange")
        both = SubElement(robot, "group", name="both")
        for arm in ARMS:
            SubElement(both, "group", name=arm)
        for arm in ARMS:
            group = SubElement(robot, "group", name=f"{arm}_hand")
            for part in self._parts:
                if self._is_of_hand(part, arm):
                    SubElement(group, "link", name=part.name)
        self._write_states(robot)
        for arm in ARMS:
            hand = {"name": f"{arm}_hand", "parent_link": f"{arm}_flange", "group": f"{arm}_hand", "parent_group": arm}
            SubElement(robot, "end_effector", hand)
        frames = {body.name: body.frame for body in self.cell.collision_bodies()}
        for a, b in sorted(self.cell.excluded_pairs):
            moves = not (_joints_before(frames[a]) == _joints_before(frames[b]) == 0)
            SubElement(robot, "disable_collisions", link1=a, link2=b, reason="Adjacent" if moves else "User")
        return _written(robot)

    @cached_property
    def joint_limits(self) -> str:
        """`joint_limits.yaml` as MoveIt reads it: a URDF has no accelerations."""
        limits = {}
        for arm in self.cell.arms.values():
            for name, speed, acceleration in zip(arm.joint_names, arm.velocity_max, arm.acceleration_max, strict=True):
                limits[name] = {
                    "has_velocity_limits": True,
                    "max_velocity": float(speed),
                    "has_acceleration_limits": True,
                    "max_acceleration": float(acceleration),
                }
        return yaml.safe_dump({"joint_limits": limits}, sort_keys=False)

    def _is_of_hand(self, part: _WrittenLink, arm: str) -> bool:
        above = {each.name: each.parent for each in self._parts}
        name = part.name
        while name not in (WORLD, f"{arm}_hand"):
            name = above[name]
        return name != WORLD

    def _write_states(self, robot: Element) -> None:
        homes = {name: dict(zip(arm.joint_names, arm.home, strict=True)) for name, arm in self.cell.arms.items()}
        states = {(arm, "home"): home for arm, home in homes.items()}
        states["both", "home"] = {joint: value for home in homes.values() for joint, value in home.items()}
        for arm, joint in self.finger_joints.items():
            for name, width in (("open", joint.width_max), ("closed", 0.0)):
                states[f"{arm}_hand", name] = {joint.name: joint.position(width)}
        for (group, name), positions in states.items():
            state = SubElement(robot, "group_state", name=name, group=group)
            for joint, value in positions.items():
                SubElement(state, "joint", name=joint, value=_number(value))

    def _write_link(self, robot: Element, part: _WrittenLink) -> None:
        link = SubElement(robot, "link", name=part.name)
        if part.inertial is not None:
            _write_inertial(link, part.inertial)
        T_part_shape = np.eye(4) if part.T_part_shape is None else part.T_part_shape
        for path, shape in zip(_mesh_paths(part), part.shapes, strict=True):
            for T_shape_solid, solid, attributes in self._solids(path, shape):
                for kind in ("visual", "collision"):
                    element = SubElement(link, kind)
                    _write_origin(element, T_part_shape @ T_shape_solid)
                    SubElement(SubElement(element, "geometry"), solid, attributes)
                    if kind == "visual":
                        SubElement(element, "material", name=part.colour)

    def _solids(
        self, path: str | None, shape: ConvexShape | StaticBox
    ) -> Iterator[tuple[Transform, str, dict[str, str]]]:
        """Yield what a shape is in a URDF: where it is, element and attributes."""
        if isinstance(shape, StaticBox):
            yield np.eye(4), "box", {"size": _numbers(shape.size)}
        elif path is not None:
            yield np.eye(4), "mesh", {"filename": f"package://{self.package}/{path}"}
        else:
            start, end = shape.vertices
            length, radius = float(np.linalg.norm(end - start)), _number(shape.radius)
            hint = np.eye(3)[int(np.argmin(np.abs(end - start)))]
            middle = transform(frame_from_z(end - start, hint), 0.5 * (start + end))
            yield middle, "cylinder", {"radius": radius, "length": _number(length)}
            for point in (start, end):
                yield transform(None, point), "sphere", {"radius": radius}


def _parts(cell: Cell) -> Iterator[_WrittenLink]:
    for static in cell.boxes:
        yield _WrittenLink(static.name, WORLD, transform(None, static.center), shapes=(static,), colour=static.role)
    for still in cell.meshes:
        parts = still.mesh.drawn.parts
        yield _WrittenLink(still.name, WORLD, still.T_world_mesh, shapes=parts, colour=still.role)
    for arm in cell.arms.values():
        yield from _arm_parts(arm)
        yield from _hand_parts(arm)


def _arm_parts(arm: Arm) -> Iterator[_WrittenLink]:
    """Yield the links of an arm, then its flange."""
    bodies, above = arm.link_bodies(), f"{arm.name}_base"
    yield _WrittenLink(above, WORLD, arm.T_world_base, shapes=bodies[0].shapes)
    T_above_joint = np.eye(4)
    for i, (body, joint) in enumerate(zip(bodies[1:], arm.joint_names, strict=True)):
        a, alpha, d, theta0 = arm.dh[i]
        T_joint_frame = transform(rotation_z(theta0) @ rotation_x(alpha), rotation_z(theta0) @ [a, 0.0, d])
        mass, *com = arm.robot.masses[i]
        inertial = _evenly(mass, np.array(com), arm.robot.links[i + 1].points)
        yield _WrittenLink(
            body.name,
            above,
            T_above_joint,
            _WrittenJoint(
                joint,
                "revolute",
                "0 0 1",
                lower=float(arm.position_min[i]),
                upper=float(arm.position_max[i]),
                velocity=float(arm.velocity_max[i]),
                effort=float(arm.torque_max[i]),
            ),
            T_part_shape=T_joint_frame,
            shapes=body.shapes,
            inertial=replace(inertial, T_part_com=T_joint_frame @ inertial.T_part_com),
        )
        above, T_above_joint = body.name, T_joint_frame
    yield _WrittenLink(f"{arm.name}_flange", above, T_above_joint)


def _hand_parts(arm: Arm) -> Iterator[_WrittenLink]:
    """Yield a hand: all of its mass on the link that is bolted to the flange, then what has a shape, then its TCP."""
    hand, name = arm.hand, f"{arm.name}_hand"
    points = np.vstack([shape.vertices for body in arm.hand_bodies(None) for shape in body.shapes])
    yield _WrittenLink(name, f"{arm.name}_flange", np.eye(4), inertial=_evenly(hand.mass, hand.com, points))
    if isinstance(hand, Pusher):
        for body in arm.hand_bodies(None):
            yield _WrittenLink(body.name, name, np.eye(4), shapes=body.shapes, colour="hand")
        yield _WrittenLink(f"{arm.name}_tcp", name, hand.T_flange_tcp)
        return
    if hand.sensor is not None:
        yield _WrittenLink(f"{arm.name}_ft300", name, np.eye(4), shapes=(hand.sensor,), colour="hand")
    base = f"{arm.name}_gripper_base"
    yield _WrittenLink(base, name, transform(None, [0.0, 0.0, hand.base_height]), shapes=(hand.base,), colour="hand")
    for finger in range(len(FINGER_SIDES)):
        yield from _finger_parts(arm.name, hand, finger)
    yield from _tcp_parts(arm.name, hand)


def _finger_joint(arm: str, hand: Gripper) -> FingerJoint:
    # Readers that go by the alphabet come to it before what mimics it.
    return FingerJoint(f"{arm}_finger", hand.fingers, hand.width_max)


def _finger_parts(arm: str, hand: Gripper, finger: int) -> Iterator[_WrittenLink]:
    """Yield one finger; the joint of finger 0 is the one that all others mimic."""
    base, prefix = f"{arm}_gripper_base", f"{arm}_finger_{finger}"
    side, master, shapes = transform(FINGER_SIDES[finger]), finger == 0, hand.finger_parts
    pad = _WrittenLink(f"{arm}_pad_{finger}", "", np.eye(4), shapes=(hand.pad,), colour="hand")
    if isinstance(hand.fingers, Jaws):
        carriage = _moves(arm, hand, "prismatic", None if master else 1.0, f"{prefix}_joint")
        yield _WrittenLink(prefix, base, side, carriage)
        for part in hand.fingers.parts:
            yield _WrittenLink(f"{prefix}_{part}", prefix, np.eye(4), shapes=(shapes[part],), colour="hand")
        yield replace(pad, parent=prefix, T_parent_part=transform(None, [0.0, *hand.fingers.pad]))
        return
    linkage = hand.fingers
    crank = _moves(arm, hand, "revolute", None if master else 1.0, f"{prefix}_outer_knuckle_joint")
    along = _moves(arm, hand, "revolute", 1.0, f"{prefix}_inner_knuckle_joint")
    back = _moves(arm, hand, "revolute", -1.0, f"{prefix}_inner_finger_joint")
    for part, parent, origin, motion in (
        ("outer_knuckle", base, linkage.outer_knuckle, crank),
        ("outer_finger", f"{prefix}_outer_knuckle", linkage.outer_finger, None),
        ("inner_finger", f"{prefix}_outer_finger", linkage.inner_finger, back),
        ("inner_knuckle", base, linkage.inner_knuckle, along),
    ):
        T = transform(None, [0.0, *origin])
        placed = side @ T if parent == base else T
        yield _WrittenLink(f"{prefix}_{part}", parent, placed, motion, shapes=(shapes[part],), colour="hand")
    yield replace(pad, parent=f"{prefix}_inner_finger", T_parent_part=transform(None, [0.0, *linkage.pad]))


def _tcp_parts(arm: str, hand: Gripper) -> Iterator[_WrittenLink]:
    """Yield the TCP, which moves along z where the fingers are a linkage.

    The crank c = (c_y, c_z), turned by q, has the height c_y sin q + c_z cos q. Half of it turned by q, and half of its
    mirror image turned by -q, add up to the same height straight above the middle.
    """
    base, fingers = f"{arm}_gripper_base", hand.fingers
    if isinstance(fingers, Jaws):
        yield _WrittenLink(f"{arm}_tcp", base, transform(None, [0.0, 0.0, fingers.pad[1]]))
        return
    y, z = 0.5 * (fingers.outer_finger + fingers.inner_finger)
    parent, origin = base, [0.0, 0.0, float(fingers.outer_knuckle[1] + fingers.pad[1])]
    for name, times, reach in (("half", 1.0, [0.0, y, z]), ("mirror", -2.0, [0.0, -y, z]), ("tcp", 1.0, None)):
        link = f"{arm}_tcp" if name == "tcp" else f"{arm}_tcp_{name}"
        yield _WrittenLink(link, parent, transform(None, origin), _moves(arm, hand, "revolute", times, f"{link}_joint"))
        parent, origin = link, reach or origin


def _moves(arm: str, hand: Gripper, kind: str, times: float | None, name: str) -> _WrittenJoint:
    """Return how a part of the fingers moves: as the master where `times` is None, else that many times as far."""
    master = _finger_joint(arm, hand)
    lower, upper = master.limits
    lever = 1.0
    if isinstance(hand.fingers, Linkage):
        lever = float(np.hypot(*(hand.fingers.outer_finger + hand.fingers.inner_finger)))
    scale = 1.0 if times is None else times
    return _WrittenJoint(
        master.name if times is None else name,
        kind,
        "1 0 0" if kind == "revolute" else "0 1 0",
        lower=min(scale * lower, scale * upper),
        upper=max(scale * lower, scale * upper),
        velocity=abs(scale) * (upper - lower) / STROKE_TIME,
        effort=hand.force_max * lever,
        mimics=None if times is None else (master.name, times),
    )


def _evenly(mass: float, com: Array, points: Array) -> _Inertial:
    """Return a mass where it is stated, turning as if it were spread evenly over the hull of its shape."""
    hull = trimesh.Trimesh(*hull_with_faces(points), process=False)
    inertia = np.asarray(hull.moment_inertia) * (mass / float(hull.volume))
    return _Inertial(float(mass), transform(None, com), inertia)


def _mesh_paths(part: _WrittenLink) -> list[str | None]:
    """Return the file of each shape of a link; None: a box or a capsule, which need none."""
    numbered = len(part.shapes) > 1
    return [
        f"meshes/{part.name}{f'_{i}' if numbered else ''}.stl"
        if isinstance(shape, ConvexShape) and shape.radius == 0.0
        else None
        for i, shape in enumerate(part.shapes)
    ]


def _joints_before(frame: str) -> int:
    return int(frame.partition("/")[2] or 0)


def _write_joint(robot: Element, part: _WrittenLink) -> None:
    motion = part.motion
    name, kind = (f"{part.name}_fixed", "fixed") if motion is None else (motion.name, motion.kind)
    joint = SubElement(robot, "joint", name=name, type=kind)
    _write_origin(joint, part.T_parent_part)
    SubElement(joint, "parent", link=part.parent)
    SubElement(joint, "child", link=part.name)
    if motion is None:
        return
    SubElement(joint, "axis", xyz=motion.axis)
    bounds = {each: _number(getattr(motion, each)) for each in ("lower", "upper", "velocity", "effort")}
    SubElement(joint, "limit", bounds)
    if motion.mimics is not None:
        SubElement(joint, "mimic", joint=motion.mimics[0], multiplier=_number(motion.mimics[1]), offset="0")


def _write_inertial(link: Element, inertial: _Inertial) -> None:
    element = SubElement(link, "inertial")
    _write_origin(element, inertial.T_part_com)
    SubElement(element, "mass", value=_number(inertial.mass))
    entries = {f"i{'xyz'[i]}{'xyz'[j]}": _number(inertial.inertia[i, j]) for i in range(3) for j in range(i, 3)}
    SubElement(element, "inertia", entries)


def _write_origin(element: Element, T: Transform) -> None:
    SubElement(element, "origin", xyz=_numbers(T[:3, 3]), rpy=_numbers(roll_pitch_yaw(T[:3, :3])))


def roll_pitch_yaw(R: Array) -> Array:
    """Return the (3,) angles about the fixed axes x, then y, then z that a rotation (3, 3) is made of [rad].

    Roll is what is left after yaw was undone: near a pitch of a right angle, where either alone is of no meaning, they
    fit each other.
    """
    yaw = math.atan2(R[1, 0], R[0, 0])
    s, c = math.sin(yaw), math.cos(yaw)
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    return np.array([math.atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1]), pitch, yaw])


def _number(value: float) -> str:
    # The shortest text that gives the same number again; no minus zero.
    return repr(float(value) + 0.0)


def _numbers(values: Array) -> str:
    return " ".join(map(_number, values))


def _written(robot: Element) -> str:
    indent(robot)
    return tostring(robot, encoding="unicode", xml_declaration=True) + "\n"
