"""Bodies, arms and hands as nodes of a viser scene: made once, then only moved."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh
from viser import FrameHandle, MeshHandle, SceneApi, SceneNodeHandle

from app.viewer.drawing.link_meshes import FULL, NEAR_REACH, Detail, LinkMeshes, write_cylinders, write_pieces
from app.viewer.palette import BODIES, Rgb, rgb
from planners.cell.arm import Arm
from planners.cell.asset_files import (
    CylinderLinkFile,
    GripperFile,
    JawsFile,
    LinkFile,
    MeshFile,
    PiecesLinkFile,
    RobotFile,
    StickFile,
)
from planners.cell.asset_shelf import AssetShelf, read_hand_file, read_robot_file
from planners.cell.cell import Cell
from planners.cell.hand import Gripper, Pusher
from planners.contract.shapes import Box, Cylinder, InlineMesh, Prism
from planners.geometry.pose import Array, Transform, from_pose7, pose_row, rotation_x, rotation_z, transform
from planners.geometry.surface import hull_with_faces

EDGE_DARKENING = 0.62
OUTLINED = ("plate", "object", "support", "obstacle", "table")
"""Roles whose edges are drawn."""
TRANSLUCENT = {"plate": 0.8, "object": 0.85}
"""Opacity of roles through which the forces inside must be seen."""
TCP_AXES = 0.07
"""Length of the axes of a hand's frame, in a cell of size 1 [m]."""
LIP_HEIGHT = 0.009
"""Of the cup at the end of a tool [m]."""
CUP_PROFILE = np.array(
    [[1.0, 0.0], [1.0, 0.06], [0.72, 0.26], [0.86, 0.34], [0.60, 0.52], [0.60, 0.80], [0.34, 0.84], [0.34, 1.0]]
)
"""Radius and height of a bellows cup's outline, in radii of its lip and in its height."""
MOST_LETTERS = 24
"""Of a name in the scene: a longer one would reach out of the picture on a phone."""
NAME_END = 8
"""Letters that are kept of the end of a longer one, by which names often differ."""
SUN = (1.6, -1.2, 3.2)
"""Whence it shines."""
SENSOR_COLOUR = (44, 48, 54)
STICK_COLOUR = (176, 182, 190)
RUBBER_COLOUR = (34, 36, 40)
FINGER_TURNS = (rotation_z(math.pi), np.eye(3))
"""Finger 0 is at -y, finger 1 at +y, which a hand file describes."""


def shortened(name: str) -> str:
    """Return a name as it is written into the scene: of a long one its middle is left out."""
    if len(name) <= MOST_LETTERS:
        return name
    return f"{name[: MOST_LETTERS - NAME_END - 1]}…{name[-NAME_END:]}"


def add_frame(scene: SceneApi, name: str, T_parent_frame: Transform, axes_length: float = 0.0) -> FrameHandle:
    """Add a frame, with axes if they have a length [m]."""
    pose = pose_row(T_parent_frame)
    return scene.add_frame(
        name,
        show_axes=axes_length > 0.0,
        axes_length=axes_length,
        axes_radius=0.03 * axes_length,
        origin_radius=0.06 * axes_length,
        position=pose[:3],
        wxyz=pose[3:],
    )


def place(handle: SceneNodeHandle, T_parent_node: Transform) -> None:
    """Move a node."""
    place_at(handle, pose_row(T_parent_node))


def place_at(handle: SceneNodeHandle, pose: Array) -> None:
    """Move a node to a pose (7,) `[x, y, z, w, x, y, z]` in its parent."""
    handle.position, handle.wxyz = pose[:3], pose[3:]


