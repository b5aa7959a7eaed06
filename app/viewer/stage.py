"""A plan in a scene: cell, bodies, contact forces, ghosts; shows any moment of it or of its simulation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from viser import ArrowsHandle, FrameHandle, SceneApi, SceneNodeHandle

from app.viewer.body_drawing import draw_body
from app.viewer.considered_drawing import draw_grasps, draw_places
from app.viewer.link_meshes import LinkMeshes
from app.viewer.nodes import add_frame, place, place_at
from app.viewer.palette import FORCE_SCALES, Rgb, linear_rgb, meaning_of, object_tint, rgb
from app.viewer.robot_drawing import RobotDrawing
from app.viewer.sources import SourceName, Sources
from app.viewer.timeline import Moment, Touch, by_hand
from app.viewer.tool_story import subjects_of
from planners.cell.cell import Cell
from planners.geometry.pose import Array, Transform, frame_from_z, transform
from planners.geometry.surface import hull_with_faces
from planners.kinematics.forward import link_frames
from planners.scene.suction_tool import TOOL_NAME

LEAST_FORCE = 0.05
"""Smaller forces are not drawn [N]."""
CONE_HEIGHT = 0.06
"""[m]"""
ARROW_MEANINGS = ("left", "right", "environment", "suction")
LAYERS = ("forces", "cones", "frames", "start", "goal", "places", "grasps")
"""What can be shown or hidden."""
FIRST_LAYERS = frozenset({"forces"})
GHOST_OPACITY = 0.28
MOVED = frozenset({"plate", "object"})
"""Roles of the body that a task is about."""
SIGNS = ("places", "grasps")
"""Layers of what was considered for one object."""
WITH_FRICTION_CONE = frozenset({"soft_finger", "point", "environment"})
"""Kinds of contacts."""


class Stage:
    """One plan in one scene. Methods may be called from any one thread at a time."""

    layers = LAYERS

    def __init__(
        self,
        scene: SceneApi,
        root: str,
        document: Mapping[str, Any],
        sources: Sources,
        cell: Cell,
        meshes: LinkMeshes,
    ) -> None:
        """Draw a plan as it is at its start.

        Args:
            scene: an empty scene.
            root: name of the node that all others stand under. A name is not to be used twice in a server's life:
                viser forgets changes to a node when one of that name was removed before.
            document: the plan document.
            sources: what the document can be played from.
            cell: that the plan was made in.
            meshes: drawings of its robots.
        """
        self._scene, self._root, self._sources, self._cell = scene, root, sources, cell
        self._visible = set(FIRST_LAYERS)
        self._arms = frozenset(cell.arms)
        light_scene(scene, root)
        self._robot = RobotDrawing(scene, cell, meshes, f"{root}/robot")
        self._metres_per_newton = FORCE_SCALES[document["task"]["kind"]]
        tints = _tints(document)
        self._bodies = {
            name: draw_body(scene, f"{root}/bodies/{name}", body, tint=tints.get(name))
            for name, body in document["bodies"].items()
        }
        self._poses = {name: np.zeros(7) for name in self._bodies}
        self._body_frames = self._add_body_frames(document)
        self._arrows = {meaning: self._add_arrows(meaning) for meaning in ARROW_MEANINGS}
        self._cones: dict[tuple[str, float, int], SceneNodeHandle] = {}
        self._ghosts = {
            "start": self._add_ghost("start", document, sources.plan.at(0.0)),
            "goal": self._add_ghost("goal", document, sources.plan.at(sources.plan.duration)),
        }
        self._subjects = _Subjects(document)
        self._signs = {layer: self._add_signs(layer, document) for layer in SIGNS}
        self._moment = sources.plan.at(0.0)
        self.show("plan", 0.0)

    def show(self, source: SourceName, time: float) -> None:
        """Show the plan or its simulation at a time [s]."""
        moment = self._moment = self._sources[source].at(time)
        self._robot.pose(moment.positions, moment.widths)
        for name, pose in moment.body_poses.items():
            if not np.array_equal(pose, self._poses[name]):
                place_at(self._bodies[name], pose)
                self._poses[name] = pose
        self._show_contacts()
        self._show_signs()

    @property
    def body_position(self) -> Array:
        """Where the body that is moved is now (3,), in the world [m]."""
        return self._moment.body_poses[self._subjects.at(self._moment.segment)][:3]

    def set_layer(self, layer: str, visible: bool) -> None:
        """Show or hide one of `LAYERS`."""
        (self._visible.add if visible else self._visible.discard)(layer)
        actions: dict[str, Callable[[], None]] = {
            "forces": self._show_contacts,
            "cones": self._show_contacts,
            "frames": lambda: self._show_frames(visible),
            **dict.fromkeys(SIGNS, self._show_signs),
        }
        actions.get(layer, lambda: self._show_ghost(layer, visible))()

    def _show_frames(self, visible: bool) -> None:
        self._robot.show_frames(visible)
        for frame in self._body_frames:
            frame.visible = visible

    def _show_ghost(self, layer: str, visible: bool) -> None:
        for handle in self._ghosts[layer]:
            handle.visible = visible

    def _show_signs(self) -> None:
        """Show what was considered for the object that is moved now."""
        subject = self._subjects.at(self._moment.segment)
        for layer, by_object in self._signs.items():
            for name, handles in by_object.items():
                visible = layer in self._visible and name == subject
                for handle in handles:
                    if handle.visible != visible:
                        handle.visible = visible

    def _show_contacts(self) -> None:
        each = self._moment.touches
        # What the fingers of a hand press against each other is many times what the hand bears.
        touches = [touch for touch in (each if "cones" in self._visible else by_hand(each)) if _is_drawn(touch)]
        for meaning, handle in self._arrows.items():
            mine = [t for t in touches if meaning_of(t.by, self._arms, t.kind) == meaning]
            drawn = bool(mine) and "forces" in self._visible
            if drawn:
                points = np.array([self._arrow(touch) for touch in mine], dtype=np.float32)
                if not np.array_equal(points, handle.points):
                    handle.points = points
            if handle.visible != drawn:
                handle.visible = drawn
        self._show_cones(touches)

    def _show_cones(self, touches: list[Touch]) -> None:
        """Every cone that was ever needed stays in the scene, hidden while it is not."""
        used = set()
        if "cones" in self._visible:
            for touch in touches:
                if touch.kind not in WITH_FRICTION_CONE:
                    continue
                meaning = meaning_of(touch.by, self._arms, touch.kind)
                number = sum(key[:2] == (meaning, touch.mu) for key in used)
                key = (meaning, touch.mu, number)
                used.add(key)
                if key not in self._cones:
                    self._cones[key] = self._add_cone(*key)
                place(self._cones[key], _cone_pose(touch, outside=_is_seen_outside(touch)))
        for key, handle in self._cones.items():
            if handle.visible != (key in used):
                handle.visible = key in used

    def _arrow(self, touch: Touch) -> Array:
        """Return start and end (2, 3) of a force: it ends at its point outside a body, or begins there."""
        along = self._metres_per_newton * touch.force
        begin = touch.point - along if _is_seen_outside(touch) else touch.point
        return np.array([begin, begin + along])

    def _add_signs(self, layer: str, document: Mapping[str, Any]) -> dict[str, list[SceneNodeHandle]]:
        """Draw what was considered for each object, hidden at first."""
        signs = {}
        for name, body in document["bodies"].items():
            if body["role"] != "object":
                continue
            if layer == "places":
                signs[name] = draw_places(self._scene, f"{self._root}/bodies/{name}", document, name)
            else:
                signs[name] = draw_grasps(self._scene, f"{self._root}/grasps", document, name)
            for handle in signs[name]:
                handle.visible = False
        return signs

    def _add_arrows(self, meaning: str) -> ArrowsHandle:
        return self._scene.add_arrows(
            f"{self._root}/contacts/{meaning}",
            np.zeros((1, 2, 3), dtype=np.float32),
            linear_rgb(meaning),
            shaft_radius=0.55 * self._metres_per_newton,
            head_radius=1.4 * self._metres_per_newton,
            head_length=3.0 * self._metres_per_newton,
            visible=False,
        )

    def _add_cone(self, meaning: str, mu: float, number: int) -> SceneNodeHandle:
        vertices, faces = _cone(mu)
        return self._scene.add_mesh_simple(
            f"{self._root}/contacts/cones/{meaning}_{mu:g}_{number}".replace(".", "p"),
            vertices,
            faces,
            color=rgb(meaning),
            opacity=0.3,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _add_body_frames(self, document: Mapping[str, Any]) -> list[FrameHandle]:
        movable = [name for name, body in document["bodies"].items() if body["role"] in ("plate", "object", "tool")]
        frames = [
            add_frame(self._scene, f"{self._root}/bodies/{name}/frame", np.eye(4), axes_length=0.1) for name in movable
        ]
        for frame in frames:
            frame.visible = False
        return frames

    def _add_ghost(self, meaning: str, document: Mapping[str, Any], moment: Moment) -> list[SceneNodeHandle]:
        """Draw bodies and arms as they are at a moment, translucent.

        A plan without segments leaves the goals to its task.
        """
        colour = rgb(meaning)
        goals = _goals(document) if meaning == "goal" and not document["segments"] else {}
        vertices, faces = _arm_hulls(self._cell, moment.positions)
        arms = self._scene.add_mesh_simple(
            f"{self._root}/ghosts/{meaning}/arms",
            vertices,
            faces,
            color=colour,
            opacity=0.6 * GHOST_OPACITY,
            flat_shading=True,
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )
        handles: list[SceneNodeHandle] = [arms]
        for name, body in document["bodies"].items():
            if body["role"] not in ("plate", "object", "tool", "cup"):
                continue
            handle = draw_body(
                self._scene, f"{self._root}/ghosts/{meaning}/{name}", body, ghost=(colour, GHOST_OPACITY)
            )
            place_at(handle, goals.get(name, moment.body_poses[name]))
            handle.visible = False
            handles.append(handle)
        return handles


class _Subjects:
    """Which body each segment of a plan is about."""

    def __init__(self, document: Mapping[str, Any]) -> None:
        self._first = next(name for name, body in document["bodies"].items() if body["role"] in MOVED)
        lifts = document["task"]["kind"] == "plate_lift"
        self._names = [] if lifts else subjects_of(document["segments"])

    def at(self, segment: int | None) -> str:
        """Return the body that a segment is about; the first there is where it says nothing."""
        name = self._names[segment] if segment is not None and self._names else None
        return name or self._first


def _tints(document: Mapping[str, Any]) -> dict[str, Rgb]:
    """Return the colours of objects by name."""
    names = [name for name, body in document["bodies"].items() if body["role"] == "object"]
    return {name: object_tint(index) for index, name in enumerate(names)}


def _goals(document: Mapping[str, Any]) -> dict[str, Array]:
    """Return where the task wants objects, by name."""
    return {item["name"]: np.array(item["goal_pose"]) for item in document["task"].get("objects", ())}


def _is_drawn(touch: Touch) -> bool:
    """Tell whether a force is drawn: not the smallest, and a cup's on the object only, not its reaction."""
    if touch.kind == "suction" and touch.body == TOOL_NAME:
        return False
    return bool(np.linalg.norm(touch.force) >= LEAST_FORCE)


