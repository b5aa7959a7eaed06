"""Runs the service, or a worker alone, until it is told to stop."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from errno import EADDRINUSE
from fcntl import LOCK_EX, LOCK_NB, flock
from functools import partial
from html import escape
from http import HTTPStatus
from importlib import resources
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory, gettempdir
from types import FrameType
from typing import TYPE_CHECKING, Any

import structlog
import uvicorn
from starlette.datastructures import Headers
from starlette.responses import HTMLResponse, JSONResponse
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocketClose

from app.access.authenticator import keys_needed
from app.access.key_store import KeyStore
from app.errors import NotReady, error_response, navigates
from app.logs import set_up_logs
from app.server.configuration import LONGEST_GOODBYE_SECONDS, server_configuration
from app.server.connections import GuardedServer, raise_file_limit
from app.settings import ServiceSettings
from planners.errors import LiftwrightError
from workers.engine.executor_lock import FileLock
from workers.engine.supervisor import Supervisor
from workers.loading import loading
from workers.settings import WorkerSettings
from workers.stores.database import open_database
from workers.stores.job_queue import JobQueue
from workers.stores.plan_store import PlanStore

if TYPE_CHECKING:
    from fastapi import FastAPI

PROCESS_LOOK_SECONDS = 0.5
"""How often it is looked whether a further process has ended [s]."""
SHARED_COUNTS = "PROMETHEUS_MULTIPROC_DIR"
"""As in `app.metrics`, which is loaded after it is set."""
COUNTS_PREFIX = "liftwright-metrics-"
COUNTS_SETTLED_SECONDS = 60.0
"""A folder of counts in which nothing was made for so long is locked, or its process has ended [s]."""
TRY_AGAIN_LATER = 1013
"""Close code of RFC 6455's registry."""

STARTING_FILES = ("starting.html", "style.css")
STARTING_POLICY = "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'"

log = structlog.get_logger(__name__)


class CannotListen(LiftwrightError):
    """An address cannot be had."""

    def __init__(self, host: str, port: int, error: OSError) -> None:
        if error.errno == EADDRINUSE:
            why = "is taken by another program; choose another with --port"
        else:
            why = f"cannot be listened on: {error.strerror}; choose another with --host or --port"
        super().__init__(f"{host}:{port} {why}")


def bind(host: str, port: int) -> list[socket.socket]:
    """Return a socket for each address of a host, bound and not listening yet: who connects is refused until it is.

    Args:
        host: name or address.
        port: 0: any free one, the same for all addresses.

    Raises:
        CannotListen: Another program listens there, or nobody can.
    """
    with ExitStack() as bound:
        sockets: list[socket.socket] = []
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
            for family, kind, protocol, _, address in dict.fromkeys(found):
                each = bound.enter_context(socket.socket(family, kind, protocol))
                each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                if family == socket.AF_INET6:
                    each.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                each.bind((address[0], port, *address[2:]))
                port = each.getsockname()[1]
                sockets.append(each)
        except OSError as error:
            raise CannotListen(host, port, error) from error
        bound.pop_all()
        return sockets


class NoKeys(LiftwrightError):
    """Others could reach the service, and nobody could be let in."""

    def __init__(self, host: str) -> None:
        super().__init__(
            f"{host} can be reached from other machines, and no key was issued that would let anybody in: "
            "`liftwright keys issue --owner NAME --scope admin` makes one"
        )


