"""`liftwright study FILE --axis …`: where a task can be solved, examined on this machine or by a service."""

from __future__ import annotations

import asyncio
import json
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from app.cli.output import BadInput, ProgressBar, refuse, written_whole
from app.cli.plan_command import NO_PLAN, SOLVED
from app.cli.service_client import ServiceClient, ServiceRefused, StudyJob
from app.cli.task_file import TaskFile
from app.pictures.study_picture import colour_of, draw_map, whole_percent
from planners.contract.problems import Problem
from planners.contract.shapes import named_uploads
from planners.errors import LiftwrightError
from planners.study.study import NotAStudy, Study
from planners.study.study_map import StudyMap, StudyPoint
from workers.settings import STUDY_COMMAND, WorkerSettings
from workers.solver.examiner_pool import ExaminerPool
from workers.solver.pool import SolverCommand
from workers.solver.protocol import HANDOVERS_VARIABLE, StudyRequest
from workers.solver.warm_up import is_warm

JOB_FAILED = 1
MARKS = {"not_found": "··", "infeasible": "××", "refused": "  ", "failed": "!!"}
"""Of points that are not solved; the others show what is kept back in per cent."""
MEANINGS = {
    "not_found": "not found",
    "infeasible": "proven infeasible",
    "refused": "no such task can be",
    "failed": "failed, our fault",
}


def study_file(
    path: Path,
    axes: Sequence[Axis],
    outputs: tuple[Path | None, Path | None],
    settings: WorkerSettings,
    *,
    certify: bool,
    processes: int | None = None,
) -> int:
    """Examine the task in a file at all values of the axes, print the map, and return the exit code.

    Args:
        path: of the task.
        axes: as `read_axis` gives them.
        outputs: where the map goes, as JSON and as a picture.
        settings: name the data directory, where handovers are kept.
        certify: whether every point is planned as `liftwright plan` does.
        processes: how many points are examined at the same time; None: one for each core.

    Raises:
        BadInput: A file is not a task.
        SolverDied, SolverFault: A process ended without an answer.
        OSError: A file cannot be read or written.
    """
    sent = {"task": TaskFile.read(str(path)).task, "axes": [axis.document() for axis in axes], "certify": certify}
    try:
        study = Study.read(sent)
    except NotAStudy as refused:
        return refuse(_as_arguments(refused.problems, axes), str(path))
    if named_uploads(study.spec.task):
        raise BadInput(f"{path} names an upload, which a service keeps; examine it with --service http://…")
    points: list[StudyPoint] = []
    with written_whole(outputs[0]) as file, ProgressBar() as bar:

        def show(point: StudyPoint) -> None:
            points.append(point)
            bar.show(f"{len(points)} of {study.count} points", len(points) / study.count)

        asyncio.run(_examine(study, settings, processes or os.cpu_count() or 1, show))
        found = StudyMap.of(study, points)
        if file is not None:
            file.write(found.model_dump_json())
    return _tell(found, outputs[1])


def post_study(
    path: Path, axes: Sequence[Axis], outputs: tuple[Path | None, Path | None], service: str, *, certify: bool
) -> int:
    """Have a service examine the task in a file, print the map, and return the exit code.

    Raises:
        BadInput: A file is not a task.
        KeyMissing, ServiceAway, ServiceRefused: The service cannot do it, and not because of the study.
        OSError: A file cannot be read or written.
    """
    study = {"task": TaskFile.read(str(path)).task, "axes": [axis.document() for axis in axes], "certify": certify}
    client = ServiceClient(service)
    try:
        # Whatever is wrong with where the map goes is known before anything is planned.
        with written_whole(outputs[0]) as file:
            job = client.follow_study(client.post_study(json.dumps(study).encode()))
            if job.state != "succeeded":
                raise _StudyEnded(job)
            found = client.read_as(StudyMap, job.links.map)
            if file is not None:
                file.write(found.model_dump_json())
    except ServiceRefused as error:
        if not error.is_about_the_input:
            raise
        return refuse(_as_arguments(error.problems, axes), str(path))
    except _StudyEnded as ended:
        sys.stderr.write(f"liftwright: {ended}\n")
        return JOB_FAILED
    code = _tell(found, outputs[1])
    sys.stdout.write(f"{'study:':<16}{client.address}{job.links.self}\n")
    if job.best_plan is not None:
        sys.stdout.write(f"{'best, certified:':<16} {client.address}{job.best_plan}\n")
    return code


