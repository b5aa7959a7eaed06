"""What every route can depend on: who calls, and what of the service that caller sees."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends
from starlette.requests import HTTPConnection

from app.access.authenticator import Authenticator
from app.access.caller import Caller
from app.resources.plan_collection import PlanCollection
from app.resources.plan_feed import PlanFeed
from app.resources.scene_collection import SceneCollection
from app.resources.webhook_collection import WebhookCollection
from app.settings import ServiceSettings


def caller_of(connection: HTTPConnection) -> Caller:
    """Return who calls, as `AccessControl` has found out."""
    return connection.state.caller


def plans_of(connection: HTTPConnection) -> PlanCollection:
    """Return the plans that the caller may see."""
    return connection.app.state.plans.seen_by(caller_of(connection))


def scenes_of(connection: HTTPConnection) -> SceneCollection:
    """Return the perceived scenes that the caller may see."""
    return connection.app.state.scenes.seen_by(caller_of(connection))


def webhooks_of(connection: HTTPConnection) -> WebhookCollection:
    """Return the webhooks that the caller may see."""
    return connection.app.state.webhooks.seen_by(caller_of(connection))


def _authenticator(connection: HTTPConnection) -> Authenticator:
    return connection.app.state.authenticator


def _feed(connection: HTTPConnection) -> PlanFeed:
    return connection.app.state.feed


def _settings(connection: HTTPConnection) -> ServiceSettings:
    return connection.app.state.settings


CurrentCaller = Annotated[Caller, Depends(caller_of)]
Plans = Annotated[PlanCollection, Depends(plans_of)]
Scenes = Annotated[SceneCollection, Depends(scenes_of)]
Webhooks = Annotated[WebhookCollection, Depends(webhooks_of)]
Authentication = Annotated[Authenticator, Depends(_authenticator)]
Feed = Annotated[PlanFeed, Depends(_feed)]
Settings = Annotated[ServiceSettings, Depends(_settings)]
