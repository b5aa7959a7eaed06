"""A draft in a scene: its things are dragged by the mouse, or moved by whoever asks, and come to lie where they can."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Coroutine, Mapping, Sequence
from dataclasses import dataclass, replace
from threading import RLock
from typing import Literal

import numpy as np
from viser import (
    FrameHandle,
    LineSegmentsHandle,
    MeshHandle,
    SceneNodeDragEvent,
    SceneNodePointerEvent,
    TransformControlsEvent,
    TransformControlsHandle,
)

from app.viewer.drawing.body_drawing import Stage, add_frame, draw_body, draw_surface, place, shortened
from app.viewer.editor.draft import CUP, Draft, DraftCup, DraftPart, cup_in_world
from app.viewer.editor.placing import STEP, put, written, yaw_of
from app.viewer.palette import BODIES, Rgb, object_tint, rgb
from planners.contract.shapes import Box, Cylinder, InlineMesh, Prism
from planners.geometry.pose import Array, Transform, rotation_z, transform

Phase = Literal["start", "update", "end"]
GOAL_OPACITY = 0.45
CHOSEN: Rgb = (15, 143, 163)
WRONG: Rgb = rgb("limit")
PATH_COLOUR = (150, 158, 168)
"""Of the last path that was found."""
HANDLES = 0.16
"""Size of the handles of a small thing, in a cell of size 1 [m]."""
LABEL_GAP = 0.03
"""Between a thing and its name, in a cell of size 1 [m]."""
GRAZING = 0.05
"""A view less steep than this onto the plane in which something is dragged moves it nowhere [rad]."""


@dataclass(frozen=True)
class Moved:
    """A thing was moved."""

    pointer: str
    """Of the member of the task that says where it is."""
    value: tuple[float, ...]
    """What that member is now: a pose, or the cup's place in plate axes."""
    phase: Phase
    number: int
    """Counts moves: what was drawn before the last one is old."""


@dataclass(frozen=True)
class Chosen:
    """Somebody clicked on a thing."""

    pointer: str


DrawnShape = Box | Cylinder | Prism | InlineMesh
DraftListener = Callable[[Moved | Chosen], None]


@dataclass(frozen=True, eq=False)
class _Drawn:
    """A thing as it is drawn."""

    name: str
    shape: DrawnShape
    frame: FrameHandle
    surface: MeshHandle
    colour: Rgb


