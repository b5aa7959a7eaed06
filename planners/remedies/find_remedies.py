"""Look for changes of a task with which there is a plan; each is planned and certified before it is told."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain

from planners.graph.rejections import CAPACITY
from planners.plan.loads import largest_load
from planners.plan.plan import Plan
from planners.plan.verdicts import Cause, PlanningOutcome, Remedy
from planners.progress import Progress
from planners.remedies.change import AnyTask, Effort, TaskChange, put, told_cup_place
from planners.remedies.kinds import KINDS

MOST_STEPS = 2400
"""Of all that is tried for one task: some 24 s on a common core."""
STEPS_OF_LESS_RESERVE = 2400
"""Besides, for the one change of which a plan is wanted that keeps less back."""
STEPS_OF_PAIRS = 600
"""Of what is tried besides, and of what is left of those, two changes at once, where no single one helps."""
STEPS_WITH_PHYSICS = 6000
"""Of what is tried for a plan that failed in physics: about a minute."""
STEPS_OF_SIMULATION = 400
"""What it takes to simulate a plan."""
STEPS_OF_A_PLAN = 1200
"""Of planning one changed task: what takes longer is given up."""
STEPS_OF_A_SCENE = 2
"""What it takes to build a changed task's scene, and to see that it cannot have a plan ..."""
STEPS_OF_A_CERTIFICATE = 40
"""... and to certify its plan, for each body that it moves."""
MOST_REMEDIES = 5
"""In all, ..."""
MOST_SIMULATED = 2
"""... of those that are simulated, too, which takes longer than planning, ..."""
MOST_OF_A_KIND = 3
"""... and of one kind."""
MOST_TRIES = 4
"""Changes of one kind that are planned, ..."""
MOST_IN_VAIN = 2
"""... and of those that are planned in vain where another kind helps."""
LESS_IS_DONE = ("object_aside",)
"""Kinds of changes with which less of the task is done: they keep nobody from looking for others."""
MOST_HALVINGS = 2
"""How often the way from what did not help to what did is halved, to tell less of a change that costs something ..."""
LESS = 0.05
"""... as long as that may save such a share of its size [1]."""
BETTER = 1.25
"""A larger change is told beside a smaller one of its way where so many times the reserve is kept back, or the largest
force is so many times less [1]."""


