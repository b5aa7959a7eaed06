"""Webhooks, and what was sent to them."""

from __future__ import annotations

import base64
import secrets
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Literal

import sqlalchemy as sa

from workers.stores.database import Database
from workers.stores.jobs import QUEUED, RUNNING, workflow_table
from workers.stores.tables import DELIVERIES, DELIVERY_ATTEMPTS, WEBHOOKS, Position, insert_rows, newest_first, now_us

SECRET_BYTES = 32
SECRET_PREFIX = "whsec_"
OVERLAP_US = 24 * 3600 * 1_000_000
"""So long messages are signed with the secret before, too [µs]."""

WantedPlans = Literal["all", "named"]


@dataclass(frozen=True)
class Webhook:
    """An address that wants to know when jobs end. Times are microseconds since 1970, UTC."""

    id: str
    created_us: int
    owner: str | None
    url: str
    plans: WantedPlans
    """Of which plans: all of its owner, or those that name it."""
    secret: str
    previous_secret: str | None
    previous_until_us: int | None
    disabled_us: int | None
    """When it has answered that it is gone for good (410)."""
    certified: bool
    """Whether it is told, too, when a plan is certified, before that is simulated."""

    def secrets_at(self, time_us: int) -> list[str]:
        """Return the secrets to sign with, the newest first."""
        if self.previous_secret is None or time_us >= (self.previous_until_us or 0):
            return [self.secret]
        return [self.secret, self.previous_secret]


class DeliveryState(Enum):
    """Where a message stands."""

    WAITING = "waiting"
    """For the job to end."""
    PENDING = "pending"
    """To be taken."""
    DELIVERED = "delivered"
    FAILED = "failed"


@dataclass(frozen=True)
class Attempt:
    """One try to deliver."""

    number: int
    at_us: int
    status: int | None
    failure: str | None


@dataclass(frozen=True)
class Delivery:
    """One message to one webhook about one plan."""

    id: str
    created_us: int
    webhook_id: str
    plan_id: str
    state: DeliveryState
    body: str | None
    """Once the job has ended."""


