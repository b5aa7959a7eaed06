"""The two connections of a watcher: what the page asks for, and the scene that viser sends."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Generic, Literal, TypeVar

import anyio
import numpy as np
import structlog
import websockets
from anyio.streams.memory import MemoryObjectReceiveStream, MemoryObjectSendStream
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.websockets import WebSocket, WebSocketDisconnect

from app.errors import (
    CellNotDrawn,
    DocumentNotReady,
    KeyNeeded,
    MapNotPainted,
    PlanNotFound,
    SceneNotFound,
    ScopeNeeded,
    StudyNotFound,
    TooManyRequests,
    TooManyWatchers,
)
from app.resources.cell_collection import CellCollection
from app.resources.plan_collection import PlanCollection
from app.resources.scene_collection import SceneCollection
from app.resources.study_collection import StudyCollection
from app.viewer.drawing import perceived_scene, plan_scene
from app.viewer.drawing.camera import VIEWS
from app.viewer.drawing.link_meshes import FULL, LIGHT
from app.viewer.playback import SourceName
from app.viewer.scene_servers import SceneServer, SceneServers
from planners.errors import LiftwrightError
from workers.stores.database_loss import DATABASE_GONE, said_by

TRY_AGAIN_LATER, INTERNAL_ERROR, POLICY_VIOLATION, BAD_DATA, UNSUPPORTED_DATA = 1013, 1011, 1008, 1007, 1003
"""Close codes of RFC 6455, and of its registry."""
CAMERA_DIGITS = 3
"""Of where it is: millimetres."""
MOST_UNSENT = 64
"""Answers and clicks that wait for a page."""
LONGEST_REASON = 120
"""Of closing [bytes]."""
Answered = TypeVar("Answered")
RequestType = TypeVar("RequestType", bound=str)
log = structlog.get_logger(__name__)


class WatcherFault(LiftwrightError):
    """The service met an error of its own while it did something for a watcher."""

    def __init__(self, deed: str, error: Exception) -> None:
        self.name = uuid.uuid4().hex[:8]
        """Stands in the log with what the error says: that can hold paths and addresses."""
        met = type(error).__name__
        super().__init__(f"The service could not {deed}: an error of its own ({met}, fault {self.name} in its log)")


class PageRequest(BaseModel, Generic[RequestType]):
    """What a page asks for by its websocket."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    type: RequestType


class OpenPlan(PageRequest[Literal["open"]]):
    """Show a plan."""

    plan: str


class OpenPerceived(PageRequest[Literal["open_perceived"]]):
    """Show a perceived scene."""

    scene: str


class ShowTime(PageRequest[Literal["time"]]):
    """Show a time of the plan or of its simulation [s]."""

    source: SourceName
    time: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class SetLayer(PageRequest[Literal["layer"]]):
    """Show or hide a layer."""

    layer: Literal[plan_scene.LAYERS + perceived_scene.LAYERS]  # pyright: ignore[reportInvalidTypeForm]
    visible: bool


class SetDetail(PageRequest[Literal["detail"]]):
    """Draw so much from the next plan on, and the cell until there is one."""

    light: bool


class PaintStudy(PageRequest[Literal["paint"]]):
    """Paint the map of a study onto the plate of the plan that is shown, as far as it is known."""

    study: str


class Look(PageRequest[Literal["view"]]):
    """Move the camera."""

    view: Literal[tuple(VIEWS)]  # pyright: ignore[reportInvalidTypeForm]


class TellCamera(PageRequest[Literal["camera"]]):
    """Tell where the camera is."""


@dataclass(frozen=True)
class PageAnswer:
    """What a page is told by its websocket: members that are JSON data, and a type."""

    type: ClassVar[str]

    def document(self) -> dict[str, object]:
        """Return it as JSON data."""
        return {"type": self.type, **vars(self)}


