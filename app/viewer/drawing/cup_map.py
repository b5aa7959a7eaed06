"""A study's map in a scene: a tile on the plate for each known place of the cup; a click chooses one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from viser import BatchedMeshHandle, ImageHandle, SceneApi, SceneNodeHandle, SceneNodePointerEvent

from app.pictures.study_picture import colour_of
from planners.contract.task_spec import LifterCup, PlateLiftTask
from planners.geometry.pose import Array, Transform
from planners.plan.plan import Plan
from planners.study.study_map import StudyMap, StudyPoint

CUP_AXES = ("/cup/position/0", "/cup/position/1")
"""Pointers of what a map on a plate varies."""
SAME_PLACE = 1e-6
"""A cup that is no farther from a point stands there [m]."""
LIFTED, SHOWN_LIFTED, MARK_LIFTED = 0.0015, 0.0018, 0.0022
"""Of tiles, of what shows their colours and of their marks above the top face [m]."""
COVERED = 0.92
"""Of its step, by a tile's side [1]."""
TILE_PIXELS, MOST_PIXELS = 25, 4096
"""Of the picture of the tiles: along one step, of which `COVERED` are whole pixels, and at most along a side [1]."""
UNSOLVED, MARK, CURRENT = (216, 216, 216), (40, 40, 40), (214, 38, 120)
TILE = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])
RISING = ((-0.25, 0.25), (0.25, -0.25))
FALLING = ((-0.25, -0.25), (0.25, 0.25))
MARKS = {
    "not_found": (RISING,),
    "infeasible": (RISING, FALLING),
    "refused": (((0.0, -0.12), (0.0, 0.12)),),
    "failed": (((-0.3, 0.0), (0.1, 0.0)), ((0.25, 0.0), (0.3, 0.0))),
}
"""Strokes by outcome, in sides of a tile, as whoever faces the robot reads them: those of the page of the study."""


@dataclass(frozen=True, eq=False)
class CupPlaces:
    """Where the points of a study have the cup, in plate axes."""

    centers: Array
    """Of all points by number (n, 2) [m]."""
    step: Array
    """Between neighbours along x and y (2,) [m]."""

    def nearest(self, place: Array, among: Sequence[int]) -> int | None:
        """Return the point, of those among which it may be, whose tile a place (2,) [m] is on; None: on no tile."""
        if not among:
            return None
        off = np.abs(self.centers[list(among)] - place) / self.step
        best = int(np.argmin(off.max(axis=1)))
        return among[best] if off[best].max() <= 0.5 else None

    def at(self, place: Array) -> int | None:
        """Return the point that has the cup at a place (2,) [m]; None: none has."""
        off = np.abs(self.centers - place).max(axis=1)
        best = int(np.argmin(off))
        return best if off[best] <= SAME_PLACE else None


def cup_places(study: StudyMap) -> CupPlaces | None:
    """Return where the points of a map have the cup; None where anything else is varied, or there is no cup."""
    axes = {axis.pointer: k for k, axis in enumerate(study.axes) if axis.part == "value"}
    cup = study.task.get("cup")
    if len(axes) != len(study.axes) or not axes.keys() <= set(CUP_AXES) or not isinstance(cup, dict):
        return None
    columns, steps = list[Array](), list[float]()
    shape = [len(axis.values) for axis in study.axes]
    at = np.array(np.unravel_index(np.arange(study.count), shape))
    told = LifterCup.model_validate(cup).position
    for side, pointer in enumerate(CUP_AXES):
        if pointer in axes:
            values = np.array(study.axes[axes[pointer]].values, dtype=float)
            columns.append(values[at[axes[pointer]]])
            gaps = np.diff(np.unique(values))
            steps.append(float(gaps.min(initial=np.inf)))
        elif told is not None:
            columns.append(np.full(study.count, told[side]))
            steps.append(np.inf)
        else:
            return None
    least = min(steps)
    if not np.isfinite(least):
        return None
    return CupPlaces(np.column_stack(columns), np.array([each if np.isfinite(each) else least for each in steps]))


def is_of_study(plan: Plan, study: StudyMap) -> bool:
    """Tell whether a plan lifts the plate of a study from where it lies there."""
    task = plan.task
    if not isinstance(task, PlateLiftTask) or study.task.get("kind") != task.kind:
        return False
    theirs = PlateLiftTask.model_validate(study.task)
    # Plans state centres of mass that studies may leave out.
    com = task.plate.com if theirs.plate.com is None else theirs.plate.com
    plate = theirs.plate.model_copy(update={"com": com})
    return plate == task.plate and theirs.plate_pose == task.plate_pose and theirs.cell == task.cell


