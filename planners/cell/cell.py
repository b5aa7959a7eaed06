"""The cell: two arms with their hands, the table, and the platform they are mounted on."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from threading import Lock
from types import MappingProxyType
from typing import Self

import numpy as np

from planners.cell.arm import Arm, Robot, load_robot
from planners.cell.asset_files import (
    ARM_NAMES,
    MOST_TOOLS,
    ArmSide,
    BoxFile,
    CellFile,
    FrameFile,
    LifterFile,
    MeshBodyFile,
    MeshFile,
    MountFile,
    ToolRestFile,
)
from planners.cell.asset_shelf import (
    PARTS,
    AssetShelf,
    fingerprint,
    part_names,
    read_cell_file,
    read_mount_file,
    shipped_shelf,
)
from planners.cell.cell_size import size_of
from planners.cell.cell_tool import CellTool, load_cell_tool
from planners.cell.hand import Gripper, Pusher, load_hand
from planners.contract.shapes import Box, InlineMesh
from planners.errors import AssetError, AssetFaults
from planners.geometry.convex import CollisionBody, box, sorted_pair
from planners.geometry.mesh_file import MOST_TRIANGLES
from planners.geometry.pose import Array, Transform, to_pose7, transform
from planners.geometry.solid_mesh import SolidMesh
from planners.plan.scenery import BodyDocument, CellDocument, MarginsDocument


@dataclass(frozen=True, eq=False)
class StaticBox:
    """A box along the world's axes that never moves."""

    name: str
    role: str
    """"table" or "frame", as in a plan document."""
    center: Array
    """(3,) [m]."""
    size: Array
    """(3,) full lengths [m]."""

    def collision_body(self) -> CollisionBody:
        """Return the box for collision queries."""
        shape = box(self.size).placed(transform(None, self.center))
        return CollisionBody(self.name, "cell", "world", (shape,))

    def document(self) -> BodyDocument:
        """Return the entry of a plan's `bodies`."""
        return BodyDocument(
            role=self.role,
            shape=Box(type="box", size=tuple(self.size.tolist())),
            mass=None,
            com=np.zeros(3),
            pose=np.array([*self.center, 1.0, 0.0, 0.0, 0.0]),
            static=True,
        )


@dataclass(frozen=True, eq=False)
class StaticMesh:
    """One closed solid that never moves."""

    name: str
    role: str
    """"frame", as in a plan document."""
    mesh: SolidMesh
    """In its own frame [m]."""
    T_world_mesh: Transform

    def collision_body(self) -> CollisionBody:
        """Return convex parts that contain it, for collision queries."""
        parts = tuple(part.placed(self.T_world_mesh) for part in self.mesh.drawn.parts)
        return CollisionBody(self.name, "cell", "world", parts)

    def document(self) -> BodyDocument:
        """Return the entry of a plan's `bodies`."""
        return BodyDocument(
            role=self.role,
            shape=InlineMesh.of(self.mesh.vertices, self.mesh.faces, self.mesh.parts),
            mass=None,
            com=np.zeros(3),
            pose=np.array(to_pose7(self.T_world_mesh)),
            static=True,
        )


@dataclass(frozen=True)
class CellLifter:
    """The vacuum lifter that hangs above the table."""

    cup_height: float
    """From the plate to where the cable begins [m]."""
    cable_radius: float
    """[m]"""
    cable_length: float
    """[m]"""
    max_force: float
    """What it lifts at most [N]; infinite where the cell does not say."""


@dataclass(frozen=True)
class CellMargins:
    """The collision margins that a cell asks for."""

    bodies: float
    """Between any two bodies that have nothing to do with one another [m]."""


@dataclass(frozen=True, eq=False)
class ToolRest:
    """A square socket on the table in which a suction tool stands upright on its cup."""

    T_world_tool: Transform
    """Where a tool stands in it."""
    walls: tuple[StaticBox, ...]

    @property
    def depth(self) -> float:
        """Height of the walls [m]."""
        return float(self.walls[0].size[2])