@dataclass(frozen=True)
class Opened(PageAnswer):
    """Whoever has connected has a scene."""

    type = "scene"
    scene: str
    """Where it is, under the address of the page."""


@dataclass(frozen=True)
class Done(PageAnswer):
    """Something was done."""

    type = "done"
    request: str
    """Type of what was asked for."""


@dataclass(frozen=True)
class RequestRefused(PageAnswer):
    """Something cannot be done."""

    type = "refused"
    request: str
    detail: str
    plan: str | None = None
    """That was asked for."""
    scene: str | None = None
    study: str | None = None


@dataclass(frozen=True)
class Faulted(PageAnswer):
    """Something could not be done for an error of the service's own."""

    type = "fault"
    request: str
    detail: str


@dataclass(frozen=True)
class ShownPlan(PageAnswer):
    """What the page tells of a plan that it shows."""

    type = "plan"
    description: Any
    study: str | None
    """Of which it plans a point."""


@dataclass(frozen=True)
class ShownScene(PageAnswer):
    """What the page tells of a perceived scene that it shows."""

    type = "perceived"
    description: Any


@dataclass(frozen=True)
class PaintedStudy(PageAnswer):
    """The map of a study is on the plate."""

    type = "painted"
    study: str
    point: int | None
    """That has the cup where the plan that is shown has it."""
    count: int
    outcomes: dict[str, int]
    """How many points are known, by outcome."""


@dataclass(frozen=True)
class ChosenPoint(PageAnswer):
    """Somebody clicked on a point of a map in the scene."""

    type = "point"
    study: str
    point: int


@dataclass(frozen=True)
class ToldCamera(PageAnswer):
    """Where the camera is."""

    type = "camera"
    camera: list[float] | None
    """Place, point that it looks at and way up; None: nobody looks."""


WatcherMessage = OpenPlan | OpenPerceived | ShowTime | SetLayer | SetDetail | PaintStudy | Look | TellCamera
WORDS = {
    "open": "show this plan",
    "open_perceived": "show this scene",
    "time": "show that time",
    "layer": "change what is shown",
    "detail": "draw the cell",
    "paint": "paint this study",
    "view": "move the camera",
    "camera": "tell where the camera is",
}
"""What is asked for, by type of request."""
REQUESTS: TypeAdapter[WatcherMessage] = TypeAdapter(Annotated[WatcherMessage, Field(discriminator="type")])


@dataclass(frozen=True)
class Visible:
    """What a watcher may see."""

    plans: PlanCollection
    scenes: SceneCollection
    studies: StudyCollection
    cells: CellCollection
    """Deleted ones too, by their ids."""


async def watch(
    socket: WebSocket, servers: SceneServers, owner: str | None, visible_now: Callable[[], Awaitable[Visible]]
) -> None:
    """Give a watcher a scene, and do with it what the page asks for until it goes away.

    Args:
        socket: the watcher's.
        servers: of all scenes.
        owner: of the key that the watcher has shown; None where no keys are asked for.
        visible_now: tells what the watcher may see, whenever it wants to see something else; raises what `admit` does.
    """
    async with scene_for(socket, servers, owner) as server:
        if server is None:
            return

        # A click in the scene comes from a thread of viser's; what is told goes out by one task, in one order.
        loop = asyncio.get_running_loop()
        outbox, sent = anyio.create_memory_object_stream[PageAnswer](MOST_UNSENT)

        def told(point: ChosenPoint) -> None:
            with suppress(RuntimeError):
                loop.call_soon_threadsafe(_tell, outbox, point)

        async def answer(text: str) -> None:
            request = REQUESTS.validate_json(text)
            work = _answer(servers, server, visible_now, request, told)
            await send_if_heard(outbox, await or_told(request, WORDS[request.type], work))

        async with outbox, anyio.create_task_group() as tasks:
            tasks.start_soon(send_on, sent, socket)
            await answer_requests(socket, answer, "viewer")
            tasks.cancel_scope.cancel()


