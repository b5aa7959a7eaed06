"""/v1/plans: post a task, watch its job, fetch the plan document."""

from __future__ import annotations

import gzip
import hashlib
import re
from collections.abc import Callable, Coroutine
from functools import cache, partial
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, Query, Request, Response
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool

from app.access.access_control import KEPT, address_of
from app.errors import NoProgram
from app.resources.followers import EventStream
from app.resources.plan_feed import stream_events
from app.resources.queries import JobOrderQuery, PlanQuery, write_page_token
from app.resources.schemas import (
    PROBLEM,
    PlanList,
    PlanResource,
    PostedPlan,
    StudyResource,
    warnings_of,
)
from app.routes.cells import CellGate
from app.routes.dependencies import (
    Cells,
    CurrentCaller,
    Feed,
    FollowerPlaces,
    Plans,
    Settings,
    bench_of,
    caller_of,
    feed_of,
    followers_of,
    intake_of,
    plans_of,
    settings_of,
    webhooks_of,
)
from app.routes.headers import KEY_PATTERN, read_event_id, read_idempotency_key, read_wait, unless_known
from app.uploads.body import read_body
from app.work.wanted import StillWanted, while_waited_for
from planners.contract.strict_json import parse_json
from planners.contract.task_spec import TaskSpec
from planners.program import NotExportable, ProgramTarget, write_program
from planners.program.urscript import Handshake
from workers.stores.jobs import JobOrder
from workers.stores.plan_store import NO_ORDER

NOT_FOUND: dict[int | str, dict[str, Any]] = {404: {**PROBLEM, "description": "No such plan"}}
UNCHANGED: dict[int | str, dict[str, Any]] = {304: {"description": "As `If-None-Match` says"}}
BAD_TOKEN: dict[int | str, dict[str, Any]] = {400: {**PROBLEM, "description": "A token that is none of ours"}}

router = APIRouter(prefix="/v1/plans", tags=["plans"])


async def _order(query: Annotated[JobOrderQuery, Query()]) -> JobOrder:
    return query.order


Order = Annotated[JobOrder, Depends(_order)]


async def post_plan(
    request: Request,
    plans: Plans,
    feed: Feed,
    settings: Settings,
    order: Order,
    idempotency_key: Annotated[str | None, Header(json_schema_extra={"pattern": KEY_PATTERN})] = None,
    prefer: Annotated[str | None, Header(description="`wait=30`: answer when the job has ended, or after 30 s")] = None,
) -> Response:
    """Accept a task; its job runs in the background."""
    key = read_idempotency_key(idempotency_key)
    # There may be several, of which the framework would give one.
    wait = None if prefer is None else read_wait(request.headers.getlist("prefer"))
    body = await read_body(request, settings.max_body_bytes, settings)
    intake, webhooks = intake_of(request), webhooks_of(request)

    def accepted(sent: Any) -> TaskSpec:
        if order.webhook_id is not None:
            webhooks.require_usable(order.webhook_id)
        return intake(sent)

    # Parsed where the task is checked, beside the requests, and once.
    sent = cache(partial(parse_json, body))
    plan, is_new = await plans.submit(sent, accepted, key, order, address_of(request))
    setattr(request.state, KEPT, is_new)
    warnings = warnings_of(sent())
    headers = {"Location": plan.links.self}
    if wait is not None:
        seconds = min(wait, settings.max_wait_seconds)
        await followers_of(request).wait_for_end(caller_of(request), feed, plan.id, seconds, request.scope)
        plan = await run_in_threadpool(plans.plan, plan.id)
        if plan.done:
            answer = PostedPlan(**plan.model_dump(), warnings=warnings)
            return plan_response(answer, 200, {**headers, "Preference-Applied": f"wait={wait}"})
    return plan_response(PostedPlan(**plan.model_dump(), warnings=warnings), 202, headers)