def serve(settings: ServiceSettings, *, with_worker: bool) -> None:
    """Serve until SIGINT or SIGTERM.

    Raises:
        NoKeys: The address is not this machine's own, and there is no key.
        CannotListen: The address is another program's, or nobody's.
        WarmUpFailed: The solver does not work.
        WorkerRuns: Another worker has the data directory.
    """
    set_up_logs()
    ask_for_keys = _ask_for_keys(settings)
    if not ask_for_keys:
        log.warning(
            "NO AUTHENTICATION: every program and person on this machine can post, read and delete plans; "
            "`liftwright keys issue` and a restart change that",
            host=settings.host,
        )
    if with_worker:
        _refuse_second_worker(settings)
    sockets = bind(settings.host, settings.port)

    def load(start: Start) -> FastAPI:
        solvers = None
        if with_worker:
            start.tell(
                "loading kernels and handovers; the first start compiles and computes them, which takes some minutes"
            )
            _warm_up_once(settings)
            from workers.solver.pool import SolverPool

            # They take as long to load as all that follows, and do it meanwhile.
            solvers = SolverPool.of(settings)
            start.call(solvers.open)
        start.tell("loading planners, cells and tools")
        with loading():
            # Here, because it takes seconds in which probes are answered already.
            from app.create_app import create_app

        return create_app(settings, with_worker=with_worker, ask_for_keys=ask_for_keys, solvers=solvers)

    service = LoadedWhileServing(load)
    server = _Server(server_configuration(service, settings), "keys" if ask_for_keys else "none", service)
    # The server raises the signal that ended it once more, when everything is in order.
    signal.signal(signal.SIGTERM, _end)
    with _further_processes(settings, sockets, ask_for_keys=ask_for_keys):
        asyncio.run(server.serve(sockets))
    if service.failure is not None:
        raise service.failure


@contextmanager
def _further_processes(
    settings: ServiceSettings, sockets: Sequence[socket.socket], *, ask_for_keys: bool
) -> Iterator[None]:
    """Have `api_processes` - 1 further processes answer on the same sockets for the time of a block.

    One that ends before is started anew, and asks for keys if this process does, whatever was issued since. Whichever
    the kernel gives a connection to answers it; none of them works on jobs.
    """
    ending = threading.Event()
    told = {"settings": settings.model_dump(mode="json"), "ask_for_keys": ask_for_keys}
    with ExitStack() as stack:
        if settings.api_processes > 1:
            os.environ[SHARED_COUNTS] = stack.enter_context(folder_of_counts())
        keepers = [
            threading.Thread(target=_keep_process, args=(told, sockets, ending), name=f"API process {n}", daemon=True)
            for n in range(1, settings.api_processes)
        ]
        for keeper in keepers:
            keeper.start()
        try:
            yield
        finally:
            ending.set()
            for keeper in keepers:
                keeper.join(2 * LONGEST_GOODBYE_SECONDS)


@contextmanager
def folder_of_counts() -> Iterator[str]:
    """Give a folder for the time of a block, and remove what killed processes have left of theirs."""
    for left in Path(gettempdir()).glob(f"{COUNTS_PREFIX}*"):
        # One that was just made is locked at once; others' cannot be opened.
        with suppress(OSError):
            if left.stat().st_mtime < time.time() - COUNTS_SETTLED_SECONDS:
                with _locked(left):
                    rmtree(left)
    with TemporaryDirectory(prefix=COUNTS_PREFIX) as folder, _locked(Path(folder)):
        yield folder


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Have a folder alone until the end of a block, or of this process, however it ends.

    Raises:
        BlockingIOError: Another process has it.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_NOFOLLOW)
    try:
        flock(descriptor, LOCK_EX | LOCK_NB)
        yield
    finally:
        os.close(descriptor)


def _keep_process(told: Mapping[str, Any], sockets: Sequence[socket.socket], ending: threading.Event) -> None:
    descriptors = [each.fileno() for each in sockets]
    command = (sys.executable, "-m", "app.serve", *map(str, descriptors))
    while not ending.is_set():
        try:
            process = subprocess.Popen(command, pass_fds=descriptors, stdin=subprocess.PIPE)
        except OSError as error:
            # The machine is short of processes or memory; the others answer meanwhile.
            log.error("an API process could not be started, and is tried again", error=str(error))
            ending.wait(PROCESS_LOOK_SECONDS)
            continue
        assert process.stdin is not None
        # It ends when its stdin does: with this process, however that ends.
        with suppress(BrokenPipeError):
            process.stdin.write(json.dumps(told).encode() + b"\n")
            process.stdin.flush()
        while process.poll() is None and not ending.wait(PROCESS_LOOK_SECONDS):
            pass
        if ending.is_set():
            with suppress(BrokenPipeError):
                process.stdin.close()
            process.wait()
        else:
            log.error("an API process has ended, and is started anew", exit_code=process.returncode)


