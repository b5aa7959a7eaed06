"""Puts the service together. Run as a program it writes the description of its interface into a file."""

from __future__ import annotations

import json
import sys
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from threading import Thread

import structlog
from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import State

from app.access.access_control import AccessControl
from app.access.audit_log import AuditLog
from app.access.authenticator import Authenticator, OpenAccess, keys_needed
from app.access.key_store import KeyStore
from app.access.rate_limiter import RateLimiter
from app.access.session_store import SessionStore
from app.errors import install_error_handlers
from app.middleware import HeadAsGet, OneLength, RequestLog
from app.openapi import install_openapi
from app.resources.cell_collection import CellCollection
from app.resources.followers import Followers
from app.resources.plan_collection import PlanCollection
from app.resources.plan_feed import POLL_SECONDS, PlanFeed
from app.resources.recordings import Recordings
from app.resources.scene_collection import SceneCollection
from app.resources.study_collection import StudyCollection
from app.resources.webhook_collection import WebhookCollection
from app.routes import (
    access,
    capabilities,
    cells,
    editor,
    meshes,
    pages,
    plans,
    probes,
    scenes,
    studies,
    tasks,
    viewer,
    webhooks,
)
from app.settings import ServiceSettings
from app.task_intake import KnownTasks, accept_task
from app.uploads.uploads import UploadLimits
from app.viewer.editor.feasibility import OtherWays
from app.viewer.page import recording_software
from app.viewer.scene_servers import SceneServers, WatcherRoom
from app.work.workbench import Workbench
from planners.cell.cell import ShippedCells, load_cells
from planners.contract.strict_json import parse_json
from planners.errors import LiftwrightError
from planners.scene.suction_tool import load_tools
from workers.engine.deadline import PatientQuestion
from workers.engine.housekeeping import DELETION_PAUSE_SECONDS
from workers.engine.supervisor import Supervisor
from workers.engine.worker import Worker
from workers.solver.feasibility_pool import FeasibilityPool
from workers.solver.pool import SolverCommand, SolverPool
from workers.stores.cell_store import CellStore
from workers.stores.database import Database, open_database
from workers.stores.job_queue import JobQueue
from workers.stores.mesh_store import MeshStore
from workers.stores.plan_store import PlanStore, Room
from workers.stores.plan_writer import PlanWriter
from workers.stores.scene_store import SceneStore
from workers.stores.study_store import StudyStore
from workers.stores.task_parts import TaskParts
from workers.stores.webhook_store import WebhookStore
from workers.webhooks.target import TargetRules

WRITABLE_SECONDS = 0.1
"""So long it holds that the database takes writes [s]."""
REFERENCE_TASKS = ("ab1.json", "domino_pile.json")
PARTS = (pages, plans, studies, tasks, scenes, meshes, cells, webhooks, access, editor, viewer, capabilities, probes)
"""In the order in which addresses are matched."""
DESCRIPTION = (
    "Plans how a dual-arm robot lifts heavy plates together with a vacuum lifter, and how it moves objects with a "
    "suction tool. Post a task, follow its job, fetch a certified plan document. SI units; world frame on the floor "
    "under the robot."
)
log = structlog.get_logger(__name__)