class _StudyEnded(LiftwrightError):
    """There is no map: the study has failed, or was cancelled."""

    def __init__(self, job: StudyJob) -> None:
        super().__init__(f"the study {job.state}: {job.error.detail if job.error is not None else ''}")


@dataclass(frozen=True)
class Axis:
    """An axis as it was typed; whether the task has it is seen when the study is read."""

    pointer: str
    part: str | None
    """Of what stands there; None: all of it."""
    span: tuple[float, float, int] | None
    """Least and greatest value, and how many there are."""
    values: tuple[Any, ...] = ()
    """Instead of a span, as JSON data."""

    def document(self) -> dict[str, object]:
        """Return the axis as a study has it, as JSON data."""
        where = {"pointer": self.pointer} if self.part is None else {"pointer": self.pointer, "part": self.part}
        if self.span is None:
            return {**where, "values": list(self.values)}
        return {**where, **dict(zip(("min", "max", "count"), self.span, strict=True))}


def read_axis(text: str) -> Axis:
    """Return the axis that an argument says: `/cup/position/0=-0.12:0.12:12`, or `/lifter_model=paper,cable`.

    Raises:
        ValueError: It says none.
    """
    target, sign, values = text.partition("=")
    pointer, at, part = target.partition("@")
    if not sign or not values or not pointer.startswith("/"):
        raise ValueError(f"{text!r} is no axis: write /POINTER=MIN:MAX:COUNT, or /POINTER=VALUE,VALUE,…")
    of = part if at else None
    bounds = values.split(":")
    if (len(bounds) == 3 and not values.startswith(("[", "{", '"'))) or (
        len(bounds) > 1 and all(map(_is_number, bounds))
    ):
        try:
            low, high, count = bounds
            return Axis(pointer, of, (float(low), float(high), int(count)))
        except ValueError:
            raise ValueError(f"{values!r} is no range: write MIN:MAX:COUNT, as -0.12:0.12:12") from None
    return Axis(pointer, of, None, tuple(_listed(values)))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _listed(text: str) -> Iterator[Any]:
    """Yield values with commas between them: JSON where it is, else words."""
    try:
        yield from json.loads(f"[{text}]")
    except ValueError:
        for word in text.split(","):
            try:
                yield json.loads(word)
            except ValueError:
                yield word


async def _examine(study: Study, settings: WorkerSettings, processes: int, show: Callable[[StudyPoint], None]) -> None:
    folder = {HANDOVERS_VARIABLE: str(settings.handovers_dir)} if settings.data_dir.is_dir() else {}
    pool = ExaminerPool(SolverCommand(STUDY_COMMAND, folder))
    # One by one: a process that is kept loses nothing between two points, and none has the last ones for itself.
    left = list(range(study.count))
    # Two processes must not compile the same kernels at the same time: then the first one begins alone.
    compiled = asyncio.Event()
    if is_warm(settings):
        compiled.set()

    async def take(document: dict[str, object]) -> None:
        compiled.set()
        show(StudyPoint.model_validate(document))

    async def work(number: int) -> None:
        if number > 0:
            await compiled.wait()
        while left:
            await pool.examine(StudyRequest(study.document(), [left.pop(0)]), take)

    try:
        async with asyncio.TaskGroup() as group:
            for number in range(min(processes, len(left))):
                group.create_task(work(number))
    except BaseExceptionGroup as several:
        raise several.exceptions[0] from None
    finally:
        await pool.close()


