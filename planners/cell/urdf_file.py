"""A URDF as it is written: links with their masses and shapes, joints between them. Nothing is left out in silence.

Only an expanded URDF is read, no xacro, and of it what describes rigid bodies and joints: `link` with `inertial`,
`visual` and `collision`, `joint` with `origin`, `axis`, `limit` and `mimic`
(http://wiki.ros.org/urdf/XML).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from planners.errors import AssetError, AssetFault, AssetFaults
from planners.geometry.pose import Array, Transform, rotation_x, rotation_y, rotation_z, transform

LARGEST_FILE = 4_000_000
"""[bytes]"""
MOST_LINKS = 500
LARGEST_NUMBER = 1e9
"""In any unit; whatever is larger is not meant."""
ROUNDED_DIGITS = (2, 3, 4, 5, 6)
"""Decimals of an angle that, if it has no more, stands for the multiple of a right angle that is rounded so: 1.57."""
_QUARTER = 0.5 * math.pi
FIXED, REVOLUTE, CONTINUOUS, FLOATING = "fixed", "revolute", "continuous", "floating"


@dataclass(frozen=True, eq=False)
class UrdfBox:
    """About its own origin."""

    size: Array
    """(3,) full lengths [m]."""


@dataclass(frozen=True)
class UrdfCylinder:
    """About the z axis, its origin in the middle."""

    radius: float
    """[m]"""
    length: float
    """[m]"""


@dataclass(frozen=True)
class UrdfSphere:
    """About its origin."""

    radius: float
    """[m]"""


@dataclass(frozen=True, eq=False)
class UrdfMesh:
    """A file."""

    filename: str
    """As the URDF has it."""
    scale: Array
    """(3,) metres a unit of the mesh, along its axes."""


@dataclass(frozen=True, eq=False)
class UrdfSolid:
    """A shape of a link."""

    T_link_solid: Transform
    shape: UrdfBox | UrdfCylinder | UrdfSphere | UrdfMesh


@dataclass(frozen=True, eq=False)
class UrdfLink:
    """A rigid body."""

    name: str
    mass: float
    """0 where none is stated [kg]."""
    com: Array
    """(3,) in the frame of the link [m]."""
    solids: tuple[UrdfSolid, ...]
    """That collide; those that are drawn where none are said to collide."""


@dataclass(frozen=True, eq=False)
class UrdfJoint:
    """Where a child is on its parent, and how it moves."""

    name: str
    kind: str
    parent: str
    child: str
    T_parent_joint: Transform
    """At zero, with right angles that are right; see `ROUNDED_DIGITS`."""
    T_as_written: Transform
    """The same, with all digits that are there."""
    axis: Array
    """(3,) unit vector in the joint's frame; of no meaning where a joint turns or slides about none."""
    limits: Mapping[str, float]
    """Those of `lower`, `upper` [rad], `velocity` [rad/s] and `effort` [Nm] that are stated."""
    mimics: str | None
    """The joint that this one follows; None: it moves by itself."""

    def T_parent_child(self, position: float) -> Transform:
        """Return where the child is at a position [rad], as written."""
        x, y, z = self.axis
        across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turn = np.eye(3) + math.sin(position) * across + (1.0 - math.cos(position)) * (across @ across)
        return self.T_as_written @ transform(turn)


@dataclass(frozen=True, eq=False)
class Urdf:
    """All of a file."""

    links: Mapping[str, UrdfLink]
    joints: tuple[UrdfJoint, ...]

    @cached_property
    def joint_above(self) -> Mapping[str, UrdfJoint]:
        """The joint that a link hangs on, by link."""
        return {joint.child: joint for joint in self.joints}

    def chain(self, root: str, tip: str) -> tuple[UrdfJoint, ...]:
        """Return the joints from one link out to another, fixed ones included.

        Raises:
            AssetError: There is no such link, or the tip does not hang on the root; faults point at `/root` or `/tip`.
        """
        faults = AssetFaults()
        for what, name in (("root", root), ("tip", tip)):
            if name not in self.links:
                faults.add(f"there is no link {name!r}; there are: {', '.join(self.links)}", pointer=f"/{what}")
        faults.raise_any()
        found: list[UrdfJoint] = []
        link = tip
        while link != root:
            if link not in self.joint_above:
                detail = f"the link {tip!r} does not hang on {root!r}, but on {link!r}"
                raise AssetError(AssetFault(detail, pointer="/tip"))
            found.append(self.joint_above[link])
            link = found[-1].parent
        return tuple(reversed(found))