@dataclass(frozen=True, eq=False)
class Cell:
    """Everything that stays when the task changes."""

    name: str
    hash: str
    """Of the content of all files the cell is made of, meshes included."""
    arms: dict[str, Arm]
    """By name, left first."""
    boxes: tuple[StaticBox, ...]
    """The table first; the walls of the tool rest, if any, are among them."""
    meshes: tuple[StaticMesh, ...]
    """What else never moves."""
    gravity: Array
    """(3,) [m/s^2]."""
    tool_rest: ToolRest | None
    """Where a suction tool is kept."""
    lifter: CellLifter
    shelf: AssetShelf
    """Where its files were found."""
    mount: str
    """Name of the file that says where arms, table and platform are."""
    tools: Mapping[str, CellTool]
    """By name, the suction tools that it brings; the shipped ones are there in every cell."""
    margins: CellMargins | None = None
    """None: those that planning keeps where no cell says otherwise."""

    @cached_property
    def bodies(self) -> tuple[CollisionBody, ...]:
        """The table and the platform, in frame "world"."""
        return tuple(static.collision_body() for static in self.still)

    @property
    def still(self) -> tuple[StaticBox | StaticMesh, ...]:
        """What never moves: boxes, then meshes."""
        return (*self.boxes, *self.meshes)

    @property
    def table_top(self) -> float:
        """Height of the table's top [m]."""
        return float(self.boxes[0].center[2] + 0.5 * self.boxes[0].size[2])

    @cached_property
    def size(self) -> float:
        """How many times as large as the papers' laboratory it is, at least 1 [1]: lengths of planning grow with it."""
        return size_of(self.arms.values())

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Twelve names: the left arm's six, then the right's."""
        return tuple(name for arm in self.arms.values() for name in arm.joint_names)

    @property
    def gripper_arms(self) -> tuple[str, ...]:
        """Names of the arms that carry a gripper."""
        return tuple(name for name, arm in self.arms.items() if isinstance(arm.hand, Gripper))

    @property
    def pusher_arms(self) -> tuple[str, ...]:
        """Names of the arms that carry a stick."""
        return tuple(name for name, arm in self.arms.items() if isinstance(arm.hand, Pusher))

    def gripper(self, arm: str) -> Gripper:
        """Return the hand of one of the `gripper_arms`."""
        hand = self.arms[arm].hand
        assert isinstance(hand, Gripper)
        return hand

    def payload_force(self, arm: str) -> float:
        """Return the largest net force that an arm's hand may bear: what its payload leaves beside the hand [N]."""
        return self.arms[arm].spare_payload * float(np.linalg.norm(self.gravity))

    @property
    def home(self) -> Array:
        """(12,) where all joints rest [rad]."""
        return np.concatenate([arm.home for arm in self.arms.values()])

    def collision_bodies(self, widths: Mapping[str, float] | None = None) -> tuple[CollisionBody, ...]:
        """Return links, hands and the cell's own bodies.

        Args:
            widths: opening of each gripper by arm [m]; a gripper not listed is fully open.

        Raises:
            WidthError: A gripper does not open so far.
        """
        widths = widths or {}
        on_arms = [(*arm.link_bodies(), *arm.hand_bodies(widths.get(name))) for name, arm in self.arms.items()]
        return (*itertools.chain.from_iterable(on_arms), *self.bodies)

    @cached_property
    def body_names(self) -> frozenset[str]:
        """Names of links, hands and the cell's own bodies."""
        return frozenset(body.name for body in self.collision_bodies())

    @cached_property
    def excluded_pairs(self) -> frozenset[tuple[str, str]]:
        """Sorted pairs of names that are never checked.

        Two rules, neither of which can hide a collision:

        - Nothing that never moves is checked against another: cell bodies, and the base links bolted to them. No
          motion changes these pairs. (The bases overlap the platform, which is how they are mounted.)
        - On one arm, nothing is checked whose frames are at most one joint apart: parts of one link or hand, and
          neighbours across a joint, which touch in its housing. The makers' ranges keep neighbours from meeting
          elsewhere; and what is mounted on the flange stays on the far side of it, where wrist 2 never is.
        """
        bodies = self.collision_bodies()
        pairs = itertools.combinations(bodies, 2)
        return frozenset(sorted_pair(a.name, b.name) for a, b in pairs if _never_collide(a.frame, b.frame))

    def body_documents(self) -> dict[str, BodyDocument]:
        """Return the entries of the table and the platform in a plan's `bodies`."""
        return {static.name: static.document() for static in self.still}

    def document(self) -> CellDocument:
        """Return a plan's `cell`."""
        document = CellDocument(
            name=self.name,
            hash=self.hash,
            gravity=self.gravity,
            arms={name: arm.document() for name, arm in self.arms.items()},
            hands={name: arm.hand.document() for name, arm in self.arms.items()},
        )
        # What a cell does not bring is left out, as it was before any could.
        if self.tools:
            document = document.model_copy(
                update={"tools": {name: each.document() for name, each in self.tools.items()}}
            )
        if self.margins is not None:
            document = document.model_copy(update={"margins": MarginsDocument(bodies=self.margins.bodies)})
        return document