def light_scene(scene: SceneApi, root: str) -> None:
    """Set light and floor: soft light from all sides, one sun with shadows."""
    scene.configure_default_lights(enabled=False)
    scene.configure_environment_map("studio", environment_intensity=0.2)
    scene.add_light_directional(
        f"{root}/lights/sun", color=(255, 250, 242), intensity=0.9, cast_shadow=True, position=(1.6, -1.2, 3.2)
    )
    scene.add_light_directional(f"{root}/lights/fill", color=(214, 228, 255), intensity=0.22, position=(-0.8, 2.0, 2.2))
    scene.add_light_ambient(f"{root}/lights/sky", color=(235, 242, 255), intensity=0.55)
    scene.add_grid(
        f"{root}/floor",
        width=6.0,
        height=6.0,
        plane="xy",
        cell_size=0.25,
        section_size=1.0,
        cell_color=(214, 220, 228),
        section_color=(190, 199, 210),
        shadow_opacity=0.25,
    )


def _is_seen_outside(touch: Touch) -> bool:
    """Tell whether a force is drawn before the point where it acts; stick, cup and table would hide it there."""
    return touch.kind == "soft_finger"


def _cone_pose(touch: Touch, *, outside: bool) -> Transform:
    """Return `T_world_cone`: the cone opens to the side on which the force is drawn."""
    hint = np.eye(3)[int(np.argmin(np.abs(touch.normal)))]
    axis = -touch.normal if outside else touch.normal
    return transform(frame_from_z(axis, hint), touch.point)


