"""The child's side of studies: one process that examines points until its worker has no more, or is gone.

Unlike a process that plans, it goes on from one request to the next: what it knows of the reach of both hands is worth
more than a fresh start.
"""

from __future__ import annotations

import gc
import json
from collections.abc import Callable

from planners.scene.shape_source import Uploads
from planners.study.study import Study
from planners.study.study_map import StudyPoint
from workers.solver.process import Channel, ReportedFaults, listen_to_the_worker, load_pipeline, tell_ready
from workers.solver.protocol import StudyRequest, uploads_of

Examine = Callable[[Study, int, Uploads], StudyPoint]
"""Examines one point, by its number."""


def main(prepare: Callable[[], Examine]) -> None:
    """Get ready and examine what is requested."""
    channel = Channel()
    requests = listen_to_the_worker()
    with ReportedFaults(channel):
        examine = prepare()
        tell_ready(channel)
        while True:
            request: StudyRequest = json.loads(requests.get())
            study, uploads = Study.of_document(request["study"]), uploads_of(request)
            for index in request["points"]:
                channel.send({"point": examine(study, index, uploads).model_dump(mode="json")})
                gc.collect()
            channel.send({"examined": True})


def _load_examiner() -> Examine:
    from planners.study.examine import PointExaminer

    return PointExaminer(load_pipeline().warm_up().solver).examine


if __name__ == "__main__":
    main(_load_examiner)