def read_urdf(content: bytes) -> Urdf:
    """Read a URDF.

    Raises:
        AssetError: It is none, is too large or not expanded, or elements are wrong; the message names each.
    """
    if len(content) > LARGEST_FILE:
        raise AssetError(f"the URDF has {len(content)} bytes; {LARGEST_FILE} are read")
    try:
        robot = fromstring(content, forbid_dtd=True)
    except (ParseError, DefusedXmlException, ValueError, LookupError) as error:
        raise AssetError(f"the URDF is no XML that is read: {error}") from error
    if robot.tag != "robot":
        raise AssetError(f"the URDF's outermost element is {robot.tag!r}, not 'robot'")
    if any("xacro" in str(element.tag) for element in robot.iter()):
        raise AssetError("the URDF has xacro elements: expand it first, `xacro robot.urdf.xacro > robot.urdf`")
    count = len(robot.findall("link"))
    if not 0 < count <= MOST_LINKS:
        raise AssetError(f"the URDF has {count} links; 1 to {MOST_LINKS} are read")
    faults, links, joints = AssetFaults(), dict[str, UrdfLink](), list[UrdfJoint]()
    for element in robot.findall("link"):
        with faults.at(""):
            link = _link(element)
            if link.name in links:
                raise AssetError(f"link {link.name!r}: is there twice")
            links[link.name] = link
    for element in robot.findall("joint"):
        with faults.at(""):
            joints.append(_joint(element))
    # What hangs on what is known when all links and joints are.
    faults.raise_any()
    _check_tree(links, joints)
    return Urdf(links, tuple(joints))


def _check_tree(links: Mapping[str, UrdfLink], joints: Sequence[UrdfJoint]) -> None:
    """Check that joints name links, and that following them up from any link comes to an end."""
    faults, above = AssetFaults(), dict[str, str]()
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                faults.add(f"joint {joint.name!r}: there is no link {link!r}")
        if joint.child in above:
            faults.add(f"joint {joint.name!r}: the link {joint.child!r} hangs on another joint already")
        above[joint.child] = joint.parent
    faults.raise_any()
    # Each link is walked from once: what was found to end is not walked again.
    ends: set[str] = set()
    for link in above:
        walked: set[str] = set()
        while link in above and link not in ends:
            if link in walked:
                raise AssetError(f"the joints go round in a circle at the link {link!r}")
            walked.add(link)
            link = above[link]
        ends |= walked


def _link(element: Element) -> UrdfLink:
    name = _text(element, "name", "a link")
    where = f"link {name!r}"
    mass, com = 0.0, np.zeros(3)
    inertial = element.find("inertial")
    if inertial is not None:
        mass = _number(_child(inertial, "mass", f"{where}: inertial"), "value", f"{where}: inertial: mass")
        com = _origin(inertial, f"{where}: inertial")[:3, 3]
        if mass < 0.0:
            raise AssetError(f"{where}: inertial: mass: must not be negative")
    solids = tuple(_solids(element, "collision", where)) or tuple(_solids(element, "visual", where))
    return UrdfLink(name, mass, com, solids)


def _solids(link: Element, tag: str, where: str) -> Iterator[UrdfSolid]:
    for number, element in enumerate(link.findall(tag)):
        place = f"{where}: {tag} {number}"
        shape = next(iter(_child(element, "geometry", place)), None)
        if shape is None or shape.tag not in _SHAPES:
            known = ", ".join(_SHAPES)
            raise AssetError(f"{place}: geometry: {'nothing' if shape is None else shape.tag!r} must be one of {known}")
        yield UrdfSolid(_origin(element, place), _SHAPES[shape.tag](shape, f"{place}: {shape.tag}"))


def _box(element: Element, where: str) -> UrdfBox:
    return UrdfBox(_positive(_numbers(element, "size", 3, where), where))


def _cylinder(element: Element, where: str) -> UrdfCylinder:
    lengths = np.array([_number(element, each, where) for each in ("radius", "length")])
    return UrdfCylinder(*_positive(lengths, where).tolist())


