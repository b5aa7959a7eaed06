"""A change of a task, and how much work looking for changes may take."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TypeVar

import numpy as np
from pydantic import JsonValue, ValidationError

from planners.contract.shapes import Box, Mesh
from planners.contract.task_change import PatchOperation, changed
from planners.contract.task_spec import Obstacle, PlateLiftTask, SuctionToolTask, read_task, write_task
from planners.errors import SceneError
from planners.geometry.pose import Array, Transform, from_pose7, pose_row
from planners.progress import Report
from planners.remedies.directions import heading, told_move
from planners.scene.body import Body
from planners.scene.standing import listed

AnyTask = PlateLiftTask | SuctionToolTask
TaskOfKind = TypeVar("TaskOfKind", bound=AnyTask)
SceneOfKind = TypeVar("SceneOfKind")

_RESERVES = (0.2, 0.3)
"""Shares of every limit to keep back in a pile that fails in physics [1]."""
_DIGITS = 9
"""After the decimal point of what a patch writes."""
_HEIGHTS = (0.05, 0.10, 0.20)
"""By how much obstacles are made lower, or raised, in a cell of size 1 [m]."""
_LOWEST = 0.01
"""What is left of their height at least [m]."""
_STANDS = 0.005
"""How far above the table what stands on it begins at most [m]."""
_UPRIGHT = 1e-6
"""How far an upright body's axis may be off [1]."""


@dataclass(frozen=True)
class TaskChange:
    """A change of a task."""

    kind: str
    """What is changed; see `planners.plan.verdicts.Remedy`."""
    sentence: str
    """What to do, for a person."""
    patch: tuple[PatchOperation, ...]
    way: str = ""
    """What is changed which way: of two changes of one kind and one way the larger does all that the smaller does.
    Empty: it is the only one of its way."""
    size: float = 0.0
    """How large it is beside others of its kind, in the unit of that kind."""
    none: float = 0.0
    """The size at which nothing would be changed, or so little as is known not to help."""
    of_size: Callable[[float], TaskChange] | None = field(default=None, compare=False)
    """Makes one of the same way that is about so large; None: only some sizes are worth asking."""

    def then(self, other: TaskChange) -> TaskChange:
        """Return this change and another one after it, as one."""
        sentence = f"Both of these together: {self.sentence} {other.sentence}"
        return TaskChange("two_changes", sentence, (*self.patch, *other.patch))

    def applied(self, task: TaskOfKind) -> TaskOfKind | None:
        """Return the changed task; None where the contract refuses it."""
        try:
            read = read_task(changed(write_task(task), self.patch))
        except ValidationError:
            return None
        assert isinstance(read, type(task))
        return read

    def built(self, task: TaskOfKind, build: Callable[[TaskOfKind], SceneOfKind]) -> SceneOfKind | None:
        """Return the scene of the changed task; None where the task or its scene is refused."""
        other = self.applied(task)
        try:
            return None if other is None else build(other)
        except SceneError:
            return None


def put(path: str, value: JsonValue) -> PatchOperation:
    """Return the operation that sets a member of an object, whether it is there or not."""
    return PatchOperation(op="add", path=path, value=value)


def replaced(path: str, value: JsonValue) -> PatchOperation:
    """Return the operation that puts another element in the place of one of a list."""
    return PatchOperation(op="replace", path=path, value=value)


def removed(path: str) -> PatchOperation:
    """Return the operation that takes a member or an element away."""
    return PatchOperation(op="remove", path=path)


def numbers(values: Array) -> list[JsonValue]:
    """Return numbers (n,) as a patch writes them."""
    return [round(float(value), _DIGITS) + 0.0 for value in values]


def moved_pose(pose: tuple[float, ...], by: Array, turn: float = 0.0) -> list[JsonValue]:
    """Return a pose `[x, y, z, w, x, y, z]` moved and turned in the world, as a patch writes it.

    Args:
        pose: as a task states it.
        by: (2,) along the world's x and y [m].
        turn: about the vertical axis through the body's origin [rad].
    """
    T_world_body = from_pose7(pose)
    cosine, sine = np.cos(turn), np.sin(turn)
    T_world_body[:3, :3] = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ T_world_body[:3, :3]
    T_world_body[:2, 3] += by
    return numbers(pose_row(T_world_body))


