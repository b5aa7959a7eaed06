"""A plan in a scene: cell, bodies, forces (of `contact_forces.py`), ghosts; any moment of it or of its simulation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from viser import FrameHandle, LabelHandle, SceneNodeHandle

from app.viewer.drawing.body_drawing import Stage, add_frame, draw_body, place_at, shortened, surface_of
from app.viewer.drawing.camera import NO_OBSTACLES
from app.viewer.drawing.considered_signs import draw_grasps, draw_places
from app.viewer.drawing.contact_forces import ContactDrawing, by_hand
from app.viewer.drawing.cup_map import CupMap, CupPlaces
from app.viewer.palette import FORCE_SCALES, Rgb, object_tint, rgb
from app.viewer.playback import Playback, SourceName, objects_of_segments
from planners.cell.cell import Cell
from planners.contract.shapes import Box, Cylinder, InlineMesh, Prism
from planners.contract.task_spec import PlateLiftTask, SuctionToolTask
from planners.geometry.pose import Array, from_pose7
from planners.geometry.surface import hull_with_faces
from planners.plan.plan import Plan
from planners.plan.scenery import BodyDocument
from planners.plan.timeline import Moment
from planners.scene.clashes import arm_frames
from planners.study.study_map import StudyMap

NAMED = frozenset({"plate", "object", "tool", "support", "obstacle"})
"""Roles whose names are shown."""
NAME_GAP, AXES_LENGTH = 0.02, 0.1
"""Between a body and its name, and of its frame, in a cell of size 1 [m]."""
LAYERS = ("forces", "newtons", "cones", "names", "frames", "start", "goal", "places", "grasps", "map")
"""What can be shown or hidden."""
FIRST_LAYERS = frozenset({"forces", "newtons", "names", "map"})
GHOST_OPACITY = 0.28
MOVED = frozenset({"plate", "object"})
"""Roles of the body that a task is about."""
SIGNS = ("places", "grasps")
"""Layers of what was considered for one object."""


@dataclass(frozen=True)
class Gate:
    """A node that is seen, with all below it, as the layers of a recording are."""

    node: str
    shown_with: tuple[str, ...]
    """Layers all of which must be shown."""
    hidden_with: tuple[str, ...] = ()
    """Layers none of which may be shown."""


def _points_of(body: BodyDocument) -> Array:
    """Return the vertices (n, 3) of a body where it is at the start, in the world [m]."""
    vertices, _, _ = surface_of(body.role, body.shape)
    T_world_body = from_pose7(body.pose)
    return vertices @ T_world_body[:3, :3].T + T_world_body[:3, 3]


class PlanScene:
    """One plan in one scene. Methods may be called from any one thread at a time."""

    layers = LAYERS

    def __init__(self, stage: Stage, root: str, playback: Playback) -> None:
        """Draw a plan as it is at its start.

        Args:
            stage: with nothing on it but the cell that the plan was made in.
            root: name of the node that all others stand under. A name is not to be used twice in a server's life:
                viser forgets changes to a node when one of that name was removed before.
            playback: the plan, and its simulation if there is one.
        """
        plan = playback.plan
        scene, cell = stage.scene, stage.cell
        self._scene, self._root, self._playback, self._cell = scene, root, playback, cell
        self._visible = set(FIRST_LAYERS)
        stage.set_up()
        self._robot = stage.robot
        self._contacts = ContactDrawing(scene, f"{root}/contacts", cell, FORCE_SCALES[plan.task.kind])
        self._pressed: ContactDrawing | None = None
        """In a recording, contacts by finger: they are beside those by hand, which both are drawn all along."""
        tints = _tints(plan)
        self._bodies = {
            name: draw_body(scene, f"{root}/bodies/{name}", body.role, body.shape, body.pose, tint=tints.get(name))
            for name, body in plan.bodies.items()
        }
        standing = [body for body in plan.bodies.values() if body.role == "obstacle"]
        self.obstacles = np.vstack([NO_OBSTACLES, *map(_points_of, standing)])
        """Points (n, 3) that obstacles lie between, in the world [m]."""
        self._poses = {name: np.zeros(7) for name in self._bodies}
        self._body_frames = self._add_body_frames(plan)
        self._names = [self._add_name(name, body) for name, body in plan.bodies.items() if body.role in NAMED]
        self._ghosts = {
            "start": self._add_ghost("start", plan, plan.at(0.0)),
            "goal": self._add_ghost("goal", plan, plan.at(plan.duration)),
        }
        self._first = next(name for name, body in plan.bodies.items() if body.role in MOVED)
        self._moved = objects_of_segments(plan.segments) if isinstance(plan.task, SuctionToolTask) else []
        self._sign_nodes = {layer: list[str]() for layer in SIGNS}
        """Names of the nodes that all signs of a layer are below."""
        self._signs = {layer: self._add_signs(layer, plan) for layer in SIGNS}
        self._moment = plan.at(0.0)
        self._map: CupMap | None = None
        self.show("plan", 0.0)

    def show(self, source: SourceName, time: float) -> None:
        """Show the plan or its simulation at a time [s]."""
        moment = self._moment = self._playback.at(source, time)
        self._robot.pose(self._joint_positions(moment), moment.widths)
        for name, pose in moment.body_poses.items():
            if not np.array_equal(pose, self._poses[name]):
                place_at(self._bodies[name], pose)
                self._poses[name] = pose
        if self._map is not None:
            self._map.T_world_plate = from_pose7(self._poses[self._first])
        self._show_contacts()
        self._show_signs()

    def paint(self, study: StudyMap, places: CupPlaces, told: Callable[[int], None]) -> int | None:
        """Paint the map of a study of cup places onto the plate, in place of what is painted there.

        Args:
            study: of this plan's plate, as far as it is known.
            places: of the cup at its points.
            told: called with the number of a point that somebody clicks on, from a thread of viser's.

        Returns:
            The point that has the cup where this plan has it, which is marked; None: none has.
        """
        task = self._playback.plan.task
        assert isinstance(task, PlateLiftTask)
        if self._map is None:
            plate = self._playback.plan.bodies[self._first]
            self._map = CupMap(self._scene, f"{self._root}/bodies/{self._first}/map", _top(plate), told)
            self._map.T_world_plate = from_pose7(self._poses[self._first])
        current = None if task.cup.position is None else places.at(np.array(task.cup.position))
        self._map.paint(study, places, current, visible="map" in self._visible)
        return current

    @property
    def playback(self) -> Playback:
        """What is played."""
        return self._playback

    @property
    def body_position(self) -> Array:
        """Where the body that is moved is now (3,), in the world [m]."""
        return self._moment.body_poses[self._moved_now][:3]

    @property
    def _moved_now(self) -> str:
        """The body that is moved; the first there is where the plan says nothing."""
        segment = self._moment.segment
        return (self._moved[segment] if segment is not None and self._moved else None) or self._first

    @property
    def moved_nodes(self) -> tuple[str, ...]:
        """Names of the nodes of the bodies that the segments move, or of the one that there is without segments."""
        return tuple(f"{self._root}/bodies/{name or self._first}" for name in self._moved) or (
            f"{self._root}/bodies/{self._first}",
        )

    def _joint_positions(self, moment: Moment) -> Array:
        """Return where the joints are (12,) [rad], which a plan without segments may leave to the cell."""
        return self._cell.home if np.isnan(moment.positions).any() else moment.positions

    def set_layer(self, layer: str, visible: bool) -> None:
        """Show or hide one of `LAYERS`."""
        (self._visible.add if visible else self._visible.discard)(layer)
        actions: dict[str, Callable[[], None]] = {
            "forces": self._show_contacts,
            "newtons": self._show_contacts,
            "cones": self._show_contacts,
            "names": lambda: self._show_names(visible),
            "frames": lambda: self._show_frames(visible),
            "map": lambda: None if self._map is None else self._map.show(visible),
            **dict.fromkeys(SIGNS, self._show_signs),
        }
        actions.get(layer, lambda: self._show_ghost(layer, visible))()

    def show_all_layers(self) -> tuple[Gate, ...]:
        """Show all layers at once from now on, for a recording, and return what tells them apart again.

        A recording cannot ask what its layers would look like, so it has all of them, and hides nodes.
        """
        root = self._root
        self._pressed = ContactDrawing(
            self._scene, f"{root}/fingers", self._cell, FORCE_SCALES[self._playback.plan.task.kind]
        )
        for layer in LAYERS:
            self.set_layer(layer, True)
        frames = [*self._body_frames, *(arm.tcp for arm in self._robot.arms.values())]
        return (
            Gate(self._contacts.arrows, ("forces",), ("cones",)),
            Gate(self._contacts.newtons, ("forces", "newtons"), ("cones",)),
            Gate(self._pressed.arrows, ("forces", "cones")),
            Gate(self._pressed.newtons, ("forces", "newtons", "cones")),
            Gate(self._pressed.cones, ("cones",)),
            *(Gate(label.name, ("names",)) for label in self._names),
            *(Gate(frame.name, ("frames",)) for frame in frames),
            *(Gate(f"{root}/ghosts/{meaning}", (meaning,)) for meaning in self._ghosts),
            *(Gate(node, (layer,)) for layer, nodes in self._sign_nodes.items() for node in nodes),
        )

    def _show_frames(self, visible: bool) -> None:
        self._robot.show_frames(visible)
        for frame in self._body_frames:
            frame.visible = visible

    def _show_names(self, visible: bool) -> None:
        for label in self._names:
            label.visible = visible

    def _show_ghost(self, layer: str, visible: bool) -> None:
        for handle in self._ghosts[layer]:
            handle.visible = visible

    def _show_signs(self) -> None:
        """Show what was considered for the object that is moved now."""
        for layer, by_object in self._signs.items():
            for name, handles in by_object.items():
                visible = layer in self._visible and name == self._moved_now
                for handle in handles:
                    if handle.visible != visible:
                        handle.visible = visible

    def _show_contacts(self) -> None:
        contacts, shown = self._moment.contacts, frozenset(self._visible)
        if self._pressed is not None:
            self._pressed.show(contacts, shown)
            self._contacts.show(by_hand(contacts), shown - {"cones"})
        else:
            # What the fingers of a hand press against each other is many times what the hand bears.
            self._contacts.show(contacts if "cones" in shown else by_hand(contacts), shown)

    def _add_signs(self, layer: str, plan: Plan) -> dict[str, list[SceneNodeHandle]]:
        """Draw what was considered for each object, hidden at first."""
        considered = plan.statistics.considered
        if considered is None:
            return {}
        names = [name for name, body in plan.bodies.items() if body.role == "object"]
        draw = draw_places if layer == "places" else draw_grasps
        signs = {}
        for name in names:
            node = f"{self._root}/bodies/{name}/places" if layer == "places" else f"{self._root}/grasps/{name}"
            add_frame(self._scene, node, np.eye(4))
            self._sign_nodes[layer].append(node)
            signs[name] = draw(self._scene, node, considered, name, self._cell.size)
            for handle in signs[name]:
                handle.visible = False
        return signs

    def _add_name(self, name: str, body: BodyDocument) -> LabelHandle:
        """Write a body's name over it."""
        return self._scene.add_label(
            f"{self._root}/bodies/{name}/name",
            shortened(name.replace("_", " ")),
            position=(0.0, 0.0, _top(body) + self._cell.size * NAME_GAP),
            font_screen_scale=0.95,
            anchor="bottom-center",
        )

    def _add_body_frames(self, plan: Plan) -> list[FrameHandle]:
        movable = [name for name, body in plan.bodies.items() if body.role in ("plate", "object", "tool")]
        length = self._cell.size * AXES_LENGTH
        frames = [
            add_frame(self._scene, f"{self._root}/bodies/{name}/frame", np.eye(4), axes_length=length)
            for name in movable
        ]
        for frame in frames:
            frame.visible = False
        return frames

    def _add_ghost(self, meaning: str, plan: Plan, moment: Moment) -> list[SceneNodeHandle]:
        """Draw bodies and arms as they are at a moment, translucent.

        A plan without segments leaves the goals to its task.
        """
        colour = rgb(meaning)
        goals = _goals(plan) if meaning == "goal" and not plan.segments else {}
        vertices, faces = _arm_hulls(self._cell, self._joint_positions(moment))
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
        for name, body in plan.bodies.items():
            if body.role not in ("plate", "object", "tool", "cup"):
                continue
            pose = goals.get(name, moment.body_poses[name])
            ghost = colour, GHOST_OPACITY
            handle = draw_body(
                self._scene, f"{self._root}/ghosts/{meaning}/{name}", body.role, body.shape, pose, ghost=ghost
            )
            handle.visible = False
            handles.append(handle)
        return handles