class WebhookStore:
    """Reads and writes webhooks and deliveries. Every method is one transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._jobs = workflow_table(database.engine.dialect.name)

    def add(self, owner: str | None, url: str, plans: WantedPlans, *, certified: bool = False) -> Webhook:
        """Register a webhook, with a new secret."""
        webhook = Webhook(uuid.uuid4().hex, now_us(), owner, url, plans, make_secret(), None, None, None, certified)
        self._database.write(sa.insert(WEBHOOKS).values(vars(webhook)))
        return webhook

    def count(self, owner: str | None) -> int:
        """Return how many webhooks an owner has."""
        query = sa.select(sa.func.count()).select_from(WEBHOOKS).where(WEBHOOKS.c.owner.is_not_distinct_from(owner))
        return self._database.scalar(query) or 0

    def get(self, webhook_id: str) -> Webhook | None:
        """Return one webhook."""
        found = self._database.mappings(sa.select(WEBHOOKS).where(WEBHOOKS.c.id == webhook_id))
        return Webhook(**found[0]) if found else None

    def newest(self, most: int, before: Position | None, owner: str | None, *, all_owners: bool) -> list[Webhook]:
        """Return at most `most` webhooks, newest first, from behind the one at `before`."""
        query = newest_first(sa.select(WEBHOOKS), WEBHOOKS, most, before)
        if not all_owners:
            query = query.where(WEBHOOKS.c.owner.is_not_distinct_from(owner))
        return [Webhook(**row) for row in self._database.mappings(query)]

    def rotate(self, webhook_id: str) -> None:
        """Give a webhook a new secret; messages are signed with the old one as well for a day."""
        new = {
            "secret": make_secret(),
            "previous_secret": WEBHOOKS.c.secret,
            "previous_until_us": now_us() + OVERLAP_US,
        }
        self._database.write(sa.update(WEBHOOKS).where(WEBHOOKS.c.id == webhook_id).values(new))

    def delete(self, webhook_id: str) -> None:
        """Remove a webhook with its log; what was not delivered never will be."""
        own = sa.select(DELIVERIES.c.id).where(DELIVERIES.c.webhook_id == webhook_id)
        with self._database.engine.begin() as transaction:
            transaction.execute(sa.delete(DELIVERY_ATTEMPTS).where(DELIVERY_ATTEMPTS.c.delivery_id.in_(own)))
            transaction.execute(sa.delete(DELIVERIES).where(DELIVERIES.c.webhook_id == webhook_id))
            transaction.execute(sa.delete(WEBHOOKS).where(WEBHOOKS.c.id == webhook_id))

    def deliveries(self, webhook_id: str, most: int, before: Position | None) -> list[Delivery]:
        """Return at most `most` messages to a webhook, newest first, from behind the one at `before`."""
        query = newest_first(sa.select(DELIVERIES), DELIVERIES, most, before)
        query = query.where(DELIVERIES.c.webhook_id == webhook_id)
        return [_delivery(row) for row in self._database.mappings(query)]

    def attempts(self, delivery_ids: Sequence[str]) -> dict[str, list[Attempt]]:
        """Return the tries of some deliveries, oldest first."""
        query = (
            sa.select(DELIVERY_ATTEMPTS)
            .where(DELIVERY_ATTEMPTS.c.delivery_id.in_(delivery_ids))
            .order_by(DELIVERY_ATTEMPTS.c.number)
        )
        found: dict[str, list[Attempt]] = {delivery_id: [] for delivery_id in delivery_ids}
        for row in self._database.rows(query):
            found[row.delivery_id].append(Attempt(row.number, row.at_us, row.status, row.failure))
        return found

    def due(self, most: int) -> list[Delivery]:
        """Return at most `most` of the messages that wait for jobs which have ended, oldest first."""
        query = (
            sa.select(DELIVERIES)
            .join(self._jobs, self._jobs.c.workflow_uuid == DELIVERIES.c.plan_id)
            .where(DELIVERIES.c.state == DeliveryState.WAITING.value, self._jobs.c.status.not_in((*QUEUED, RUNNING)))
            .order_by(DELIVERIES.c.created_us, DELIVERIES.c.id)
            .limit(most)
        )
        return [_delivery(row) for row in self._database.mappings(query)]

    def delivery(self, delivery_id: str) -> Delivery | None:
        """Return one message."""
        found = self._database.mappings(sa.select(DELIVERIES).where(DELIVERIES.c.id == delivery_id))
        return _delivery(found[0]) if found else None

    def begin(self, delivery: Delivery, body: str, enqueue: Callable[[sa.Connection], None]) -> None:
        """Have a message delivered; nothing happens if somebody else has begun that already."""
        with self._database.engine.begin() as transaction:
            waits = sa.and_(DELIVERIES.c.id == delivery.id, DELIVERIES.c.state == DeliveryState.WAITING.value)
            pending = {"state": DeliveryState.PENDING.value, "body": body}
            if transaction.execute(sa.update(DELIVERIES).where(waits).values(pending)).rowcount == 1:
                enqueue(transaction)

    def note(
        self,
        delivery: Delivery,
        attempt: Attempt,
        state: DeliveryState,
        enqueue: Callable[[sa.Connection], None] | None = None,
    ) -> None:
        """Keep how a try went and where the message stands now, and have the next one made, all or nothing."""
        same = sa.and_(DELIVERY_ATTEMPTS.c.delivery_id == delivery.id, DELIVERY_ATTEMPTS.c.number == attempt.number)
        with self._database.engine.begin() as transaction:
            stands = sa.update(DELIVERIES).where(DELIVERIES.c.id == delivery.id).values(state=state.value)
            if transaction.execute(stands).rowcount == 0:
                return
            # There is one already if the worker died behind the last one's end.
            transaction.execute(sa.delete(DELIVERY_ATTEMPTS).where(same))
            transaction.execute(sa.insert(DELIVERY_ATTEMPTS).values(delivery_id=delivery.id, **vars(attempt)))
            if enqueue is not None:
                enqueue(transaction)

    def disable(self, webhook_id: str) -> None:
        """Send nothing more to a webhook."""
        self._database.write(sa.update(WEBHOOKS).where(WEBHOOKS.c.id == webhook_id).values(disabled_us=now_us()))


def expect_deliveries(transaction: sa.Connection, plans: Sequence[tuple[str, str | None, str | None]]) -> None:
    """Have webhooks told when the jobs of plans end: those of a plan's owner that want to know, and the one it names.

    Args:
        transaction: with which they are expected.
        plans: id, owner and the id of the named webhook of each.
    """
    owners = {owner for _, owner, _ in plans}
    owned = sa.or_(WEBHOOKS.c.owner.in_(owners - {None}), *([WEBHOOKS.c.owner.is_(None)] if None in owners else []))
    query = sa.select(WEBHOOKS.c.id, WEBHOOKS.c.owner, WEBHOOKS.c.plans).where(owned, WEBHOOKS.c.disabled_us.is_(None))
    webhooks = transaction.execute(query).all()
    rows = [
        {
            "id": uuid.uuid4().hex,
            "created_us": now_us(),
            "webhook_id": webhook.id,
            "plan_id": plan_id,
            "state": DeliveryState.WAITING.value,
        }
        for plan_id, owner, named in plans
        for webhook in webhooks
        if webhook.owner == owner and (webhook.plans == "all" or webhook.id == named)
    ]
    if rows:
        insert_rows(transaction, DELIVERIES, rows)


def tell_certified(
    plan_id: str, body: str, enqueue: Callable[[sa.Connection, str], None], transaction: sa.Connection
) -> None:
    """Have a message about a certified plan delivered to those who wait for its end and want to know of that, too.

    Args:
        plan_id: of which plan.
        body: of the message.
        enqueue: has a message, by its id, be delivered if a transaction commits.
        transaction: with which all of it happens.
    """
    query = (
        sa.select(WEBHOOKS.c.id)
        .join(DELIVERIES, DELIVERIES.c.webhook_id == WEBHOOKS.c.id)
        .where(DELIVERIES.c.plan_id == plan_id, DELIVERIES.c.state == DeliveryState.WAITING.value)
        .where(WEBHOOKS.c.certified, WEBHOOKS.c.disabled_us.is_(None))
    )
    for webhook_id in transaction.scalars(query).all():
        row = {
            "id": uuid.uuid4().hex,
            "created_us": now_us(),
            "webhook_id": webhook_id,
            "plan_id": plan_id,
            "state": DeliveryState.PENDING.value,
            "body": body,
        }
        transaction.execute(sa.insert(DELIVERIES).values(row))
        enqueue(transaction, row["id"])


def forget_deliveries(transaction: sa.Connection, plan_id: str) -> None:
    """Remove all messages about a plan."""
    own = sa.select(DELIVERIES.c.id).where(DELIVERIES.c.plan_id == plan_id)
    transaction.execute(sa.delete(DELIVERY_ATTEMPTS).where(DELIVERY_ATTEMPTS.c.delivery_id.in_(own)))
    transaction.execute(sa.delete(DELIVERIES).where(DELIVERIES.c.plan_id == plan_id))


def make_secret() -> str:
    """Return a new secret, in the form in which receivers are given it (Standard Webhooks)."""
    return SECRET_PREFIX + base64.b64encode(secrets.token_bytes(SECRET_BYTES)).decode()


def _delivery(row: sa.RowMapping) -> Delivery:
    return Delivery(**{**row, "state": DeliveryState(row["state"])})