class PostRoute(APIRoute):
    """The way to `post_plan`.

    The framework finds out for each request what an endpoint depends on, which takes longer than to check a task. Where
    there is no query, that is known.
    """

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return what answers a request."""
        answer_any = super().get_route_handler()

        async def answer(request: Request) -> Response:
            if request.scope["query_string"]:
                return await answer_any(request)
            headers, found = request.headers, (plans_of(request), feed_of(request), settings_of(request))
            return await post_plan(request, *found, NO_ORDER, headers.get("idempotency-key"), headers.get("prefer"))

        return answer


router.add_api_route(
    "",
    post_plan,
    methods=["POST"],
    route_class_override=PostRoute,
    status_code=202,
    response_model=PostedPlan,
    summary="Post a task",
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {"application/json": {"schema": {"$ref": "#/components/schemas/TaskSpec"}}},
        }
    },
    responses={
        200: {"model": PostedPlan, "description": "`Prefer: wait` was given and the job has ended"},
        202: {"description": "Accepted; `Location` is the plan's address"},
        400: {**PROBLEM, "description": "Not JSON, or a header that cannot be followed"},
        413: {**PROBLEM, "description": "Too large"},
        415: {**PROBLEM, "description": "Not declared as JSON"},
        422: {**PROBLEM, "description": "A task that cannot be planned: every reason with its JSON pointer"},
        429: {**PROBLEM, "description": "Too many unfinished jobs, or too many of yours that wait for their start"},
    },
)


@router.get("", response_model=PlanList, summary="List plans, newest first", responses=BAD_TOKEN)
def list_plans(plans: Plans, query: Annotated[PlanQuery, Query()]) -> PlanList:
    """Return one page of those plans for which everything holds that the query says."""
    page, next_page = plans.page(query)
    return PlanList(plans=page, next_page_token=write_page_token(next_page))


@router.get("/{plan_id}", response_model=PlanResource, summary="Look at a plan", responses={**NOT_FOUND, **UNCHANGED})
def get_plan(plan_id: str, plans: Plans, if_none_match: Annotated[str | None, Header()] = None) -> Response:
    """Return a plan; 304 if it is as the `ETag` in `If-None-Match` says."""
    response = plan_response(plans.plan(plan_id), 200, {})
    return unless_known(response, if_none_match)


@router.get(
    "/{plan_id}/document",
    summary="Fetch the plan document",
    responses={
        **NOT_FOUND,
        **UNCHANGED,
        200: {
            "content": {"application/json": {"schema": {"$ref": "#/components/schemas/PlanDocument"}}},
            "description": "The plan document",
        },
    },
)
def get_document(
    plan_id: str,
    plans: Plans,
    if_none_match: Annotated[str | None, Header()] = None,
    accept_encoding: Annotated[str, Header()] = "",
) -> Response:
    """Return the plan document, once there is a `verdict`.

    A plan that is still simulated has the `simulation` null, and another `ETag` than when that is there.
    """
    document = plans.document(plan_id)
    # Weak: compressed or not, it is the same document in other bytes.
    headers = {"ETag": f'W/"{document.sha256}"', "Vary": "Accept-Encoding", "Cache-Control": "no-cache"}
    body = document.gzip
    if re.search(r"\bgzip\b(?!\s*;\s*q=0(\.0*)?\s*(,|$))", accept_encoding):
        headers["Content-Encoding"] = "gzip"
    else:
        body = gzip.decompress(body)
    return unless_known(Response(body, 200, headers, "application/json"), if_none_match)


@router.get(
    "/{plan_id}/program.zip",
    summary="Fetch a plan as a program",
    response_class=Response,
    responses={
        **NOT_FOUND,
        409: {**PROBLEM, "description": "It must not become a program, and why"},
        200: {"content": {"application/zip": {}}, "description": "Its files"},
    },
)
async def get_program(
    request: Request,
    plan_id: str,
    plans: Plans,
    cells: Cells,
    limits: CellGate,
    target: Annotated[ProgramTarget, Query(description="URScript for two controllers, a package for ROS 2, or tables")],
    handshake: Annotated[Handshake, Query(description="Of `ur`: how the controllers wait for each other")] = (
        Handshake.REGISTERS
    ),
) -> Response:
    """Return a certified plan as a program, certified once more; docs/robot.md says how to run it."""
    bench = bench_of(request)

    def program(wanted: StillWanted) -> bytes:
        document = gzip.decompress(plans.document(plan_id).gzip)
        named, visible = plans.task(plan_id)["cell"], cells.with_deleted()
        if named not in visible:
            # An admin may have planned in somebody else's cell, whose files other keys of the plan's owner do not see.
            raise NoProgram("the plan is in a cell that belongs to somebody else")
        try:
            return bench.do(wanted, write_program, document, visible[named], target, handshake)
        except NotExportable as why:
            raise NoProgram(str(why)) from why

    packed = await while_waited_for(request, program, limits.worked)
    name = f'attachment; filename="{plan_id}.{target.value}.zip"'
    return Response(packed, media_type="application/zip", headers={"Content-Disposition": name})


@router.get(
    "/{plan_id}/events",
    summary="Follow a job (server-sent events)",
    responses={
        **NOT_FOUND,
        200: {
            "content": {"text/event-stream": {}},
            "description": "`progress` events; one `certified` before a plan is simulated, or one `verdict` before "
            "changes are tried of a task without a plan; then one `finished`",
        },
        204: {"description": "Everything was received already"},
        400: {**PROBLEM, "description": "A `Last-Event-ID` that no event of this stream has"},
        429: {**PROBLEM, "description": "Too many event streams, or too many of yours"},
    },
)
async def get_events(
    plan_id: str,
    plans: Plans,
    feed: Feed,
    caller: CurrentCaller,
    followers: FollowerPlaces,
    last_event_id: Annotated[str | None, Header()] = None,
) -> Response:
    """Follow a job from its first event, or from behind `Last-Event-ID`."""
    plan = await run_in_threadpool(plans.plan, plan_id)
    sent = await run_in_threadpool(plans.store.last_event, plan_id)
    received = read_event_id(last_event_id, sent + 1 if plan.done else sent)
    if received > sent:
        return Response(status_code=204)
    return EventStream(stream_events(feed, plan_id, received, plans.plan), followers, caller)


@router.post(
    "/{plan_id}/cancel",
    status_code=202,
    response_model=PlanResource,
    summary="Cancel a job",
    responses={**NOT_FOUND, 409: {**PROBLEM, "description": "Already finished"}},
)
def cancel_plan(plan_id: str, plans: Plans) -> Response:
    """Cancel a job; its process is gone within a second."""
    return plan_response(plans.cancel(plan_id), 202, {})


@router.delete(
    "/{plan_id}",
    status_code=204,
    summary="Delete a finished plan",
    responses={**NOT_FOUND, 409: {**PROBLEM, "description": "Not finished"}},
)
def delete_plan(plan_id: str, plans: Plans) -> None:
    """Remove a finished plan with its document and events."""
    plans.delete(plan_id)


def plan_response(plan: PlanResource | StudyResource, status: int, headers: dict[str, str]) -> Response:
    """Return a plan or a study as an answer, which says whether it may still change."""
    body = plan.model_dump_json().encode()
    headers = {**headers, "ETag": f'"{hashlib.sha256(body).hexdigest()[:32]}"', "Cache-Control": "no-cache"}
    if not plan.done:
        headers["Retry-After"] = "1"
    return Response(body, status, headers, "application/json")