def _light_scene(scene: SceneApi, root: str, detail: Detail) -> None:
    """Set light and floor: soft light from all sides, one sun, with shadows where there is time for them."""
    scene.configure_default_lights(enabled=False)
    if detail.shadows:
        scene.configure_environment_map("studio", environment_intensity=0.2)
    else:
        scene.configure_environment_map(None)
    # Without surroundings that shine from everywhere, the sky has to.
    sun, sky = (0.9, 0.55) if detail.shadows else (1.6, 2.1)
    scene.add_light_directional(
        f"{root}/lights/sun", color=(255, 250, 242), intensity=sun, cast_shadow=detail.shadows, position=SUN
    )
    scene.add_light_directional(f"{root}/lights/fill", color=(214, 228, 255), intensity=0.22, position=(-0.8, 2.0, 2.2))
    scene.add_light_ambient(f"{root}/lights/sky", color=(235, 242, 255), intensity=sky)
    scene.add_grid(
        f"{root}/floor",
        width=6.0,
        height=6.0,
        plane="xy",
        cell_size=0.25,
        section_size=1.0,
        cell_color=(152, 161, 172),
        section_color=(128, 138, 150),
        cell_thickness=0.5,
        section_thickness=0.8,
        shadow_opacity=0.25 if detail.shadows else 0.0,
    )


class Stage:
    """Light, floor and robots: what all scenes of one cell have, drawn once and kept from one plan to the next."""

    def __init__(self, scene: SceneApi, root: str, cell: Cell, meshes: LinkMeshes, detail: Detail = FULL) -> None:
        """Draw the cell with its robots at home.

        Args:
            scene: that has no other stage.
            root: name of the node that all others stand under, never used before in the server's life.
            cell: whose robots are drawn.
            meshes: drawings of them.
            detail: how much is drawn.
        """
        self.scene, self.cell, self.detail = scene, cell, detail
        self._root = add_frame(scene, root, np.eye(4))
        _light_scene(scene, root, detail)
        self._robots = add_frame(scene, f"{root}/robot", np.eye(4))
        self.robot = RobotDrawing(scene, cell, meshes, f"{root}/robot", detail)
        self.robot.pose(cell.home, {})

    def set_up(self) -> None:
        """Show the robots at home, without frames, as they are before anything is played."""
        self.show_robot(True)
        self.robot.show_frames(False)
        self.robot.pose(self.cell.home, {})

    def show_robot(self, visible: bool) -> None:
        """Show or hide the robots."""
        self._robots.visible = visible

    def remove(self) -> None:
        """Take all of it out of the scene."""
        self._root.remove()


class EmptyCell:
    """A cell with nothing to be done in it: what is seen while a plan is loaded."""

    layers = ()

    def __init__(self, stage: Stage, root: str) -> None:
        stage.set_up()
        for name, body in stage.cell.body_documents().items():
            draw_body(stage.scene, f"{root}/bodies/{name}", body.role, body.shape, body.pose)
        (table,) = (box for box in stage.cell.boxes if box.name == "table")
        self.body_position = np.array([*table.center[:2], stage.cell.table_top])
        """The middle of the table (3,), in the world [m]."""

    def set_layer(self, layer: str, visible: bool) -> None:
        """Show or hide nothing: there are no layers."""


def draw_body(
    scene: SceneApi,
    name: str,
    role: str,
    shape: Box | Cylinder | Prism | InlineMesh,
    pose: Sequence[float] | Array,
    *,
    ghost: tuple[Rgb, float] | None = None,
    tint: Rgb | None = None,
) -> FrameHandle:
    """Add a body under a frame of its own.

    Args:
        scene: where to add it.
        name: of the frame.
        role: as in a plan.
        shape: in the body's frame.
        pose: (7,) `[x, y, z, w, x, y, z]` in the world.
        ghost: colour and opacity instead of those of its role.
        tint: colour instead of that of its role.
    """
    frame = add_frame(scene, name, from_pose7(pose))
    draw_surface(scene, name, role, shape, ghost=ghost, tint=tint)
    return frame


