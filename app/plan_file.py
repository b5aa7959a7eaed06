"""`liftwright plan FILE`: one task, no server."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from errno import ENOENT
from pathlib import Path
from typing import Any, TextIO

from pydantic import ValidationError

from app.intake import accept_task
from app.progress_bar import ProgressBar
from app.settings import ServiceSettings
from app.summary import summarise
from planners.contract.problems import Problem, problems_of
from planners.contract.strict_json import NotJson
from planners.errors import SceneError
from workers.pipeline import Pipeline
from workers.progress_scale import ProgressScale

SOLVED, NO_PLAN, BAD_INPUT = 0, 2, 3


def plan_file(path: Path, out: Path | None) -> int:
    """Plan the task in a file, print what came of it, and return the exit code.

    Raises:
        CertificateFailed: A plan was found that must not be used.
        OSError: A file cannot be read or written.
    """
    try:
        settings = ServiceSettings()
        # A command that only reads a file makes no data directory of its own.
        pipeline = Pipeline.load(settings.handovers_dir if settings.data_dir.is_dir() else None)
        task = accept_task(path.read_bytes(), pipeline.cells)
    except NotJson as error:
        return _refuse([Problem(pointer="", detail=str(error))])
    except (ValidationError, SceneError) as error:
        return _refuse(problems_of(error))
    with _written_whole(out) as file:
        document = _solve(pipeline, path.stem, task)
        if file is not None:
            json.dump(document, file, allow_nan=False)
    sys.stdout.write(summarise(document) + "\n")
    return SOLVED if document["outcome"] == "solved" else NO_PLAN


def _solve(pipeline: Pipeline, name: str, task: dict[str, Any]) -> dict[str, Any]:
    with ProgressBar() as bar:
        scale = ProgressScale.of(task)

        def show(stage: str, done: int, total: int) -> None:
            bar.show(stage, scale.advance(stage, done, total))

        document = pipeline.solve({"id": name, "task": task}, show)
        bar.show("done", 1.0)
    return document


@contextmanager
def _written_whole(out: Path | None) -> Iterator[TextIO | None]:
    """Open a file beside `out` that takes its place at the end: an impossible place is told before the planning."""
    if out is None:
        yield None
        return
    if out.exists() and not out.is_file():
        # A pipe or a terminal; of a directory the system says so itself.
        with out.open("w", encoding="utf-8") as stream:
            yield stream
        return
    if not out.parent.is_dir():
        raise FileNotFoundError(ENOENT, "no such folder", str(out))
    partial = out.with_name(f".{out.name}.{os.getpid()}")
    try:
        with partial.open("x", encoding="utf-8") as file:
            yield file
        partial.replace(out)
    finally:
        partial.unlink(missing_ok=True)


def _refuse(problems: list[Problem]) -> int:
    for problem in problems:
        choices = problem.get("allowed")
        allowed = f" (one of: {', '.join(choices)})" if choices else ""
        sys.stderr.write(f"{problem['pointer'] or '/'}: {problem['detail']}{allowed}\n")
    return BAD_INPUT
