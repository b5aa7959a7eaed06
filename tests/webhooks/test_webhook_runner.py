"""Looking for jobs that webhooks wait for costs as little as there is news."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from sqlalchemy import event

from tests.support.accepted import accept
from tests.support.service import task
from workers.settings import WorkerSettings
from workers.stores.database import Database, open_database
from workers.stores.job_queue import JobQueue
from workers.stores.jobs import workflow_table
from workers.stores.plan_store import PlanStore
from workers.stores.tables import now_us
from workers.stores.webhook_store import Attempt, DeliveryState, WebhookStore
from workers.webhooks.runner import BATCH, WebhookRunner


@dataclass(frozen=True)
class Stores:
    database: Database
    plans: PlanStore
    queue: JobQueue
    webhooks: WebhookStore
    runner: WebhookRunner

    def accept(self, number: int) -> list[str]:
        return [accept(self.plans, task(), None, self.queue).id for _ in range(number)]

    def become(self, plan_ids: list[str], status: str) -> None:
        jobs = workflow_table("sqlite")
        with self.database.engine.begin() as transaction:
            changed = sa.update(jobs).where(jobs.c.workflow_uuid.in_(plan_ids))
            transaction.execute(changed.values(status=status))

    def states(self, webhook_id: str) -> dict[str, DeliveryState]:
        return {each.plan_id: each.state for each in self.webhooks.deliveries(webhook_id, 1000, None)}

    @contextmanager
    def statements(self) -> Iterator[list[str]]:
        """Collect what the database is asked."""
        asked: list[str] = []

        def keep(_: Any, __: Any, statement: str, *rest: Any) -> None:
            asked.append(statement)

        event.listen(self.database.engine, "before_cursor_execute", keep)
        yield asked
        event.remove(self.database.engine, "before_cursor_execute", keep)


@pytest.fixture
def stores(tmp_path: Path) -> Iterator[Stores]:
    settings = WorkerSettings(data_dir=tmp_path)
    database = open_database(settings)
    queue, plans, webhooks = JobQueue(database), PlanStore(database), WebhookStore(database)
    yield Stores(database, plans, queue, webhooks, WebhookRunner(settings, queue, plans, webhooks))
    queue.close()
    database.close()


def test_jobs_that_have_not_ended_are_one_question_however_many_messages_wait_for_them(stores: Stores) -> None:
    for _ in range(3):
        stores.webhooks.add(None, "https://mes.example/", "all")
    plans = stores.accept(10)
    stores.become(plans[:3], "PENDING")
    stores.become(plans[3:5], "DELAYED")
    with stores.statements() as asked:
        stores.runner.look()
    assert len(asked) == 1


@pytest.mark.parametrize("status", ["SUCCESS", "ERROR", "CANCELLED", "MAX_RECOVERY_ATTEMPTS_EXCEEDED"])
def test_messages_about_jobs_that_have_ended_are_begun_and_no_others(stores: Stores, status: str) -> None:
    webhook = stores.webhooks.add(None, "https://mes.example/", "all")
    ended, waiting = stores.accept(2), stores.accept(3)
    stores.become(ended, status)
    for _ in range(2):
        stores.runner.look()
    states = stores.states(webhook.id)
    assert {states[plan_id] for plan_id in ended} == {DeliveryState.PENDING}
    assert {states[plan_id] for plan_id in waiting} == {DeliveryState.WAITING}


def test_many_at_once_are_begun_batch_by_batch(stores: Stores) -> None:
    webhook = stores.webhooks.add(None, "https://mes.example/", "all")
    plans = stores.accept(BATCH + 5)
    stores.become(plans, "SUCCESS")
    for begun in (BATCH, BATCH + 5):
        stores.runner.look()
        assert list(stores.states(webhook.id).values()).count(DeliveryState.PENDING) == begun


@pytest.mark.parametrize("deleted", ["plan", "webhook"])
def test_nothing_is_left_of_messages_of_what_is_deleted(stores: Stores, deleted: str) -> None:
    webhook = stores.webhooks.add(None, "https://mes.example/told", "all")
    told, other = stores.accept(2)
    stores.become([told, other], "SUCCESS")
    stores.runner.look()
    for delivery in stores.webhooks.deliveries(webhook.id, 10, None):
        again = partial(stores.runner._enqueue, delivery, 2, 0.0)
        stores.webhooks.note(delivery, Attempt(1, now_us(), 503, "busy"), DeliveryState.PENDING, again)
    jobs = workflow_table("sqlite")
    assert len(stores.database.column(sa.select(jobs.c.workflow_uuid))) == 6
    if deleted == "plan":
        stores.queue.forget(told)
        left = [name for name in stores.database.column(sa.select(jobs.c.workflow_uuid)) if name.startswith(told)]
        assert left == []
        assert len(stores.database.column(sa.select(jobs.c.workflow_uuid))) == 3
    else:
        stores.queue.forget_webhook(webhook.id)
        assert set(stores.database.column(sa.select(jobs.c.workflow_uuid))) == {told, other}
