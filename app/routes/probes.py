"""Probes and metrics, for whoever watches the service."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Gauge, generate_latest
from sqlalchemy.exc import SQLAlchemyError

from app.errors import NotReady
from app.plan_desk import PlanDesk
from workers.job_state import JobState

router = APIRouter(tags=["operations"])


@router.get("/livez", summary="Is the process alive?")
async def livez() -> dict[str, str]:
    """Answer without looking at anything."""
    return {"status": "alive"}


@router.get("/readyz", summary="Can it work?")
def readyz(request: Request) -> dict[str, str]:
    """Answer once the database can be reached."""
    desk: PlanDesk = request.app.state.desk
    try:
        desk.store.check()
    except SQLAlchemyError as error:
        raise NotReady("the database cannot be reached") from error
    return {"status": "ready"}


@router.get("/metrics", summary="Prometheus metrics", response_class=Response)
def metrics(request: Request) -> Response:
    """Count unfinished jobs by state, and documents by outcome."""
    desk: PlanDesk = request.app.state.desk
    registry = CollectorRegistry()
    jobs = Gauge("liftwright_jobs", "Unfinished jobs", ["state"], registry=registry)
    states = desk.queue.unfinished(request.app.state.settings.max_queued)
    for state in (JobState.QUEUED, JobState.RUNNING):
        jobs.labels(state.value).set(states.count(state))
    documents = Gauge("liftwright_documents", "Stored plan documents", ["outcome"], registry=registry)
    for outcome, count in desk.store.outcome_counts().items():
        documents.labels(outcome).set(count)
    return Response(generate_latest(registry), media_type=CONTENT_TYPE_LATEST)
