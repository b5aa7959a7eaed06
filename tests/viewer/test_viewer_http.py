"""What the viewer answers without a browser."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
import websockets.exceptions
from websockets.sync.client import connect

from tests.support.scan_frames import shipped
from tests.support.service import FAKE_SOLVER, ServiceProcess, finished, running_service, task


@pytest.fixture(scope="module")
def service(data_dir: Path) -> Iterator[ServiceProcess]:
    with running_service(data_dir, FAKE_SOLVER) as service:
        yield service


@pytest.fixture
def client(service: ServiceProcess) -> Iterator[httpx.Client]:
    with service.client() as client:
        yield client


def watch_address(service: ServiceProcess) -> str:
    return f"ws://127.0.0.1:{service.port}/viewer/watch"


def test_view_leads_to_the_viewer_with_the_plan(client: httpx.Client) -> None:
    plan = finished(client, client.post("/v1/plans", json=task()).json())
    answer = client.get(plan["links"]["view"])
    assert answer.status_code == 307
    assert answer.headers["location"] == f"/viewer/?plan={plan['id']}"
    assert client.get(answer.headers["location"]).headers["content-type"].startswith("text/html")


@pytest.mark.parametrize("link", ["view", "recording.html"])
def test_an_unknown_plan_has_neither_view_nor_recording(client: httpx.Client, link: str) -> None:
    answer = client.get(f"/v1/plans/{'0' * 32}/{link}")
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize(
    "address", ["/viewer/nothing", "/nothing", f"/v1/plans/{'0' * 32}/view", "/v1/plans?colour=red"]
)
@pytest.mark.slow
def test_what_is_refused_is_a_page_for_a_person_and_a_problem_for_a_program(client: httpx.Client, address: str) -> None:
    problem = client.get(address)
    page = client.get(address, headers={"Accept": "text/html,application/xhtml+xml,*/*;q=0.8"})
    assert problem.headers["content-type"] == "application/problem+json"
    assert page.headers["content-type"].startswith("text/html")
    assert page.status_code == problem.status_code >= 400
    assert html.escape(problem.json()["detail"]) in page.text
    ways = re.findall(r'<a href="([^"]+)"', page.text)
    assert ways
    assert {client.get(way, follow_redirects=True).status_code for way in ways} == {200}


def test_what_is_posted_by_a_browser_too_is_refused_as_to_a_program(client: httpx.Client) -> None:
    answer = client.post("/v1/plans", json={}, headers={"Accept": "text/html"})
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.slow
def test_the_view_of_a_scene_leads_to_the_viewer_which_tells_of_its_objects(
    service: ServiceProcess, client: httpx.Client
) -> None:
    scene = client.post("/v1/scenes", files=shipped().form()).json()
    answer = client.get(scene["links"]["view"])
    assert answer.status_code == 307
    assert answer.headers["location"] == f"/viewer/?scene={scene['id']}"
    with connect(watch_address(service)) as socket:
        socket.recv()
        socket.send(json.dumps({"type": "open_perceived", "scene": scene["id"]}))
        told = json.loads(socket.recv())["description"]
        assert [each["name"] for each in told["objects"]] == [each["name"] for each in scene["scene"]["objects"]]
        # What only plans have does no harm.
        for request in ({"type": "time", "source": "plan", "time": 1.0}, {"type": "view", "view": "close"}):
            socket.send(json.dumps(request))
            assert json.loads(socket.recv())["type"] == "done"
        for layer in ("models", "forces"):
            socket.send(json.dumps({"type": "layer", "layer": layer, "visible": False}))
            assert json.loads(socket.recv())["type"] == "done"
        socket.send(json.dumps({"type": "open_perceived", "scene": "none"}))
        refused = json.loads(socket.recv())
        assert (refused["type"], refused["scene"]) == ("refused", "none")


def test_an_unknown_scene_has_no_view(client: httpx.Client) -> None:
    assert client.get(f"/v1/scenes/{'0' * 32}/view").status_code == 404


@pytest.mark.parametrize(
    ("path", "some"),
    [("/viewer/", {"viewer.css", "plot.js", "player.js"}), ("/viewer/new", {"style.css", "editor.css", "editor.js"})],
)
def test_everything_a_page_names_is_served(client: httpx.Client, path: str, some: set[str]) -> None:
    page = client.get(path).text
    names = [part.split('"')[0] for part in page.replace('src="', 'href="').split('href="')[1:]]
    names = [name for name in names if not name.startswith(("data:", "/"))]
    assert some <= set(names)
    assert {client.get(f"/viewer/{name}").status_code for name in names} == {200}


@pytest.mark.parametrize("name", ["page.html", "../create_app.py", "..%2fpage.py", "scene/guess/"])
def test_nothing_else_is_served(client: httpx.Client, name: str) -> None:
    assert client.get(f"/viewer/{name}").status_code == 404


def test_a_watcher_gets_a_scene_and_is_told_of_plans_that_are_not_there(service: ServiceProcess) -> None:
    with connect(watch_address(service)) as socket:
        opened = json.loads(socket.recv())
        assert httpx.get(f"{service.address}/viewer/{opened['scene']}").status_code == 200
        socket.send(json.dumps({"type": "open", "plan": "none"}))
        answer = json.loads(socket.recv())
        assert answer["type"] == "refused"
        assert "none" in answer["detail"]
        socket.send(json.dumps({"type": "time", "source": "plan", "time": 1.0}))
        assert json.loads(socket.recv()) == {"type": "done", "request": "time"}


@pytest.mark.parametrize("light", [False, True])
def test_the_cell_is_drawn_before_any_plan_is_opened(service: ServiceProcess, light: bool) -> None:
    with connect(watch_address(service)) as socket:
        socket.recv()
        socket.send(json.dumps({"type": "detail", "light": light}))
        assert json.loads(socket.recv()) == {"type": "done", "request": "detail"}


def test_a_fault_of_the_service_is_told_as_one_and_the_connection_stays(
    service: ServiceProcess, client: httpx.Client
) -> None:
    # What the fake solver answers is no plan document: a fault that nobody thought of.
    plan = finished(client, client.post("/v1/plans", json=task()).json())
    with connect(watch_address(service)) as socket:
        socket.recv()
        told = []
        for _ in range(2):
            socket.send(json.dumps({"type": "open", "plan": plan["id"]}))
            told.append(json.loads(socket.recv()))
        assert {(each["type"], each["request"]) for each in told} == {("fault", "open")}
        assert all(
            "could not show this plan" in each["detail"] and "ValidationError" in each["detail"] for each in told
        )
        assert told[0]["detail"] != told[1]["detail"], "each fault is found in the log by a name of its own"
        socket.send(json.dumps({"type": "time", "source": "plan", "time": 1.0}))
        assert json.loads(socket.recv()) == {"type": "done", "request": "time"}


@pytest.mark.parametrize(
    "request_",
    ["{", '{"type":"time","source":"plan","time":-1}', '{"type":"dance"}', '{"type":"time","source":"dream","time":1}'],
)
def test_a_request_that_makes_no_sense_ends_the_connection_and_nothing_else(
    service: ServiceProcess, request_: str
) -> None:
    with connect(watch_address(service)) as socket:
        socket.recv()
        socket.send(request_)
        with pytest.raises(websockets.exceptions.ConnectionClosed) as closed:
            socket.recv()
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1007
    assert httpx.get(f"{service.address}/readyz").status_code == 200


def test_a_request_that_is_no_text_ends_the_connection_and_nothing_else(service: ServiceProcess) -> None:
    with connect(watch_address(service)) as socket:
        socket.recv()
        socket.send(b'{"type": "view", "view": "close"}')
        with pytest.raises(websockets.exceptions.ConnectionClosed) as closed:
            socket.recv()
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1003
    assert httpx.get(f"{service.address}/readyz").status_code == 200


def test_pages_of_others_may_not_watch(service: ServiceProcess) -> None:
    with pytest.raises(websockets.exceptions.InvalidStatus), connect(watch_address(service), origin="http://evil.test"):  # pyright: ignore[reportArgumentType]
        pass