def draw_surface(
    scene: SceneApi,
    name: str,
    role: str,
    shape: Box | Cylinder | Prism | InlineMesh,
    *,
    ghost: tuple[Rgb, float] | None = None,
    tint: Rgb | None = None,
) -> MeshHandle:
    """Add a body's surface with its edges under a frame that is there; the arguments are those of `draw_body`."""
    colour, opacity = ghost or (tint or BODIES[role], TRANSLUCENT.get(role))
    vertices, faces, round_ = surface_of(role, shape)
    drawn = scene.add_mesh_simple(
        f"{name}/surface",
        vertices,
        faces,
        color=colour,
        opacity=opacity,
        flat_shading=not round_,
        side="double" if role == "cup" else "front",
        cast_shadow=ghost is None,
        receive_shadow=ghost is None,
    )
    if role in OUTLINED and not round_:
        scene.add_line_segments(
            f"{name}/edges",
            sharp_edges(vertices, faces),
            np.array(colour) * EDGE_DARKENING / 255.0,
            thickness=1.5,
            thickness_units="screen",
        )
    if role == "tool" and ghost is None:
        _draw_lip(scene, f"{name}/lip", vertices)
    return drawn


def _draw_lip(scene: SceneApi, name: str, tool: Array) -> None:
    """Draw a cup round the lower end of a tool, whose origin is the centre of its lip."""
    lowest = tool[tool[:, 2] < LIP_HEIGHT]
    radius = 1.06 * float(np.hypot(lowest[:, 0], lowest[:, 1]).max(initial=0.0))
    if radius > 0.0:
        scene.add_cylinder(
            name, radius=radius, height=LIP_HEIGHT, color=rgb("suction"), position=(0.0, 0.0, 0.5 * LIP_HEIGHT)
        )


def surface_of(role: str, shape: Box | Cylinder | Prism | InlineMesh) -> tuple[Array, np.ndarray, bool]:
    """Return vertices (n, 3) and faces (m, 3) of a body as it is drawn, and whether its surface is round."""
    match shape:
        case Box():
            mesh = trimesh.creation.box(shape.size)
            return mesh.vertices, mesh.faces, False
        case Cylinder() if role == "cup":
            return *_cup(shape.radius, shape.height), True
        case Cylinder():
            mesh = trimesh.creation.cylinder(shape.radius, shape.height, sections=40)
            return mesh.vertices, mesh.faces, True
        case Prism():
            return *hull_of_prism(shape.outline, shape.height), False
        case InlineMesh():
            return np.array(shape.vertices), np.array(shape.faces), False


def hull_of_prism(outline: Sequence[Sequence[float]], height: float) -> tuple[Array, np.ndarray]:
    """Return vertices and faces of the hull of a prism about the origin, of an outline (n, 2) and a height [m]."""
    corners = [np.column_stack([outline, np.full(len(outline), z)]) for z in (-0.5 * height, 0.5 * height)]
    return hull_with_faces(np.vstack(corners))


def _cup(radius: float, height: float) -> tuple[Array, np.ndarray]:
    """Return a bellows cup whose lip is at the lower end of its cylinder."""
    profile = CUP_PROFILE * (radius, height) - (0.0, 0.5 * height)
    mesh = trimesh.creation.revolve(np.vstack([profile, [0.0, 0.5 * height]]), sections=40)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def sharp_edges(vertices: Array, faces: np.ndarray) -> Array:
    """Return the edges (n, 2, 3) at which the surface bends."""
    mesh = trimesh.Trimesh(vertices, faces, process=True)
    sharp = mesh.face_adjacency_edges[mesh.face_adjacency_angles > np.radians(20.0)]
    return np.asarray(mesh.vertices[sharp], dtype=float)


