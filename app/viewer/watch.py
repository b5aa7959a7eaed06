"""The two connections of a watcher: what the page asks for, and the scene that viser sends."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import anyio
import structlog
import websockets
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.websockets import WebSocket, WebSocketDisconnect

from app.errors import CellNotDrawn, DocumentNotReady, PlanNotFound, SceneNotFound, TheatreFull
from app.plan_desk import PlanDesk
from app.scene_desk import SceneDesk
from app.viewer import perceived_stage, stage
from app.viewer.room import VIEWS, Room
from app.viewer.sources import SourceName
from app.viewer.theatre import Theatre

TRY_AGAIN_LATER, POLICY_VIOLATION, BAD_DATA = 1013, 1008, 1007
"""Close codes of RFC 6455."""
log = structlog.get_logger(__name__)


class _Request(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class OpenPlan(_Request):
    """Put a plan into the room."""

    type: Literal["open"]
    plan: str


class OpenPerceived(_Request):
    """Put a perceived scene into the room."""

    type: Literal["open_perceived"]
    scene: str


class ShowTime(_Request):
    """Show a time of the plan or of its simulation [s]."""

    type: Literal["time"]
    source: SourceName
    time: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class SetLayer(_Request):
    """Show or hide a layer."""

    type: Literal["layer"]
    layer: Literal[stage.LAYERS + perceived_stage.LAYERS]  # pyright: ignore[reportInvalidTypeForm]
    visible: bool


class Look(_Request):
    """Move the camera."""

    type: Literal["view"]
    view: Literal[tuple(VIEWS)]  # pyright: ignore[reportInvalidTypeForm]


Request = OpenPlan | OpenPerceived | ShowTime | SetLayer | Look
REQUESTS: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="type")])


async def watch(socket: WebSocket, theatre: Theatre, desk: PlanDesk, scenes: SceneDesk) -> None:
    """Give a watcher a room, and do there what the page asks for until it goes away; desks have what it may see."""
    await socket.accept()
    try:
        room = await theatre.enter()
    except TheatreFull as error:
        await socket.close(TRY_AGAIN_LATER, str(error))
        return
    try:
        await socket.send_json({"type": "room", "scene": f"scene/{room.key}/"})
        while True:
            request = REQUESTS.validate_json(await socket.receive_text())
            answer = await run_in_threadpool(_answer, theatre, room, desk, scenes, request)
            await socket.send_json(answer)
    except WebSocketDisconnect:
        log.debug("a watcher left")
    except ValidationError:
        await socket.close(BAD_DATA, "not a request of this viewer")
    finally:
        with anyio.CancelScope(shield=True):
            await theatre.leave(room)


def _answer(theatre: Theatre, room: Room, desk: PlanDesk, scenes: SceneDesk, request: Request) -> dict[str, Any]:
    match request:
        case OpenPlan():
            try:
                return {"type": "story", "story": theatre.open(room, desk, request.plan)}
            except (PlanNotFound, DocumentNotReady, CellNotDrawn) as error:
                return {"type": "refused", "plan": request.plan, "detail": str(error)}
        case OpenPerceived():
            try:
                return {"type": "perceived", "story": theatre.open_perceived(room, scenes, request.scene)}
            except (SceneNotFound, CellNotDrawn) as error:
                return {"type": "refused", "scene": request.scene, "detail": str(error)}
        case ShowTime():
            room.show(request.source, request.time)
        case SetLayer():
            room.set_layer(request.layer, visible=request.visible)
        case Look():
            room.look(VIEWS[request.view])
    return {"type": "done", "request": request.type}


async def relay_scene(socket: WebSocket, room: Room) -> None:
    """Pass a room's scene on to the browser until either side goes away."""
    protocols = [websockets.Subprotocol(name) for name in socket.scope["subprotocols"]]
    try:
        async with websockets.connect(
            room.address, subprotocols=protocols or None, max_size=None, compression=None, proxy=None
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
