"""A robot's file from a URDF: what a URDF says, in Denavit and Hartenberg's frames, with what it does not say.

The axes of the joints at zero give the table. What is constant before the first axis becomes the file's `base`, what is
behind the last one is in the last row. How far the flange is from where the URDF has it is told: numbers of a URDF are
rounded, so that right angles are not quite right (`urdf_file.ROUNDED_DIGITS`, `planners.kinematics.table_of_axes`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import get_args

import numpy as np
import trimesh
from pydantic import ValidationError
from scipy.spatial import ConvexHull, QhullError

from planners.cell.asset_files import (
    JOINTS,
    LINK_NAMES,
    ONLY_SIX_JOINTS,
    JointFile,
    LinkName,
    MassFile,
    PiecesLinkFile,
    PlacementFile,
    RobotFile,
    Triple,
)
from planners.cell.asset_shelf import faults_of
from planners.cell.urdf_file import (
    CONTINUOUS,
    FIXED,
    REVOLUTE,
    Urdf,
    UrdfBox,
    UrdfCylinder,
    UrdfJoint,
    UrdfLink,
    UrdfMesh,
    UrdfSolid,
    UrdfSphere,
    read_urdf,
)
from planners.errors import AssetError, AssetFaults
from planners.geometry.convex import box, cylinder, enclosing_hull
from planners.geometry.mesh_file import MeshFormat, MeshRefused, read_mesh_file
from planners.geometry.pose import Array, Transform, inverse
from planners.kinematics.arm_kind import NoClosedForm, arm_kind
from planners.kinematics.forward import flange_pose, link_frames
from planners.kinematics.table_of_axes import table_of_axes
from planners.plan.scenery import JOINTS as JOINT_NAMES

Resolve = Callable[[str], bytes | None]
"""The content of a file by its path inside a folder or an archive; None where there is none."""
EXACT = 1e-7
"""Of the flange: nearer to where a URDF has it is no news [m, rad]."""
FURTHEST = math.radians(540.0)
"""Position of a joint [rad]."""
CYLINDER_SIDES = 16
LARGEST = 1e4
"""Of what a robot's file says of a joint [deg/s, Nm]."""
SWIFTEST = 50.0
"""Speed of a joint [rad/s]: that of none, as far as is known; what is larger is most likely in degrees."""
FARTHEST = 1e3
"""Of a link's shape from its frame [m]."""
MOST_SHAPES = 200
"""Of all links: as many as fit a file of a cell if each is thinned."""
MOST_CORNERS = 12_000
"""Of all shapes together."""
_IN_DEGREES = ": a URDF has radians; are these degrees?"
_TRIALS = 200
"""Random postures in which both kinematics are compared."""
_FORMATS: Mapping[str, MeshFormat] = {each: each for each in get_args(MeshFormat)}


@dataclass(frozen=True)
class RobotFigures:
    """What a URDF does not say of a robot, or not always; six numbers are one a joint, from the base out."""

    name: str
    root: str
    """The link with which the arm is mounted."""
    tip: str
    """The link that hands are bolted to, its z axis out of the flange."""
    payload: float
    """[kg]"""
    acceleration: Sequence[float]
    """[rad/s^2]"""
    torque: Sequence[float] | None = None
    """[Nm]; None: each joint's `effort`."""
    mass: Sequence[float] | None = None
    """Of the links that move, each then taken to be in the middle of its shapes [kg]; None: of their `inertial`."""


@dataclass(frozen=True)
class UrdfRobot:
    """A robot, and what whoever gave the URDF should know."""

    file: RobotFile
    joint_names: tuple[str, ...]
    """As the URDF has them, base to flange; the file has the names that all arms have."""
    deviation: tuple[float, float]
    """Largest distance and angle of the flange from where the URDF has it, in random postures [m, rad]."""
    notes: tuple[str, ...]
    """What was taken otherwise than written, or left out."""


