"""Puts the service together."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib import resources
from importlib.metadata import version

from anyio import CapacityLimiter
from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool

from app.errors import install_error_handlers
from app.intake import accept_task
from app.openapi import install_openapi
from app.plan_desk import PlanDesk
from app.routes import capabilities, meshes, plans, probes, scenes, viewer
from app.settings import ServiceSettings
from app.viewer.theatre import Theatre
from planners.scene.cell import Cell, known_cells, load_cell
from workers.database import open_database
from workers.job_queue import JobQueue
from workers.mesh_store import MeshStore
from workers.plan_store import PlanStore
from workers.scene_store import SceneStore
from workers.worker import Worker

REFERENCE_TASK = "ab1.json"
DESCRIPTION = (
    "Plans how a dual-arm robot lifts heavy plates together with a vacuum lifter. Post a task, follow its job, "
    "fetch a certified plan document. SI units; world frame on the floor under the robot."
)


def create_app(settings: ServiceSettings, *, with_worker: bool) -> FastAPI:
    """Return the service; with a worker in the same process, or for workers elsewhere on the same database."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        database = await run_in_threadpool(open_database, settings)
        queue = JobQueue(database)
        store = PlanStore(database)
        app.state.cells = await run_in_threadpool(_warm_cells)
        app.state.meshes = MeshStore(database)
        app.state.scenes = SceneStore(database)
        app.state.perceivers = CapacityLimiter(settings.max_perceived)
        app.state.desk = PlanDesk(store, queue, settings.max_queued)
        app.state.theatre = Theatre(app.state.desk, app.state.cells, settings.data_dir / "drawings")
        worker = Worker(settings, database, queue, store) if with_worker else None
        try:
            if worker is not None:
                await worker.start()
            yield
        finally:
            await app.state.theatre.close()
            if worker is not None:
                await worker.stop()
            queue.close()
            database.close()

    app = FastAPI(
        title="Liftwright",
        version=version("liftwright"),
        description=DESCRIPTION,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
    )
    app.state.settings = settings
    install_error_handlers(app)
    for router in (plans.router, scenes.router, meshes.router, viewer.router, capabilities.router, probes.router):
        app.include_router(router)
    install_openapi(app)
    return app


def _warm_cells() -> dict[str, Cell]:
    """Load the cells, and once check a task, so that no request waits for files or compiled kernels."""
    cells = {name: load_cell(name) for name in known_cells()}
    reference = resources.files("assets").joinpath("tasks", REFERENCE_TASK)
    accept_task(reference.read_bytes(), cells)
    return cells
