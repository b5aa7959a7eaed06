"""Probes and metrics, for whoever watches the service."""

from __future__ import annotations

import asyncio

import structlog
from fastapi import APIRouter, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest

from app.errors import NotReady
from app.metrics import ServiceMetrics, process_metrics
from app.resources.plan_collection import PlanCollection
from workers.engine.deadline import PatientQuestion
from workers.engine.supervisor import Supervisor
from workers.stores.database_loss import DATABASE_GONE, said_by
from workers.stores.job_queue import STUDY_QUEUE

PROBE_SECONDS = 2.0
"""So long a probe waits for the database [s]; who watches containers gives up after three."""
router = APIRouter(tags=["operations"])
log = structlog.get_logger(__name__)


@router.get("/livez", summary="Is the process alive?")
async def livez() -> dict[str, str]:
    """Answer without looking at anything."""
    return {"status": "alive"}


@router.get("/readyz", summary="Can it work?")
async def readyz(request: Request) -> dict[str, str]:
    """Answer while the database takes writes and what is done in the background gets on.

    No thread of those that answer requests is waited for: all of them may wait for the database.
    """
    writable: PatientQuestion[None] = request.app.state.writable
    try:
        async with asyncio.timeout(PROBE_SECONDS):
            await asyncio.shield(asyncio.wrap_future(writable.ask()))
    except TimeoutError as error:
        raise NotReady(f"the database has not answered within {PROBE_SECONDS:g} s") from error
    except DATABASE_GONE as error:
        log.warning("database cannot be used", error=said_by(error))
        raise NotReady("the database cannot be reached, or takes no writes; the log says why") from error
    if request.app.state.unloadable is not None:
        raise NotReady("a shipped cell cannot be loaded; the log says why")
    supervisor: Supervisor = request.app.state.supervisor
    if stuck := supervisor.stuck:
        raise NotReady(f"what does not get on, as the log says: {', '.join(stuck)}")
    return {"status": "ready"}


@router.get("/metrics", summary="Prometheus metrics", response_class=Response)
def metrics(request: Request) -> Response:
    """Tell the queues' depths, what has become of jobs and how long their stages took, of all workers together."""
    plans: PlanCollection = request.app.state.plans
    registry = CollectorRegistry()
    most = request.app.state.settings.max_queued
    jobs, parts = plans.queue.depth(most), plans.queue.depth(most, STUDY_QUEUE)
    registry.register(ServiceMetrics(jobs, parts, plans.store.outcome_counts(), plans.store.totals()))
    for collector in process_metrics():
        registry.register(collector)
    return Response(generate_latest(registry), media_type=CONTENT_TYPE_LATEST)
