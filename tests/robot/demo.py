"""`make demo-robot`: plans, exports, executes and replays a lift and a pile, on controllers that stand in for robots.

Everything is done by the commands that one types at a real cell, except that the one that executes goes by the clock of
the controllers, which waits for it where a machine is busy. They are a process each and know nothing of plans. What
their arms move is in one world of physics, which their wrists feel, and so is who raises the lifter, unevenly.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import webbrowser
from pathlib import Path

from app.cli.execute_command import EXECUTED, ExecuteRequest, execute_file
from planners.cell.cell import load_cell
from planners.plan.plan import Plan
from planners.program.guard import exportable
from planners.program.schedule import Schedule
from tests.support.controller.lock_step import lock_step
from tests.support.controller.physical_cell import physical_cell
from tests.support.controller.stand_in import hosts

TASKS = ("ab1", "domino_pile")
SEED = 1
"""Of who raises the lifter, unevenly."""


def main() -> int:
    """Run the demo; 0 only if everything was executed to its end."""
    parser = argparse.ArgumentParser(prog="make demo-robot", description=__doc__)
    parser.add_argument("tasks", nargs="*", metavar="NAME", help=f"of assets/tasks; default: {' '.join(TASKS)}")
    parser.add_argument("--once", action="store_true", help="open no browser")
    parser.add_argument("--speed", type=float, default=1.0, metavar="SHARE", help="of the planned speed; default: 1")
    parser.add_argument("--folder", type=Path, default=Path("data/robot"), metavar="DIR", help="default: data/robot")
    parsed = parser.parse_args()
    parsed.folder.mkdir(parents=True, exist_ok=True)
    with open(os.devnull) as nobody:
        # Nobody is at the keyboard.
        sys.stdin = nobody
        done = [show(name, parsed.folder, parsed.speed) for name in parsed.tasks or TASKS]
    for page in done:
        if page is not None and not parsed.once:
            webbrowser.open(page.absolute().as_uri())
    return 0 if all(done) else 1


def show(task: str, folder: Path, speed: float) -> Path | None:
    """Take a shipped task all the way; returns the page that plays plan and execution, None: it was not executed."""
    plan, log, page = (folder / f"{task}{suffix}" for suffix in (".json", ".log.jsonl", ".html"))
    if _run("plan", f"assets/tasks/{task}.json", "--out", str(plan)) or _run("export", str(plan), "--target", "ur"):
        return None
    document = plan.read_bytes()
    schedule = Schedule.of(exportable(document, load_cell(Plan.read(document).cell.name)))
    with physical_cell(schedule, SEED, beyond_reach=True) as physics, lock_step(schedule) as clock:
        clock.physics = physics
        at = hosts()
        addresses = ("--left", at["left"], "--right", at["right"])
        _tell("execute", str(plan), *addresses, "--run", "--continuous", "--speed", str(speed), "--log", str(log))
        asked = ExecuteRequest(plan, at, None, True, True, speed, log)
        executed = execute_file(asked, clock.connect) == EXECUTED
        if physics.gave_way is not None:
            print(f"in physics: {physics.gave_way}", file=sys.stderr)
            return None
    return page if executed and _run("replay", str(plan), str(log), "--out", str(page)) == 0 else None


def _tell(*words: str) -> None:
    print("\n$ liftwright", *words, flush=True)


def _run(*words: str) -> int:
    _tell(*words)
    return subprocess.run(
        [sys.executable, "-m", "app.cli.main", *words], stdin=subprocess.DEVNULL, check=False
    ).returncode


if __name__ == "__main__":
    sys.exit(main())