def _tell(outbox: MemoryObjectSendStream[PageAnswer], point: ChosenPoint) -> None:
    """Tell the page of a click, unless it has gone or does not keep up."""
    with suppress(anyio.WouldBlock, anyio.BrokenResourceError, anyio.ClosedResourceError):
        outbox.send_nowait(point)


@asynccontextmanager
async def scene_for(socket: WebSocket, servers: SceneServers, owner: str | None) -> AsyncIterator[SceneServer | None]:
    """Give a scene to whoever connects, and tell them; None where there is none, or they have left already."""
    await socket.accept()
    try:
        server = await or_fault("open a scene", servers.enter(owner))
    except (TooManyWatchers, WatcherFault) as error:
        code = TRY_AGAIN_LATER if isinstance(error, TooManyWatchers) else INTERNAL_ERROR
        await socket.close(code, str(error)[:LONGEST_REASON])
        yield None
        return
    try:
        try:
            await socket.send_json(Opened(f"scene/{server.key}/").document())
        except WebSocketDisconnect:
            yield None
        else:
            yield server
    finally:
        with anyio.CancelScope(shield=True):
            await servers.leave(server)


async def answer_requests(socket: WebSocket, answer: Callable[[str], Awaitable[None]], page: str) -> None:
    """Have what a page asks for be answered until it goes away, or asks for what nobody knows."""
    try:
        while (text := await _receive_text(socket)) is not None:
            await answer(text)
        await socket.close(UNSUPPORTED_DATA, f"requests of this {page} are text")
    except WebSocketDisconnect:
        log.debug("somebody left", page=page)
    except (KeyNeeded, ScopeNeeded):
        await socket.close(POLICY_VIOLATION, "the key that opened this page opens nothing any more: log in again")
    except ValidationError:
        await socket.close(BAD_DATA, f"not a request of this {page}")


async def _receive_text(socket: WebSocket) -> str | None:
    """Return the next message; None if it is a binary one."""
    message = await socket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message["code"])
    return message.get("text")


async def send_if_heard(outbox: MemoryObjectSendStream[PageAnswer], answer: PageAnswer) -> None:
    """Put an answer behind those that wait for a page, once there is room for it; nowhere if the page has gone."""
    try:
        await outbox.send(answer)
    except anyio.BrokenResourceError:
        log.debug("nobody listens any more")


async def send_on(sent: MemoryObjectReceiveStream[PageAnswer], socket: WebSocket) -> None:
    """Send a page what waits for it until it goes away."""
    # Closed behind the last that can be sent, so that no answer waits for a page that has gone.
    async with sent:
        try:
            async for answer in sent:
                await socket.send_json(answer.document())
        except (WebSocketDisconnect, RuntimeError):
            log.debug("somebody left")


async def or_told(request: PageRequest, deed: str, work: Awaitable[PageAnswer]) -> PageAnswer:
    """Return the answer to a request, or what went wrong in the service itself.

    Raises:
        KeyNeeded, ScopeNeeded: Nothing is answered any more.
    """
    try:
        return await or_fault(deed, work)
    except DATABASE_GONE as error:
        log.error("database cannot be used", error=said_by(error))
        return refusal(request, "The database is away, or its disk is full; what was accepted is kept.")
    except WatcherFault as fault:
        return Faulted(request.type, str(fault))


async def or_fault(deed: str, work: Awaitable[Answered]) -> Answered:
    """Return the result of some work for a watcher.

    Raises:
        WatcherFault: It met an error that nobody thought of; the log has it.
        Exception: What the work raises and its caller answers.
    """
    try:
        return await work
    except (TooManyWatchers, KeyNeeded, ScopeNeeded, *DATABASE_GONE):
        raise
    except Exception as error:
        # What a request is answered with a 500, only here the connection would break: the page would take that for a
        # service that went away, and ask for the same again and again.
        fault = WatcherFault(deed, error)
        log.exception("a watcher met a fault", deed=deed, fault=fault.name)
        raise fault from error