def robot_from_urdf(content: bytes, figures: RobotFigures, resolve: Resolve, folder: str = "") -> UrdfRobot:
    """Describe the arm between two links of an expanded URDF.

    Args:
        content: of the URDF.
        figures: what it does not say.
        resolve: returns files of the folder or archive that the URDF is in. Paths have no "..".
        folder: of the URDF in there; meshes that are named by a path are looked for beside it.

    Raises:
        AssetError: The URDF is wrong, has another number of joints, is of no kind that has a closed form, or leaves
            something out that the figures do not give. Every fault is told, and names its element; those that have a
            pointer are of the figures.
    """
    urdf = read_urdf(content)
    chain = urdf.chain(figures.root, figures.tip)
    moving = _moving(chain, figures)
    faults, notes = AssetFaults(), [*_left_out(urdf, chain, figures)]
    # Where there is no table, what else is wrong is told as well.
    T_root_0, dh, deviation = np.eye(4), np.zeros((JOINTS, 4)), (0.0, 0.0)
    with faults.at(""):
        T_root_0, dh = table_of_axes(*_axes(chain))
        kind = arm_kind(dh)
        if isinstance(kind, NoClosedForm):
            raise AssetError(f"joints {', '.join(joint.name for joint in moving)}: {kind.reason}")
        deviation = _deviation(chain, T_root_0, dh)
    if max(deviation) > EXACT:
        far = f"{1e3 * deviation[0]:.3g} mm and {math.degrees(deviation[1]):.3g} deg"
        notes.append(f"rounded angles and lengths were taken as exact; that moves the flange by up to {far}")
    frames = np.empty((JOINTS + 1, 4, 4))
    link_frames(dh, T_root_0, np.zeros(JOINTS), frames)
    bodies = list(_bodies(urdf, chain, figures))
    pieces = _all_pieces(bodies, frames, _Meshes(resolve, folder), faults)
    joints = [_joint_file(i, joint, dh[i], figures, notes, faults) for i, joint in enumerate(moving)]
    masses = _mass_files(bodies[1:], frames[1:], pieces[1:], figures, faults)
    faults.raise_any()
    placement = _placement(T_root_0)
    with _told_of("the arm"):
        file = RobotFile(
            name=figures.name,
            base=None if placement == _AT_ORIGIN else placement,
            joints=tuple(joint for joint in joints if joint is not None),
            links=tuple(
                PiecesLinkFile(name=name, pieces=tuple(_corners(piece) for piece in parts))
                for name, parts in zip(LINK_NAMES, pieces, strict=True)
            ),
            masses=masses,
            payload=figures.payload,
            reach=round(_span(dh), 3),
        )
    return UrdfRobot(file, tuple(joint.name for joint in moving), deviation, tuple(notes))


@contextmanager
def _told_of(what: str) -> Iterator[None]:
    """Have numbers that are beyond what a robot's file may say be told of an element of the URDF.

    Raises:
        AssetError: There are such.
    """
    try:
        yield
    except ValidationError as error:
        told = ((fault.pointer.strip("/"), fault.detail) for fault in faults_of(error, RobotFile))
        raise AssetError(*(": ".join(part for part in (what, *each) if part) for each in told)) from error


def _moving(chain: Sequence[UrdfJoint], figures: RobotFigures) -> tuple[UrdfJoint, ...]:
    moving, faults = tuple(joint for joint in chain if joint.kind != FIXED), AssetFaults()
    for joint in moving:
        where = f"joint {joint.name!r}"
        if joint.kind not in (REVOLUTE, CONTINUOUS):
            faults.add(f"{where}: type {joint.kind!r}: joints of an arm turn, {REVOLUTE} or {CONTINUOUS}")
        if joint.mimics is not None:
            faults.add(f"{where}: mimic: it follows {joint.mimics!r}; joints of an arm turn by themselves here")
    if len(moving) != JOINTS:
        between = f"{len(moving)} joints turn between {figures.root!r} and {figures.tip!r}"
        names = ", ".join(joint.name for joint in moving) or "none"
        faults.add(f"{between} ({names}). " + (ONLY_SIX_JOINTS if len(moving) > JOINTS else "An arm has six."))
    for name in ("acceleration", "torque", "mass"):
        given = getattr(figures, name)
        if given is not None and (len(given) != JOINTS or min(given) <= 0.0):
            faults.add(f"must be {JOINTS} numbers greater than 0, one a joint", pointer=f"/{name}")
    faults.raise_any()
    return moving


def _left_out(urdf: Urdf, chain: Sequence[UrdfJoint], figures: RobotFigures) -> Iterator[str]:
    """Say what moves beside the arm, and what hangs on its tip: neither is part of it."""
    on_chain = {figures.root, *(joint.child for joint in chain)}
    for joint in urdf.joints:
        if joint.parent == figures.tip:
            yield f"{joint.child!r} hangs on the tip by joint {joint.name!r}, and is not part of the arm"
        elif joint.kind != FIXED and joint.child not in on_chain and joint.parent in on_chain:
            yield f"{joint.child!r} moves on {joint.parent!r} by joint {joint.name!r}, and is not part of the arm"


