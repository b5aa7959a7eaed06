"""A solver process whose answers are made up: the real machinery of processes around a function of a few lines.

What it does is told by the task's `external_id`: `steps-5` takes five steps, `hang` never ends, `die` kills itself,
`fail` raises, `eat` takes 64 GiB, `child` starts a process of its own and hangs; `infeasible` is answered so at once,
`remedies-5` is, too, and then told what helps after five steps; anything else is solved. `simulate-5` is certified, and
then simulated for five steps, `simulate-hang` for ever; `simulate-die` kills itself in the first simulation,
`simulate-fail` raises in each. Documents tell who planned them. An argument `fail` has every task fail.
"""

from __future__ import annotations

import base64
import gzip
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

from planners.progress import Progress, Report
from workers.solver.process import COMPILE, main
from workers.solver.protocol import Answer, SolverRequest

STEP_SECONDS = 0.05


def solve(request: SolverRequest, progress: Progress, certified: Callable[[Answer], bool]) -> Answer:
    if request.certified is not None:
        before = json.loads(gzip.decompress(base64.b64decode(request.certified)))
        solved = before["outcome"] == "solved"
        return simulated(before, progress, again=True) if solved else remedied(before, progress)
    document = planned(request, progress)
    if str(request.task.get("external_id")).startswith("simulate-"):
        before = Answer("solved", json.dumps({**document, "simulation": None}).encode())
        return before if certified(before) else simulated(document, progress, again=False)
    if str(request.task.get("external_id")).startswith("remedies-"):
        before = Answer(document["outcome"], json.dumps(document).encode())
        return before if certified(before) else remedied(document, progress)
    return Answer(document["outcome"], json.dumps(document).encode())


def planned(request: SolverRequest, progress: Progress) -> dict[str, Any]:
    """Do what the task tells, and return a document."""
    wish = "fail" if "fail" in sys.argv else str(request.task.get("external_id"))
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
    return {
        "schema_version": "1.0",
        "id": request.id,
        "outcome": "infeasible" if wish == "infeasible" or wish.startswith("remedies-") else "solved",
        "process": os.getpid(),
        "task": request.task,
        "meshes": sorted(request.meshes or {}),
        "noise": "x" * 5000,
    }


def simulated(document: dict[str, Any], progress: Progress, *, again: bool) -> Answer:
    """Simulate a plan; `again`: as it came back from the worker."""
    wish = str(document["task"]["external_id"]).removeprefix("simulate-")
    if wish == "die" and not again:
        os.kill(os.getpid(), signal.SIGKILL)
    if wish == "fail":
        raise ValueError("the fake solver was told to fail in physics")
    steps = int(wish) if wish.isdigit() else 1 if wish in ("die", "slip") else 6000
    for step in range(steps):
        progress(Report("simulate", step + 1, steps))
        time.sleep(STEP_SECONDS)
    ending = "slipped" if wish == "slip" else "lifted"
    physics = "failed" if wish == "slip" else "passed"
    return Answer("solved", json.dumps({**document, "simulation": {"outcome": ending}}).encode(), physics=physics)


def remedied(document: dict[str, Any], progress: Progress) -> Answer:
    """Add what helps to a proof that there is no plan."""
    steps = int(str(document["task"]["external_id"]).removeprefix("remedies-"))
    for step in range(steps):
        progress(Report("remedies", step + 1, steps))
        time.sleep(STEP_SECONDS)
    return Answer("infeasible", json.dumps({**document, "remedies": ["another place"]}).encode())


if __name__ == "__main__":
    if COMPILE not in sys.argv:
        main(lambda: solve)
