"""One random layout, planned and certified."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from planners.scene.suction_tool import TOOL_NAME
from tests.benchmarks.certified_plan import BROKEN, SOLVED, certified_plan
from tests.benchmarks.random_piles import Pile, strewn
from tests.benchmarks.tasks import task_body
from workers.solver.pipeline import Pipeline


@dataclass(frozen=True)
class PileAttempt:
    """What came of one layout. Seconds."""

    pile: str
    seed: int
    outcome: str
    """As in the plan document, or that its certificate failed, or that the planner broke."""
    reason: str = ""
    """Why it is not solved and certified."""
    planning: float = 0.0
    """Spec to document, wall clock."""
    planning_cpu: float = 0.0
    certificate: float = 0.0
    certificate_cpu: float = 0.0
    stages: dict[str, float] = field(default_factory=dict)
    """CPU time of each stage of planning."""
    order: list[str] = field(default_factory=list)
    """Objects as they were first moved."""
    handovers: int = 0
    put_aside: int = 0
    """How many objects were put aside before they were moved to their goals."""
    duration: float = 0.0
    """Of the motion."""
    hose_turns: float = 0.0
    """Most turns of the tool about its axis at any time, either way [1]."""

    @property
    def key(self) -> tuple[str, int]:
        """Pile and seed."""
        return self.pile, self.seed

    @property
    def solved(self) -> bool:
        """Whether it was planned and the plan passed its certificate."""
        return self.outcome == SOLVED

    def told(self) -> str:
        """Say in a line what came of it."""
        seconds = f"{self.planning:.2f} s, CPU {self.planning_cpu:.2f} s"
        return f"{self.pile}, seed {self.seed}: {self.outcome} in {seconds}. {self.reason}".strip()

    @classmethod
    def broken(cls, key: tuple[str, int], error: BaseException) -> Self:
        """Return the attempt of a layout at which the planner raised what it should not raise."""
        return cls(*key, BROKEN, f"{type(error).__name__}: {error}")


class PileWorker:
    """What one process needs for planning layouts."""

    def __init__(self, databases: Path) -> None:
        """Load cells and meshes.

        Args:
            databases: folder of a handover store.
        """
        self._pipeline = Pipeline.load(databases)

    def warm_up(self, pile: Pile) -> None:
        """Plan and certify the shipped task, so that all kernels are loaded."""
        self._solve(pile, 0, task_body(pile.task))

    def attempt(self, pile: Pile, seed: int) -> PileAttempt:
        """Plan and certify the layout of a seed.

        Raises:
            SceneError: the layout is refused.
        """
        return self._solve(pile, seed, strewn(pile, seed))

    def _solve(self, pile: Pile, seed: int, body: dict[str, Any]) -> PileAttempt:
        plan = certified_plan(self._pipeline, body)
        stages = {stage["name"]: stage["seconds"] for stage in plan.document["statistics"]["stages"]}
        figures = _figures(plan.document)
        return PileAttempt(pile.name, seed, plan.outcome, plan.reason, stages=stages, **plan.seconds, **figures)


def _figures(document: Mapping[str, Any]) -> dict[str, Any]:
    search, segments = document["statistics"]["search"], document["segments"]
    carried = [name for segment in segments for name in segment["body_poses"] if name != TOOL_NAME]
    return {
        "order": list(dict.fromkeys(carried)),
        "handovers": search["handovers"],
        "put_aside": search["put_aside"],
        "duration": segments[-1]["time"][-1] if segments else 0.0,
        "hose_turns": search["most_hose_turns"],
    }