def _serve_along(descriptors: Sequence[int]) -> None:
    """Answer requests on sockets of the process that has started this one, until it ends."""
    set_up_logs()
    told = json.loads(sys.stdin.buffer.readline())
    settings = ServiceSettings(**told["settings"])
    from app.create_app import create_app

    app = create_app(settings, with_worker=False, ask_for_keys=told["ask_for_keys"])
    server = GuardedServer(server_configuration(app, settings))

    def end_with_the_first() -> None:
        sys.stdin.buffer.read()
        server.should_exit = True

    threading.Thread(target=end_with_the_first, name="end", daemon=True).start()
    signal.signal(signal.SIGTERM, _end)
    asyncio.run(server.serve([socket.socket(fileno=descriptor) for descriptor in descriptors]))
    # As a worker ends: threads of the engine that wait for a database which is away would keep the process.
    os._exit(0)


def work(settings: WorkerSettings) -> None:
    """Work on jobs until SIGINT or SIGTERM.

    Raises:
        WarmUpFailed: The solver does not work.
        WorkerRuns: Another worker has this name.
    """
    set_up_logs()
    raise_file_limit()
    _refuse_second_worker(settings)
    _warm_up_once(settings)
    asyncio.run(_work(settings))


def _warm_up_once(settings: WorkerSettings) -> None:
    """Spare a start after the first one the seconds that it takes to find that everything is there."""
    from workers.solver.warm_up import is_warm, warm_up

    if not is_warm(settings):
        warm_up(settings)


def _ask_for_keys(settings: ServiceSettings) -> bool:
    """Tell whether keys are asked for, by all processes of the service.

    Raises:
        NoKeys: They are, because of the address, and there is none that opens anything.
    """
    with closing(open_database(settings)) as database:
        keys = KeyStore(database)
        if not settings.is_loopback and not database.at_start(keys.any_valid):
            raise NoKeys(settings.host)
        return database.at_start(partial(keys_needed, settings, keys))


def _refuse_second_worker(settings: WorkerSettings) -> None:
    """Say so at once, in one line; the worker itself takes the lock for good when it starts."""
    if settings.embedded:
        FileLock(settings.data_dir, settings.executor_name).release()


def _end(number: int, frame: FrameType | None) -> None:
    # As a worker ends: threads of the engine that wait for a database which is away would keep the process.
    os._exit(0)


def _starting_page(doing: str) -> HTMLResponse:
    """Return what a person sees who comes too early: it asks again by itself. No script of ours is there yet."""
    page, styles = (resources.files("app.viewer").joinpath("static", name).read_text() for name in STARTING_FILES)
    filled = page.replace("<!-- styles -->", styles).replace("<!-- doing -->", escape(doing))
    return HTMLResponse(
        filled, HTTPStatus.SERVICE_UNAVAILABLE, {**NotReady.headers, "Content-Security-Policy": STARTING_POLICY}
    )


@dataclass(frozen=True, eq=False)
class Start:
    """What whoever loads the service may call meanwhile, from any thread."""

    tell: Callable[[str], None]
    """Says how far it is."""
    call: Callable[[Callable[[], None]], object]
    """Has something called on the loop on which the service will run."""