@dataclass(frozen=True)
class Drawings:
    """Drawings of meshes, in one detail."""

    meshes: LinkMeshes
    shelf: AssetShelf
    """Where the files of the cell are."""
    detail: Detail

    def link(self, link: LinkFile, reach: float) -> bytes:
        """Return a link's drawing as binary glTF: of the maker's mesh, or of what stands in for it.

        Args:
            link: what the robot's file says of it.
            reach: of its arm [m].
        """
        if isinstance(link, CylinderLinkFile):
            return write_cylinders([(each.start, each.end, each.radius) for each in link.cylinders])
        if isinstance(link, PiecesLinkFile):
            return write_pieces(link.pieces)
        settings = replace(self.detail.links, cell=self.detail.links.cell * max(1.0, reach / NEAR_REACH))
        return self.meshes.glb(link.mesh, self.shelf, link.transform(), settings)

    def hand(self, mesh: MeshFile) -> bytes:
        """Return the drawing of a part of a hand."""
        return self.meshes.glb(mesh, self.shelf, np.eye(4), self.detail.hands)


class RobotDrawing:
    """All arms of a cell under one node of the scene tree."""

    def __init__(self, scene: SceneApi, cell: Cell, meshes: LinkMeshes, root: str, detail: Detail) -> None:
        drawn = Drawings(meshes, cell.shelf, detail)
        self.arms = {
            name: ArmDrawing(scene, arm, drawn, f"{root}/{name}", cell.size) for name, arm in cell.arms.items()
        }

    def pose(self, positions: Array, widths: Mapping[str, float]) -> None:
        """Show joint positions (12,) [rad] and gripper openings by arm [m]."""
        for index, (name, arm) in enumerate(self.arms.items()):
            arm.pose(positions[6 * index : 6 * index + 6], widths.get(name))

    def show_frames(self, visible: bool) -> None:
        """Show or hide the frames of the hands."""
        for arm in self.arms.values():
            arm.tcp.visible = visible


class ArmDrawing:
    """One arm with its hand: a chain of frames, of which only the turning ones ever change."""

    def __init__(self, scene: SceneApi, arm: Arm, drawings: Drawings, root: str, cell_size: float = 1.0) -> None:
        self._arm = arm
        self._positions = np.full(6, np.nan)
        self._joints: list[FrameHandle] = []
        add_frame(scene, root, arm.T_world_base)
        links = link_files(arm, drawings.shelf)
        scene.add_glb(f"{root}/link_0", drawings.link(links[0], arm.robot.reach))
        parent = root
        for index, (a, alpha, d, _) in enumerate(arm.dh, start=1):
            joint = f"{parent}/joint_{index}"
            self._joints.append(add_frame(scene, joint, np.eye(4)))
            parent = f"{joint}/after"
            add_frame(scene, parent, transform(rotation_x(alpha), [a, 0.0, d]))
            scene.add_glb(f"{parent}/link_{index}", drawings.link(links[index], arm.robot.reach))
        self._hand = _draw_hand(scene, arm, drawings, parent)
        self.tcp = add_frame(scene, f"{parent}/tcp", np.eye(4), axes_length=cell_size * TCP_AXES)
        self.tcp.visible = False
        self._set_width(None)

    def pose(self, positions: Array, width: float | None) -> None:
        """Show joint positions (6,) [rad] and the gripper's opening [m]."""
        for index, handle in enumerate(self._joints):
            if positions[index] != self._positions[index]:
                half = 0.5 * (positions[index] + self._arm.dh[index, 3])
                handle.wxyz = (math.cos(half), 0.0, 0.0, math.sin(half))
        self._positions = positions.copy()
        if width is not None:
            self._set_width(width)

    def _set_width(self, width: float | None) -> None:
        T_flange_tcp = self._hand.set_width(width)
        if T_flange_tcp is not None:
            place(self.tcp, T_flange_tcp)


class _StickDrawing:
    """A sensor, a stick and its round tip."""

    def __init__(self, scene: SceneApi, hand: Pusher, flange: str) -> None:
        self._hand: Pusher | None = hand
        bottom = _draw_sensor(scene, hand, flange)
        centre = float(hand.T_flange_tcp[2, 3])
        scene.add_cylinder(
            f"{flange}/stick",
            radius=hand.stick.radius,
            height=centre - bottom,
            color=STICK_COLOUR,
            position=(0.0, 0.0, 0.5 * (centre + bottom)),
        )
        scene.add_icosphere(
            f"{flange}/tip", radius=1.02 * hand.tip_radius, color=RUBBER_COLOUR, position=(0.0, 0.0, centre)
        )

    def set_width(self, _: float | None) -> Transform | None:
        """Return `T_flange_tcp` if it is new."""
        hand, self._hand = self._hand, None
        return None if hand is None else hand.T_flange_tcp


