"""The service in this very thread, without a port: each request is one turn of its event loop."""

from __future__ import annotations

import asyncio
import logging
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import httpx
import structlog
from fastapi import FastAPI

import app.create_app as creation
from app.access import authenticator
from app.access.key_store import KeyStore
from app.resources.cell_collection import examined_upload
from app.server.answer_headers import AnswerHeaders
from app.settings import ServiceSettings
from app.work.wanted import StillWanted
from app.work.workbench import Workbench
from planners.perception.perceive import perceive
from workers.stores.database import open_database


class OwnService:
    """The app over a data directory, which outlives it; nobody works on its jobs."""

    def __init__(self, folder: Path, **settings: Any) -> None:
        """Prepare an empty data directory in a folder; each life begins with a copy of it."""
        self._folder, self._settings = folder, settings
        self._empty, self._lives = folder / "empty", 0
        open_database(ServiceSettings(data_dir=self._empty)).close()
        self._data_dir = self._empty

    def begin_anew(self) -> None:
        """Forget everything, and start."""
        self._lives += 1
        self._data_dir = self._folder / str(self._lives)
        shutil.copytree(self._empty, self._data_dir)
        self._start()

    def restart(self) -> None:
        """End the app, and have another one over what it has left."""
        self._stop()
        self._start()

    def end(self) -> None:
        """End the app, and remove what it has left."""
        self._stop()
        shutil.rmtree(self._data_dir)

    @property
    def state(self) -> Any:
        """What the app's routes work with."""
        return self._app.state

    @property
    def keys(self) -> KeyStore:
        """As `liftwright keys` has it."""
        return KeyStore(self._app.state.database)

    def ask(self, method: str, path: str, key: str | None = None, **request: Any) -> httpx.Response:
        """Send a request, and wait for the answer."""
        headers = {**request.pop("headers", {}), **({} if key is None else {"Authorization": f"Bearer {key}"})}
        return self._runner.run(self._client.request(method, path, headers=headers, **request))

    def _start(self) -> None:
        settings = ServiceSettings.model_validate({"data_dir": self._data_dir, **self._settings})
        self._app: FastAPI = creation.create_app(settings, with_worker=False)
        self._runner = asyncio.Runner()
        self._life = self._app.router.lifespan_context(self._app)
        self._runner.run(_awaited(self._life.__aenter__))
        transport = httpx.ASGITransport(AnswerHeaders(self._app), raise_app_exceptions=False)
        self._client = httpx.AsyncClient(transport=transport, base_url="http://localhost", timeout=60.0)

    def _stop(self) -> None:
        self._runner.run(self._client.aclose())
        self._runner.run(_awaited(partial(self._life.__aexit__, None, None, None)))
        self._runner.close()


async def _awaited(call: Callable[[], Any]) -> None:
    await call()


@contextmanager
def sparing_repeats() -> Iterator[None]:
    """Look at the same cell and the same scan once only, whatever is asked how often; and have no key trusted.

    What is loaded ahead in each life is loaded when it is first wanted. A key that was revoked may open the service for
    a second more; here that second is none.
    """
    do = Workbench.do
    cells: dict[tuple[bytes, str], Any] = {}
    scenes: dict[tuple[str, ...], Any] = {}

    def do_once(self: Workbench, wanted: StillWanted, work: Any, *given: Any) -> Any:
        if work is perceive:
            scan, files, cell = given
            shown = (scan.model_dump_json(), *(f"{name} {hash(files[name])}" for name in sorted(files)))
            if shown not in scenes:
                scenes[shown] = perceive(scan, files, cell)
            return scenes[shown]
        if work is examined_upload:
            content, suffix, *_ = given
            if (content, suffix) not in cells:
                cells[content, suffix] = examined_upload(*given)
            return cells[content, suffix]
        return do(self, wanted, work, *given)

    silent = structlog.make_filtering_bound_logger(logging.CRITICAL)
    told = structlog.get_config()["wrapper_class"]
    structlog.configure(wrapper_class=silent)
    try:
        with (
            mock.patch.object(Workbench, "do", do_once),
            mock.patch.object(creation, "_load_ahead"),
            mock.patch.object(authenticator, "TRUSTED_SECONDS", 0.0),
        ):
            yield
    finally:
        structlog.configure(wrapper_class=told)
