"""Probes and metrics, for whoever watches the service."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest

from app.errors import NotReady
from app.metrics import ServiceMetrics, process_metrics
from app.resources.plan_collection import PlanCollection
from workers.engine.supervisor import Supervisor
from workers.stores.database import Database
from workers.stores.database_loss import DATABASE_GONE

router = APIRouter(tags=["operations"])


@router.get("/livez", summary="Is the process alive?")
async def livez() -> dict[str, str]:
    """Answer without looking at anything."""
    return {"status": "alive"}


@router.get("/readyz", summary="Can it work?")
def readyz(request: Request) -> dict[str, str]:
    """Answer while the database takes writes and what is done in the background gets on."""
    database: Database = request.app.state.database
    try:
        database.require_writable()
    except DATABASE_GONE as error:
        raise NotReady("the database cannot be reached, or takes no writes") from error
    supervisor: Supervisor = request.app.state.supervisor
    if stuck := supervisor.stuck:
        raise NotReady(f"what does not get on, as the log says: {', '.join(stuck)}")
    return {"status": "ready"}


@router.get("/metrics", summary="Prometheus metrics", response_class=Response)
def metrics(request: Request) -> Response:
    """Tell the queue's depth, what has become of jobs and how long their stages took, of all workers together."""
    plans: PlanCollection = request.app.state.plans
    registry = CollectorRegistry()
    depth = plans.queue.depth(request.app.state.settings.max_queued)
    registry.register(ServiceMetrics(depth, plans.store.outcome_counts(), plans.store.totals()))
    for collector in process_metrics():
        registry.register(collector)
    return Response(generate_latest(registry), media_type=CONTENT_TYPE_LATEST)
