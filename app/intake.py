"""From the bytes of a request to a task that can be planned."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any, Protocol

import anyio
from starlette.requests import ClientDisconnect, Request

from app.errors import BodyStalled, BodyTooLarge, EncodedBody, NotJsonMedia
from planners.cell.cell import Cell
from planners.contract.scene_document import SceneDocument
from planners.contract.task_spec import read_task, write_task
from planners.errors import SceneError
from planners.perception.scene_task import fill_from_scene
from planners.scene.scene import build_scene, with_centres
from planners.scene.shape_source import Uploads, no_uploads
from planners.scene.suction_tool import NO_TOOLS, SuctionTool

Scenes = Callable[[str], SceneDocument | None]
"""Finds what was perceived in a scene, by its id; None if there is none."""
DRAINED_BYTES = 32_000_000
"""So much of a body that is refused is still taken off the wire, so that the sender gets to read the answer."""


class NeedsScene(SceneError):
    """A task takes an object from a scene and names none."""

    def __init__(self) -> None:
        super().__init__("/scene_id", 'is required: an object has a "detection", which is looked up in a scene')


def no_scenes(scene_id: str) -> SceneDocument | None:
    """Know of no scene."""
    return None


class Patience(Protocol):
    """How long the parts of a body are waited for."""

    @property
    def body_stall_seconds(self) -> float:
        """For the next part [s]."""
        ...

    @property
    def body_seconds(self) -> float:
        """For all of it [s]."""
        ...


async def read_body(request: Request, limit: int, patience: Patience) -> bytes:
    """Return the body of a JSON request.

    Raises:
        NotJsonMedia: It is declared as something else.
        EncodedBody: It is declared as compressed.
        BodyTooLarge: It has more than `limit` bytes; the rest is not kept.
    """
    media_type = request.headers.get("content-type")
    if media_type is None or media_type.split(";")[0].strip().lower() != "application/json":
        raise NotJsonMedia(media_type)
    return await read_limited(request, limit, patience)


async def read_limited(request: Request, limit: int, patience: Patience) -> bytes:
    """Return the body of a request, whatever it is.

    Raises:
        EncodedBody: It is declared as compressed.
        BodyTooLarge: It has more than `limit` bytes; the rest is not kept.
        BodyStalled: Its sender is slower than `patience` allows.
    """
    coding = request.headers.get("content-encoding", "identity")
    if coding.strip().lower() != "identity":
        raise EncodedBody(coding)
    if _not_worth_reading(request, limit):
        raise BodyTooLarge(limit)
    body = bytearray()
    stream = _patient(request, patience)
    async for chunk in stream:
        body += chunk
        if len(body) > limit:
            break
    else:
        return bytes(body)
    del body
    try:
        drained = 0
        async for chunk in stream:
            drained += len(chunk)
            if drained > DRAINED_BYTES:
                break
    except ClientDisconnect:
        pass  # It did not want to know.
    raise BodyTooLarge(limit)


async def _patient(request: Request, patience: Patience) -> AsyncIterator[bytes]:
    """Yield a body as it comes, as long as it comes."""
    stream = aiter(request.stream())
    deadline = anyio.current_time() + patience.body_seconds
    while True:
        rest = deadline - anyio.current_time()
        try:
            with anyio.fail_after(min(patience.body_stall_seconds, rest)):
                chunk = await anext(stream)
        except StopAsyncIteration:
            return
        except TimeoutError:
            raise BodyStalled(patience.body_stall_seconds) from None
        yield chunk


def _not_worth_reading(request: Request, limit: int) -> bool:
    """Whether a body is declared as too large, and its sender waits for a word first or would send for ages."""
    declared = request.headers.get("content-length", "")
    size = int(declared) if declared.isdecimal() else 0
    waits = request.headers.get("expect", "").lower() == "100-continue"
    return size > (limit if waits else limit + DRAINED_BYTES)


def accept_task(
    sent: Any,
    cells: Mapping[str, Cell],
    uploads: Uploads = no_uploads,
    scenes: Scenes = no_scenes,
    tools: Mapping[str, SuctionTool] = NO_TOOLS,
) -> dict[str, Any]:
    """Return a task with every default filled in, once it is known that it can be begun.

    Args:
        sent: the task as JSON data.
        cells: that there are, by name.
        uploads: finds meshes.
        scenes: finds perceived scenes, which a task may name in place of poses.
        tools: that were loaded before, by name; others are read from their files.

    Raises:
        pydantic.ValidationError, SceneError: What is wrong with it.
    """
    task = read_task(_with_scene(sent, cells, scenes))
    scene = build_scene(task, cells, uploads=uploads, tools=tools)
    return write_task(with_centres(task, scene))


def _with_scene(body: Any, cells: Mapping[str, Cell], scenes: Scenes) -> Any:
    if not isinstance(body, dict) or body.get("kind") != "suction_tool":
        return body
    scene_id = body.get("scene_id")
    if scene_id is None:
        objects = body.get("objects")
        if isinstance(objects, list) and any(isinstance(each, dict) and "detection" in each for each in objects):
            raise NeedsScene
        return body
    scene = scenes(scene_id) if isinstance(scene_id, str) else None
    if scene is None:
        raise SceneError("/scene_id", "there is no such scene; POST a scan to /v1/scenes")
    if scene.cell not in cells:
        raise SceneError("/scene_id", f"the scene was perceived in the cell {scene.cell}, which there is not")
    return fill_from_scene(body, scene, cells[scene.cell])
