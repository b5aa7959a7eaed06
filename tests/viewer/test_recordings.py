"""Recordings are made once, in turn, and only while somebody waits for them."""

from __future__ import annotations

import asyncio
import re
import select
import threading
import time
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.errors import TooManyRecordings
from app.resources.recordings import Recordings
from app.settings import ServiceSettings
from app.viewer.scene_servers import SceneServers
from app.work.wanted import NobodyWaits, StillWanted
from tests.support.service import FAKE_SOLVER, finished, task, wait_for
from tests.support.serving import served
from workers.stores.plan_store import StoredDocument

WAITING = 3


def document(name: str) -> StoredDocument:
    return StoredDocument(b"", name)


class Maker:
    """Makes pages, and may be held up."""

    def __init__(self) -> None:
        self.made: list[str] = []
        self.begun = threading.Event()
        self.free = threading.Event()

    def __call__(self, of: StoredDocument, wanted: StillWanted) -> str:
        self.begun.set()
        poll = select.poll()
        poll.register(wanted.descriptor, 0)
        deadline = time.monotonic() + 20.0
        while not self.free.wait(0.01):
            assert time.monotonic() < deadline
            if poll.poll(0):
                raise NobodyWaits
        self.made.append(of.sha256)
        return f"page of {of.sha256}" + 1000 * " "


async def forever() -> None:
    await asyncio.Event().wait()


def run(folder: Path, body: Callable[[Recordings, Maker], Coroutine[Any, Any, None]], **settings: Any) -> None:
    async def all_of_it() -> None:
        make = Maker()
        limits = {"software": "1", "most_bytes": 10**6, "most_waiting": WAITING, **settings}
        await body(Recordings(folder, make, **limits), make)

    asyncio.run(all_of_it())


async def begun(task: asyncio.Task[bytes]) -> None:
    """Let it come as far as it does without anything being made."""
    for _ in range(50):
        await asyncio.sleep(0.005)
        assert not task.done() or task.exception()


def test_what_nobody_waits_for_any_more_is_not_made(tmp_path: Path) -> None:
    async def body(recordings: Recordings, make: Maker) -> None:
        leave = asyncio.Event()
        first = asyncio.create_task(recordings.get(document("first"), leave.wait))
        await begun(first)
        left = [asyncio.create_task(recordings.get(document(f"left {n}"), leave.wait)) for n in range(WAITING)]
        await begun(left[-1])
        leave.set()
        assert all(isinstance(each, NobodyWaits) for each in await asyncio.gather(first, *left, return_exceptions=True))
        stays = asyncio.create_task(recordings.get(document("stays"), forever))
        await begun(stays)
        make.free.set()
        assert (await stays).startswith(b"page of stays")
        # The first one was being made when its client left: whoever asks again has it made anew.
        assert make.made == ["stays"]
        assert (await recordings.get(document("first"), forever)).startswith(b"page of first")
        assert make.made == ["stays", "first"]

    run(tmp_path, body)


def test_many_who_ask_for_one_recording_have_it_made_once_and_too_many_others_are_refused(tmp_path: Path) -> None:
    async def body(recordings: Recordings, make: Maker) -> None:
        asked = [asyncio.create_task(recordings.get(document("a"), forever)) for _ in range(40)]
        others = [asyncio.create_task(recordings.get(document(f"{n}"), forever)) for n in range(WAITING)]
        await begun(others[-1])
        with pytest.raises(TooManyRecordings) as refused:
            await recordings.get(document("one more"), forever)
        assert "Retry-After" in refused.value.headers
        make.free.set()
        await asyncio.gather(*asked, *others)
        assert sorted(make.made) == ["0", "1", "2", "a"]
        assert (await recordings.get(document("one more"), forever)).startswith(b"page of one more")

    run(tmp_path, body)