def refusal(request: PageRequest, detail: str) -> RequestRefused:
    """Return the answer to a request that cannot be met; it names the plan, scene or study that was asked for."""
    return RequestRefused(request.type, detail, **request.model_dump(include={"plan", "scene", "study"}))


async def _answer(
    servers: SceneServers,
    server: SceneServer,
    visible_now: Callable[[], Awaitable[Visible]],
    request: WatcherMessage,
    clicked: Callable[[ChosenPoint], None],
) -> PageAnswer:
    match request:
        case OpenPlan() | OpenPerceived():
            return await _opened(servers, server, visible_now, request)
        case PaintStudy():
            return await _painted(server, visible_now, request, clicked)
        case ShowTime():
            await run_in_threadpool(server.show, request.source, request.time)
        case SetLayer():
            await run_in_threadpool(server.set_layer, request.layer, visible=request.visible)
        case SetDetail():
            await run_in_threadpool(servers.set_detail, server, LIGHT if request.light else FULL)
        case Look():
            await run_in_threadpool(server.look, VIEWS[request.view])
        case TellCamera():
            camera = server.camera
            told = None if camera is None else [round(float(each), CAMERA_DIGITS) for each in np.concatenate(camera)]
            return ToldCamera(told)
    return Done(request.type)


async def _opened(
    servers: SceneServers,
    server: SceneServer,
    visible_now: Callable[[], Awaitable[Visible]],
    request: OpenPlan | OpenPerceived,
) -> PageAnswer:
    try:
        visible = await visible_now()
        if isinstance(request, OpenPlan):
            plan = await run_in_threadpool(servers.open, server, visible.plans, request.plan)
            study = (await run_in_threadpool(visible.plans.plan, request.plan)).study_id
            return ShownPlan(plan.model_dump(mode="json", by_alias=True), study)
        scene = await run_in_threadpool(servers.open_perceived, server, visible.scenes, request.scene)
        return ShownScene(scene.model_dump(mode="json"))
    except (PlanNotFound, DocumentNotReady, SceneNotFound, CellNotDrawn, TooManyRequests) as error:
        return refusal(request, str(error))


async def _painted(
    server: SceneServer,
    visible_now: Callable[[], Awaitable[Visible]],
    request: PaintStudy,
    clicked: Callable[[ChosenPoint], None],
) -> PageAnswer:
    study = request.study

    def told(index: int) -> None:
        clicked(ChosenPoint(study, index))

    try:
        known = await run_in_threadpool((await visible_now()).studies.map, study)
        point = await run_in_threadpool(server.paint, known, told)
    except (StudyNotFound, MapNotPainted, TooManyRequests) as error:
        return refusal(request, str(error))
    return PaintedStudy(study, point, known.count, known.outcomes)


async def relay_scene(socket: WebSocket, address: str) -> None:
    """Pass a scene on to the browser until either side goes away."""
    protocols = [websockets.Subprotocol(name) for name in socket.scope["subprotocols"]]
    try:
        async with websockets.connect(
            address, subprotocols=protocols or None, max_size=None, compression=None, proxy=None
        ) as scene:
            await socket.accept(scene.subprotocol)
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(_pass_up, socket, scene, tasks.cancel_scope)
                async for message in scene:
                    await (socket.send_bytes(message) if isinstance(message, bytes) else socket.send_text(message))
                tasks.cancel_scope.cancel()
            await socket.close()
    except* (OSError, websockets.WebSocketException, WebSocketDisconnect, RuntimeError):
        # Either side went away: there is nobody left to tell.
        log.debug("a scene's connection ended")


async def _pass_up(socket: WebSocket, scene: websockets.ClientConnection, scope: anyio.CancelScope) -> None:
    while True:
        message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            scope.cancel()
            return
        await scene.send(message["bytes"] if message.get("bytes") is not None else message["text"])