def _bodies(
    urdf: Urdf, chain: Sequence[UrdfJoint], figures: RobotFigures
) -> Iterator[list[tuple[Transform, UrdfLink]]]:
    """Yield the links, with `T_root_link` at zero, of what the joints of the chain leave rigid: base to flange."""
    on_chain = {joint.child for joint in chain}
    T_root_link, seeds = np.eye(4), [(np.eye(4), figures.root)]
    for joint in chain:
        T_root_link = T_root_link @ joint.T_parent_joint
        if joint.kind != FIXED:
            yield _rigid(urdf, seeds, on_chain, figures.tip)
            seeds = []
        seeds.append((T_root_link, joint.child))
    yield _rigid(urdf, seeds, on_chain, figures.tip)


def _rigid(
    urdf: Urdf, seeds: Iterable[tuple[Transform, str]], on_chain: set[str], tip: str
) -> list[tuple[Transform, UrdfLink]]:
    """Return links of the chain with all that is fixed to them, but for what is fixed to the tip."""
    found: list[tuple[Transform, UrdfLink]] = []
    waiting = list(seeds)
    while waiting:
        T_root_link, name = waiting.pop()
        found.append((T_root_link, urdf.links[name]))
        if name != tip:
            waiting += [
                (T_root_link @ joint.T_parent_joint, joint.child)
                for joint in urdf.joints
                if joint.parent == name and joint.kind == FIXED and joint.child not in on_chain
            ]
    return found


def _axes(chain: Sequence[UrdfJoint]) -> tuple[Array, Array, Transform]:
    """Return the axes (6, 3) at zero, a point of each (6, 3), and `T_root_tip`."""
    axes, points, T_root_link = list[Array](), list[Array](), np.eye(4)
    for joint in chain:
        T_root_link = T_root_link @ joint.T_parent_joint
        if joint.kind != FIXED:
            axes.append(T_root_link[:3, :3] @ joint.axis)
            points.append(T_root_link[:3, 3])
    return np.array(axes), np.array(points), T_root_link


def _deviation(chain: Sequence[UrdfJoint], T_root_0: Transform, dh: Array) -> tuple[float, float]:
    """Return the largest distance [m] and angle [rad] of the flange from where the joints of a URDF lead."""
    rng = np.random.default_rng(0)
    distance = angle = 0.0
    for q in rng.uniform(-math.pi, math.pi, (_TRIALS, JOINTS)):
        T, positions = np.eye(4), iter(q.tolist())
        for joint in chain:
            T = T @ joint.T_parent_child(0.0 if joint.kind == FIXED else next(positions))
        ours = flange_pose(dh, T_root_0, q)
        distance = max(distance, float(np.linalg.norm(ours[:3, 3] - T[:3, 3])))
        half_chord = float(np.linalg.norm(ours[:3, :3] - T[:3, :3])) / math.sqrt(8.0)
        angle = max(angle, 2.0 * math.asin(min(1.0, half_chord)))
    return distance, angle


def _joint_file(
    i: int, joint: UrdfJoint, row: Array, figures: RobotFigures, notes: list[str], faults: AssetFaults
) -> JointFile | None:
    """Return what the file says of a joint; None: something is wrong with it."""
    where = f"joint {joint.name!r}"
    velocity, effort = joint.limits.get("velocity", 0.0), joint.limits.get("effort", 0.0)
    wrong = list[str]()
    if not 0.0 < velocity <= math.radians(LARGEST):
        most = f"{math.radians(LARGEST):.0f} rad/s{_IN_DEGREES if velocity > 0.0 else ''}"
        wrong.append(f"velocity must be greater than 0 and at most {most}")
    elif velocity > SWIFTEST:
        notes.append(f"{where} turns at {velocity:g} rad/s{_IN_DEGREES}")
    if figures.torque is None and not 0.0 < effort <= LARGEST:
        most = f"{LARGEST:g} Nm, or `torque` be given for all joints"
        wrong.append(f"effort must be greater than 0 and at most {most}")
    position = _range(joint, notes, wrong)
    for each in wrong:
        faults.add(f"{where}: limit: {each}")
    if position is None or wrong:
        return None
    with faults.at(""), _told_of(where):
        return JointFile(
            name=JOINT_NAMES[i],
            a=float(row[0]),
            alpha_deg=_degrees(row[1]),
            d=float(row[2]),
            theta0_deg=_degrees(row[3]),
            position_deg=position,
            velocity_deg=math.degrees(velocity),
            acceleration=float(figures.acceleration[i]),
            torque=float(effort if figures.torque is None else figures.torque[i]),
        )
    return None


