"""`liftwright plan FILE`: one task, no server."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from pydantic import ValidationError

from app.intake import accept_task
from app.progress_bar import ProgressBar
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
        pipeline = Pipeline.load()
        task = accept_task(path.read_bytes(), pipeline.cells)
    except NotJson as error:
        return _refuse([Problem(pointer="", detail=str(error))])
    except (ValidationError, SceneError) as error:
        return _refuse(problems_of(error))
    with ProgressBar() as bar:
        scale = ProgressScale()

        def show(stage: str, done: int, total: int) -> None:
            bar.show(stage, scale.advance(stage, done, total))

        document = pipeline.solve({"id": path.stem, "task": task}, show)
        bar.show("done", 1.0)
    if out is not None:
        out.write_text(json.dumps(document, allow_nan=False))
    sys.stdout.write(summarise(document) + "\n")
    return SOLVED if document["outcome"] == "solved" else NO_PLAN


def _refuse(problems: list[Problem]) -> int:
    for problem in problems:
        choices = problem.get("allowed")
        allowed = f" (one of: {', '.join(choices)})" if choices else ""
        sys.stderr.write(f"{problem['pointer'] or '/'}: {problem['detail']}{allowed}\n")
    return BAD_INPUT
