"""A process that examines points of studies and makes its answers up.

What it does is told by the task's `external_id`: `slow` takes a while at each point, `hang` never ends one, `die-7`
kills itself at point 7, `fail-7` raises there. Every third point is not found, the others keep back the more the higher
their number is, with `bright` 15 % at each. Each number that is begun is appended to the file that is named as an
argument.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

from planners.scene.shape_source import Uploads
from planners.study.study import Study
from planners.study.study_map import StudyPoint
from workers.solver.study_process import main

STEP_SECONDS, BRIGHT = 0.1, 0.15


def examine(study: Study, index: int, _: Uploads) -> StudyPoint:
    wish = str(study.spec.task.get("external_id"))
    if len(sys.argv) > 1:
        with Path(sys.argv[1]).open("a") as begun:
            begun.write(f"{index}\n")
    if wish == "slow":
        time.sleep(STEP_SECONDS)
    if wish == "hang":
        time.sleep(600)
    if wish == f"die-{index}":
        os.kill(os.getpid(), signal.SIGKILL)
    if wish == f"fail-{index}":
        raise ValueError("the fake examiner was told to fail")
    found = index % 3 != 2
    return StudyPoint(
        index=index,
        at=study.at(index),
        outcome="solved" if found else "not_found",
        examined="searched",
        reserve=(BRIGHT if wish == "bright" else 0.001 * index) if found else None,
        largest_force=15.0 if found else None,
        seconds=0.5,
        summary=f"made up by {os.getpid()}",
    )


if __name__ == "__main__":
    main(lambda: examine)
