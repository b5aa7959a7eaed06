"""What a service must know after what it was asked: plain values beside it, and laws of its lists told another way."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

MAX_QUEUED, MAX_QUEUED_OF_OWNER, MAX_DELAYED, MAX_WEBHOOKS, MAX_STUDIES = 7, 5, 2, 3, 3
"""So low that they are met."""
SCOPES = ("read", "write", "admin")
STATION = "station"
"""Name of every cell of one's own."""


@dataclass(eq=False)
class Key:
    """A key that was issued."""

    id: str
    text: str
    owner: str
    scope: str
    opens: bool = True
    """Whether it has neither expired nor been revoked."""

    def may(self, needed: str) -> bool:
        return SCOPES.index(self.scope) >= SCOPES.index(needed)

    def sees(self, owner: str) -> bool:
        return self.scope == "admin" or owner == self.owner


@dataclass(eq=False)
class Thing:
    """Something that was accepted."""

    id: str
    owner: str
    created_at: str = ""
    gone: bool = False
    """Whether it was deleted."""


@dataclass(eq=False)
class Plan(Thing):
    kind: str = "plate_lift"
    external_id: str | None = None
    work_master: str | None = None
    priority: int = 0
    start_time: str | None = None
    scene_id: str | None = None
    state: str = "queued"
    outcome: str | None = None
    document: bytes | None = None
    attempts: int = 0

    @property
    def done(self) -> bool:
        return self.state in ("succeeded", "failed", "cancelled")

    @property
    def waits(self) -> bool:
        """Whether a worker may begin it."""
        return self.state == "queued" and self.start_time is None


@dataclass(eq=False)
class Scene(Thing):
    body: Any = None
    """As it was first answered."""


@dataclass(eq=False)
class Webhook(Thing):
    url: str = ""
    plans: str = "all"
    secrets: set[str] = field(default_factory=set)
    """All that it ever had."""
    told_of: list[Plan] = field(default_factory=list)
    """Plans that it waits for the end of, oldest first."""


@dataclass(eq=False)
class Study(Thing):
    count: int = 0
    external_id: str | None = None
    state: str = "queued"
    points: set[int] = field(default_factory=set)
    """That are known."""
    plans: dict[int, Plan] = field(default_factory=dict)
    """That were made of points."""


@dataclass(eq=False)
class Cell(Thing):
    content: int = 0
    version: int = 0
    posted: int = 0
    """The greater, the later it was posted last."""


T = TypeVar("T", bound=Thing)


@dataclass
class World:
    """Everything that was accepted, in the order in which it was; what is gone, too."""

    keys: list[Key] = field(default_factory=list)
    plans: list[Plan] = field(default_factory=list)
    scenes: list[Scene] = field(default_factory=list)
    webhooks: list[Webhook] = field(default_factory=list)
    studies: list[Study] = field(default_factory=list)
    cells: list[Cell] = field(default_factory=list)
    meshes: dict[str, Any] = field(default_factory=dict)
    """By id, as they were first answered."""
    plan_of_key: dict[tuple[str, str], tuple[Plan, Any]] = field(default_factory=dict)
    """By owner and idempotency key, with the body that came first."""
    study_of_key: dict[tuple[str, str], tuple[Study, Any]] = field(default_factory=dict)
    audit: list[dict[str, Any]] = field(default_factory=list)
    """Oldest first."""
    made: Counter[str] = field(default_factory=Counter)
    """Documents ever made, by outcome, and failed jobs."""

    def told(self, plan: Plan) -> dict[str, Any]:
        """Return what must be said of a plan."""
        orders = {"queued": "AllowedToStart", "running": "Running", "succeeded": "Ended"}
        return {
            "id": plan.id,
            "kind": plan.kind,
            "external_id": plan.external_id,
            "work_master": plan.work_master,
            "priority": plan.priority,
            "start_time": plan.start_time,
            "state": plan.state,
            "done": plan.done,
            "job_order_state": orders.get(plan.state, "Aborted"),
            "outcome": plan.outcome,
            "verdict": plan.outcome,
            "created_at": plan.created_at,
            "attempts": plan.attempts,
            "cancelled_by": "request" if plan.state == "cancelled" else None,
            "queue_position": self.place(plan),
        }

    def place(self, plan: Plan) -> int | None:
        """Return the place in the queue of a plan by playing it out: the owner of whom the fewest run is served next.

        No owner's turn was before another's here: no job has a time at which it was begun.
        """
        if plan.gone or not plan.waits:
            return None
        running = Counter(each.owner for each in self.plans if each.state == "running" and not each.gone)
        waiting = [each for each in self.plans if each.waits and not each.gone]
        place = 0
        while True:
            place += 1
            first = {}
            for each in sorted(waiting, key=lambda each: (-each.priority, _moment(each))):
                first.setdefault(each.owner, each)
            served = min(first.values(), key=lambda each: (running[each.owner], _moment(each)))
            if served is plan:
                return place
            waiting.remove(served)
            running[served.owner] += 1

    def no_room(self, owner: str, *, delayed: bool) -> bool:
        """Tell whether another job of an owner must be refused."""
        due = [each.owner for each in self.plans if not each.gone and (each.waits or each.state == "running")]
        later = [each for each in self.plans if each.state == "queued" and each.start_time and each.owner == owner]
        full = len(due) >= MAX_QUEUED or due.count(owner) >= MAX_QUEUED_OF_OWNER
        return full or (delayed and sum(not each.gone for each in later) >= MAX_DELAYED)

    def accept(self, plan: Plan, webhook_id: str | None = None) -> None:
        """Note that a plan was accepted, of whose end webhooks are told."""
        self.plans.append(plan)
        for webhook in self.webhooks:
            if (
                webhook.owner == plan.owner
                and not webhook.gone
                and (webhook.plans == "all" or webhook.id == webhook_id)
            ):
                webhook.told_of.append(plan)

    def station_of(self, owner: str) -> Cell | None:
        """Return which cell an owner's tasks mean by the name of all of them."""
        mine = [cell for cell in self.cells if cell.owner == owner and not cell.gone]
        return max(mine, key=lambda cell: cell.posted, default=None)


def listed(things: Iterable[T], key: Key) -> list[T]:
    """Return what a list shows to the holder of a key: what is there and theirs, newest first."""
    seen = [thing for thing in things if not thing.gone and key.sees(thing.owner)]
    return sorted(seen, key=lambda thing: (thing.created_at, thing.id), reverse=True)


def known_by(body: dict[str, Any], names: Iterable[str]) -> dict[str, Any]:
    """Return some members of an answer."""
    return {name: body[name] for name in names}


def pages(things: Sequence[Any], size: int) -> list[Sequence[Any]]:
    """Return the pages of a list; an empty one has one."""
    return [things[begin : begin + size] for begin in range(0, max(1, len(things)), size)]


def _moment(plan: Plan) -> tuple[str, str]:
    """Return when a plan was accepted as the engine has it, which knows milliseconds; then the id says."""
    return plan.created_at[: len("2026-01-01T00:00:00.000")], plan.id
