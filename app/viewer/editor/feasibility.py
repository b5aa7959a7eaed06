"""What can be said at once of a task that changes: whether the last path would still hold with the forces of now."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from planners.cell.cell import Cell
from planners.contract.strict_model import StrictModel
from planners.contract.task_spec import PlateLiftTask, read_task, write_task
from planners.errors import SceneError
from planners.manipulation.statics.path_forces import PathFails, PathForces, PathHolds
from planners.plan.plan import Plan
from planners.scene.scene import build_scene

FORCES = (
    *("/cup", "/lifter_model", "/friction", "/hand_force_limit", "/options", "/seed", "/external_id"),
    *("/plate/mass", "/plate/com", "/plate/mass_tolerance", "/plate/com_tolerance"),
)
"""Members of a plate lift that change what bears on the plate, and not where it can be moved."""
PERCENT = 100.0
ON = {
    "face": "lying on its face",
    "edge": "standing on an edge",
    "vertex": "standing on a corner",
    "none": "in the air",
}
"""What of the plate touches its support."""


class FeasibilityDescription(StrictModel):
    """What the page tells of the last path."""

    holds: bool
    words: str


class LastPath:
    """The path of the last plan of a lift, warm to be asked. Not for two threads at once."""

    def __init__(self, plan: Plan, cells: Mapping[str, Cell]) -> None:
        self._forces, self._cells = PathForces(plan), cells
        self._moves = _but_forces(plan.task)

    @staticmethod
    def can_be_of(plan: Plan) -> bool:
        """Tell whether a plan has a path that can be asked."""
        return isinstance(plan.task, PlateLiftTask) and bool(plan.segments)

    def judge(self, sent: Any) -> FeasibilityDescription | None:
        """Say whether the path holds with the forces of a task, as JSON data; None where it is no path of the task.

        It is none where the task would be refused or leaves the cup's place open, or more than forces has changed.
        """
        try:
            task = read_task(sent)
            if not isinstance(task, PlateLiftTask) or task.cup.position is None or _but_forces(task) != self._moves:
                return None
            answer = self._forces.ask(build_scene(task, self._cells))
        except (ValidationError, SceneError):
            return None
        return FeasibilityDescription(holds=isinstance(answer, PathHolds), words=_words(answer, task.options.reserve))


def _words(answer: PathHolds | PathFails, asked: float) -> str:
    if isinstance(answer, PathHolds):
        less = "" if answer.reserve >= asked else f"; {PERCENT * asked:g} % are asked for"
        return f"The last path still holds: {PERCENT * answer.reserve:.3g} % of every limit is kept back{less}."
    where = f"At {answer.time:.1f} s of the last path the plate is not held, {ON[answer.element]}"
    if answer.limit is None:
        return f"{where}: no single limit decides."
    return f"{where}: the {answer.limit} is short by {answer.missing:.1f} N."


def _but_forces(task: Any) -> dict[str, Any]:
    """Return a task as JSON data without the members that are `FORCES`."""
    data = write_task(task)
    for pointer in FORCES:
        holder, steps = data, pointer.split("/")[1:]
        for step in steps[:-1]:
            holder = holder[step]
        holder.pop(steps[-1], None)
    return data
