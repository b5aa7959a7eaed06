"""Uploads of meshes: so many are held in memory, so many worked on, and the event loop parses none of them."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import get_args

import httpx
import pytest
from fastapi import FastAPI

import app.uploads.uploads
from app.errors import install_error_handlers
from app.routes import dependencies, meshes, scenes
from app.routes.pages import problem_for_a_person
from app.settings import ServiceSettings
from app.uploads.form import FormPart, form_parts
from app.uploads.uploads import UploadLimits
from planners.geometry.solid_mesh import SolidMesh
from tests.geometry.mesh_shapes import angle, file_of

HELD, WORKED, SENDERS = 3, 2, 10
FORM = {"Content-Type": "multipart/form-data; boundary=a"}


@dataclass
class Crowd:
    """How many are somewhere, and how many were at most."""

    now: int = 0
    most: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @contextmanager
    def inside(self) -> Iterator[None]:
        with self._lock:
            self.now += 1
            self.most = max(self.most, self.now)
        try:
            yield
        finally:
            with self._lock:
                self.now -= 1


class SlowStore:
    """A store of meshes that holds up whoever asks until all are there who can be."""

    def __init__(self) -> None:
        self.working = Crowd()
        self._full = threading.Event()

    def get(self, mesh_id: str) -> SolidMesh | None:
        with self.working.inside():
            if self.working.now >= WORKED:
                self._full.set()
            self._full.wait(5.0)
            threading.Event().wait(0.02)
        return None

    def add(self, mesh_id: str, mesh: SolidMesh) -> None:
        pass


def service(store: SlowStore) -> FastAPI:
    asgi = FastAPI()
    asgi.state.settings = ServiceSettings()
    asgi.state.workbench, asgi.state.meshes, asgi.state.cells = None, store, {}
    for part in (dependencies.Scenes, dependencies.Cells):
        asgi.dependency_overrides[get_args(part)[1].dependency] = lambda: None
    asgi.state.mesh_limits = asgi.state.scan_limits = UploadLimits(HELD, WORKED)
    install_error_handlers(asgi, problem_for_a_person)
    asgi.include_router(meshes.router)
    asgi.include_router(scenes.router)
    return asgi


def test_so_many_meshes_are_received_and_so_many_worked_on_at_once() -> None:
    store, receiving = SlowStore(), Crowd()
    content = file_of(angle(), "stl")

    async def body() -> AsyncIterator[bytes]:
        with receiving.inside():
            for part in (content[:100], content[100:]):
                await asyncio.sleep(0.01)
                yield part

    async def post_all() -> list[int]:
        transport = httpx.ASGITransport(service(store))
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            posts = [
                client.post("/v1/meshes", content=body(), headers={"Content-Type": "model/stl"}) for _ in range(SENDERS)
            ]
            return [answer.status_code for answer in await asyncio.gather(*posts)]

    assert asyncio.run(post_all()) == [201] * SENDERS
    assert receiving.most == HELD
    assert store.working.most == WORKED


@pytest.mark.parametrize("path", ["/v1/meshes", "/v1/scenes"])
def test_a_form_is_parsed_beside_the_event_loop(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    threads: list[threading.Thread] = []

    def noted(*given: object) -> list[FormPart]:
        threads.append(threading.current_thread())
        return form_parts(*given)  # pyright: ignore[reportArgumentType]

    async def post() -> httpx.Response:
        transport = httpx.ASGITransport(service(SlowStore()))
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return await client.post(path, content=b"--a\r\n\r\n\r\n--a--", headers=FORM)

    monkeypatch.setattr(app.uploads.uploads, "form_parts", noted)
    assert asyncio.run(post()).status_code == 422
    assert threads
    assert threading.main_thread() not in threads