class PlanMemory:
    """Plans changed tasks, each once: what a search asks to find its way is told later at no cost."""

    def __init__(self, plan: Callable[[AnyTask], Plan | None], effort: Effort) -> None:
        """Take what plans a task and certifies the plan, and what may be tried."""
        self._plan, self._effort = plan, effort
        self._known: dict[str, Plan | None] = {}

    def __call__(self, changed: AnyTask) -> Plan | None:
        """Return the plan of a task; None where there is none that passes, or it is not known and no step is left."""
        key = changed.model_dump_json()
        if key not in self._known:
            if self._effort.ended:
                return None
            self._known[key] = self._plan(changed)
        return self._known[key]


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
        changes: of each kind, the smallest first, or the likeliest; None: some were asked in vain, and other kinds have
            their turn.
        attempt: plans a task and certifies the plan, and simulates it if it is to be; None where there is none that
            passes. Counts what it does.
        task: that has no plan, or one that fails in physics.
        effort: what may be tried.
        progress: told of it; may raise `PlanningCancelled`.
        most: so many are enough.

    Returns:
        What helps, the kinds in their order, and of each kind the smallest change first, as `worth_telling` leaves it.
    """
    searches = [_OfKind(each) for each in changes]
    open_kinds = searches
    while open_kinds and len(worth_telling(each.found for each in searches)) < most:
        each = open_kinds[0]
        others_help = any(other.helps for other in searches if other is not each)
        each.try_next(attempt, task, effort, progress, others_help=others_help)
        open_kinds = [*open_kinds[1:], *([] if each.ended else [each])]
    told = worth_telling(each.found for each in searches)[:most]
    # Only of what is told, in whose place the smaller change comes: it keeps nothing else from being told.
    for each in searches:
        told = [each.made_less(remedy, attempt, task, effort, progress) for remedy in told]
    return told


def worth_telling(kinds: Iterable[Sequence[tuple[TaskChange, Remedy]]]) -> list[Remedy]:
    """Return the remedies of each kind, the smallest first, without those that add nothing to another.

    Of the same way a larger change is told only if its plan is clearly better (`BETTER`); and none that does what
    another one does, and more.
    """
    told = list(chain.from_iterable(_clearly_better(found) for found in kinds))
    return [each for each in told if not any(_contains(each, other) for other in told)]


def _clearly_better(found: Iterable[tuple[TaskChange, Remedy]]) -> Iterator[Remedy]:
    """Yield the smallest of each way, and of the larger ones those whose plan is better than all that came before."""
    smaller: dict[str, list[Remedy]] = {}
    for change, remedy in sorted(found, key=lambda each: each[0].size):
        told = smaller.setdefault(change.way, []) if change.way else []
        if all(_is_better(remedy, other) for other in told):
            told.append(remedy)
            yield remedy


def _is_better(one: Remedy, other: Remedy) -> bool:
    """Whether a reader would choose the larger change `one` for what its plan keeps back, or for its forces."""
    keeps_more = one.reserve is not None and other.reserve is not None and one.reserve >= BETTER * other.reserve
    forces = one.largest_force, other.largest_force
    bears_less = forces[0] is not None and forces[1] is not None and BETTER * forces[0] <= forces[1]
    return keeps_more or bears_less


def _contains(one: Remedy, other: Remedy) -> bool:
    return len(one.patch) > len(other.patch) and all(step in one.patch for step in other.patch)


def why_none(tried: Iterable[str]) -> str:
    """Say what was tried in vain, for a task for which no change was found.

    Args:
        tried: kinds of changes.
    """
    words = [words for kind, words in KINDS.items() if kind in set(tried)]
    return f"Tried in vain: {', '.join(words)}." if words else "No change is known that would help."


def in_vain(causes: Iterable[Cause], remedies: Iterable[Remedy], tried: Iterable[str]) -> str:
    """Say that more force of the hands is not enough where a proof names what hands bear; else say nothing.

    Args:
        causes: of there being no plan.
        remedies: what helps.
        tried: kinds of changes.
    """
    kind = "hand_limits"
    is_named = any(cause.where == CAPACITY for cause in causes)
    if not is_named or kind not in tried or any(remedy.kind == kind for remedy in remedies):
        return ""
    return f"Tried alone and in vain: {KINDS[kind]}. "


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
        self._changes, self._tries, self._in_vain = changes, 0, 0
        self._closed: set[str] = set()
        """Ways of which a larger change added nothing."""
        self._in_vain_up_to: dict[str, float] = {}
        """By way, the size of the largest change that was planned in vain: smaller ones do less."""
        self.found: list[tuple[TaskChange, Remedy]] = []
        self.ended = False

    @property
    def helps(self) -> bool:
        """Whether it has found something with which all of the task is done."""
        return any(change.kind not in LESS_IS_DONE for change, _ in self.found)

    def try_next(
        self,
        attempt: Callable[[AnyTask], Plan | None],
        task: AnyTask,
        effort: Effort,
        progress: Progress,
        *,
        others_help: bool,
    ) -> None:
        """Plan the next change of the kind, if there is one and steps are left."""
        try:
            change = next(each for each in self._changes if each is None or not self._is_known(each))
        except StopIteration:
            self.ended = True
            return
        if change is None:
            # What was asked in vain is not asked on where something else helps.
            self.ended = others_help or effort.ended
            return
        changed, last = change.applied(task), effort.ended
        if changed is None:
            self.ended = True
            return
        effort.trying = change.kind
        progress(effort.report())
        plan = attempt(changed)
        if plan is not None:
            remedy = _remedy(change, plan)
            self.found.append((change, remedy))
            if remedy not in worth_telling([self.found]):
                self._closed.add(change.way)
        if plan is not None or not last:
            effort.tried.add(change.kind)
        if plan is None and change.way:
            self._in_vain_up_to[change.way] = max(change.size, self._in_vain_up_to.get(change.way, 0.0))
        self._tries += 1
        self._in_vain += plan is None
        enough = len(worth_telling([self.found])) >= MOST_OF_A_KIND or self._tries >= MOST_TRIES
        # Where no step is left, only what is known is told.
        self.ended = last or enough or (others_help and self._in_vain >= MOST_IN_VAIN)

    def made_less(
        self,
        remedy: Remedy,
        attempt: Callable[[AnyTask], Plan | None],
        task: AnyTask,
        effort: Effort,
        progress: Progress,
    ) -> Remedy:
        """Return a smaller change of the same way that helps, too, if there is one between it and what did not help.

        That is looked for where sizes are anything, of the smallest change of its way that this search has found.
        """
        least = next((change for change, each in self.found if each is remedy), None)
        if least is None:
            return remedy
        of_its_way = [change for change, _ in self.found if change.way == least.way]
        if any(other.size < least.size for other in of_its_way):
            return remedy
        known = max(self._in_vain_up_to.get(least.way, -math.inf), *(change.none for change in of_its_way))
        for _ in range(MOST_HALVINGS):
            if effort.ended or least.of_size is None or 0.5 * (least.size - known) < LESS * least.size:
                break
            between = least.of_size(0.5 * (known + least.size))
            changed = between.applied(task)
            if changed is None or not known < between.size < least.size:
                break
            effort.trying = between.kind
            progress(effort.report())
            plan = attempt(changed)
            if plan is None:
                known = between.size
            else:
                least, remedy = between, _remedy(between, plan)
        return remedy

    def _is_known(self, change: TaskChange) -> bool:
        """Whether planning a change would tell nothing new."""
        return change.way in self._closed or change.size < self._in_vain_up_to.get(change.way, -math.inf)


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