def _cone(mu: float, sides: int = 28) -> tuple[Array, np.ndarray]:
    """Return a friction cone about +z with its tip in the origin."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    rim = CONE_HEIGHT * np.column_stack([mu * np.cos(angles), mu * np.sin(angles), np.ones(sides)])
    index = np.arange(sides)
    faces = np.column_stack([np.zeros(sides, dtype=int), 1 + (index + 1) % sides, 1 + index])
    return np.vstack([np.zeros((1, 3)), rim]), faces


def _arm_hulls(cell: Cell, positions: Array) -> tuple[Array, np.ndarray]:
    """Return the hulls of links and hands in the world, as one mesh."""
    vertices: list[Array] = []
    faces: list[np.ndarray] = []
    for index, arm in enumerate(cell.arms.values()):
        frames = np.empty((7, 4, 4))
        link_frames(arm.dh, arm.T_world_base, np.ascontiguousarray(positions[6 * index : 6 * index + 6]), frames)
        for body in (*arm.link_bodies(), *arm.hand_bodies(None)):
            T = frames[int(body.frame.partition("/")[2])]
            for shape in body.shapes:
                if len(shape.vertices) < 4:
                    continue
                corners, triangles = hull_with_faces(shape.vertices)
                faces.append(triangles + sum(map(len, vertices)))
                vertices.append(corners @ T[:3, :3].T + T[:3, 3])
    return np.vstack(vertices), np.vstack(faces)
