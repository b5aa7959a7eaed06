"""Nodes of a viser scene, placed by transforms and by a document's poses."""

from __future__ import annotations

import numpy as np
from viser import FrameHandle, SceneApi, SceneNodeHandle

from planners.geometry.pose import Array, Transform, to_pose7


def add_frame(scene: SceneApi, name: str, T_parent_frame: Transform, axes_length: float = 0.0) -> FrameHandle:
    """Add a frame, with axes if they have a length [m]."""
    pose = np.array(to_pose7(T_parent_frame))
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
    place_at(handle, np.array(to_pose7(T_parent_node)))


def place_at(handle: SceneNodeHandle, pose: Array) -> None:
    """Move a node to a pose (7,) `[x, y, z, w, x, y, z]` in its parent."""
    handle.position, handle.wxyz = pose[:3], pose[3:]
