"""Look for changes of a task with which there is a plan; each is planned and certified before it is told."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from planners.plan.loads import largest_load
from planners.plan.plan import Plan
from planners.plan.verdicts import PlanningOutcome, Remedy
from planners.progress import Progress, Report
from planners.remedies.change import KINDS, AnyTask, Effort, TaskChange, put, told_cup_place

MOST_STEPS = 100
"""Of all that is tried for one task: some 20 s on a common core."""
STEPS_WITH_PHYSICS = 120
"""Of what is tried for a plan that failed in physics: about a minute."""
STEPS_OF_SIMULATION = 8
"""What it takes to simulate a plan."""
STEPS_OF_PAIRS = 36
"""Of what is tried besides, two changes at once, where no single one helps."""
MOST_REMEDIES = 5
"""In all, ..."""
MOST_SIMULATED = 2
"""... of those that are simulated, too, which takes longer than planning, ..."""
MOST_OF_A_KIND = 3
"""... and of one kind."""
MOST_TRIES = 4
"""Changes of one kind that are planned."""


def find_remedies(
    changes: Iterable[Iterator[TaskChange | None]],
    attempt: Callable[[AnyTask], Plan | None],
    task: AnyTask,
    effort: Effort,
    progress: Progress,
    most: int = MOST_REMEDIES,
) -> list[Remedy]:
    """Plan changed tasks, one of each kind in turn, until enough was found or so much was tried.

    Args:
        changes: of each kind, the smallest first; None: other kinds have their turn.
        attempt: plans a task and certifies the plan, and simulates it if it is to be; None where there is none that
            passes.
        task: that has no plan, or one that fails in physics.
        effort: what may be tried.
        progress: told of it; may raise `PlanningCancelled`.
        most: so many are enough.

    Returns:
        What helps, the kinds in their order, and of each kind the smallest change first.
    """
    searches = [_OfKind(each) for each in changes]
    while open_kinds := [each for each in searches if not each.ended]:
        for each in open_kinds:
            progress(Report("remedies", effort.spent, effort.steps))
            each.try_next(attempt, task, effort)
            found = [remedy for each in searches for remedy in each.found]
            if len(found) == most:
                return found
    return [remedy for each in searches for remedy in each.found]


def why_none(tried: Iterable[str]) -> str:
    """Say what was tried in vain, for a task for which no change was found.

    Args:
        tried: kinds of changes.
    """
    words = [words for kind, words in KINDS.items() if kind in set(tried)]
    return f"Tried in vain: {', '.join(words)}." if words else "No change is known that would help."


def with_cup_at(place: tuple[float, float], remedy: Remedy) -> Remedy:
    """Return a remedy that states the cup's place [m, plate axes], too, for a task that leaves it open."""
    if any(step.path == "/cup/position" for step in remedy.patch):
        return remedy
    patch = [put("/cup/position", [*place]), *remedy.patch]
    sentence = f"{remedy.sentence} The cup stays at {told_cup_place(place)}."
    return remedy.model_copy(update={"patch": patch, "sentence": sentence})


class _OfKind:
    """The search for remedies of one kind."""

    def __init__(self, changes: Iterator[TaskChange | None]) -> None:
        self._changes, self._tries = changes, 0
        self.found: list[Remedy] = []
        self.ended = False

    def try_next(self, attempt: Callable[[AnyTask], Plan | None], task: AnyTask, effort: Effort) -> None:
        """Plan the next change of the kind, if there is one and steps are left."""
        try:
            change = next(self._changes)
        except StopIteration:
            self.ended = True
            return
        if change is None:
            return
        changed = change.applied(task)
        if changed is None or not effort.take("plan"):
            self.ended = True
            return
        self._tries += 1
        effort.tried.add(change.kind)
        plan = attempt(changed)
        if plan is not None:
            self.found.append(_remedy(change, plan))
        self.ended = len(self.found) >= MOST_OF_A_KIND or self._tries >= MOST_TRIES


def _remedy(change: TaskChange, plan: Plan) -> Remedy:
    assert plan.certificate is not None
    reserve = plan.statistics.reserve
    return Remedy(
        kind=change.kind,
        sentence=change.sentence,
        patch=list(change.patch),
        outcome=PlanningOutcome(plan.outcome),
        certified=plan.certificate.passed,
        reserve=None if reserve is None else reserve.value,
        largest_force=largest_load(plan)[0] or None,
        simulated=plan.simulation is not None,
    )
