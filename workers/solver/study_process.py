"""The child's side of studies: one process that examines points until its worker has no more, or is gone.

Unlike a process that plans, it goes on from one request to the next: what it knows of the reach of both hands is worth
more than a fresh start.
"""

from __future__ import annotations

import gc
from collections.abc import Callable

from planners.study.study import Study
from planners.study.study_map import StudyPoint
from workers.solver.process import Channel, answer_each, load_pipeline
from workers.solver.protocol import Message, StudyRequest, uploads_of

Examine = Callable[[Study, int, StudyRequest], StudyPoint]
"""Examines one point, by its number, with what came with the request."""


def main(prepare: Callable[[], Examine]) -> None:
    """Get ready and examine what is requested."""

    def answering() -> Callable[[bytes, Channel], None]:
        examine = prepare()
        return lambda line, channel: _answer(examine, StudyRequest.read(line), channel)

    answer_each(answering)


def _answer(examine: Examine, request: StudyRequest, channel: Channel) -> None:
    study = Study.of_document(request.study)
    for index in request.points:
        channel.send(Message(point=examine(study, index, request).model_dump(mode="json")))
        gc.collect()
    channel.send(Message(examined=True))


def _load_examiner() -> Examine:
    from planners.study.examine import PointExaminer
    from workers.solver.pipeline import cells_of

    # The first point loads the kernels that points need, which are fewer than all.
    solver = load_pipeline().solver
    examiner = PointExaminer(solver)

    def examine(study: Study, index: int, request: StudyRequest) -> StudyPoint:
        cells = cells_of(request, solver.cells)
        return examiner.examine(study, index, uploads_of(request), cells)

    return examine


if __name__ == "__main__":
    main(_load_examiner)