@cache
def known_cells() -> tuple[str, ...]:
    """Return the names of the cells that are shipped: that does not change while a process runs."""
    return tuple(shipped_shelf().names("cells"))


@cache
def load_cell(name: str) -> Cell:
    """Load a shipped cell, once, as `known_cells` looks once.

    Raises:
        AssetError: There is none of this name, or one of its files is wrong; the message names file and field.
    """
    shelf = shipped_shelf()
    return read_cell(shelf.find("cells", name), shelf)


_LOADING = Lock()


class ShippedCells(Mapping[str, Cell]):
    """The shipped cells by name, each of which is loaded when it is first asked for, and others beside them."""

    def __init__(self, others: Mapping[str, Cell] = MappingProxyType({})) -> None:
        """Take the others, by name."""
        self._others = others

    def __getitem__(self, name: str) -> Cell:
        if name in self._others:
            return self._others[name]
        if name not in known_cells():
            raise KeyError(name)
        # One of several threads that ask at once loads it: there is one value of each cell.
        with _LOADING:
            return load_cell(name)

    def __contains__(self, name: object) -> bool:
        return name in self._others or name in known_cells()

    def __iter__(self) -> Iterator[str]:
        yield from dict.fromkeys((*known_cells(), *self._others))

    def __len__(self) -> int:
        return len(list(iter(self)))


def load_cells() -> dict[str, Cell]:
    """Load every shipped cell, by name.

    Raises:
        AssetError: One of their files is wrong; the message names file and field.
    """
    return dict(ShippedCells())


def read_cell(path: Path, shelf: AssetShelf) -> Cell:
    """Load the cell of a file, with what it names on a shelf.

    Raises:
        AssetError: Something is wrong with it; every fault names its file and member.
    """
    faults = AssetFaults()
    return CellParts.read(path, shelf, faults).whole(faults)