class CupMap:
    """The tiles of one map under the frame of a plate, which they move with."""

    def __init__(self, scene: SceneApi, root: str, top: float, told: Callable[[int], None]) -> None:
        """Paint nothing yet.

        Args:
            scene: that has the plate.
            root: name of nodes below the plate's frame, never used before in the server's life.
            top: of the plate's top face above its origin [m].
            told: called with the number of a point that somebody clicks on, from a thread of viser's.
        """
        self._scene, self._root, self._top, self._told = scene, root, top, told
        self._painted = 0
        self._handles: list[SceneNodeHandle] = []
        self._places: CupPlaces | None = None
        self._known: list[int] = []
        self.T_world_plate: Transform = np.eye(4)
        """Where the plate is now."""

    def paint(self, study: StudyMap, places: CupPlaces, current: int | None, *, visible: bool) -> None:
        """Paint what is known of a map, in place of what was painted before, with the current point marked."""
        for handle in self._handles:
            handle.remove()
        self._painted += 1
        node = f"{self._root}/{self._painted}"
        self._places, self._known = places, [point.index for point in study.points]
        self._handles = []
        if study.points:
            centers = places.centers[self._known]
            colours = np.array([_colour_of_point(point) for point in study.points], dtype=np.uint8)
            tiles = self._add_tiles(f"{node}/tiles", centers, places.step, colours)
            tiles.on_click(self._clicked)
            self._handles += [tiles, self._add_picture(f"{node}/picture", centers, places.step, colours)]
        strokes = [
            places.centers[point.index] + np.array(stroke) * places.step
            for point in study.points
            for stroke in MARKS.get(point.outcome, ())
        ]
        self._add_lines(f"{node}/marks", strokes, MARK, 2.0)
        if current is not None:
            corners = places.centers[current] + TILE[:, :2] * places.step
            edges = [corners[[k, (k + 1) % 4]] for k in range(4)]
            self._add_lines(f"{node}/current", edges, CURRENT, 5.0)
        self.show(visible)

    def show(self, visible: bool) -> None:
        """Show or hide all tiles."""
        for handle in self._handles:
            handle.visible = visible

    def _add_tiles(self, name: str, centers: Array, step: Array, colours: np.ndarray) -> BatchedMeshHandle:
        """Add what is clicked on: each tile by itself, so that the one below the pointer is outlined."""
        return self._scene.add_batched_meshes_simple(
            name,
            TILE,
            np.array([[0, 1, 2], [0, 2, 3]]),
            batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (len(centers), 1)),
            batched_positions=self._on_top(centers, LIFTED),
            batched_scales=np.tile([*(COVERED * step), 1.0], (len(centers), 1)),
            batched_colors=np.round(255 * _light(colours)).astype(np.uint8),
            material="toon3",
            lod="off",
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _add_picture(self, name: str, centers: Array, step: Array, colours: np.ndarray) -> ImageHandle:
        """Add what is seen: the colours of the scale, whatever light falls on the plate.

        viser lights all meshes, and maps their tones; pictures it shows as they are.
        """
        pixels, corner, size = picture_of_tiles(centers, step, colours)
        return self._scene.add_image(
            name,
            pixels,
            *size,
            format="png",
            cast_shadow=False,
            receive_shadow=False,
            position=(*(corner + 0.5 * size), self._top + SHOWN_LIFTED),
        )

    def _add_lines(self, name: str, strokes: Sequence[Array], colour: tuple[int, int, int], thickness: float) -> None:
        if not strokes:
            return
        ends = np.array([self._on_top(stroke, MARK_LIFTED) for stroke in strokes])
        self._handles.append(
            self._scene.add_line_segments(name, ends, colour, thickness=thickness, thickness_units="screen")
        )

    def _on_top(self, places: Array, lifted: float) -> Array:
        return np.column_stack([places, np.full(len(places), self._top + lifted)])

    def _clicked(self, event: SceneNodePointerEvent[BatchedMeshHandle]) -> None:
        assert self._places is not None
        T = np.linalg.inv(self.T_world_plate)
        origin = T[:3, :3] @ np.array(event.ray_origin) + T[:3, 3]
        along = T[:3, :3] @ np.array(event.ray_direction)
        if abs(along[2]) < np.finfo(float).eps:
            return
        place = origin + (self._top + LIFTED - origin[2]) / along[2] * along
        point = self._places.nearest(place[:2], self._known)
        if point is not None:
            self._told(point)


def picture_of_tiles(centers: Array, step: Array, colours: np.ndarray) -> tuple[np.ndarray, Array, Array]:
    """Return a picture (rows along y, columns along x, RGBA) of tiles, its first corner (2,) and its size (2,) [m]."""
    corner, reach = centers.min(axis=0) - 0.5 * step, np.ptp(centers, axis=0) + step
    pixel = np.maximum(step / TILE_PIXELS, reach / MOST_PIXELS)
    counts = np.rint(reach / pixel).astype(int)
    pixels = np.zeros((counts[1], counts[0], 4), dtype=np.uint8)
    # Between tiles there is nothing, in the colour of the nearest one: where a browser mixes pixels, it mixes that in.
    for side in (1.0, COVERED):
        lows = np.rint((centers - corner - 0.5 * side * step) / pixel).astype(int)
        highs = np.maximum(lows + 1, np.rint((centers - corner + 0.5 * side * step) / pixel).astype(int))
        for (left, first), (right, last), colour in zip(lows, highs, colours, strict=True):
            pixels[first:last, left:right] = (*colour, 255 if side == COVERED else 0)
    return pixels, corner, counts * pixel


def _light(colours: np.ndarray) -> Array:
    """Return the light (n, 3) of sRGB colours [1] (IEC 61966-2-1): viser takes colours of batched meshes so."""
    coded = colours / 255
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def _colour_of_point(point: StudyPoint) -> tuple[int, int, int]:
    """Return the colour of a tile: viridis by what is kept back, grey where nothing is solved."""
    if point.outcome != "solved":
        return UNSOLVED
    blue, green, red = colour_of(point.reserve or 0.0)
    return red, green, blue