class _GripperDrawing:
    """A sensor, the gripper's base, and the parts of both fingers."""

    def __init__(
        self, scene: SceneApi, hand: Gripper, file: GripperFile | JawsFile, drawings: Drawings, flange: str
    ) -> None:
        self._hand, self._width = hand, math.nan
        _draw_sensor(scene, hand, flange)
        self._T_flange_base = transform(None, [0.0, 0.0, hand.base_height])
        add_frame(scene, f"{flange}/gripper", self._T_flange_base)
        _draw_part(scene, f"{flange}/gripper/base", file, "base", drawings)
        self._parts: list[dict[str, FrameHandle]] = []
        for finger in range(2):
            frames = {}
            for part in (*hand.finger_parts, "pad"):
                name = f"{flange}/finger_{finger}_{part}"
                frames[part] = add_frame(scene, name, np.eye(4))
                if part == "pad":
                    scene.add_box(f"{name}/box", color=RUBBER_COLOUR, dimensions=hand.pad_size)
                else:
                    _draw_part(scene, f"{name}/drawn", file, part, drawings)
            self._parts.append(frames)

    def set_width(self, width: float | None) -> Transform | None:
        """Show an opening [m], the widest when None; return `T_flange_tcp` if it is new."""
        hand = self._hand
        wanted = hand.width_max if width is None else min(max(width, 0.0), hand.width_max)
        if wanted == self._width:
            return None
        self._width = wanted
        poses = hand.fingers.frames(wanted)
        for turn, frames in zip(FINGER_TURNS, self._parts, strict=True):
            T_flange_side = self._T_flange_base @ transform(turn)
            for part, handle in frames.items():
                place(handle, T_flange_side @ poses[part])
        return hand.T_flange_tcp(wanted)


def _draw_hand(scene: SceneApi, arm: Arm, drawings: Drawings, flange: str) -> _StickDrawing | _GripperDrawing:
    if isinstance(arm.hand, Pusher):
        return _StickDrawing(scene, arm.hand, flange)
    file = read_hand_file(drawings.shelf.find("hands", arm.hand.name))
    assert not isinstance(file, StickFile)
    return _GripperDrawing(scene, arm.hand, file, drawings, flange)


def _draw_part(scene: SceneApi, name: str, file: GripperFile | JawsFile, part: str, drawings: Drawings) -> None:
    """Draw the base or a finger's part of a gripper, in the frame that the name is in."""
    if isinstance(file, GripperFile):
        scene.add_glb(name, drawings.hand(getattr(file.meshes, part)))
        return
    described = file.base if part == "base" else file.finger[part]
    scene.add_box(name, color=SENSOR_COLOUR, dimensions=described.size, position=described.center)


def _draw_sensor(scene: SceneApi, hand: Gripper | Pusher, flange: str) -> float:
    """Draw the force-torque sensor, if there is one, and return how far it reaches from the flange [m]."""
    if hand.sensor is None:
        return 0.0
    vertices, faces = hull_with_faces(hand.sensor.vertices)
    scene.add_mesh_simple(f"{flange}/sensor", vertices, faces, color=SENSOR_COLOUR, flat_shading=True)
    return float(vertices[:, 2].max())


def link_files(arm: Arm, shelf: AssetShelf) -> tuple[LinkFile, ...]:
    """Return the meshes of an arm's links, those of another robot where its file says so."""
    file: RobotFile = read_robot_file(shelf.find("robots", arm.robot.name))
    if file.links is None:
        file = read_robot_file(shelf.find("robots", str(file.links_of)))
    assert file.links is not None
    return file.links
