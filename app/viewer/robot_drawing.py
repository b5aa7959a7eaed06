"""The arms and hands of a cell in a scene: made once, then posed by joint angles and gripper openings."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from viser import FrameHandle, SceneApi

from app.viewer.link_meshes import HANDS, LinkMeshes
from app.viewer.nodes import add_frame, place
from planners.cell.arm import Arm
from planners.cell.asset_files import (
    AssetShelf,
    GripperFile,
    LinkFile,
    RobotFile,
    read_hand_file,
    read_robot_file,
    shipped_shelf,
)
from planners.cell.cell import Cell
from planners.cell.hand import Gripper, Pusher
from planners.geometry.pose import Array, Transform, rotation_x, rotation_z, transform
from planners.geometry.surface import hull_with_faces

SENSOR_COLOUR = (44, 48, 54)
STICK_COLOUR = (176, 182, 190)
RUBBER_COLOUR = (34, 36, 40)
FINGER_TURNS = (rotation_z(math.pi), np.eye(3))
"""Finger 0 is at -y, finger 1 at +y, which a hand file describes."""


class RobotDrawing:
    """All arms of a cell under one node of the scene tree."""

    def __init__(self, scene: SceneApi, cell: Cell, meshes: LinkMeshes, root: str) -> None:
        shelf = shipped_shelf()
        self.arms = {name: ArmDrawing(scene, arm, meshes, shelf, f"{root}/{name}") for name, arm in cell.arms.items()}

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

    def __init__(self, scene: SceneApi, arm: Arm, meshes: LinkMeshes, shelf: AssetShelf, root: str) -> None:
        self._arm = arm
        self._positions = np.full(6, np.nan)
        self._joints: list[FrameHandle] = []
        add_frame(scene, root, arm.T_world_base)
        links = link_files(arm, shelf)
        _draw_link(scene, f"{root}/link_0", meshes, links[0])
        parent = root
        for index, (a, alpha, d, _) in enumerate(arm.dh, start=1):
            joint = f"{parent}/joint_{index}"
            self._joints.append(add_frame(scene, joint, np.eye(4)))
            parent = f"{joint}/after"
            add_frame(scene, parent, transform(rotation_x(alpha), [a, 0.0, d]))
            _draw_link(scene, f"{parent}/link_{index}", meshes, links[index])
        self._hand = _draw_hand(scene, arm, meshes, shelf, parent)
        self.tcp = add_frame(scene, f"{parent}/tcp", np.eye(4), axes_length=0.07)
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

    def __init__(self, scene: SceneApi, hand: Gripper, file: GripperFile, meshes: LinkMeshes, flange: str) -> None:
        self._hand, self._width = hand, math.nan
        _draw_sensor(scene, hand, flange)
        self._T_flange_base = transform(None, [0.0, 0.0, hand.base_height])
        scene.add_glb(
            f"{flange}/gripper", meshes.glb(file.meshes.base, np.eye(4), HANDS), position=(0.0, 0.0, hand.base_height)
        )
        self._parts: list[dict[str, FrameHandle]] = []
        for finger in range(2):
            frames = {}
            for part in (*hand.finger_parts, "pad"):
                name = f"{flange}/finger_{finger}_{part}"
                frames[part] = add_frame(scene, name, np.eye(4))
                if part == "pad":
                    scene.add_box(f"{name}/box", color=RUBBER_COLOUR, dimensions=hand.pad_size)
                else:
                    scene.add_glb(f"{name}/mesh", meshes.glb(getattr(file.meshes, part), np.eye(4), HANDS))
            self._parts.append(frames)

    def set_width(self, width: float | None) -> Transform | None:
        """Show an opening [m], the widest when None; return `T_flange_tcp` if it is new."""
        hand = self._hand
        wanted = hand.width_max if width is None else min(max(width, 0.0), hand.width_max)
        if wanted == self._width:
            return None
        self._width = wanted
        poses = hand.linkage.frames(hand.linkage.angle(wanted))
        for turn, frames in zip(FINGER_TURNS, self._parts, strict=True):
            T_flange_side = self._T_flange_base @ transform(turn)
            for part, handle in frames.items():
                place(handle, T_flange_side @ poses[part])
        return hand.T_flange_tcp(wanted)


def _draw_hand(
    scene: SceneApi, arm: Arm, meshes: LinkMeshes, shelf: AssetShelf, flange: str
) -> _StickDrawing | _GripperDrawing:
    if isinstance(arm.hand, Pusher):
        return _StickDrawing(scene, arm.hand, flange)
    file = read_hand_file(shelf.find("hands", arm.hand.name, "hand"))
    assert isinstance(file, GripperFile)
    return _GripperDrawing(scene, arm.hand, file, meshes, flange)


def _draw_sensor(scene: SceneApi, hand: Gripper | Pusher, flange: str) -> float:
    """Draw the force-torque sensor and return how far it reaches from the flange [m]."""
    vertices, faces = hull_with_faces(hand.sensor.vertices)
    scene.add_mesh_simple(f"{flange}/sensor", vertices, faces, color=SENSOR_COLOUR, flat_shading=True)
    return float(vertices[:, 2].max())


def link_files(arm: Arm, shelf: AssetShelf) -> tuple[LinkFile, ...]:
    """Return the meshes of an arm's links, those of another robot where its file says so."""
    file: RobotFile = read_robot_file(shelf.find("robots", arm.robot.name, "robot"))
    if file.links is None:
        file = read_robot_file(shelf.find("robots", str(file.links_of), "links_of"))
    assert file.links is not None
    return file.links


def _draw_link(scene: SceneApi, name: str, meshes: LinkMeshes, link: LinkFile) -> None:
    scene.add_glb(name, meshes.glb(link.mesh, link.transform()))