class LoadedWhileServing:
    """ASGI application: a service that is loaded while connections are taken already.

    Until it is there `/livez` says that the process lives, and everything else is 503 with what is waited for: a page
    for browsers that ask for one.
    """

    def __init__(self, load: Callable[[Start], FastAPI]) -> None:
        """Take what returns the service, from a thread of its own."""
        self._load, self._doing = load, "reading its settings"
        self._service: FastAPI | None = None
        self.failure: BaseException | None = None
        """Why there will be no service."""
        self.on_failure: Callable[[], None] = lambda: None
        """Called when that is known."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection, or the server's own begin and end."""
        if scope["type"] == "lifespan":
            await self._live(receive, send)
        elif self._service is not None:
            await self._service(scope, receive, send)
        elif scope["type"] == "websocket":
            await WebSocketClose(TRY_AGAIN_LATER)(scope, receive, send)
        elif scope["path"] == "/livez":
            await JSONResponse({"status": "alive"})(scope, receive, send)
        elif navigates(scope["method"], Headers(scope=scope)):
            await _starting_page(self._doing)(scope, receive, send)
        else:
            await error_response(NotReady(f"the service is starting: {self._doing}"))(scope, receive, send)

    async def _live(self, receive: Receive, send: Send) -> None:
        await receive()
        stop = asyncio.Event()
        life = asyncio.create_task(self._run(stop))
        await send({"type": "lifespan.startup.complete"})
        await receive()
        stop.set()
        if self._service is None:
            life.cancel()
        with suppress(asyncio.CancelledError):
            await life
        await send({"type": "lifespan.shutdown.complete"})

    async def _run(self, stop: asyncio.Event) -> None:
        """Load the service, and have it live until it is to stop."""
        try:
            start = Start(self._tell, asyncio.get_running_loop().call_soon_threadsafe)
            service = await _in_a_thread(lambda: self._load(start))
            self._tell("opening the database and starting what works in the background")
            async with service.router.lifespan_context(service):
                self._service = service
                log.info("ready")
                await stop.wait()
        except Exception as error:  # noqa: BLE001 - whoever serves raises it again
            self.failure = error
            self.on_failure()

    def _tell(self, doing: str) -> None:
        self._doing = doing


async def _in_a_thread(work: Callable[[], FastAPI]) -> FastAPI:
    """Return what `work` returns. Its thread holds up no end of the process, as those of an executor do."""
    loop, done = asyncio.get_running_loop(), asyncio.Future["FastAPI"]()

    def settle(result: FastAPI | None, error: Exception | None) -> None:
        if done.cancelled():
            return
        if result is None:
            done.set_exception(error or RuntimeError("nothing was loaded"))
        else:
            done.set_result(result)

    def run() -> None:
        result, failure = None, None
        try:
            result = work()
        except Exception as error:  # noqa: BLE001 - whoever waits raises it again
            failure = error
        # Who waits may have stopped waiting, and its loop with it.
        with suppress(RuntimeError):
            loop.call_soon_threadsafe(settle, result, failure)

    threading.Thread(target=run, name="loading", daemon=True).start()
    return await done


class _Server(GuardedServer):
    """Says where it listens once it does, and ends when there will be nothing to serve."""

    def __init__(self, config: uvicorn.Config, authentication: str, service: LoadedWhileServing) -> None:
        super().__init__(config)
        self._authentication = authentication
        service.on_failure = self._end

    def _end(self) -> None:
        self.should_exit = True

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        try:
            await super().startup(sockets)
        except OSError as error:
            # Another program has begun to listen meanwhile.
            await self.lifespan.shutdown()
            raise CannotListen(self.config.host, self.config.port, error) from error
        if self.started:
            host, port = self.servers[0].sockets[0].getsockname()[:2]
            log.info("listening", address=f"http://{host}:{port}", authentication=self._authentication)


async def _work(settings: WorkerSettings) -> None:
    from workers.engine.worker import Worker

    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    database = open_database(settings)
    queue = JobQueue(database)
    supervisor = Supervisor()
    worker = Worker(settings, database, queue, PlanStore(database), supervisor)
    await worker.start()
    log.info("working", worker=settings.worker_name, slots=settings.worker_slots)
    try:
        await stop.wait()
    finally:
        await supervisor.stop()
        await worker.stop()
        queue.close()
        database.close()
    log.info("worker has ended", worker=settings.worker_name)
    # Everything is given back. Threads of the engine that wait for a database which is away would keep the process.
    os._exit(0)


if __name__ == "__main__":
    _serve_along([int(word) for word in sys.argv[1:]])