def more_kept_back(task: AnyTask) -> Iterator[TaskChange]:
    """Yield changes with which more of every limit is kept back, of a task whose plan keeps too little in physics."""
    if isinstance(task, PlateLiftTask):
        if task.options.minimise != "risk":
            sentence = 'Keep as much of every limit back as can be, by "minimise": "risk".'
            yield TaskChange("reserve", sentence, (_with_option(task, "minimise", "risk"),))
        return
    for share in (each for each in _RESERVES if each > task.options.reserve):
        sentence = f"Keep {100 * share:.0f} % of every limit back."
        yield TaskChange("reserve", sentence, (_with_option(task, "reserve", share),))


def _with_option(task: AnyTask, name: str, value: JsonValue) -> PatchOperation:
    """Return the operation that sets an option, in tasks as posted, too, which may have no options at all."""
    return put("/options", {**task.options.model_dump(mode="json", exclude_defaults=True), name: value})


def obstacle_moved(index: int, obstacle: Obstacle, way: Array) -> TaskChange:
    """Return the change that moves the obstacle of a number by a way (2,) in the world [m]."""
    moved = obstacle.model_dump(mode="json") | {"pose": moved_pose(obstacle.pose, way)}
    sentence = f"Move {obstacle.name} {told_move(way, obstacle.pose)}."
    steps = (replaced(f"/obstacles/{index}", moved),)
    return TaskChange("obstacle", sentence, steps, f"{obstacle.name} {heading(way)}", float(np.linalg.norm(way)))


def obstacle_out_of_the_way(
    index: int, obstacle: Obstacle, T_world_body: Transform, table_top: float, size: float = 1.0
) -> Iterator[TaskChange]:
    """Yield changes of the height of an obstacle: what stands is made lower, what hangs is raised.

    Args:
        index: its number in the task.
        obstacle: as the task states it; one that is tilted, and a mesh, keeps its height.
        T_world_body: its frame.
        table_top: height of the table [m].
        size: of the cell [1].
    """
    for step in (size * height for height in _HEIGHTS):
        found = _at_other_height(index, obstacle, T_world_body, table_top, step)
        if found is None:
            return
        operation, left = found
        raised, lowered = f"Raise {obstacle.name} by {1e3 * step:.0f} mm.", f"Make {obstacle.name} {1e3 * step:.0f} mm"
        sentence = raised if left is None else f"{lowered} lower, {1e3 * left:.0f} mm high."
        yield TaskChange("obstacle", sentence, (operation,), f"height of {obstacle.name}", step)


def obstacles_out_of_the_way(
    bodies: Mapping[int, tuple[Obstacle, Transform]], table_top: float, size: float = 1.0
) -> Iterator[TaskChange]:
    """Yield changes of the heights of several obstacles at once, as far as each is high enough to be made lower.

    Args:
        bodies: by number in the task: as the task states it, and its frame.
        table_top: height of the table [m].
        size: of the cell [1].
    """
    for step in (size * height for height in _HEIGHTS):
        steps: list[PatchOperation] = []
        lower, raised = list[str](), list[str]()
        for index, (obstacle, T_world_body) in bodies.items():
            found = _at_other_height(index, obstacle, T_world_body, table_top, step)
            if found is not None:
                steps.append(found[0])
                (raised if found[1] is None else lower).append(obstacle.name)
        told = [f"make {listed(lower)} {1e3 * step:.0f} mm lower"] if lower else []
        told += [f"raise {listed(raised)} by {1e3 * step:.0f} mm"] if raised else []
        if steps:
            # A larger step may be none for a low one.
            names = listed([*lower, *raised])
            sentence = " and ".join(told)
            sentence = f"{sentence[0].upper()}{sentence[1:]}."
            yield TaskChange("obstacle", sentence, tuple(steps), f"heights of {names}", step)