def test_of_several_who_wait_one_may_leave(tmp_path: Path) -> None:
    async def body(recordings: Recordings, make: Maker) -> None:
        leave = asyncio.Event()
        blocking = asyncio.create_task(recordings.get(document("blocking"), forever))
        await begun(blocking)
        leaves, stays = (asyncio.create_task(recordings.get(document("a"), each)) for each in (leave.wait, forever))
        await begun(stays)
        leave.set()
        with pytest.raises(NobodyWaits):
            await leaves
        make.free.set()
        assert (await stays).startswith(b"page of a")
        await blocking

    run(tmp_path, body)


def test_what_is_kept_is_bounded_and_the_last_used_stay(tmp_path: Path) -> None:
    async def body(recordings: Recordings, make: Maker) -> None:
        make.free.set()
        for name in ("a", "b", "c", "a", "d", "a", "d"):
            await recordings.get(document(name), forever)
        assert make.made == ["a", "b", "c", "d"]
        assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 3500
        await recordings.get(document("b"), forever)
        assert make.made == ["a", "b", "c", "d", "b"]

    run(tmp_path, body, most_bytes=3500)


def test_another_version_of_the_software_makes_pages_of_its_own(tmp_path: Path) -> None:
    async def body(recordings: Recordings, make: Maker) -> None:
        make.free.set()
        await recordings.get(document("a"), forever)
        assert make.made == ["a"]

    run(tmp_path, body)
    run(tmp_path, body, software="2")


def test_a_recording_that_fails_fails_for_all_who_wait_and_is_tried_again(tmp_path: Path) -> None:
    async def body(recordings: Recordings, _: Maker) -> None:
        tried = list[str]()

        def fails(of: StoredDocument, _: StillWanted) -> str:
            assert free.wait(20)
            tried.append(of.sha256)
            raise ValueError("out of order")

        broken = Recordings(tmp_path, fails, "1", 10**6, WAITING)
        for _attempt in range(2):
            free = threading.Event()
            asked = [asyncio.create_task(broken.get(document("a"), forever)) for _ in range(3)]
            await begun(asked[-1])
            free.set()
            told = await asyncio.gather(*asked, return_exceptions=True)
            assert [type(each) for each in told] == [ValueError] * 3
        assert tried == ["a", "a"]

    run(tmp_path, body)


def how_many_left(client: httpx.Client) -> float:
    """Return how many who asked for recordings have left before, in all tests of this process."""
    left = r'_count{method="GET",route="/v1/plans/{plan_id}/recording.html",status="499"} (\S+)'
    return sum(map(float, re.findall(left, client.get("/metrics").text)))


@pytest.mark.slow
def test_over_http_a_client_that_leaves_is_noticed_and_a_recording_is_known_by_its_tag(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = Maker()
    monkeypatch.setattr(SceneServers, "record", lambda _, *asked: make(*asked))
    settings = ServiceSettings(data_dir=tmp_path, solver_command=FAKE_SOLVER, worker_slots=1, max_recordings_waiting=1)
    with served(settings) as address, httpx.Client(base_url=address, timeout=20.0) as client:
        plans = [client.post("/v1/plans", json=task(external_id="now")).json() for _ in range(4)]
        pages = [f"{finished(client, plan)['links']['self']}/recording.html" for plan in plans]
        before = how_many_left(client)
        with ThreadPoolExecutor(2) as pool:
            first = pool.submit(client.get, pages[0])
            assert make.begun.wait(20)
            for number in (1, 2):
                # Each leaves room for the next one when it leaves.
                with pytest.raises(httpx.ReadTimeout):
                    httpx.get(f"{address}{pages[number]}", timeout=0.5)
                wait_for(lambda so_many=before + number: how_many_left(client) == so_many, 5.0)
            stays = pool.submit(client.get, pages[3])
            wait_for(lambda: httpx.get(f"{address}{pages[1]}", timeout=1.0).status_code == 429, 5.0)
            make.free.set()
            assert first.result().status_code == stays.result().status_code == 200
        assert len(make.made) == 2
        tag = first.result().headers["ETag"]
        assert client.get(pages[0], headers={"If-None-Match": tag}).status_code == 304
        assert client.get(pages[0]).text == first.result().text
        assert len(make.made) == 2
