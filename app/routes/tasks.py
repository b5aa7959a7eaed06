"""/v1/tasks: ask about a task that is not posted yet."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request
from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool

from app.resources.schemas import PROBLEM, ProblemItem, Resource, warnings_of
from app.routes.dependencies import Intake, Settings
from app.uploads.body import read_body
from planners.contract.problems import problems_of
from planners.contract.strict_json import parse_json
from planners.contract.task_spec import write_task
from planners.errors import SceneError


class TaskCheck(Resource):
    """What `POST /v1/plans` would say of a task."""

    accepted: bool
    """Whether the task would be taken. That there is a plan is not said: it takes planning."""
    errors: list[ProblemItem]
    """What the task would be refused for, in the order of its members. Where its members are as they must be, the first
    thing that cannot stand as it says."""
    warnings: list[ProblemItem]
    """What would be taken and is most probably not meant, as a quaternion 0, 0, 0, 1, which is half a turn: w comes
    first."""
    task: dict[str, Any] | None
    """The task as it would be accepted, every default filled in; null where it would be refused."""


router = APIRouter(prefix="/v1/tasks", tags=["tasks"])


@router.post(
    "/check",
    summary="Check a task without posting it",
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {"application/json": {"schema": {"$ref": "#/components/schemas/TaskSpec"}}},
        }
    },
    responses={
        400: {**PROBLEM, "description": "Not JSON"},
        413: {**PROBLEM, "description": "Too large"},
        415: {**PROBLEM, "description": "Not declared as JSON"},
    },
)
async def check_task(request: Request, intake: Intake, settings: Settings) -> TaskCheck:
    """Tell whether a task would be accepted, and with which defaults, or everything it would be refused for.

    Nothing is stored and no job begins, so that a key with the scope `read` is enough.
    """
    body = await read_body(request, settings.max_body_bytes, settings)
    return await run_in_threadpool(lambda: check(parse_json(body), intake))


def check(sent: Any, intake: Intake) -> TaskCheck:
    """Return what an intake says of a task, given as JSON data."""
    try:
        return TaskCheck(accepted=True, errors=[], warnings=warnings_of(sent), task=write_task(intake(sent)))
    except (ValidationError, SceneError) as error:
        errors = [ProblemItem.model_validate(problem, from_attributes=True) for problem in problems_of(error)]
        return TaskCheck(accepted=False, errors=errors, warnings=warnings_of(sent), task=None)
