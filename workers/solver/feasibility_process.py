"""The child's side of live feasibility: one process that keeps the graph of a lift as long as somebody changes it."""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import astuple

from workers.solver.process import Channel, answer_each
from workers.solver.protocol import FeasibilityRequest, Message, uploads_of


def _load() -> Callable[[bytes, Channel], None]:
    # Here, because it takes a second in which the service may die.
    from planners.cell.cell import ShippedCells
    from planners.contract.task_spec import PlateLiftTask
    from planners.errors import SceneError
    from planners.study.feasibility import FeasibilityExaminer
    from workers.solver.pipeline import cells_of, reference_task

    examiner, shipped = FeasibilityExaminer(), ShippedCells()
    # Loads the kernels that the first question would wait for.
    examiner.ask(reference_task(hold_density=0.25), shipped)

    def answer(line: bytes, channel: Channel) -> None:
        request = FeasibilityRequest.read(line)
        lift = PlateLiftTask.model_validate(request.lift)
        try:
            found = examiner.ask(lift, cells_of(request, shipped), uploads_of(request))
        except SceneError:
            # What is wrong with the lift is told by whoever checks it.
            found = None
        channel.send(Message(feasibility=() if found is None else astuple(found)))
        gc.collect()

    return answer


if __name__ == "__main__":
    answer_each(_load)