_TYPED = {"min": "MIN ", "max": "MAX ", "count": "COUNT ", "part": "what stands after @ "}
"""How a member of an axis is called where it is typed."""


def _as_arguments(problems: Iterable[Problem], axes: Sequence[Axis]) -> list[Problem]:
    """Tell problems of axes by what was typed."""
    told: list[Problem] = []
    for problem in problems:
        steps = problem.pointer.split("/")
        if steps[1:2] == ["axes"] and len(steps) > 2 and steps[2].isdecimal():
            # Without its name a bound of the axis reads as one of the member that is varied.
            of = _TYPED.get(steps[3], "") if len(steps) == 4 else ""
            told.append(replace(problem, pointer=f"--axis {axes[int(steps[2])].pointer}", detail=of + problem.detail))
        else:
            told.append(replace(problem, pointer=problem.pointer.removeprefix("/task")))
    return told


def _tell(found: StudyMap, picture: Path | None) -> int:
    if picture is not None:
        picture.write_bytes(draw_map(found))
    console = Console(highlight=False, soft_wrap=True)
    for line in drawn(found):
        console.print(line)
    return SOLVED if found.best is not None else NO_PLAN


def drawn(found: StudyMap) -> Iterator[Text]:
    """Yield the map as lines for a terminal: the first axis to the right, the second one upwards."""
    first, *more = found.axes
    rows = more[0].values if more else [None]
    by_place = {point.at: point for point in found.points}
    width = max([4, *(len(_word(value)) + 1 for value in first.values)]) if len(first.values) <= 16 else 4
    edge = max((len(_word(value)) for value in rows if value is not None), default=0) + 2
    if more:
        yield Text(f"{more[0].pointer}{_turned(more[0].part)}")
    for row in reversed(range(len(rows))):
        label = "" if rows[row] is None else _word(rows[row])
        line = Text(f"{label:>{edge}} ")
        for column in range(len(first.values)):
            point = by_place.get((column, row) if more else (column,))
            line.append_text(_block(point, width))
        yield line
    step = 1 if width > 4 or len(first.values) <= 16 else max(1, math.ceil(8 / width))
    labels = "".join(f"{_word(value):^{width * step}}"[: width * step] for value in first.values[::step])
    yield Text(f"{'':>{edge}} {labels}")
    yield Text(f"{'':>{edge}} {first.pointer}{_turned(first.part)}")
    yield Text("")
    told = [f"{found.outcomes['solved']} of {found.count} points solved (kept back of every limit in %)"]
    told += [f"{MARKS[name]} {found.outcomes[name]} {MEANINGS[name]}" for name in MARKS if found.outcomes[name]]
    yield Text("; ".join(told))
    if found.best is None:
        yield Text("No point is solved.")
        return
    where = ", ".join(
        f"{axis.pointer}{_turned(axis.part)} = {_word(value)}"
        for axis, value in zip(found.axes, found.best.values, strict=True)
    )
    yield Text(f"{'best:':<16}{where}")
    yield Text(f"{'':<16}{found.best.why}")
    if not found.certify:
        yield Text(f"{'':<16}searched and not certified: `liftwright plan` of that task certifies it")


def _block(point: StudyPoint | None, width: int) -> Text:
    if point is None:
        return Text(f"{'?':^{width}}")
    if point.outcome != "solved":
        return Text(f"{MARKS[point.outcome]:^{width}}", style="dim")
    blue, green, red = colour_of(point.reserve or 0.0)
    ink = "white" if red + green + blue < 330 else "black"
    text = f"{whole_percent(point.reserve)}"
    return Text(f"{text:^{width}}", style=f"{ink} on rgb({red},{green},{blue})")


def _word(value: Any) -> str:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return f"{value:.3g}"
    text = value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))
    return text if len(text) <= 24 else f"{text[:23]}…"


def _turned(part: str) -> str:
    return " turned [rad]" if part == "yaw" else ""
