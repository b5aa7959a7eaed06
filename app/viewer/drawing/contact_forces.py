"""Contact forces in a scene: arrows, their sizes in newtons, friction cones."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Set
from dataclasses import replace

import numpy as np
from viser import ArrowsHandle, LabelHandle, SceneApi, SceneNodeHandle

from app.viewer.drawing.body_drawing import add_frame, place
from app.viewer.palette import linear_rgb, meaning_of, rgb
from planners.cell.cell import Cell
from planners.geometry.pose import Array, Transform, frame_from_z, transform
from planners.plan.timeline import ContactForce
from planners.scene.suction_tool import TOOL_NAME

LEAST_FORCE = 0.05
"""Smaller forces are not drawn [N]."""
LEAST_TOLD_FORCE = 0.5
"""The size of smaller ones is not written beside them [N]."""
CONE_HEIGHT = 0.06
"""In a cell of size 1 [m]."""
ARROW_MEANINGS = ("left", "right", "environment", "suction")
WITH_FRICTION_CONE = frozenset({"soft_finger", "point", "environment"})
"""Kinds of contacts."""


class ContactDrawing:
    """Contact forces as arrows, their sizes in newtons, and friction cones."""

    def __init__(self, scene: SceneApi, root: str, cell: Cell, metres_per_newton: float) -> None:
        """Draw nothing yet, under a node that is named `root`, in a cell, with arrows of a length for each newton."""
        self._scene, self._arms, self._metres_per_newton = scene, frozenset(cell.arms), metres_per_newton
        self._size = cell.size
        self.arrows, self.newtons, self.cones = (f"{root}/{part}" for part in ("arrows", "newtons", "cones"))
        """Names of the nodes that all of a kind are below."""
        for part in (self.arrows, self.newtons, self.cones):
            add_frame(scene, part, np.eye(4))
        self._arrows = {meaning: self._add_arrows(meaning) for meaning in ARROW_MEANINGS}
        self._newtons: list[LabelHandle] = []
        self._cones: dict[tuple[str, float, int], SceneNodeHandle] = {}

    def show(self, contacts: Iterable[ContactForce], layers: Set[str]) -> None:
        """Show those of `forces`, `newtons` and `cones` that are among `layers`."""
        forces = [force for force in contacts if _is_drawn(force)]
        for meaning, handle in self._arrows.items():
            mine = [t for t in forces if meaning_of(t.by, self._arms, t.kind) == meaning]
            drawn = bool(mine) and "forces" in layers
            if drawn:
                points = np.array([self._arrow(force) for force in mine], dtype=np.float32)
                if not np.array_equal(points, handle.points):
                    handle.points = points
            if handle.visible != drawn:
                handle.visible = drawn
        self._show_newtons(forces if layers >= {"forces", "newtons"} else [])
        self._show_cones(forces if "cones" in layers else [])

    def _show_newtons(self, forces: Iterable[ContactForce]) -> None:
        """Write its size beside the tip of each force, as names stand over bodies; what is not needed stays, hidden."""
        told = [
            (f"{size:.1f} N", self._arrow(force)[0 if _is_seen_outside(force) else 1])
            for force in forces
            if (size := float(np.linalg.norm(force.force))) >= LEAST_TOLD_FORCE
        ]
        while len(self._newtons) < len(told):
            name = f"{self.newtons}/{len(self._newtons)}"
            self._newtons.append(self._scene.add_label(name, "", font_screen_scale=0.95, anchor="bottom-left"))
        for label, (words, tip) in zip(self._newtons, told, strict=False):
            if label.text != words:
                label.text = words
            label.position = tip
        for index, label in enumerate(self._newtons):
            if label.visible != (index < len(told)):
                label.visible = index < len(told)

    def _show_cones(self, forces: Iterable[ContactForce]) -> None:
        """Every cone that was ever needed stays in the scene, hidden while it is not."""
        used = set[tuple[str, float, int]]()
        for force in forces:
            if force.kind not in WITH_FRICTION_CONE:
                continue
            meaning = meaning_of(force.by, self._arms, force.kind)
            number = sum(key[:2] == (meaning, force.mu) for key in used)
            key = (meaning, force.mu, number)
            used.add(key)
            if key not in self._cones:
                self._cones[key] = self._add_cone(*key)
            place(self._cones[key], _cone_pose(force, outside=_is_seen_outside(force)))
        for key, handle in self._cones.items():
            if handle.visible != (key in used):
                handle.visible = key in used

    def _arrow(self, force: ContactForce) -> Array:
        """Return start and end (2, 3) of a force: it ends at its point outside a body, or begins there."""
        along = self._metres_per_newton * force.force
        begin = force.point - along if _is_seen_outside(force) else force.point
        return np.array([begin, begin + along])

    def _add_arrows(self, meaning: str) -> ArrowsHandle:
        return self._scene.add_arrows(
            f"{self.arrows}/{meaning}",
            np.zeros((1, 2, 3), dtype=np.float32),
            linear_rgb(meaning),
            # How long a newton is drawn is told; how thick, nobody reads.
            shaft_radius=0.55 * self._size * self._metres_per_newton,
            head_radius=1.4 * self._size * self._metres_per_newton,
            head_length=3.0 * self._size * self._metres_per_newton,
            visible=False,
        )

    def _add_cone(self, meaning: str, mu: float, number: int) -> SceneNodeHandle:
        vertices, faces = _cone(mu, self._size * CONE_HEIGHT)
        return self._scene.add_mesh_simple(
            f"{self.cones}/{meaning}_{mu:g}_{number}".replace(".", "p"),
            vertices,
            faces,
            color=rgb(meaning),
            opacity=0.3,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )


def by_hand(forces: Iterable[ContactForce]) -> list[ContactForce]:
    """Put one force in place of those of a hand's fingers on a body, midway between them.

    That is what the hand bears, without its squeeze.
    """
    result, fingers = list[ContactForce](), defaultdict[tuple[str, str], list[ContactForce]](list)
    for force in forces:
        if force.kind == "soft_finger":
            fingers[force.by, force.body].append(force)
        else:
            result.append(force)
    for pair in fingers.values():
        point = np.mean([each.point for each in pair], axis=0)
        moments = [each.wrench[3:] + np.cross(each.point - point, each.force) for each in pair]
        wrench = np.concatenate([np.sum([each.force for each in pair], axis=0), np.sum(moments, axis=0)])
        result.append(replace(pair[0], finger=None, point=point, wrench=wrench))
    return result


def _is_drawn(force: ContactForce) -> bool:
    """Tell whether a force is drawn: not the smallest, and a cup's on the object only, not its reaction."""
    if force.kind == "suction" and force.body == TOOL_NAME:
        return False
    return bool(np.linalg.norm(force.force) >= LEAST_FORCE)


def _is_seen_outside(force: ContactForce) -> bool:
    """Tell whether a force is drawn before the point where it acts; stick, cup and table would hide it there."""
    return force.kind == "soft_finger"


def _cone_pose(force: ContactForce, *, outside: bool) -> Transform:
    """Return `T_world_cone`: the cone opens to the side on which the force is drawn."""
    hint = np.eye(3)[int(np.argmin(np.abs(force.normal)))]
    axis = -force.normal if outside else force.normal
    return transform(frame_from_z(axis, hint), force.point)


def _cone(mu: float, height: float, sides: int = 28) -> tuple[Array, np.ndarray]:
    """Return a friction cone about +z with its tip in the origin, so high [m]."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    rim = height * np.column_stack([mu * np.cos(angles), mu * np.sin(angles), np.ones(sides)])
    index = np.arange(sides)
    faces = np.column_stack([np.zeros(sides, dtype=int), 1 + (index + 1) % sides, 1 + index])
    return np.vstack([np.zeros((1, 3)), rim]), faces
