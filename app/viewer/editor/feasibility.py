"""What can be said at once of a task that changes: whether the last path still holds, or else another way is left."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import structlog
from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool

from planners.cell.cell import Cell
from planners.contract.strict_model import StrictModel
from planners.contract.task_spec import PlateLiftTask, read_task, without, write_task
from planners.errors import SceneError
from planners.manipulation.statics.path_forces import FORCES, PathFails, PathForces, PathHolds
from planners.plan.plan import Plan
from planners.plan.verdicts import Feasibility
from planners.scene.scene import build_scene
from planners.scene.shape_source import Uploads
from workers.solver.feasibility_pool import FeasibilityPool
from workers.solver.protocol import FeasibilityRequest
from workers.stores.database_loss import DATABASE_GONE, said_by
from workers.stores.task_parts import TaskParts

log = structlog.get_logger(__name__)
_NOT_THE_PATH = (*FORCES, "/plate/com", "/plate/com_tolerance", "/options", "/seed", "/external_id")
"""Members of a plate lift that change nothing of where arms and plate are along a path."""
PERCENT = 100.0
ON = {
    "face": "lying on its face",
    "edge": "standing on an edge",
    "vertex": "standing on a corner",
    "none": "in the air",
}
"""What of the plate touches its support."""


class FeasibilityDescription(StrictModel):
    """What the page tells of the last path, or of what is left without it."""

    holds: bool
    words: str


class LastPath:
    """The path of the last plan of a lift, warm to be asked. Not for two threads at once."""

    def __init__(self, plan: Plan, cells: Mapping[str, Cell], uploads: Uploads) -> None:
        """`cells` and `uploads`: that its task may name."""
        self._forces, self._cells, self._uploads = PathForces(plan), cells, uploads
        self._moves = without(plan.task, _NOT_THE_PATH)

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
            if not isinstance(task, PlateLiftTask) or task.cup.position is None:
                return None
            if without(task, _NOT_THE_PATH) != self._moves:
                return None
            answer = self._forces.ask(build_scene(task, self._cells, self._uploads))
        except (ValidationError, SceneError):
            return None
        return FeasibilityDescription(holds=isinstance(answer, PathHolds), words=_words(answer, task.options.reserve))


class OtherWays:
    """Asks a process that keeps the graph of an editor's lift whether any way is left."""

    def __init__(self, pool: FeasibilityPool, parts: TaskParts) -> None:
        self._pool, self._parts = pool, parts

    async def ask(self, editor: str, sent: Any, cell: str | None) -> FeasibilityDescription | None:
        """Say whether a lift, as JSON data, has a way left; None where it is no lift, or nothing is known.

        Args:
            editor: who asks, one question at a time.
            sent: the task.
            cell: that the editor may see, as its task says it; lifts in other cells are none.
        """
        try:
            task = read_task(sent)
        except ValidationError:
            return None
        if not isinstance(task, PlateLiftTask) or task.cup.position is None or task.cell != cell:
            return None
        lift = write_task(task)
        try:
            parts = await run_in_threadpool(self._parts.named_by, [lift])
        except DATABASE_GONE as error:
            log.error("database cannot be used", error=said_by(error))
            return None
        found = await self._pool.ask(editor, FeasibilityRequest(lift, parts.meshes, parts.cell_folders))
        if found is None:
            return None
        return FeasibilityDescription(holds=found.kept is not None, words=_words_of_ways(found, task.options.reserve))

    async def leave(self, editor: str) -> None:
        """Forget the lift of an editor that is closed."""
        await self._pool.leave(editor)


def _words_of_ways(found: Feasibility, asked: float) -> str:
    if found.kept is None:
        return found.why or "No way is left among the poses and holds that are tried first; a plan tries more of them."
    if found.kept < asked:
        return (
            f"A way is left, but none was seen that keeps the {PERCENT * asked:g} % of every limit that are asked for."
        )
    return f"A way is left that keeps {PERCENT * found.kept:g} % of every limit back."


def _words(answer: PathHolds | PathFails, asked: float) -> str:
    if isinstance(answer, PathHolds):
        less = "" if answer.reserve >= asked else f"; {PERCENT * asked:g} % are asked for"
        return f"The last path still holds: {PERCENT * answer.reserve:.3g} % of every limit is kept back{less}."
    where = f"At {answer.time:.1f} s of the last path the plate is not held, {ON[answer.element]}"
    if answer.limit is None:
        return f"{where}: no single limit decides."
    return f"{where}: the {answer.limit} is short by {answer.missing:.1f} N."