def _range(joint: UrdfJoint, notes: list[str], wrong: list[str]) -> tuple[float, float] | None:
    """Return the range of a joint [deg]; None: it has none, and `wrong` says why."""
    where = f"joint {joint.name!r}"
    if joint.kind == CONTINUOUS:
        notes.append(f"{where} turns without end; it is given -360 to 360 deg")
        return -360.0, 360.0
    if not {"lower", "upper"} <= set(joint.limits):
        wrong.append(f"lower and upper are required of a joint that is {REVOLUTE}")
        return None
    lower, upper = joint.limits["lower"], joint.limits["upper"]
    if lower >= upper:
        wrong.append("lower must be less than upper")
        return None
    if max(-lower, upper) > FURTHEST:
        notes.append(f"{where} turns further than 540 deg, and is given no more{_IN_DEGREES}")
        lower, upper = max(lower, -FURTHEST), min(upper, FURTHEST)
    if lower >= upper:
        wrong.append("all of its range is further than 540 deg away from zero")
        return None
    return math.degrees(lower), math.degrees(upper)


def _degrees(angle: float) -> float:
    """Return an angle in degrees, right angles exactly."""
    return float(round(math.degrees(angle), 12))


def _mass_files(
    bodies: Sequence[list[tuple[Transform, UrdfLink]]],
    frames: Array,
    pieces: Sequence[list[Array]],
    figures: RobotFigures,
    faults: AssetFaults,
) -> tuple[MassFile, ...]:
    """Return masses and centres of mass of the links that move, each in its own frame."""
    found = list[MassFile]()
    for i, name in enumerate(LINK_NAMES[1:]):
        links = ", ".join(repr(link.name) for _, link in bodies[i])
        with faults.at(""), _told_of(links):
            if figures.mass is None:
                found.append(_stated_mass(name, bodies[i], frames[i], links))
            elif pieces[i]:
                found.append(MassFile(name=name, mass=float(figures.mass[i]), com=_triple(_middle(pieces[i]))))
    return tuple(found)


def _stated_mass(name: LinkName, body: Sequence[tuple[Transform, UrdfLink]], frame: Transform, links: str) -> MassFile:
    total = sum(link.mass for _, link in body)
    if total <= 0.0:
        raise AssetError(f"{links}: no mass is stated: add `inertial`, or give `mass` for all links that move")
    moment = sum((link.mass * (T[:3, :3] @ link.com + T[:3, 3]) for T, link in body), np.zeros(3))
    back = inverse(frame)
    return MassFile(name=name, mass=total, com=_triple(back[:3, :3] @ (moment / total) + back[:3, 3]))


def _middle(pieces: Sequence[Array]) -> Array:
    """Return the centre (3,) of the volume of convex pieces [m]."""
    hulls = [trimesh.convex.convex_hull(piece) for piece in pieces]
    volumes = np.array([hull.volume for hull in hulls])
    return volumes @ np.array([hull.center_mass for hull in hulls]) / volumes.sum()


@dataclass(frozen=True)
class _Meshes:
    """Meshes of a URDF, inside one folder or archive."""

    resolve: Resolve
    folder: str

    def vertices(self, mesh: UrdfMesh, where: str) -> Array:
        """Return the vertices (n, 3) of a mesh in its own frame [m].

        Raises:
            AssetError: There is none inside the folder, or it is not read.
        """
        name = mesh.filename
        suffix = PurePosixPath(name).suffix.removeprefix(".").lower()
        file_format = _FORMATS.get(suffix)
        if file_format is None:
            known = ", ".join(each.upper() for each in _FORMATS)
            raise AssetError(f"{where}: mesh {name[:200]!r}: collisions are checked with meshes of the kinds {known}")
        paths = list(_inside(name, self.folder))
        content = next((found for path in paths if (found := self.resolve(path)) is not None), None)
        if content is None:
            looked = " and ".join(paths) or "nowhere: only what lies inside the same folder is read"
            raise AssetError(f"{where}: mesh {name[:200]!r} is not there; it was looked for at {looked}")
        try:
            vertices, _ = read_mesh_file(content, file_format)
        except MeshRefused as error:
            raise AssetError(f"{where}: mesh {name[:200]!r}: {error}") from error
        return vertices * mesh.scale


def _inside(name: str, folder: str) -> Iterator[str]:
    """Yield where a mesh may be inside the folder: a package as a folder of its name, or as the folder itself."""
    package = "package://"
    paths = [name.removeprefix(package)] if name.startswith(package) else [f"{folder}/{name}" if folder else name]
    if name.startswith(package):
        paths.append("/".join(PurePosixPath(paths[0]).parts[1:]))
    for path in paths:
        parts = _resolved(path)
        if parts:
            yield "/".join(parts)


