"""What every route can depend on: who calls, and what of the service that caller sees."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial
from typing import Annotated, Any, TypeVar

from fastapi import Depends
from starlette.requests import HTTPConnection

from app.access.authenticator import Authenticator
from app.access.caller import Caller
from app.resources.cell_collection import CellCollection
from app.resources.followers import Followers
from app.resources.plan_collection import PlanCollection
from app.resources.plan_feed import PlanFeed
from app.resources.scene_collection import SceneCollection
from app.resources.study_collection import StudyCollection
from app.resources.webhook_collection import WebhookCollection
from app.settings import ServiceSettings
from app.task_intake import AcceptedTask, accept_task
from app.work.workbench import Workbench

Dependency = TypeVar("Dependency")


def caller_of(connection: HTTPConnection) -> Caller:
    """Return who calls, as `AccessControl` has found out."""
    return connection.state.caller


def cells_of(connection: HTTPConnection) -> CellCollection:
    """Return the cells that the caller's tasks may name."""
    return connection.app.state.cells.seen_by(caller_of(connection))


def plans_of(connection: HTTPConnection) -> PlanCollection:
    """Return the plans that the caller may see."""
    return connection.app.state.plans.seen_by(caller_of(connection))


def scenes_of(connection: HTTPConnection) -> SceneCollection:
    """Return the perceived scenes that the caller may see."""
    return connection.app.state.scenes.seen_by(caller_of(connection))


def studies_of(connection: HTTPConnection) -> StudyCollection:
    """Return the studies that the caller may see."""
    return connection.app.state.studies.seen_by(caller_of(connection))


def webhooks_of(connection: HTTPConnection) -> WebhookCollection:
    """Return the webhooks that the caller may see."""
    return connection.app.state.webhooks.seen_by(caller_of(connection))


def intake_of(connection: HTTPConnection) -> Callable[[Any], AcceptedTask]:
    """Return what turns a caller's JSON data into a task that can be begun, or raises what is wrong with it."""
    state, scenes = connection.app.state, scenes_of(connection).document
    found = {"cells": cells_of(connection), "uploads": state.meshes.get, "scenes": scenes, "tools": state.tools}
    return partial(accept_task, **found, known=state.known_tasks)


def _authenticator(connection: HTTPConnection) -> Authenticator:
    return connection.app.state.authenticator


def feed_of(connection: HTTPConnection) -> PlanFeed:
    """Return what tells of the progress of plans."""
    return connection.app.state.feed


def followers_of(connection: HTTPConnection) -> Followers:
    """Return the places of those who follow plans and studies."""
    return connection.app.state.followers


def _study_feed(connection: HTTPConnection) -> PlanFeed:
    return connection.app.state.study_feed


def bench_of(connection: HTTPConnection) -> Workbench:
    """Return where what takes seconds is done."""
    return connection.app.state.workbench


def settings_of(connection: HTTPConnection) -> ServiceSettings:
    """Return the settings of the service."""
    return connection.app.state.settings


def _at_once(found: Callable[[HTTPConnection], Dependency]) -> Callable[[HTTPConnection], Awaitable[Dependency]]:
    """Return what the framework calls as it is: what is no coroutine function it would have a thread call."""

    async def find(connection: HTTPConnection) -> Dependency:
        return found(connection)

    return find


CurrentCaller = Annotated[Caller, Depends(_at_once(caller_of))]
Plans = Annotated[PlanCollection, Depends(_at_once(plans_of))]
Cells = Annotated[CellCollection, Depends(_at_once(cells_of))]
Scenes = Annotated[SceneCollection, Depends(_at_once(scenes_of))]
Studies = Annotated[StudyCollection, Depends(_at_once(studies_of))]
Webhooks = Annotated[WebhookCollection, Depends(_at_once(webhooks_of))]
Intake = Annotated[Callable[[Any], AcceptedTask], Depends(_at_once(intake_of))]
Authentication = Annotated[Authenticator, Depends(_at_once(_authenticator))]
Feed = Annotated[PlanFeed, Depends(_at_once(feed_of))]
StudyFeed = Annotated[PlanFeed, Depends(_at_once(_study_feed))]
FollowerPlaces = Annotated[Followers, Depends(_at_once(followers_of))]
Bench = Annotated[Workbench, Depends(_at_once(bench_of))]
Settings = Annotated[ServiceSettings, Depends(_at_once(settings_of))]
