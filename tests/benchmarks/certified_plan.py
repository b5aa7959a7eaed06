"""One task, planned and certified as the service does, and the seconds that either took."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from time import process_time
from typing import Any

from planners.plan.simulation import PhysicsFailure, failure_of
from planners.planning import CertificateFailed
from planners.progress import silent
from tests.benchmarks.bench_tasks import TimedCertifier, clocks
from workers.solver.pipeline import Pipeline
from workers.solver.protocol import SolverRequest

SOLVED, UNCERTIFIED, BROKEN = "solved", "certificate failed", "broken"


@dataclass(frozen=True, eq=False)
class CertifiedPlan:
    """What came of one task. Seconds."""

    document: Mapping[str, Any]
    outcome: str
    """As in the plan document, or that its certificate failed."""
    reason: str
    """Why it is not solved and certified."""
    failure: PhysicsFailure | None
    """In physics; None where it did not fail, or was not tried."""
    seconds: Mapping[str, float]
    """`planning`, spec to document, and `certificate`, wall clock; the same with `_cpu`."""


def certified_plan(pipeline: Pipeline, body: Mapping[str, Any], *, simulate: bool = False) -> CertifiedPlan:
    """Plan and certify a task, and look for no remedies; the plan is simulated only where that is asked for.

    Raises:
        SceneError: the task is refused.
    """
    certifier = TimedCertifier(pipeline.solver.certify)
    task = {**body, "options": {**body.get("options", {}), "simulate": simulate, "remedies": False}}
    pipeline = replace(pipeline, solver=replace(pipeline.solver, certify=certifier, clock=process_time))
    begun, reason, outcome = clocks(), "", ""
    try:
        plan = pipeline.solve(SolverRequest("benchmark", task), silent)
    except CertificateFailed as failure:
        plan, outcome, reason = failure.plan, UNCERTIFIED, str(failure)
    document = plan.document()
    return CertifiedPlan(
        document,
        outcome or document["outcome"],
        reason or _cause(document),
        failure_of(plan.simulation),
        {
            "planning": certifier.begun[0] - begun[0],
            "planning_cpu": certifier.begun[1] - begun[1],
            "certificate": certifier.ended[0] - certifier.begun[0],
            "certificate_cpu": certifier.ended[1] - certifier.begun[1],
        },
    )


def _cause(document: Mapping[str, Any]) -> str:
    if document["outcome"] == SOLVED:
        return ""
    explanation = document["explanation"]
    return " ".join([explanation["summary"], "; ".join(cause["reason"] for cause in explanation["causes"])]).strip()