def create_app(
    settings: ServiceSettings,
    *,
    with_worker: bool,
    ask_for_keys: bool | None = None,
    solvers: SolverPool | None = None,
) -> FastAPI:
    """Return the service.

    Args:
        settings: of the service.
        with_worker: whether a worker is in the same process; else they are elsewhere, on the same database.
        ask_for_keys: as was decided for all processes of the service; None: it is decided when this one starts.
        solvers: of that worker, which closes them; None: some that it opens when the service starts.
    """

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with AsyncExitStack() as to_close:
            database = app.state.database = await run_in_threadpool(open_database, settings)
            to_close.callback(database.close)
            # Anybody may ask, and each answer is a write.
            app.state.writable = PatientQuestion(database.require_writable, WRITABLE_SECONDS)
            queue, store, supervisor = JobQueue(database), PlanStore(database), Supervisor()
            to_close.callback(queue.close)
            app.state.supervisor = supervisor
            app.state.tools = await run_in_threadpool(load_tools)
            kept_cells = CellStore(database, settings.cells_dir)
            app.state.cells = CellCollection(ShippedCells(), kept_cells)
            app.state.unloadable = None
            ahead = Thread(target=_load_ahead, args=(app.state,), name="loading ahead", daemon=True)
            app.state.cell_limits = UploadLimits(settings.max_meshes_held, settings.max_meshes_covered)
            app.state.known_tasks = KnownTasks()
            app.state.meshes = MeshStore(database)
            app.state.scenes = SceneCollection(SceneStore(database), store, queue)
            app.state.scan_limits = UploadLimits(settings.max_scans_held, settings.max_perceived)
            app.state.mesh_limits = UploadLimits(settings.max_meshes_held, settings.max_meshes_covered)
            room = Room(settings.max_queued, settings.max_queued_of_owner, settings.max_delayed)
            writer = PlanWriter(store, queue, room)
            to_close.push_async_callback(run_in_threadpool, writer.close)
            app.state.plans = PlanCollection(store, queue, writer, room)
            rules = TargetRules(settings.webhook_hosts, settings.webhook_networks)
            app.state.webhooks = WebhookCollection(WebhookStore(database), queue, rules, settings.max_webhooks)
            studies = StudyStore(database, store, queue)
            app.state.studies = StudyCollection(studies, queue, app.state.plans, settings)
            app.state.feed, app.state.study_feed = PlanFeed(store, queue), PlanFeed(studies, studies, "point")
            most_followers = min(settings.max_followers, settings.max_connections // 2)
            app.state.followers = Followers(most_followers, settings.max_followers_of_owner)
            app.state.authenticator = await run_in_threadpool(_authenticator, settings, database, ask_for_keys)
            bench = app.state.workbench = Workbench(settings.work_memory_mb * 2**20)
            to_close.callback(bench.close)
            folders = settings.data_dir / "drawings", settings.data_dir / "watched"
            watchers = WatcherRoom(settings.max_watchers, settings.max_watchers_of_owner)
            servers = app.state.scene_servers = SceneServers(app.state.cells.with_deleted(), *folders, watchers, bench)
            app.state.recordings = Recordings(
                settings.data_dir / "recordings",
                servers.record,
                recording_software(),
                settings.recordings_mb * 2**20,
                settings.max_recordings_waiting,
            )
            command = SolverCommand.of(settings, settings.feasibility_command)
            ways = FeasibilityPool(command, settings.max_lifts_kept)
            to_close.push_async_callback(ways.close)
            app.state.other_ways = OtherWays(ways, TaskParts(app.state.meshes, kept_cells))
            worker = Worker(settings, database, queue, store, supervisor, solvers) if with_worker else None
            if worker is not None:
                to_close.push_async_callback(worker.stop)
            to_close.push_async_callback(app.state.scene_servers.close)
            to_close.push_async_callback(supervisor.stop)
            supervisor.repeat("feed", app.state.feed.look, POLL_SECONDS)
            supervisor.repeat("study feed", app.state.study_feed.look, POLL_SECONDS)
            if worker is not None:
                await worker.start()
            else:
                # A worker elsewhere clears its own machine only.
                clearing = partial(run_in_threadpool, kept_cells.clear_folder)
                supervisor.repeat("cells", clearing, DELETION_PAUSE_SECONDS)
            ahead.start()
            yield

    app = FastAPI(
        title="Liftwright",
        version=version("liftwright"),
        description=DESCRIPTION,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        generate_unique_id_function=lambda route: route.name,
    )
    app.state.settings = settings
    install_error_handlers(app, pages.problem_for_a_person)
    app.add_middleware(AccessControl, page=pages.problem_for_a_person)
    app.add_middleware(HeadAsGet)
    app.add_middleware(OneLength)
    app.add_middleware(RequestLog)
    for part in PARTS:
        app.include_router(part.router)
    install_openapi(app)
    return app


def _authenticator(settings: ServiceSettings, database: Database, ask_for_keys: bool | None) -> Authenticator:
    """Return the authenticator, which is open only where nobody but this machine's own users can come to it."""
    keys = KeyStore(database)
    if ask_for_keys is None:
        ask_for_keys = keys_needed(settings, keys)
    kind = Authenticator if ask_for_keys else OpenAccess
    limiter = RateLimiter(settings.requests_per_second, settings.request_burst)
    return kind(keys, SessionStore(database), AuditLog(database), limiter)


def _load_ahead(state: State) -> None:
    """Check a task of each kind, and load all cells, so that hardly a request waits for files or compiled kernels.

    What is shipped and cannot be loaded is told by `/readyz`: it is a fault of the installation, and of no task.
    """
    try:
        for name in REFERENCE_TASKS:
            sent = parse_json(resources.files("assets").joinpath("tasks", name).read_bytes())
            accept_task(sent, ShippedCells(), tools=state.tools)
        load_cells()
    except LiftwrightError as error:
        log.error("what is shipped cannot be loaded", error=str(error))
        state.unloadable = str(error)


def write_openapi(path: Path) -> None:
    """Write the description of the interface as it is checked in."""
    described = create_app(ServiceSettings(), with_worker=False).openapi()
    path.write_text(json.dumps(described, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    write_openapi(Path(sys.argv[1]))
