"""The connection of the editor: what it begins with, draws and moves, and what it refuses."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import anyio
import httpx
import pytest
import websockets
from starlette.websockets import WebSocketDisconnect
from websockets.sync.client import ClientConnection, connect

from app.viewer.editor.draft_scene import Chosen
from app.viewer.editor.editing import Judged, News, Workshop, _Editing, edit
from app.viewer.watch import MOST_UNSENT, PageAnswer
from planners.geometry.pose import from_pose7
from planners.scene.shape_source import no_uploads
from tests.support.scan_frames import shipped
from tests.support.service import FAKE_SOLVER, ServiceProcess, running_service, task


@pytest.fixture(scope="module")
def service(data_dir: Path) -> Iterator[ServiceProcess]:
    with running_service(data_dir, FAKE_SOLVER, worker_slots=1) as service:
        yield service


@pytest.fixture(scope="module")
def client(service: ServiceProcess) -> Iterator[httpx.Client]:
    with service.client() as client:
        yield client


@pytest.fixture
def socket(service: ServiceProcess) -> Iterator[ClientConnection]:
    address = service.address.replace("http", "ws") + "/viewer/edit"
    with connect(address, max_size=None) as socket:
        assert json.loads(socket.recv())["type"] == "scene"
        yield socket


def ask(socket: ClientConnection, **request: Any) -> dict[str, Any]:
    socket.send(json.dumps(request))
    return json.loads(socket.recv(timeout=60))


def draw(socket: ClientConnection, body: Any, chosen: str | None = None) -> dict[str, Any]:
    return ask(socket, type="draw", task=body, chosen=chosen, wrong=[], moves=0)


@pytest.mark.slow
def test_it_begins_with_an_example_a_plan_or_a_scene(socket: ClientConnection, client: httpx.Client) -> None:
    assert ask(socket, type="start", of="example", name="ab1") == {"type": "draft", "task": task("ab1.json")}
    plan = client.post("/v1/plans", json=task("pb1.json")).json()
    of_plan = ask(socket, type="start", of="plan", name=plan["id"])["task"]
    assert client.post("/v1/tasks/check", json=of_plan).json()["task"] == of_plan, "it is as it was accepted"
    scene = client.post("/v1/scenes", files=shipped().form()).raise_for_status().json()
    of_scene = ask(socket, type="start", of="scene", name=scene["id"])["task"]
    assert len(of_scene["objects"]) == len(scene["scene"]["objects"]) > 0
    missing = client.post("/v1/tasks/check", json=of_scene).json()["errors"]
    assert {error["pointer"].rpartition("/")[2] for error in missing} == {"mass"}, "a camera weighs nothing"
    weighed = {**of_scene, "objects": [{**each, "mass": 0.3} for each in of_scene["objects"]]}
    assert client.post("/v1/tasks/check", json=weighed).json()["accepted"] is True


@pytest.mark.parametrize("of", ["example", "plan", "scene"])
def test_what_is_not_there_is_refused_and_the_connection_stays(socket: ClientConnection, of: str) -> None:
    told = ask(socket, type="start", of=of, name="none")
    assert (told["type"], told["request"]) == ("refused", "start")
    assert "none" in told["detail"]
    assert draw(socket, task()) == {"type": "done", "request": "draw"}


def test_what_is_nudged_is_moved_on_its_table_and_told(socket: ClientConnection) -> None:
    draw(socket, task("ab1.json"), "/plate_pose")
    moved = ask(socket, type="nudge", pointer="/plate_pose", by=[0.01, -0.02], turn=0.5)
    assert (moved["type"], moved["pointer"], moved["phase"], moved["number"]) == ("moved", "/plate_pose", "end", 1)
    before, after = from_pose7(task("ab1.json")["plate_pose"]), from_pose7(moved["value"])
    assert after[:3, 3] - before[:3, 3] == pytest.approx([0.01, -0.02, 0.0])
    assert after[2, 2] == pytest.approx(1.0)
    assert json.loads(socket.recv()) == {"type": "done", "request": "nudge"}


def test_the_cup_is_nudged_along_the_world_on_a_plate_that_is_turned(socket: ClientConnection) -> None:
    turned = [0.3, 0, 1.114, 0.7071067811865476, 0, 0, 0.7071067811865476]
    draw(socket, task("ab1.json", plate_pose=turned), "/cup/position")
    moved = ask(socket, type="nudge", pointer="/cup/position", by=[0.01, 0.0], turn=0.0)
    assert moved["value"] == pytest.approx([0.1, -0.01]), "the plate's y is the world's -x"


def test_what_was_moved_stays_where_it_is_in_an_older_draft_and_all_else_is_drawn(socket: ClientConnection) -> None:
    body = task("ab1.json")
    draw(socket, {**body, "cup": None})
    ask(socket, type="nudge", pointer="/plate_pose", by=[0.05, 0.0], turn=0.0)
    socket.recv()
    draw(socket, body)  # Sent before the page heard of the move, so that its plate is where it was.
    moved = ask(socket, type="nudge", pointer="/cup/position", by=[0.01, 0.0], turn=0.0)
    assert moved["value"] == pytest.approx([0.11, 0.0]), "the cup is there"
    socket.recv()
    again = ask(socket, type="nudge", pointer="/plate_pose", by=[0.0, 0.0], turn=0.0)
    assert again["value"][:2] == pytest.approx([body["plate_pose"][0] + 0.05, body["plate_pose"][1]])


def test_what_is_not_drawn_is_not_moved(socket: ClientConnection) -> None:
    draw(socket, {"kind": "plate_lift"})
    told = ask(socket, type="nudge", pointer="/plate_pose", by=[0.01, 0.0], turn=0.0)
    assert told == {"type": "done", "request": "nudge"}


@pytest.mark.parametrize("body", [None, [], {}, {"kind": "dance"}, {"kind": "plate_lift", "cell": "moon_base"}])
def test_whatever_is_to_be_drawn_is_no_fault(socket: ClientConnection, body: Any) -> None:
    assert draw(socket, body) == {"type": "done", "request": "draw"}


@pytest.mark.slow
def test_without_a_path_it_is_told_whether_any_way_is_left(socket: ClientConnection) -> None:
    lift = {**task("ab1.json"), "options": {"hold_density": 0.75, "reserve": 0.0}}
    draw(socket, lift)
    told = []
    for force in (80.0, 12.0):
        changed = {**lift, "cup": {**lift["cup"], "max_force": force}}
        assert ask(socket, type="judge", task=changed) == {"type": "judged", "feasibility": None}
        told.append(json.loads(socket.recv(timeout=120)))
    assert [(each["type"], each["feasibility"]["holds"]) for each in told] == [("way", True), ("way", False)]


def test_of_what_is_no_lift_of_the_cell_that_is_shown_nothing_is_known(socket: ClientConnection) -> None:
    draw(socket, task("ab1.json"))
    for no_lift in (None, task("ab1_ur3.json"), task("can_stack.json"), {**task("ab1.json"), "cup": {}}):
        assert ask(socket, type="judge", task=no_lift) == {"type": "judged", "feasibility": None}
        assert json.loads(socket.recv(timeout=60)) == {"type": "way", "feasibility": None}


@pytest.mark.parametrize(
    "request_",
    [
        {"type": "dance"},
        {"type": "nudge", "pointer": "/plate_pose", "by": [1e9, 0.0], "turn": 0.0},
        {"type": "start", "of": "thin air", "name": "ab1"},
    ],
)
def test_a_request_that_makes_no_sense_ends_the_connection_and_nothing_else(
    socket: ClientConnection, service: ServiceProcess, request_: dict[str, Any]
) -> None:
    socket.send(json.dumps(request_))
    with pytest.raises(websockets.exceptions.ConnectionClosed) as closed:
        socket.recv()
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 1007
    assert httpx.get(f"{service.address}/readyz").status_code == 200


class LazyPage:
    """A page that is told of its scene, asks on and on, and reads no answer before it leaves."""

    def __init__(self) -> None:
        self.asked = 0
        self.left = asyncio.Event()

    async def accept(self) -> None:
        pass

    async def send_json(self, data: dict[str, Any]) -> None:
        if data["type"] != "scene":
            await self.left.wait()
            raise WebSocketDisconnect

    async def receive(self) -> dict[str, Any]:
        if self.left.is_set():
            return {"type": "websocket.disconnect", "code": 1001}
        self.asked += 1
        return {"type": "websocket.receive", "text": '{"type": "judge", "task": null}'}


class NoServers:
    """Gives out scenes in which nothing is."""

    async def enter(self, owner: str | None) -> SimpleNamespace:
        return SimpleNamespace(key="none")

    async def leave(self, server: SimpleNamespace) -> None:
        pass


class NoWays:
    """Keeps no lift, and takes for ever to say so."""

    async def ask(self, editor: str, sent: Any, cell: str | None) -> None:
        await asyncio.Event().wait()

    async def leave(self, editor: str) -> None:
        pass


def test_of_a_page_that_reads_no_answers_nothing_more_is_read_and_it_can_leave() -> None:
    async def edited() -> int:
        page, servers = LazyPage(), NoServers()
        workshop = Workshop(servers, no_uploads, {}, None, NoWays())  # pyright: ignore[reportArgumentType]
        editing = asyncio.create_task(edit(page, workshop, None))  # pyright: ignore[reportArgumentType]
        # One is being sent, and one waits for room.
        while page.asked < MOST_UNSENT + 2:
            await asyncio.sleep(0.0)
        # Long enough for more, were they read.
        await asyncio.sleep(0.2)
        asked = page.asked
        page.left.set()
        await editing
        return asked

    assert asyncio.run(edited()) == MOST_UNSENT + 2


def test_news_of_the_scene_are_dropped_for_a_page_that_does_not_keep_up_and_answers_are_not() -> None:
    async def told() -> list[PageAnswer]:
        outbox, sent = anyio.create_memory_object_stream[PageAnswer](MOST_UNSENT)
        workshop = Workshop(NoServers(), no_uploads, {}, None, NoWays())  # pyright: ignore[reportArgumentType]
        editing = _Editing(workshop, SimpleNamespace(), outbox)  # pyright: ignore[reportArgumentType]
        for _ in range(10 * MOST_UNSENT):
            editing._told(Chosen("/cup"))
        await asyncio.sleep(0.0)
        answering = asyncio.create_task(editing.answer('{"type": "judge", "task": null}'))
        while not (answering.done() or outbox.statistics().tasks_waiting_send):
            await asyncio.sleep(0.0)
        received = [sent.receive_nowait() for _ in range(MOST_UNSENT + 1)]
        await answering
        outbox.close()
        sent.close()
        return received

    *news, answer = asyncio.run(told())
    assert all(isinstance(each, News) for each in news)
    assert answer == Judged(None)
