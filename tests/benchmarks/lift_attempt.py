"""One random lift, planned and certified; one that was not found is tried once more among many more holds and poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

from planners.progress import silent
from tests.benchmarks.certified_plan import BROKEN, SOLVED, certified_plan
from tests.benchmarks.random_lifts import drawn
from workers.solver.pipeline import Pipeline
from workers.solver.protocol import SolverRequest

NOT_FOUND, INFEASIBLE = "not_found", "infeasible"
DENSITIES = (3.3, 2.7, 2.2, 1.6)
"""Of contacts and of holds, for the second look: the first whose graph is not too large. None is one that the service
tries by itself, so that other poses and holds are looked at."""


@dataclass(frozen=True)
class LiftAttempt:
    """What came of one random lift. Seconds."""

    seed: int
    dense: bool
    """Whether this is the second look."""
    outcome: str
    """As in the plan document, or that its certificate failed, or that the planner broke."""
    summary: str = ""
    """Of the explanation."""
    reason: str = ""
    """Why it is not solved and certified, in full."""
    density: float = 1.0
    """At which it was searched; 0: even the least dense graph was too large."""
    planning: float = 0.0
    """Spec to document, wall clock."""
    planning_cpu: float = 0.0
    certificate: float = 0.0
    certificate_cpu: float = 0.0
    reserve: float | None = None
    """Share of all force limits that the plan keeps back [1], where its document says so."""
    length: int | None = None
    """Nodes of the sequence."""
    contact_changes: int | None = None
    remedies: int | None = None
    """Changes of the task that were told, each with a certified plan; None: it was not asked for any."""
    remedies_seconds: float = 0.0
    """What looking for them took, wall clock."""

    @classmethod
    def broken(cls, key: tuple[int, bool], error: BaseException) -> Self:
        """Return the attempt at which the planner raised what it should not raise."""
        return cls(*key, BROKEN, reason=f"{type(error).__name__}: {error}")

    @property
    def key(self) -> tuple[int, bool]:
        """Seed, and whether it is the second look."""
        return self.seed, self.dense

    @property
    def solved(self) -> bool:
        """Whether it was planned and the plan passed its certificate."""
        return self.outcome == SOLVED

    def told(self) -> str:
        """Say in a line what came of it."""
        density = f", ×{self.density:g}" if self.dense else ""
        return f"seed {self.seed}{density}: {self.outcome} in {self.planning:.2f} s. {self.summary}".strip()


def attempt(pipeline: Pipeline, seed: int) -> LiftAttempt:
    """Plan and certify the lift of a seed as a user would have it planned; where there is no plan, find remedies."""
    found = _attempt(pipeline, seed, None)
    if found.outcome not in (NOT_FOUND, INFEASIBLE):
        return found
    body = {**drawn(seed), "options": {"simulate": False}}
    plan = pipeline.solve(SolverRequest("benchmark", body), silent)
    count, seconds = len(plan.explanation.remedies or ()), dict(plan.statistics.times).get("remedies", 0.0)
    return replace(found, remedies=count, remedies_seconds=seconds)


def dense_attempt(pipeline: Pipeline, seed: int) -> LiftAttempt:
    """Look for a plan of the same lift among as many poses and holds as fit into memory."""
    for density in DENSITIES[:-1]:
        found = _attempt(pipeline, seed, density)
        if found.density > 0.0:
            return found
    return _attempt(pipeline, seed, DENSITIES[-1])


def _attempt(pipeline: Pipeline, seed: int, density: float | None) -> LiftAttempt:
    body = drawn(seed)
    if density is not None:
        body["options"] = {"contact_density": density, "hold_density": density}
    plan = certified_plan(pipeline, body)
    explanation, statistics = plan.document["explanation"], plan.document["statistics"]
    searched = 1.0 if density is None else 0.0 if _too_large(plan.document) else density
    reserve = statistics.get("reserve")
    return LiftAttempt(
        seed,
        density is not None,
        plan.outcome,
        explanation["summary"],
        plan.reason,
        searched,
        reserve=None if reserve is None else reserve["value"],
        length=statistics["search"].get("length"),
        contact_changes=statistics["search"].get("contact_changes"),
        **plan.seconds,
    )


def _too_large(document: Mapping[str, Any]) -> bool:
    """Whether nothing was searched, or less than was asked for: the graph did not fit into memory."""
    return document["outcome"] == NOT_FOUND and "fit into memory" in document["explanation"]["summary"]