@dataclass(frozen=True, eq=False)
class CellParts:
    """What of a cell's files can be used, whatever is wrong with others of them."""

    file: CellFile | None
    """None: something is wrong with it."""
    mount: MountFile | None
    """None: something is wrong with it, or the cell names none."""
    arms: Mapping[str, Arm]
    """Those of which robot, hand and place are there, left first."""
    meshes: tuple[StaticMesh, ...]
    """Those of the mount that can be read."""
    tools: Mapping[str, CellTool]
    """Those of its suction tools that can be read."""
    shelf: AssetShelf
    """Where the files were found."""

    @classmethod
    def read(cls, path: Path, shelf: AssetShelf, faults: AssetFaults) -> Self:
        """Read a cell's file and all that it names, each once, and gather what is wrong with any of it.

        Args:
            path: of the cell's file.
            shelf: where to look for what it names.
            faults: where everything that is wrong is added, with its file and member.
        """
        file, mount = None, None
        robots, hands, named = dict[str, Robot](), dict[str, Gripper | Pusher](), part_names("cells", path)
        with faults.at(str(path)):
            file = read_cell_file(path)
        with faults.at(str(path), "/mount"):
            name = named.get("mount")
            mount = None if name is None else read_mount_file(shelf.find("mounts", name))
        for member, kind in PARTS["cells"]:
            with faults.at(str(path), f"/{member}"):
                name = named.get(member, "")
                if kind == "robots" and name and name not in robots:
                    robots[name] = load_robot(name, shelf)
                elif kind == "hands" and name and name not in hands:
                    hands[name] = load_hand(name, shelf)
        tools = _tools(shelf, str(path), faults)
        if mount is None:
            return cls(file, mount, {}, (), tools, shelf)
        arms = dict[str, Arm]()
        for side in ARM_NAMES:
            robot, hand = (named.get(f"arms/{side}/{member}", "") for member in ("robot", "hand"))
            if robot in robots and hand in hands:
                arms[side] = _arm(side, mount, robots[robot], hands[hand])
        _check_payloads(arms, str(path), faults)
        if len(arms) == len(ARM_NAMES) and not any(isinstance(arm.hand, Gripper) for arm in arms.values()):
            detail = "two sticks hold nothing: a plate lift needs a gripper and a stick, a suction tool two grippers"
            faults.add(detail, str(path), "/arms")
        return cls(file, mount, arms, _meshes(mount, shelf, faults), tools, shelf)

    def whole(self, faults: AssetFaults) -> Cell:
        """Return the cell, in which nothing is wrong.

        Args:
            faults: all that was gathered of it, what is missing included.

        Raises:
            AssetError: There are some.
        """
        faults.raise_any()
        assert self.assembled is not None
        return self.assembled

    @property
    def table(self) -> StaticBox:
        """The table of the mount that there is."""
        assert self.mount is not None
        return _boxes(self.mount)[0]

    @cached_property
    def assembled(self) -> Cell | None:
        """The cell without what cannot be used of it; None: too little is there."""
        file, mount, arms = self.file, self.mount, self.arms
        if file is None or mount is None or len(arms) < len(ARM_NAMES):
            return None
        # A cell that says nothing of margins has the hash that it had before any could.
        unsaid = {"margins"} if file.margins is None else None
        contents = [file.model_dump_json(exclude=unsaid), mount.model_dump_json()]
        contents += [text for arm in arms.values() for text in (arm.robot.fingerprint, arm.hand.fingerprint)]
        contents += [fingerprint((each.mesh.vertices.tobytes(), each.mesh.faces.tobytes())) for each in self.meshes]
        contents += [tool.fingerprint for tool in self.tools.values()]
        digest = fingerprint(text.encode() for text in contents)
        rest = None if file.tool_rest is None else _tool_rest(file.tool_rest, mount)
        boxes = (*_boxes(mount), *(() if rest is None else rest.walls))
        gravity, lifter = np.array(file.gravity), _lifter(file.lifter or LifterFile())
        return Cell(
            name=file.name,
            hash=digest,
            arms=dict(arms),
            boxes=boxes,
            meshes=self.meshes,
            gravity=gravity,
            tool_rest=rest,
            lifter=lifter,
            shelf=self.shelf,
            mount=file.mount,
            tools=self.tools,
            margins=None if file.margins is None else CellMargins(file.margins.bodies),
        )


def _arm(side: ArmSide, mount: MountFile, robot: Robot, hand: Gripper | Pusher) -> Arm:
    place = mount.arms[side]
    return Arm(side, robot, place.transform() @ robot.T_mount_base, np.radians(place.home_deg), hand)


def _check_payloads(arms: Mapping[str, Arm], path: str, faults: AssetFaults) -> None:
    for name, arm in arms.items():
        if arm.spare_payload <= 0.0:
            bears = f"{arm.robot.name} bears {arm.robot.payload:.4g} kg at its flange"
            faults.add(f"{arm.hand.name} weighs {arm.hand.mass:.4g} kg, and {bears}", path, f"/arms/{name}/hand")