def _sphere(element: Element, where: str) -> UrdfSphere:
    return UrdfSphere(float(_positive(_numbers(element, "radius", 1, where), where)[0]))


def _mesh(element: Element, where: str) -> UrdfMesh:
    scale = _numbers(element, "scale", 3, where) if "scale" in element.attrib else np.ones(3)
    if not scale.all():
        raise AssetError(f"{where}: scale: must not be 0")
    return UrdfMesh(_text(element, "filename", where), scale)


_SHAPES = {"box": _box, "cylinder": _cylinder, "sphere": _sphere, "mesh": _mesh}


def _joint(element: Element) -> UrdfJoint:
    name = _text(element, "name", "a joint")
    where = f"joint {name!r}"
    kind = _text(element, "type", where)
    limit, mimic = element.find("limit"), element.find("mimic")
    stated = (
        () if limit is None else (each for each in ("lower", "upper", "velocity", "effort") if each in limit.attrib)
    )
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=_text(_child(element, "parent", where), "link", f"{where}: parent"),
        child=_text(_child(element, "child", where), "link", f"{where}: child"),
        T_parent_joint=_origin(element, where, squared=True),
        T_as_written=_origin(element, where),
        # Exporters write an axis 0 0 0 on joints that have none.
        axis=np.array([1.0, 0.0, 0.0]) if kind in (FIXED, FLOATING) else _axis(element, where),
        limits={each: _number(limit, each, f"{where}: limit") for each in stated} if limit is not None else {},
        mimics=None if mimic is None else _text(mimic, "joint", f"{where}: mimic"),
    )


def _axis(joint: Element, where: str) -> Array:
    """Return the unit vector (3,) about or along which a joint moves, x where none is stated."""
    axis = joint.find("axis")
    direction = np.array([1.0, 0.0, 0.0]) if axis is None else _numbers(axis, "xyz", 3, f"{where}: axis")
    length = float(np.linalg.norm(direction))
    if length < 1e-9:
        raise AssetError(f"{where}: axis: xyz must not be 0 0 0")
    return direction / length


def _origin(element: Element, where: str, *, squared: bool = False) -> Transform:
    """Return the `origin` of an element: `xyz` [m], and `rpy` about the fixed axes x, then y, then z [rad].

    With `squared`, angles that stand for multiples of a right angle are those.
    """
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    xyz = _numbers(origin, "xyz", 3, f"{where}: origin") if "xyz" in origin.attrib else np.zeros(3)
    angles = _numbers(origin, "rpy", 3, f"{where}: origin") if "rpy" in origin.attrib else np.zeros(3)
    roll, pitch, yaw = (_squared(angle) if squared else angle for angle in angles.tolist())
    return transform(rotation_z(yaw) @ rotation_y(pitch) @ rotation_x(roll), xyz)


def _squared(angle: float) -> float:
    """Return the multiple of a right angle that an angle stands for, or the angle [rad]."""
    quarter = round(angle / _QUARTER) * _QUARTER
    stands = any(angle == round(angle, digits) and abs(angle - quarter) < 10.0**-digits for digits in ROUNDED_DIGITS)
    return quarter if stands else angle


def _child(element: Element, tag: str, where: str) -> Element:
    found = element.find(tag)
    if found is None:
        raise AssetError(f"{where}: {tag} is required")
    return found


def _text(element: Element, name: str, where: str) -> str:
    value = element.get(name)
    if not value:
        raise AssetError(f"{where}: {name} is required")
    return value


def _number(element: Element, name: str, where: str) -> float:
    return float(_numbers(element, name, 1, where)[0])


def _numbers(element: Element, name: str, count: int, where: str) -> Array:
    words = _text(element, name, where).split()
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.array([math.nan])
    if len(values) != count or not (np.abs(values) <= LARGEST_NUMBER).all():
        raise AssetError(
            f"{where}: {name}: must be {count} number{'s' if count > 1 else ''}, not {' '.join(words)[:60]!r}"
        )
    return values


def _positive(values: Array, where: str) -> Array:
    if (values <= 0.0).any():
        raise AssetError(f"{where}: all lengths must be greater than 0")
    return values
