"""Planning of the shipped tasks in a warm process: spec to plan, and the certificate apart."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter, process_time
from typing import Any

from planners.certify import Certificate
from planners.contract.task_spec import write_task
from planners.planning import CertificateFailed
from planners.progress import silent
from tests.benchmarks.tasks import SOLVABLE, TOO_HEAVY, Note, median_of, task_body
from workers.solver.pipeline import Pipeline, reference_task
from workers.solver.protocol import SolverRequest


@dataclass(frozen=True)
class TaskFigures:
    """One task. Medians over the runs; seconds."""

    name: str
    outcome: str
    summary: str
    planning: float
    """Spec to plan."""
    planning_cpu: float
    slowest_planning: float
    """Of all runs."""
    stages: dict[str, float]
    certificate: float
    certificate_cpu: float
    failed_checks: tuple[str, ...]
    graph: dict[str, Any]
    search: dict[str, Any]

    @property
    def total(self) -> float:
        """Planning and certificate."""
        return self.planning + self.certificate


@dataclass
class TimedCertifier:
    """Stands before the certifier of a pipeline: where planning ends and certifying begins."""

    certify: Callable[..., Certificate | None]
    document: dict[str, Any] | None = None
    certificate: Certificate | None = None
    begun: tuple[float, float] = (0.0, 0.0)
    """Wall clock and CPU [s]."""
    ended: tuple[float, float] = (0.0, 0.0)

    def __call__(self, document: bytes, *known: Any) -> Certificate | None:
        self.begun = clocks()
        self.certificate = self.certify(document, *known)
        self.ended = clocks()
        self.document = json.loads(document)
        return self.certificate


def measure(
    pipeline: Pipeline, note: Note, names: Sequence[str] = (*SOLVABLE, *TOO_HEAVY), runs: int = 5
) -> list[TaskFigures]:
    """Plan and certify each task `runs` times, after one run that loads the compiled kernels."""
    note("warming up")
    _run(pipeline, write_task(reference_task()))
    return [_task(pipeline, name, note, runs) for name in names]


def measure_body(pipeline: Pipeline, body: dict[str, Any]) -> dict[str, Any]:
    """Plan one task once, after one run that loads the compiled kernels; return seconds, outcome and sizes."""
    _run(pipeline, write_task(reference_task()))
    certifier, seconds = _run(pipeline, body)
    document = certifier.document
    sizes = {name: document["statistics"]["graph"].get(name, 0) for name in ("poses", "nodes", "edges")}
    return {**seconds, "outcome": document["outcome"], **sizes}


def _task(pipeline: Pipeline, name: str, note: Note, runs: int) -> TaskFigures:
    note(f"planning {name}, {runs} times")
    certifiers, seconds = zip(*(_run(pipeline, task_body(name)) for _ in range(runs)), strict=True)
    figures = median_of(list(seconds))
    document, certificate = certifiers[0].document, certifiers[0].certificate
    assert certificate is not None, f"{name} was not found"
    return TaskFigures(
        name=name,
        outcome=document["outcome"],
        summary=document["explanation"]["summary"],
        slowest_planning=max(row["planning"] for row in seconds),
        stages=median_of([_stages(each.document, row) for each, row in zip(certifiers, seconds, strict=True)]),
        failed_checks=tuple(check.name for check in certificate.failures),
        graph=document["statistics"]["graph"],
        search=document["statistics"]["search"],
        **figures,
    )


def _run(pipeline: Pipeline, body: dict[str, Any]) -> tuple[TimedCertifier, dict[str, float]]:
    """Solve a task once, up to its certificate; a plan that fails it is timed all the same."""
    certifier = TimedCertifier(pipeline.solver.certify)
    # Plans of remedies are certified as well, and would be taken for the task's own.
    body = {**body, "options": {**body.get("options", {}), "simulate": False, "remedies": False}}
    begun = clocks()
    try:
        timed = replace(pipeline, solver=replace(pipeline.solver, certify=certifier))
        timed.solve(SolverRequest("benchmark", body), silent)
    except CertificateFailed:
        assert certifier.certificate is not None
    return certifier, {
        "planning": certifier.begun[0] - begun[0],
        "planning_cpu": certifier.begun[1] - begun[1],
        "certificate": certifier.ended[0] - certifier.begun[0],
        "certificate_cpu": certifier.ended[1] - certifier.begun[1],
    }


def _stages(document: dict[str, Any], seconds: dict[str, float]) -> dict[str, float]:
    """Return the planner's stages; what they leave is reading the task, placing the scene, writing the document."""
    stages = {stage["name"]: stage["seconds"] for stage in document["statistics"]["stages"] if stage["name"] != "scene"}
    stages = {name: spent for name, spent in stages.items() if name != "certify"}
    return {"scene and document": seconds["planning"] - sum(stages.values()), **stages}


def clocks() -> tuple[float, float]:
    return perf_counter(), process_time()