def _boxes(mount: MountFile) -> tuple[StaticBox, ...]:
    boxes = ((name, file) for name, file in mount.platform.items() if isinstance(file, BoxFile))
    platform = [_static_box(f"platform_{name}", "frame", file) for name, file in boxes]
    return (_static_box("table", "table", mount.table), *platform, *_columns(mount.frame))


def _meshes(mount: MountFile, shelf: AssetShelf, faults: AssetFaults) -> tuple[StaticMesh, ...]:
    """Load the meshes among what never moves, equal ones once: covering one by convex parts takes up to ten seconds."""
    meshes, known, triangles = list[StaticMesh](), dict[MeshFile, SolidMesh](), 0
    path = str(shelf.find("mounts", mount.name))
    for name, file in mount.platform.items():
        if isinstance(file, MeshBodyFile):
            with faults.at(path, f"/platform/{name}/mesh"):
                if triangles > MOST_TRIANGLES:
                    told = (
                        f"the meshes before it have {triangles} triangles together, at most {MOST_TRIANGLES} are taken"
                    )
                    raise AssetError(f"{told}: simplify them")
                if file.mesh not in known:
                    known[file.mesh] = shelf.solid(file.mesh)
                    triangles += len(known[file.mesh].faces)
                meshes.append(StaticMesh(f"platform_{name}", "frame", known[file.mesh], file.transform()))
    return tuple(meshes)


def _tools(shelf: AssetShelf, path: str, faults: AssetFaults) -> dict[str, CellTool]:
    """Load the suction tools of a cell's own folders."""
    tools, names = dict[str, CellTool](), shelf.own_names("tools")
    if len(names) > MOST_TOOLS:
        faults.add(f"brings {len(names)} suction tools; at most {MOST_TOOLS} are taken", path)
        return tools
    for name in names:
        with faults.at(str(shelf.find("tools", name))):
            tools[name] = load_cell_tool(name, shelf)
    return tools


def _lifter(file: LifterFile) -> CellLifter:
    most = float("inf") if file.max_force is None else file.max_force
    return CellLifter(file.cup_height, file.cable_radius, file.cable_length, most)


def _tool_rest(file: ToolRestFile, mount: MountFile) -> ToolRest:
    """Put four walls round the place; those in front and behind close the corners."""
    x, y = file.position
    top = mount.table.center[2] + 0.5 * mount.table.size[2]
    middle = file.clearance + 0.5 * file.thickness
    z = top + 0.5 * file.height
    across = np.array([file.thickness, 2.0 * (file.clearance + file.thickness), file.height])
    along = np.array([2.0 * file.clearance, file.thickness, file.height])
    walls = (
        StaticBox("tool_rest_front", "frame", np.array([x + middle, y, z]), across),
        StaticBox("tool_rest_back", "frame", np.array([x - middle, y, z]), across),
        StaticBox("tool_rest_left", "frame", np.array([x, y + middle, z]), along),
        StaticBox("tool_rest_right", "frame", np.array([x, y - middle, z]), along),
    )
    return ToolRest(transform(position=[x, y, top]), walls)


def _static_box(name: str, role: str, file: BoxFile) -> StaticBox:
    return StaticBox(name, role, np.array(file.center), np.array(file.size))


def _columns(frame: FrameFile) -> list[StaticBox]:
    size = np.array([frame.profile, frame.profile, frame.height])
    centers = [np.array([x, y, 0.5 * frame.height]) for x, y in frame.columns]
    return [StaticBox(f"frame_{i}", "frame", center, size) for i, center in enumerate(centers)]


def _never_collide(frame_a: str, frame_b: str) -> bool:
    """Tell whether the rules of `Cell.excluded_pairs` leave out bodies of these frames."""
    arm_a, _, joints_a = frame_a.partition("/")
    arm_b, _, joints_b = frame_b.partition("/")
    # The world has no joints; bases are after none.
    a, b = int(joints_a or 0), int(joints_b or 0)
    if a == 0 and b == 0:
        return True
    return arm_a == arm_b and abs(a - b) <= 1
