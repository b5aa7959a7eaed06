"""/v1/webhooks: be told when jobs end, instead of asking."""

from __future__ import annotations

import json
from datetime import datetime
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.concurrency import run_in_threadpool

from app.errors import NotAWebhook
from app.resources.queries import read_page_token, write_page_token
from app.resources.schemas import PROBLEM, Resource, moment
from app.routes.dependencies import Settings, Webhooks
from app.uploads.body import read_body
from planners.contract.problems import problems_of
from planners.contract.strict_json import parse_json
from workers.stores.webhook_store import Attempt, Delivery, Webhook
from workers.webhooks.target import LONGEST_URL

NOT_FOUND: dict[int | str, dict[str, Any]] = {404: {**PROBLEM, "description": "No such webhook"}}

router = APIRouter(prefix="/v1/webhooks", tags=["webhooks"])


class WebhookSpec(BaseModel):
    """A webhook that is to be registered."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, use_attribute_docstrings=True)

    url: str = Field(min_length=1, max_length=LONGEST_URL)
    """Where messages are posted: https, a public address unless the operator allows others."""
    plans: Literal["all", "named"] = "all"
    """Whether it wants to know of all plans of its owner, or of those that were posted with `?webhook=` and its id."""
    certified: bool = False
    """Whether it is told, too, when a plan is certified and its document can be fetched, while it is still simulated:
    by a message of type `plan.certified`, before the one that tells the end."""


class WebhookLinks(Resource):
    """Where to go from here."""

    self: str
    deliveries: str
    rotate: str


class WebhookResource(Resource):
    """An address that is told when jobs end."""

    id: str
    url: str
    plans: Literal["all", "named"]
    certified: bool = False
    """Whether it is told, too, when a plan is certified."""
    created_at: datetime
    disabled_at: datetime | None
    """When it has answered 410; nothing is sent any more."""
    secret: str | None
    """To check signatures with (Standard Webhooks); told once, when it is new."""
    links: WebhookLinks


class WebhookList(Resource):
    """One page of webhooks, newest first."""

    webhooks: list[WebhookResource]
    next_page_token: str | None


class AttemptResource(Resource):
    """One try to deliver a message."""

    number: int
    at: datetime
    status: int | None
    """Of the answer, if there was one."""
    failure: str | None


class DeliveryResource(Resource):
    """One message about one plan."""

    id: str
    """As in the header `webhook-id`; the same at every try."""
    plan_id: str
    type: str | None = None
    """What it tells, as `plan.succeeded`; None while it waits."""
    state: Literal["waiting", "pending", "delivered", "failed"]
    """waiting: for the job to end; pending: to be taken."""
    created_at: datetime
    attempts: list[AttemptResource]


class DeliveryList(Resource):
    """One page of messages, newest first."""

    deliveries: list[DeliveryResource]
    next_page_token: str | None


PageSize = Annotated[int, Query(ge=1, le=200)]


@router.post(
    "",
    status_code=201,
    response_model=WebhookResource,
    summary="Register a webhook",
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {"application/json": {"schema": WebhookSpec.model_json_schema()}},
        }
    },
    responses={
        400: {**PROBLEM, "description": "Not JSON"},
        409: {**PROBLEM, "description": "The owner has as many webhooks as one may have"},
        413: {**PROBLEM, "description": "Too large"},
        415: {**PROBLEM, "description": "Not declared as JSON"},
        422: {**PROBLEM, "description": "A webhook that leads where none may"},
    },
)
async def post_webhook(request: Request, response: Response, webhooks: Webhooks, settings: Settings) -> WebhookResource:
    """Register an address that is told when jobs end. Keep the secret: it is told once."""
    body = await read_body(request, settings.max_body_bytes, settings)
    try:
        spec = WebhookSpec.model_validate(parse_json(body))
    except ValidationError as error:
        raise NotAWebhook(problems_of(error, WebhookSpec)) from error
    resource = _resource(
        await run_in_threadpool(webhooks.register, spec.url, spec.plans, certified=spec.certified), tell=True
    )
    response.headers["Location"] = resource.links.self
    return resource


@router.get("", summary="List webhooks, newest first", responses={400: {**PROBLEM, "description": "A foreign token"}})
def list_webhooks(webhooks: Webhooks, page_size: PageSize = 50, page_token: str | None = None) -> WebhookList:
    """Return one page of webhooks."""
    page, position = webhooks.page(page_size, read_page_token(page_token))
    return WebhookList(webhooks=[_resource(webhook) for webhook in page], next_page_token=write_page_token(position))


@router.get("/{webhook_id}", summary="Look at a webhook", responses=NOT_FOUND)
def get_webhook(webhook_id: str, webhooks: Webhooks) -> WebhookResource:
    """Return a webhook, without its secret."""
    return _resource(webhooks.webhook(webhook_id))


@router.delete("/{webhook_id}", status_code=204, summary="Delete a webhook", responses=NOT_FOUND)
def delete_webhook(webhook_id: str, webhooks: Webhooks) -> None:
    """Remove a webhook with its log."""
    webhooks.delete(webhook_id)


@router.post("/{webhook_id}/rotate", summary="Replace a webhook's secret", responses=NOT_FOUND)
def rotate_webhook(webhook_id: str, webhooks: Webhooks) -> WebhookResource:
    """Return a new secret; for a day messages are signed with the old one as well."""
    return _resource(webhooks.rotate(webhook_id), tell=True)


@router.get(
    "/{webhook_id}/deliveries",
    summary="Read what was sent to a webhook, newest first",
    responses={**NOT_FOUND, 400: {**PROBLEM, "description": "A foreign token"}},
)
def list_deliveries(
    webhook_id: str, webhooks: Webhooks, page_size: PageSize = 50, page_token: str | None = None
) -> DeliveryList:
    """Return one page of messages with how each try went."""
    deliveries, position = webhooks.deliveries(webhook_id, page_size, read_page_token(page_token))
    return DeliveryList(
        deliveries=[_delivery(delivery, attempts) for delivery, attempts in deliveries],
        next_page_token=write_page_token(position),
    )


def _resource(webhook: Webhook, *, tell: bool = False) -> WebhookResource:
    address = f"/v1/webhooks/{webhook.id}"
    return WebhookResource(
        id=webhook.id,
        url=webhook.url,
        plans=webhook.plans,
        certified=webhook.certified,
        created_at=moment(webhook.created_us),
        disabled_at=None if webhook.disabled_us is None else moment(webhook.disabled_us),
        secret=webhook.secret if tell else None,
        links=WebhookLinks(self=address, deliveries=f"{address}/deliveries", rotate=f"{address}/rotate"),
    )


def _delivery(delivery: Delivery, attempts: list[Attempt]) -> DeliveryResource:
    return DeliveryResource(
        id=f"msg_{delivery.id}",
        plan_id=delivery.plan_id,
        type=None if delivery.body is None else json.loads(delivery.body)["type"],
        state=delivery.state.value,
        created_at=moment(delivery.created_us),
        attempts=[
            AttemptResource(number=tried.number, at=moment(tried.at_us), status=tried.status, failure=tried.failure)
            for tried in attempts
        ],
    )
