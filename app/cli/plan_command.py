"""`liftwright plan FILE…`: tasks, planned on this machine or by a service."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from app.cli.output import BAD_INPUT, BadInput, Refused, refuse, said_of, warn, written_whole
from app.cli.task_file import STDIN, TaskFile
from planners.contract.problems import doubts_of
from planners.errors import LiftwrightError

if TYPE_CHECKING:
    from planners.plan.plan import Plan

SOLVED, FAILED, NO_PLAN = 0, 1, 2
"""Exit codes, as is `BAD_INPUT`."""
FROM_BEST_TO_WORST = (SOLVED, NO_PLAN, BAD_INPUT, FAILED)


@dataclass(frozen=True)
class Planned:
    """What came of a task."""

    plan: Plan
    viewer: str | None = None
    """Where a service shows it."""


class TaskPlanner(Protocol):
    """Plans tasks, here or elsewhere."""

    def begin(self, file: TaskFile) -> Callable[[], Planned]:
        """Accept a task, and return what plans it, or waits until that is done.

        Raises:
            Refused: It is not one that can be planned.
        """
        ...


@dataclass
class _Job:
    """One file and what becomes of it."""

    named: str
    title: str | None
    """What begins its line of outcome; None: it is the only one, and is told of in full."""
    out: Path | None
    file: TaskFile | None = None
    plan: Callable[[], Planned] | None = None
    refusal: str = ""
    code: int | None = None


def plan_files(
    named: Sequence[str],
    out: Path | None,
    load_planner: Callable[[], TaskPlanner],
    *,
    check: bool = True,
    apply: int | None = None,
    plans: bool = True,
) -> int:
    """Plan the tasks in files, print what came of each, and return the exit code, of several the worst.

    Args:
        named: files, or "-" for standard input.
        out: where the plan document goes; of several tasks a folder, which is made if it is not there.
        load_planner: called only if there is a task to plan.
        check: whether tasks are read before that, so that what is none is refused at once.
        apply: number of the remedy with which a task that has no plan is written anew, beside it; None: none.
        plans: whether to plan; otherwise it is only told what is wrong with the tasks.

    Raises:
        BadInput: Two tasks would have one name, or a document would replace its task.
        LiftwrightError: Whoever plans cannot.
        OSError: A document cannot be written.
    """
    if apply is not None and len(named) > 1:
        raise BadInput("--apply takes one task: its remedies are its own")
    titles = [f"{name:<{max(map(len, named))}}  " if len(named) > 1 else None for name in named]
    jobs = [_Job(*of_one) for of_one in zip(named, titles, _places(named, out), strict=True)]
    for job in jobs:
        _read(job, check=check)
    planner = load_planner() if any(job.code is None for job in jobs) else None
    for job in jobs:
        if planner is not None and job.file is not None and job.code is None:
            _begin(job, job.file, planner)
    for job in jobs:
        if job.plan is None:
            _tell_line(job, job.refusal)
        elif not plans:
            job.code = SOLVED
            sys.stdout.write(f"{job.title or f'{job.named}: '}a task that can be planned\n")
        else:
            planned = _plan(job, job.plan)
            if apply is not None and planned is not None and job.file is not None:
                _apply(apply, planned.plan, job.file)
    return max((job.code or SOLVED for job in jobs), key=FROM_BEST_TO_WORST.index)


def _places(named: Sequence[str], out: Path | None) -> list[Path | None]:
    """Return where the document of each task goes."""
    if len(set(named)) < len(named):
        twice = next(name for name in named if named.count(name) > 1)
        raise BadInput(f"{twice} is given twice")
    if out is None:
        return [None] * len(named)
    places = [out]
    if len(named) > 1:
        if out.exists() and not out.is_dir():
            raise BadInput(f"{out} is a file; of several tasks the documents go to a folder")
        out.mkdir(exist_ok=True)
        places = [out / f"{'stdin' if name == STDIN else Path(name).stem}.json" for name in named]
    for name, place in zip(named, places, strict=True):
        if places.count(place) > 1:
            raise BadInput(f"two tasks would be written to {place}; rename one, or plan them one after the other")
        if name != STDIN and place.exists() and place.samefile(name):
            raise BadInput(f"{place} is a task; write its plan elsewhere")
    return list(places)


def _read(job: _Job, *, check: bool) -> None:
    try:
        job.file = TaskFile.read(job.named)
        if check:
            job.file.check()
        if doubts := doubts_of(job.file.task):
            _name_it(job)
            warn(doubts, job.named, job.file.line_of)
    except (BadInput, OSError) as error:
        sys.stderr.write(f"liftwright: {said_of(error) if isinstance(error, OSError) else error}\n")
        job.code, job.refusal = BAD_INPUT, "refused, no task"
    except Refused as error:
        _refuse(job, error)


def _begin(job: _Job, file: TaskFile, planner: TaskPlanner) -> None:
    try:
        job.plan = planner.begin(file)
    except Refused as error:
        _refuse(job, error)


def _refuse(job: _Job, error: Refused) -> None:
    _name_it(job)
    job.code = refuse(error.problems, job.named, None if job.file is None else job.file.line_of)
    count = len(error.problems)
    job.refusal = f"refused, {count} problem{'s' if count > 1 else ''}"


def _name_it(job: _Job) -> None:
    """Say of which of several files the next lines are."""
    if job.title is not None:
        sys.stderr.write(f"{job.named}:\n")


def _apply(number: int, plan: Plan, file: TaskFile) -> None:
    """Write the task with a remedy applied beside it, as JSON.

    Raises:
        BadInput: There are remedies, but not so many.
    """
    from planners.contract.task_change import changed
    from planners.contract.task_spec import to_post_again, write_task

    if plan.outcome == "solved" and not plan.explanation.remedies:
        sys.stdout.write(f"{'changed task:':<16}none, the task has a plan as it is\n")
        return
    remedies = plan.explanation.remedies or []
    if not remedies:
        sys.stdout.write(f"{'changed task:':<16}none, as no change was found that helps\n")
        return
    if number > len(remedies):
        raise BadInput(f"there is no remedy {number} to apply: choose from 1 to {len(remedies)}")
    # What a scene gives stands in the task of the plan alone.
    of_scene = plan.task.kind == "suction_tool" and plan.task.scene_id is not None
    task = write_task(to_post_again(plan.task)) if of_scene else file.task
    path = Path(file.named).with_name(f"{file.stem}.remedy-{number}.json")
    with written_whole(path) as written:
        assert written is not None
        json.dump(changed(task, remedies[number - 1].patch), written, indent=2, allow_nan=False)
    sys.stdout.write(f"{'changed task:':<16}{path}\n")


def _plan(job: _Job, plan: Callable[[], Planned]) -> Planned | None:
    """Plan, tell what came of it, and return it; None where it failed."""
    # Here, because a task that is refused needs nothing of it.
    from app.summary import outcome_line, summarise

    try:
        with written_whole(job.out) as file:
            planned = plan()
            if file is not None:
                json.dump(planned.plan.document(), file, allow_nan=False)
    except LiftwrightError as error:
        sys.stderr.write(f"liftwright: {error if job.title is None else f'{job.named}: {error}'}\n")
        job.code = FAILED
        _tell_line(job, "failed")
        return None
    job.code = SOLVED if planned.plan.outcome == "solved" else NO_PLAN
    _tell_line(job, outcome_line(planned.plan))
    if job.title is None:
        sys.stdout.write(summarise(planned.plan) + "\n")
        if planned.viewer is not None:
            sys.stdout.write(f"{'viewer:':<16}{planned.viewer}\n")
    return planned


def _tell_line(job: _Job, outcome: str) -> None:
    """Print the outcome of one of several tasks."""
    if job.title is not None:
        sys.stdout.write(f"{job.title}{outcome}\n")
        sys.stdout.flush()
