"""A solver process whose answers are made up: the real machinery of processes around a function of a few lines.

What it does is told by the task's `external_id`: `steps-5` takes five steps, `hang` never ends, `die` kills itself,
`fail` raises, `eat` takes 64 GiB, `child` starts a process of its own and hangs; `infeasible` is answered so at once,
anything else is solved. Documents say which process made them.
An argument `fail` has every task fail.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

from planners.progress import Progress, Report
from workers.solver.process import COMPILE, main
from workers.solver.protocol import Answer, SolverRequest

STEP_SECONDS = 0.05


def solve(request: SolverRequest, progress: Progress) -> Answer:
    wish = "fail" if "fail" in sys.argv else str(request["task"].get("external_id"))
    progress(Report("scene", 1, 1))
    if wish == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if wish == "eat":
        eaten = [bytearray(2**26) for _ in range(2**10)]
        raise AssertionError(f"{len(eaten)} bites of 64 MiB fitted in")
    if wish == "fail":
        raise ValueError("the fake solver was told to fail")
    if wish == "child":
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    if wish in ("hang", "child"):
        for _ in range(6000):
            progress(Report("graph", 1, 2))
            time.sleep(0.1)
    if wish.startswith("steps-"):
        steps = int(wish.removeprefix("steps-"))
        for step in range(steps):
            progress(Report("motion", step + 1, steps))
            time.sleep(STEP_SECONDS)
    document = {
        "schema_version": "1.0",
        "id": request["id"],
        "outcome": "infeasible" if wish == "infeasible" else "solved",
        "process": os.getpid(),
        "task": request["task"],
        "meshes": sorted(request.get("meshes", {})),
        "noise": "x" * 5000,
    }
    return Answer(document["outcome"], json.dumps(document).encode())


if __name__ == "__main__":
    if COMPILE not in sys.argv:
        main(lambda: solve)
