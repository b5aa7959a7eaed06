"""The connection of somebody who edits a task: the page keeps the task, the scene shows it and is dragged in."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any, Literal

import anyio
import structlog
from anyio.streams.memory import MemoryObjectSendStream
from pydantic import Field, TypeAdapter
from starlette.concurrency import run_in_threadpool
from starlette.websockets import WebSocket

from app.errors import (
    CellNotDrawn,
    DocumentNotReady,
    PlanNotFound,
    SceneNotFound,
    TooManyRequests,
)
from app.viewer.drawing.camera import VIEWS
from app.viewer.drawing.link_meshes import FULL, LIGHT
from app.viewer.editor.draft import cell_of, read_draft
from app.viewer.editor.draft_scene import Chosen, DraftScene, Moved
from app.viewer.editor.feasibility import LastPath, OtherWays
from app.viewer.editor.found_path import lines_of
from app.viewer.editor.starts import NoSuchExample, example_task, task_of_scene
from app.viewer.page import describe_plan
from app.viewer.scene_servers import SceneServer, SceneServers
from app.viewer.watch import (
    MOST_UNSENT,
    Done,
    Look,
    PageAnswer,
    PageRequest,
    SetDetail,
    Visible,
    answer_requests,
    or_told,
    refusal,
    scene_for,
    send_if_heard,
    send_on,
)
from planners.cell.cell import Cell
from planners.contract.task_spec import write_task
from planners.errors import SceneError
from planners.scene.shape_source import ShapeSource, Uploads
from planners.scene.suction_tool import SuctionTool

MOST_MOVES = 2**53
MOST_THINGS = 1000
Pointer = Annotated[str, Field(max_length=200)]
Metres = Annotated[float, Field(ge=-20.0, le=20.0, allow_inf_nan=False)]
log = structlog.get_logger(__name__)


class StartFrom(PageRequest[Literal["start"]]):
    """Give a task to begin with."""

    of: Literal["example", "plan", "scene"]
    name: Pointer


class DrawDraft(PageRequest[Literal["draw"]]):
    """Show a task, finished or not."""

    task: Any
    chosen: Pointer | None
    wrong: Annotated[list[Pointer], Field(max_length=MOST_THINGS)]
    moves: Annotated[int, Field(ge=0, le=MOST_MOVES)]
    """How many moves that were told of the task takes into account."""


class Nudge(PageRequest[Literal["nudge"]]):
    """Move a thing a little, and have it come to lie."""

    pointer: Pointer
    by: tuple[Metres, Metres]
    turn: Annotated[float, Field(ge=-7.0, le=7.0, allow_inf_nan=False)]
    """About the vertical [rad]."""


class ShowPath(PageRequest[Literal["path"]]):
    """Draw the way of what a plan moves, in place of the last one; None: no way."""

    plan: Pointer | None


class Judge(PageRequest[Literal["judge"]]):
    """Say at once whether the last path would hold with the forces of a task, and soon whether else a way is left."""

    task: Any


@dataclass(frozen=True)
class Begun(PageAnswer):
    """A task to begin with, as JSON data."""

    type = "draft"
    task: Any


@dataclass(frozen=True)
class Judged(PageAnswer):
    """Whether the last path would hold; None: there is none."""

    type = "judged"
    feasibility: Any


@dataclass(frozen=True)
class WayJudged(PageAnswer):
    """Whether a way is left for the task that was judged last; None: nothing is known of it."""

    type = "way"
    feasibility: Any


@dataclass(frozen=True)
class PlanResult(PageAnswer):
    """What the page tells of a plan that was made of the task, and whose path is shown."""

    type = "result"
    plan: str | None
    description: Any


@dataclass(frozen=True)
class News(PageAnswer):
    """What somebody did in the scene."""

    what: Moved | Chosen

    def document(self) -> dict[str, object]:
        """Return it as JSON data."""
        return {"type": type(self.what).__name__.lower(), **asdict(self.what)}


EditorMessage = StartFrom | DrawDraft | Nudge | ShowPath | Judge | SetDetail | Look
WORDS = {
    "start": "begin with that",
    "draw": "show this task",
    "nudge": "move that",
    "path": "show the path of this plan",
    "judge": "judge this task by the last path",
    "detail": "draw the cell",
    "view": "move the camera",
}
"""What is asked for, by type of request."""
RESULT = {"outcome", "outcome_words", "outcome_meaning", "summary", "causes", "remedies", "highlights"}
"""What the page tells of a plan that was made of the task."""
REQUESTS: TypeAdapter[EditorMessage] = TypeAdapter(Annotated[EditorMessage, Field(discriminator="type")])


@dataclass(frozen=True)
class Workshop:
    """What all who edit share."""

    servers: SceneServers
    uploads: Uploads
    tools: Mapping[str, SuctionTool]
    visible_now: Callable[[], Awaitable[Visible]]
    """Tells what somebody may see, whenever something is opened; raises what `admit` does."""
    ways: OtherWays


async def edit(socket: WebSocket, workshop: Workshop, owner: str | None) -> None:
    """Give somebody of an owner a scene with a draft in it; do with it what the page asks for until it goes away."""
    async with scene_for(socket, workshop.servers, owner) as server:
        if server is None:
            return
        # What is answered and what was dragged goes out in one order, by one task.
        outbox, sent = anyio.create_memory_object_stream[PageAnswer](MOST_UNSENT)
        async with outbox, anyio.create_task_group() as tasks:
            tasks.start_soon(send_on, sent, socket)
            editing = _Editing(workshop, server, outbox)
            tasks.start_soon(editing.look_for_ways)
            await answer_requests(socket, editing.answer, "editor")
            tasks.cancel_scope.cancel()


@dataclass(frozen=True, eq=False)
class _Question:
    """For which task a way is looked for."""

    task: Any
    is_told: bool = True


@dataclass
class _Editing:
    """One who edits: a scene, and the draft that is shown in it."""

    workshop: Workshop
    server: SceneServer
    outbox: MemoryObjectSendStream[PageAnswer]
    loop: asyncio.AbstractEventLoop = field(default_factory=asyncio.get_running_loop)
    scene: DraftScene | None = None
    cell: Cell | None = None
    """In which the scene is."""
    cell_name: str | None = None
    """By which the task calls it."""
    path: LastPath | None = None
    """Of the plan that was shown last."""

    def __post_init__(self) -> None:
        self.shapes = ShapeSource(self.workshop.uploads)
        self._question: _Question | None = None
        """That is to be asked of the graph of the lift, or was asked last and is still of interest."""
        self._asked = asyncio.Event()

    async def look_for_ways(self) -> None:
        """Ask for ways of the task that is judged, one question after the other; of several that wait, the last."""
        try:
            while True:
                await self._asked.wait()
                self._asked.clear()
                question = self._question
                if question is None:
                    continue
                found = await self.workshop.ways.ask(self.server.key, question.task, self.cell_name)
                if question is self._question and question.is_told:
                    await self.outbox.send(WayJudged(None if found is None else found.model_dump()))
        except anyio.BrokenResourceError:
            log.debug("nobody listens any more")
        finally:
            with anyio.CancelScope(shield=True):
                await self.workshop.ways.leave(self.server.key)

    async def answer(self, text: str) -> None:
        """Do what is asked for, and say so, or what went wrong, once the page has room for that."""
        request = REQUESTS.validate_json(text)
        await send_if_heard(self.outbox, await or_told(request, WORDS[request.type], self._answered(request)))

    async def _answered(self, request: EditorMessage) -> PageAnswer:
        try:
            match request:
                case StartFrom():
                    visible = await self.workshop.visible_now()
                    return Begun(await run_in_threadpool(self._start, request, visible))
                case ShowPath():
                    return await run_in_threadpool(self._show_path, request, await self.workshop.visible_now())
                case DrawDraft():
                    visible = None if self._stays(request) else await self.workshop.visible_now()
                    await run_in_threadpool(self._draw, request, visible)
                case Judge():
                    return await self._judge(request.task)
                case _:
                    await run_in_threadpool(self._change_scene, request)
        except (PlanNotFound, DocumentNotReady, SceneNotFound, NoSuchExample, CellNotDrawn, TooManyRequests) as error:
            return refusal(request, str(error))
        except SceneError as error:
            return refusal(request, error.detail)
        return Done(request.type)

    def _start(self, request: StartFrom, visible: Visible) -> Any:
        match request.of:
            case "example":
                return example_task(request.name)
            case "plan":
                return visible.plans.task(request.name)
            case "scene":
                return task_of_scene(visible.scenes.scene(request.name).document, visible.cells)

    def _change_scene(self, request: Nudge | SetDetail | Look) -> None:
        match request:
            case Nudge() if self.scene is not None:
                self.scene.nudge(request.pointer, request.by, request.turn)
            case SetDetail():
                self.workshop.servers.set_detail(self.server, LIGHT if request.light else FULL)
            case Look():
                self.server.look(VIEWS[request.view])

    def _stays(self, request: DrawDraft) -> bool:
        """Tell whether a task is for the cell that is shown, or names none."""
        return cell_of(request.task) in (None, self.cell_name)

    def _draw(self, request: DrawDraft, visible: Visible | None) -> None:
        """Show a task; `visible` is None where its cell stays."""
        name = cell_of(request.task)
        # A cell that there is not is told where the task is checked; here the last one stays.
        if name is not None and visible is not None and name in visible.cells:
            self.cell, self.cell_name = visible.cells[name], name
            self.scene = self.workshop.servers.open_draft(self.server, self.cell, self._told)
        if self.scene is None or self.cell is None:
            return
        draft = read_draft(request.task, self.cell, self.shapes, self.workshop.tools)
        with self.server.together():
            self.scene.show(draft, request.chosen, frozenset(request.wrong), request.moves)

    def _show_path(self, request: ShowPath, visible: Visible) -> PageAnswer:
        plan = None if request.plan is None else self.workshop.servers.load(visible.plans, request.plan)
        # Where nothing was found the last path that was stays.
        if self.scene is not None and (plan is None or plan.segments):
            with self.server.together():
                self.scene.show_path(lines_of(plan))
        if plan is None:
            self.path = None
            return Done(request.type)
        if LastPath.can_be_of(plan) and plan.task.cell in visible.cells:
            self.path = LastPath(plan, visible.cells, self.workshop.uploads)
        # The graph is made before somebody drags anything.
        self.loop.call_soon_threadsafe(self._ask_for_ways, _Question(write_task(plan.task), is_told=False))
        told = describe_plan(plan).model_dump(mode="json", by_alias=True, include=RESULT)
        return PlanResult(request.plan, told)

    async def _judge(self, task: Any) -> Judged:
        judged = None if self.path is None else await run_in_threadpool(self.path.judge, task)
        if judged is not None and judged.holds:
            self._question = None
            return Judged(judged.model_dump())
        self._ask_for_ways(_Question(task))
        return Judged(None if judged is None else judged.model_dump())

    def _ask_for_ways(self, question: _Question) -> None:
        self._question = question
        self._asked.set()

    def _told(self, news: Moved | Chosen) -> None:
        """Pass on what somebody did in the scene, from a thread of viser's."""
        self.loop.call_soon_threadsafe(self._tell, News(news))

    def _tell(self, news: News) -> None:
        """Tell the page, unless it does not keep up: what was moved meanwhile it sees in the scene."""
        try:
            self.outbox.send_nowait(news)
        except anyio.WouldBlock:
            log.debug("news were dropped", page="editor")
        except (anyio.BrokenResourceError, anyio.ClosedResourceError):
            log.debug("nobody listens any more")