def _resolved(path: str) -> list[str] | None:
    """Return the steps of a relative path, None where it leads out of where it begins."""
    if path.startswith("/") or "\\" in path or ":" in path or "\0" in path:
        return None
    steps: list[str] = []
    for step in path.split("/"):
        if step == "..":
            if not steps:
                return None
            steps.pop()
        elif step not in ("", "."):
            steps.append(step)
    return steps


def _all_pieces(
    bodies: Sequence[Sequence[tuple[Transform, UrdfLink]]], frames: Array, meshes: _Meshes, faults: AssetFaults
) -> list[list[Array]]:
    """Return, by body, the corners (n, 3) of a convex hull around each of its shapes, in its frame [m].

    There are as many corners as a file of a cell may have: where a hull has more, fewer are put around it.
    """
    count = sum(len(link.solids) for body in bodies for _, link in body)
    if count > MOST_SHAPES:
        faults.add(f"the arm has {count} shapes; at most {MOST_SHAPES} are taken: join or simplify them")
        return [[] for _ in bodies]
    most = MOST_CORNERS // max(1, count)
    return [_pieces(body, frames[i], meshes, most, faults) for i, body in enumerate(bodies)]


def _pieces(
    body: Sequence[tuple[Transform, UrdfLink]], frame: Transform, meshes: _Meshes, most: int, faults: AssetFaults
) -> list[Array]:
    found: list[Array] = []
    for T_root_link, link in body:
        for solid in link.solids:
            T = inverse(frame) @ T_root_link @ solid.T_link_solid
            with faults.at(""):
                points = _points(solid, f"link {link.name!r}", meshes)
                corners = _hull(points @ T[:3, :3].T + T[:3, 3], f"link {link.name!r}")
                found.append(corners if len(corners) <= most else enclosing_hull(corners))
    if not any(link.solids for _, link in body):
        links = ", ".join(repr(link.name) for _, link in body)
        faults.add(f"{links}: no shape is stated: collisions could not be checked. Add `collision`")
    return found


def _hull(points: Array, where: str) -> Array:
    """Return the corners among points (n, 3) [m]."""
    # What is no number is not within it either.
    if not (np.abs(points) <= FARTHEST).all():
        raise AssetError(f"{where}: a shape has corners that are no numbers, or farther than {FARTHEST:g} m away")
    try:
        return points[ConvexHull(points).vertices]
    except QhullError as error:
        raise AssetError(f"{where}: a shape spans no volume") from error


def _points(solid: UrdfSolid, where: str, meshes: _Meshes) -> Array:
    """Return points (n, 3) whose hull contains a solid, in its frame [m]."""
    shape = solid.shape
    if isinstance(shape, UrdfBox):
        return box(shape.size).vertices
    if isinstance(shape, UrdfCylinder):
        return cylinder(shape.radius, shape.length, CYLINDER_SIDES).vertices
    if isinstance(shape, UrdfSphere):
        ball = trimesh.creation.icosphere(subdivisions=1)
        # Faces, not corners, are at the radius.
        flats = np.einsum("ij,ij->i", ball.face_normals, ball.triangles_center)
        return np.asarray(ball.vertices) * (shape.radius / float(flats.min()))
    return meshes.vertices(shape, where)


def _corners(piece: Array) -> tuple[Triple, ...]:
    """Return corners to a tenth of a micrometre."""
    return tuple(_triple(corner.round(7)) for corner in piece)


def _triple(vector: Array) -> Triple:
    x, y, z = vector.tolist()
    return x, y, z


_AT_ORIGIN = PlacementFile(position=(0.0, 0.0, 0.0), rpy_deg=(0.0, 0.0, 0.0))


def _placement(T: Transform) -> PlacementFile:
    """Return a transform as a file states it."""
    R = T[:3, :3]
    level = math.hypot(R[0, 0], R[1, 0])
    pitch = math.atan2(-R[2, 0], level)
    if level > EXACT:
        roll, yaw = math.atan2(R[2, 1], R[2, 2]), math.atan2(R[1, 0], R[0, 0])
    else:
        # Roll and yaw turn about one axis.
        roll, yaw = math.atan2(-R[1, 2], R[1, 1]), 0.0
    return PlacementFile(
        position=_triple(T[:3, 3]), rpy_deg=(math.degrees(roll), math.degrees(pitch), math.degrees(yaw))
    )


def _span(dh: Array) -> float:
    """Return how far no point of the flange is beyond, from where the first axis leaves the second [m]."""
    return abs(float(dh[0, 0])) + float(np.hypot(dh[1:, 0], dh[1:, 2]).sum())