class DraftScene:
    """One draft in one scene, which is shown by one thread while it is dragged in another, viser's."""

    layers: Collection[str] = ()

    def __init__(self, stage: Stage, root: str, tell: DraftListener) -> None:
        """Draw an empty cell.

        Args:
            stage: with the cell that the task is for.
            root: name of the node that all others stand under, never used before in the server's life.
            tell: called with whatever somebody does in the scene, from a thread of viser's.
        """
        self._scene, self._root, self._cell, self._tell = stage.scene, root, stage.cell, tell
        stage.set_up()
        for name, body in self._cell.body_documents().items():
            draw_body(self._scene, f"{root}/cell/{name}", body.role, body.shape, body.pose)
        self._lock = RLock()
        """Held by whoever draws or moves: drawn things and the draft belong together."""
        self._draft = Draft({}, None)
        self._drawn: dict[str, _Drawn] = {}
        self._made = 0
        self._chosen: str | None = None
        self.moves = 0
        """How often something was moved in the scene."""
        self._moved: dict[str, int] = {}
        """The number of each thing's last move, by pointer."""
        self._grab, self._height = np.zeros(2), 0.0
        self._turning = self._add_handles("turning", turns=True)
        self._sliding = self._add_handles("sliding", turns=False)
        self._dragged: str | None = None
        self._path: LineSegmentsHandle | None = None

    @property
    def body_position(self) -> Array:
        """Where the thing is that was chosen, or else the middle of the table (3,), in the world [m]."""
        if self._chosen == CUP and self._draft.plate is not None and self._draft.cup is not None:
            return cup_in_world(self._draft.plate, self._draft.cup)
        part = self._draft.parts.get(self._chosen or "")
        table = self._cell.boxes[0].center
        return np.array([table[0], table[1], self._cell.table_top]) if part is None else part.T_world_body[:3, 3]

    def set_layer(self, layer: str, visible: bool) -> None:
        """Show or hide a layer: there is none."""

    def show(self, draft: Draft, chosen: str | None, wrong: Collection[str], moves: int) -> None:
        """Show a draft.

        Args:
            draft: what to show.
            chosen: pointer of the thing that has handles.
            wrong: pointers of the things with which something is wrong.
            moves: how many moves the draft takes into account; what was moved since stays where it is.
        """
        with self._lock:
            draft = self._with_later_moves(draft, moves)
            self._draft, self._chosen = draft, chosen
            wanted = self._wanted(draft)
            for pointer in [pointer for pointer in self._drawn if pointer not in wanted]:
                self._drawn.pop(pointer).frame.remove()
            for pointer, (shape, T) in wanted.items():
                drawn = self._drawn.get(pointer)
                if drawn is None or not _same(drawn.shape, shape) or drawn.name != self._name(pointer):
                    if drawn is not None:
                        drawn.frame.remove()
                    self._drawn[pointer] = self._draw(pointer, shape, T)
                else:
                    place(drawn.frame, T)
            self._colour(wrong)
            if self._dragged is None:
                self._place_handles()

    def _with_later_moves(self, draft: Draft, moves: int) -> Draft:
        """Return a draft in which things that were moved since are where they are now: the page will hear of it."""
        parts, cup = dict(draft.parts), draft.cup
        for pointer in (pointer for pointer, number in self._moved.items() if number > moves):
            if pointer == CUP and cup is not None and self._draft.cup is not None:
                cup = replace(cup, position=self._draft.cup.position)
            elif pointer in parts and pointer in self._draft.parts:
                parts[pointer] = replace(parts[pointer], T_world_body=self._draft.parts[pointer].T_world_body)
        return Draft(parts, cup)

    def nudge(self, pointer: str, by: Sequence[float], turn: float) -> None:
        """Move a thing and tell of it.

        Args:
            pointer: of the thing; of one that is not drawn nothing happens.
            by: how far along the world's x and y [m].
            turn: about the vertical [rad].
        """
        with self._lock:
            if pointer == CUP and self._draft.cup is not None and self._draft.plate is not None:
                along = self._draft.plate.T_world_body[:2, :2].T @ np.array(by)
                x, y = np.array(self._draft.cup.position) + along
                self._slide((float(x), float(y)), "end")
            elif pointer in self._draft.parts:
                T = self._draft.parts[pointer].T_world_body
                T_wanted = transform(rotation_z(turn) @ T[:3, :3], T[:3, 3] + (by[0], by[1], 0.0))
                self._move(pointer, T_wanted, "end")
            self._place_handles()

    def show_path(self, lines: Array) -> None:
        """Draw a path that was found, in grey, in place of the last one.

        Args:
            lines: (n, 2, 3) begin and end of each, in the world [m]; n may be 0.
        """
        if self._path is not None:
            self._path.remove()
            self._path = None
        if len(lines):
            self._made += 1
            self._path = self._scene.add_line_segments(
                f"{self._root}/path_{self._made}", lines, PATH_COLOUR, thickness=1.5, thickness_units="screen"
            )

    def _name(self, pointer: str) -> str:
        return "cup" if pointer == CUP else self._draft.parts[pointer].name

    def _wanted(self, draft: Draft) -> Mapping[str, tuple[DrawnShape, Transform]]:
        wanted: dict[str, tuple[DrawnShape, Transform]] = {
            pointer: (part.shape, part.T_world_body) for pointer, part in draft.parts.items()
        }
        if draft.cup is not None and draft.plate is not None:
            pad = Cylinder(type="cylinder", radius=draft.cup.radius, height=self._cell.lifter.cup_height)
            wanted[CUP] = pad, self._cup_pose(draft.plate, draft.cup)
        return wanted

    def _cup_pose(self, plate: DraftPart, cup: DraftCup) -> Transform:
        up = 0.5 * self._cell.lifter.cup_height * plate.T_world_body[:3, 2]
        return transform(plate.T_world_body[:3, :3], cup_in_world(plate, cup) + up)

    def _draw(self, pointer: str, shape: DrawnShape, T: Transform) -> _Drawn:
        self._made += 1
        name = f"{self._root}/draft_{self._made}"
        part = self._draft.parts.get(pointer)
        role = "cup" if part is None else part.role
        is_goal = part is not None and part.is_goal
        number = int(pointer.split("/")[2]) if role == "object" else 0
        colour = rgb("goal") if is_goal else object_tint(number) if role == "object" else BODIES[role]
        frame = add_frame(self._scene, name, T)
        surface = draw_surface(
            self._scene, name, role, shape, ghost=(colour, GOAL_OPACITY) if is_goal else None, tint=colour
        )
        surface.on_drag("left")(self._on_drag(pointer))
        surface.on_click(self._on_click(pointer))
        if part is not None and part.role in ("object", "obstacle"):
            self._add_label(name, part)
        return _Drawn(self._name(pointer), shape, frame, surface, colour)

    def _add_label(self, name: str, part: DraftPart) -> None:
        top = part.T_world_body[:3, :3].T @ np.array([0.0, 0.0, self._half_height(part) + self._cell.size * LABEL_GAP])
        # A goal may be where its object is, and has its name below that of the object.
        anchor = "top-center" if part.is_goal else "bottom-center"
        self._scene.add_label(f"{name}/name", shortened(part.name), position=top, font_screen_scale=0.85, anchor=anchor)

    def _half_height(self, part: DraftPart) -> float:
        return float((part.solid.surface()[0] @ part.T_world_body[2, :3]).max())

    def _colour(self, wrong: Collection[str]) -> None:
        for pointer, drawn in self._drawn.items():
            colour = WRONG if pointer in wrong else CHOSEN if pointer == self._chosen else drawn.colour
            if tuple(drawn.surface.color) != colour:
                drawn.surface.color = colour

    def _add_handles(self, name: str, *, turns: bool) -> TransformControlsHandle:
        handles = self._scene.add_transform_controls(
            f"{self._root}/{name}",
            scale=self._cell.size * HANDLES,
            active_axes=(True, True, False),
            disable_rotations=not turns,
            depth_test=False,
            visible=False,
        )
        handles.on_update(self._on_handles)
        return handles

    def _place_handles(self) -> None:
        """Put the handles to the thing that is chosen."""
        part = self._draft.parts.get(self._chosen or "")
        on_cup = self._chosen == CUP and self._draft.cup is not None and self._draft.plate is not None
        for handles, used in ((self._turning, part is not None), (self._sliding, on_cup)):
            if handles.visible != used:
                handles.visible = used
        if part is not None:
            corners = part.solid.surface()[0]
            self._turning.scale = max(
                self._cell.size * HANDLES, 0.75 * float(np.linalg.norm(np.ptp(corners[:, :2], axis=0)))
            )
            T = part.T_world_body
            place(self._turning, transform(rotation_z(yaw_of(T[:3, :3])), T[:3, 3]))
        elif on_cup and self._draft.cup is not None and self._draft.plate is not None:
            place(self._sliding, self._cup_pose(self._draft.plate, self._draft.cup))

    async def _on_handles(self, event: TransformControlsEvent) -> None:
        with self._lock:
            T = transform(position=event.target.position)
            if self._chosen == CUP:
                self._slide_to(T[:3, 3], event.phase)
            elif self._chosen is not None and self._chosen in self._draft.parts:
                w, _, _, z = event.target.wxyz
                now = self._draft.parts[self._chosen].T_world_body
                turn = 2.0 * math.atan2(z, w) - yaw_of(now[:3, :3])
                self._move(self._chosen, transform(rotation_z(turn) @ now[:3, :3], T[:3, 3]), event.phase)
            if event.phase == "end":
                self._place_handles()

    def _on_click(self, pointer: str) -> Callable[[SceneNodePointerEvent[MeshHandle]], None]:
        def chosen(_: SceneNodePointerEvent[MeshHandle]) -> None:
            self._tell(Chosen(pointer))

        return chosen

    def _on_drag(self, pointer: str) -> Callable[[SceneNodeDragEvent[MeshHandle]], Coroutine]:
        # One after the other: viser runs what is not async in threads, in any order.
        async def dragged(event: SceneNodeDragEvent[MeshHandle]) -> None:
            with self._lock:
                if event.phase == "start":
                    self._tell(Chosen(pointer))
                    self._chosen = pointer
                    self._grab = self.body_position[:2] - np.array(event.start_position)[:2]
                    self._height = event.start_position[2]
                # The pointer is told on a plane that faces the camera; where it is meant is on the level one.
                eye, seen = event.client.camera.position, np.array(event.end_position)
                along = seen - eye
                if abs(along[2]) > math.sin(GRAZING) * float(np.linalg.norm(along)):
                    here = (eye + along * (self._height - eye[2]) / along[2])[:2] + self._grab
                    if pointer == CUP:
                        self._slide_to(np.append(here, 0.0), event.phase)
                    elif pointer in self._draft.parts:
                        T = self._draft.parts[pointer].T_world_body.copy()
                        T[:2, 3] = here
                        self._move(pointer, T, event.phase)
                if event.phase == "end":
                    self._dragged = None
                    self._place_handles()

        return dragged

    def _slide_to(self, point: Array, phase: Phase) -> None:
        """Move the cup to the place of the plate's top that is below or above a point (3,) [m]."""
        if self._draft.plate is not None:
            T = self._draft.plate.T_world_body
            x, y = T[:2, :2].T @ (point[:2] - T[:2, 3])
            self._slide((float(x), float(y)), phase)

    def _slide(self, wanted: tuple[float, float], phase: Phase) -> None:
        plate, cup = self._draft.plate, self._draft.cup
        if plate is None or cup is None:
            return
        x, y = (round(round(each / STEP) * STEP, 6) + 0.0 for each in wanted)
        self._draft = replace(self._draft, cup=replace(cup, position=(x, y)))
        if self._draft.cup is not None and CUP in self._drawn:
            place(self._drawn[CUP].frame, self._cup_pose(plate, self._draft.cup))
        self._told(CUP, (x, y), phase)

    def _move(self, pointer: str, T_wanted: Transform, phase: Phase) -> None:
        part = self._draft.parts[pointer]
        T = put(part, T_wanted, self._draft, self._cell)
        self._draft = replace(self._draft, parts={**self._draft.parts, pointer: replace(part, T_world_body=T)})
        place(self._drawn[pointer].frame, T)
        if self._draft.plate is self._draft.parts[pointer] and self._draft.cup is not None and CUP in self._drawn:
            place(self._drawn[CUP].frame, self._cup_pose(self._draft.parts[pointer], self._draft.cup))
        self._told(pointer, tuple(written(T)), phase)

    def _told(self, pointer: str, value: tuple[float, ...], phase: Phase) -> None:
        self.moves += 1
        self._moved[pointer] = self.moves
        self._dragged = None if phase == "end" else pointer
        self._tell(Moved(pointer, value, phase, self.moves))


def _same(one: DrawnShape, other: DrawnShape) -> bool:
    if isinstance(one, InlineMesh) and isinstance(other, InlineMesh):
        return one is other or np.array_equal(one.vertices, other.vertices)
    return type(one) is type(other) and one == other