def _at_other_height(
    index: int, obstacle: Obstacle, T_world_body: Transform, table_top: float, step: float
) -> tuple[PatchOperation, float | None] | None:
    """Return what puts an obstacle out of the way by a step [m], and the height [m] that is left; None where it hangs.

    None: it is tilted, a mesh, or not high enough.
    """
    shape = obstacle.shape
    upright = abs(abs(float(T_world_body[2, 2])) - 1.0) < _UPRIGHT
    if not upright or isinstance(shape, Mesh):
        return None
    height = shape.size[2] if isinstance(shape, Box) else shape.height
    changes: dict[str, JsonValue] = {}
    rise, left = step, None
    if float(T_world_body[2, 3]) - 0.5 * height - table_top <= _STANDS:
        if height - step < _LOWEST:
            return None
        rise, left = -0.5 * step, round(height - step, _DIGITS)
        size: dict[str, JsonValue] = {"size": [*shape.size[:2], left]} if isinstance(shape, Box) else {"height": left}
        changes["shape"] = shape.model_dump(mode="json") | size
    x, y, z, *turn = obstacle.pose
    changes["pose"] = [x, y, round(z + rise, _DIGITS), *turn]
    return replaced(f"/obstacles/{index}", obstacle.model_dump(mode="json") | changes), left


def standing_on_others(bodies: Sequence[Body]) -> dict[int, list[int]]:
    """Return which bodies stand on which, by number: those on whose top others begin, each with these.

    Bodies are taken as upright boxes around them. What stands on others, or has others on it, is not moved alone.
    """
    low, high = np.empty((len(bodies), 3)), np.empty((len(bodies), 3))
    for number, body in enumerate(bodies):
        corners = body.solid.surface()[0] @ body.T_world_body[:3, :3].T + body.T_world_body[:3, 3]
        low[number], high[number] = corners.min(axis=0), corners.max(axis=0)
    above = {
        number: [
            int(other)
            for other in np.flatnonzero(
                (np.abs(low[:, 2] - high[number, 2]) <= _STANDS)
                & (low[:, :2] < high[number, :2]).all(axis=1)
                & (high[:, :2] > low[number, :2]).all(axis=1)
            )
        ]
        for number in range(len(bodies))
    }
    return {number: others for number, others in above.items() if others}


def stacked(above: Mapping[int, Sequence[int]]) -> frozenset[int]:
    """Return the numbers of bodies that stand on others or have others on them, as `standing_on_others` found them."""
    return frozenset(above).union(*above.values())


def told_cup_place(place: tuple[float, float]) -> str:
    """Say where on the plate a place of the cup is, in plate axes [m]."""
    return f"({1e3 * place[0]:z.0f}, {1e3 * place[1]:z.0f}) mm on the plate"


def turning(angle: float) -> str:
    """Say how far and which way an angle turns about the vertical [rad]."""
    return f"{np.degrees(abs(angle)):.0f}° {'counterclockwise' if angle > 0.0 else 'clockwise'}, seen from above"


WORK = MappingProxyType(
    {
        "suction": 5,
        "regrasp graph": 1,
        "first motion": 7,
        "second motion": 10,
        "forces": 2,
        "merge": 4,
        "search": 3,
        "motion": 20,
    }
)
"""About what is done from one report of a stage to the next, in steps. Handovers, which may be kept from earlier, and
what is not listed count nothing."""


class Effort:
    """How much may still be tried, counted in steps and never in seconds: the same on every machine.

    A step is about a hundredth of a second on a common core. What planners report is counted as they report it, so that
    what ends at once costs next to nothing, and what takes long costs as much as it takes.
    """

    def __init__(self, steps: int) -> None:
        """Take how many steps there are."""
        self.steps, self.spent = steps, 0
        self.tried: set[str] = set()
        """Kinds of the changes that were planned, or of which it was asked whether they leave a way."""
        self.trying: str | None = None
        """The kind of the change that is tried now."""

    @property
    def ended(self) -> bool:
        """Whether no step is left: nothing new is begun."""
        return self.spent >= self.steps

    def take(self, steps: int) -> None:
        """Count what was done."""
        self.spent += steps

    def worked(self, report: Report) -> None:
        """Count what a planner begins, as it reports it."""
        self.take(WORK.get(report.stage, 0))

    def report(self) -> Report:
        """Say how far it is, and what kind of change is tried."""
        return Report("remedies", min(self.spent, self.steps), self.steps, self.trying)
