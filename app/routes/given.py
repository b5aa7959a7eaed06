"""What every route can ask to be given."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Request
from starlette.requests import HTTPConnection

from app.access.caller import Caller
from app.access.door import Door
from app.plan_desk import PlanDesk
from app.plan_feed import PlanFeed
from app.scene_desk import SceneDesk
from app.settings import ServiceSettings
from app.webhook_desk import WebhookDesk


def caller_of(connection: HTTPConnection) -> Caller:
    """Return who calls, as the gate has found out."""
    return connection.state.caller


def scenes_of(connection: HTTPConnection) -> SceneDesk:
    """Return the perceived scenes that the caller may see."""
    return connection.app.state.scenes.seen_by(caller_of(connection))


def webhooks_of(connection: HTTPConnection) -> WebhookDesk:
    """Return the webhooks that the caller may see."""
    return connection.app.state.webhook_desk(caller_of(connection))


def _caller(request: Request) -> Caller:
    return caller_of(request)


def _desk(request: Request) -> PlanDesk:
    """Return the plans that the caller may see."""
    return request.app.state.desk.seen_by(caller_of(request))


def _scenes(request: Request) -> SceneDesk:
    return scenes_of(request)


def _door(request: Request) -> Door:
    return request.app.state.door


def _feed(request: Request) -> PlanFeed:
    return request.app.state.feed


def _settings(request: Request) -> ServiceSettings:
    return request.app.state.settings


def _webhooks(request: Request) -> WebhookDesk:
    return webhooks_of(request)


CallerGiven = Annotated[Caller, Depends(_caller)]
Desk = Annotated[PlanDesk, Depends(_desk)]
DoorGiven = Annotated[Door, Depends(_door)]
Feed = Annotated[PlanFeed, Depends(_feed)]
Scenes = Annotated[SceneDesk, Depends(_scenes)]
Webhooks = Annotated[WebhookDesk, Depends(_webhooks)]
Settings = Annotated[ServiceSettings, Depends(_settings)]
