"""/v1/studies: post a task with what is varied, watch the map fill, have its points planned."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Header, Path, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from app.pictures.study_picture import draw_map
from app.resources.followers import EventStream
from app.resources.plan_feed import stream_events
from app.resources.queries import read_page_token, write_page_token
from app.resources.schemas import PROBLEM, PlanResource, StudyList, StudyResource
from app.routes.dependencies import (
    Cells,
    CurrentCaller,
    FollowerPlaces,
    Settings,
    Studies,
    StudyFeed,
    caller_of,
    cells_of,
    followers_of,
    scenes_of,
)
from app.routes.headers import KEY_PATTERN, read_event_id, read_idempotency_key, read_wait, unless_known
from app.routes.plans import plan_response
from app.task_intake import with_parts
from app.uploads.body import read_body
from planners.contract.strict_json import parse_json
from planners.study.study_map import StudyMap

NOT_FOUND: dict[int | str, dict[str, Any]] = {404: {**PROBLEM, "description": "No such study"}}
BAD_TOKEN: dict[int | str, dict[str, Any]] = {400: {**PROBLEM, "description": "A token that is none of ours"}}
LARGEST_INDEX = 10**6

router = APIRouter(prefix="/v1/studies", tags=["studies"])


@router.post(
    "",
    status_code=202,
    response_model=StudyResource,
    summary="Post a study",
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {"application/json": {"schema": {"$ref": "#/components/schemas/StudySpec"}}},
        }
    },
    responses={
        200: {"model": StudyResource, "description": "`Prefer: wait` was given and the study has ended"},
        202: {"description": "Accepted; `Location` is the study's address"},
        400: {**PROBLEM, "description": "Not JSON, or a header that cannot be followed"},
        413: {**PROBLEM, "description": "Too large"},
        415: {**PROBLEM, "description": "Not declared as JSON"},
        422: {**PROBLEM, "description": "A study that cannot be begun: every reason with its JSON pointer"},
        429: {**PROBLEM, "description": "Too many unfinished studies"},
    },
)
async def post_study(
    request: Request,
    studies: Studies,
    feed: StudyFeed,
    settings: Settings,
    idempotency_key: Annotated[str | None, Header(json_schema_extra={"pattern": KEY_PATTERN})] = None,
    prefer: Annotated[str | None, Header(description="`wait=30`: answer when it has ended, or after 30 s")] = None,
) -> Response:
    """Accept a study; its points are examined in the background."""
    key = read_idempotency_key(idempotency_key)
    wait = None if prefer is None else read_wait(request.headers.getlist("prefer"))
    body = await read_body(request, settings.max_body_bytes, settings)
    cells, scenes = cells_of(request), scenes_of(request).document

    def submit() -> StudyResource:
        return studies.submit(parse_json(body), lambda task: with_parts(task, cells, scenes), key, cells)

    study = await run_in_threadpool(submit)
    headers = {"Location": study.links.self}
    if wait is not None:
        seconds = min(wait, settings.max_wait_seconds)
        await followers_of(request).wait_for_end(caller_of(request), feed, study.id, seconds, request.scope)
        study = await run_in_threadpool(studies.study, study.id)
        if study.done:
            return plan_response(study, 200, {**headers, "Preference-Applied": f"wait={wait}"})
    return plan_response(study, 202, headers)


@router.get("", response_model=StudyList, summary="List studies, newest first", responses=BAD_TOKEN)
def list_studies(
    studies: Studies, page_size: Annotated[int, Query(ge=1, le=200)] = 50, page_token: str | None = None
) -> StudyList:
    """Return one page of studies."""
    page, next_page = studies.page(page_size, read_page_token(page_token))
    return StudyList(studies=page, next_page_token=write_page_token(next_page))


@router.get("/{study_id}", response_model=StudyResource, summary="Look at a study", responses=NOT_FOUND)
def get_study(study_id: str, studies: Studies, if_none_match: Annotated[str | None, Header()] = None) -> Response:
    """Return a study; 304 if it is as the `ETag` in `If-None-Match` says."""
    return unless_known(plan_response(studies.study(study_id), 200, {}), if_none_match)


@router.get("/{study_id}/map", summary="Fetch the map, as far as it is known", responses=NOT_FOUND)
def get_map(study_id: str, studies: Studies) -> StudyMap:
    """Return the outcome of every point that is known, and the best one."""
    return studies.map(study_id)


@router.get(
    "/{study_id}/map.png",
    summary="Fetch the map as a picture",
    responses={**NOT_FOUND, 200: {"content": {"image/png": {}}, "description": "The map, as far as it is known"}},
)
def get_picture(study_id: str, studies: Studies) -> Response:
    """Return the map as a picture whose colours people with any colour vision tell apart."""
    return Response(draw_map(studies.map(study_id)), 200, {"Cache-Control": "no-cache"}, "image/png")


@router.get(
    "/{study_id}/events",
    summary="Follow a study (server-sent events)",
    responses={
        **NOT_FOUND,
        200: {"content": {"text/event-stream": {}}, "description": "A `point` event for each, then one `finished`"},
        204: {"description": "Everything was received already"},
        400: {**PROBLEM, "description": "A `Last-Event-ID` that no event of this stream has"},
        429: {**PROBLEM, "description": "Too many event streams, or too many of yours"},
    },
)
async def get_study_events(
    study_id: str,
    studies: Studies,
    feed: StudyFeed,
    caller: CurrentCaller,
    followers: FollowerPlaces,
    last_event_id: Annotated[str | None, Header()] = None,
) -> Response:
    """Follow a study from its first point, or from behind `Last-Event-ID`."""
    study = await run_in_threadpool(studies.study, study_id)
    sent = study.known
    received = read_event_id(last_event_id, sent + 1 if study.done else sent)
    if received > sent:
        return Response(status_code=204)
    return EventStream(stream_events(feed, study_id, received, studies.study), followers, caller)


@router.post(
    "/{study_id}/points/{index}/plan",
    status_code=202,
    response_model=PlanResource,
    summary="Plan a point",
    responses={
        200: {"model": PlanResource, "description": "Its plan has ended"},
        404: {**PROBLEM, "description": "No such study, or no such point, or its cell is there no more"},
        429: {**PROBLEM, "description": "Too many unfinished jobs, or too many of the study's owner"},
    },
)
def plan_point(
    study_id: str, index: Annotated[int, Path(ge=0, le=LARGEST_INDEX)], studies: Studies, cells: Cells
) -> Response:
    """Have the task of a point planned, certified and simulated as any other; asked again, that plan is returned."""
    plan = studies.plan_point(study_id, index, cells.with_deleted())
    return plan_response(plan, 200 if plan.done else 202, {"Location": plan.links.self})


@router.post(
    "/{study_id}/cancel",
    status_code=202,
    response_model=StudyResource,
    summary="Cancel a study",
    responses={**NOT_FOUND, 409: {**PROBLEM, "description": "Already finished"}},
)
def cancel_study(study_id: str, studies: Studies) -> Response:
    """Cancel what is left of a study; points that are known stay."""
    return plan_response(studies.cancel(study_id), 202, {})


@router.delete(
    "/{study_id}",
    status_code=204,
    summary="Delete a finished study",
    responses={**NOT_FOUND, 409: {**PROBLEM, "description": "Not finished"}},
)
def delete_study(study_id: str, studies: Studies) -> None:
    """Remove a finished study with its points; plans that were made of points stay."""
    studies.delete(study_id)