def _top(body: BodyDocument) -> float:
    """Return how far a body reaches up from its origin, along its own z [m]."""
    match body.shape:
        case Box(size=size):
            return 0.5 * size[2]
        case InlineMesh(vertices=vertices):
            return float(np.asarray(vertices)[:, 2].max())
        case Cylinder() | Prism():
            return 0.5 * body.shape.height


def _tints(plan: Plan) -> dict[str, Rgb]:
    """Return the colours of objects by name."""
    names = [name for name, body in plan.bodies.items() if body.role == "object"]
    return {name: object_tint(index) for index, name in enumerate(names)}


def _goals(plan: Plan) -> dict[str, Array]:
    """Return where the task wants objects, by name."""
    objects = plan.task.objects if isinstance(plan.task, SuctionToolTask) else ()
    return {item.name: np.array(item.goal_pose) for item in objects}


def _arm_hulls(cell: Cell, positions: Array) -> tuple[Array, np.ndarray]:
    """Return the hulls of links and hands in the world, as one mesh."""
    vertices: list[Array] = []
    faces: list[np.ndarray] = []
    frames = arm_frames(cell, positions)
    for body in (each for each in cell.collision_bodies() if each.frame in frames):
        T = frames[body.frame]
        for shape in body.shapes:
            if len(shape.vertices) < 4:
                continue
            corners, triangles = hull_with_faces(shape.vertices)
            faces.append(triangles + sum(map(len, vertices)))
            vertices.append(corners @ T[:3, :3].T + T[:3, 3])
    return np.vstack(vertices), np.vstack(faces)
