"""Tells webhooks that jobs have ended, as often as it takes."""

from __future__ import annotations

import json
import random
import ssl
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import partial

import sqlalchemy as sa
import standardwebhooks
import structlog

from workers.settings import WorkerSettings
from workers.stores.database_loss import once_it_is_there
from workers.stores.job_queue import JobQueue
from workers.stores.jobs import JobState
from workers.stores.plan_store import PlanRecord, PlanStore
from workers.stores.tables import now_us
from workers.stores.webhook_store import Attempt, Delivery, DeliveryState, Webhook, WebhookStore
from workers.webhooks.post import PostResult, post
from workers.webhooks.target import TargetRules

BATCH = 100
"""So many messages are begun at one look [1]."""
JITTER = 0.1
"""By so much a pause is longer at most [1]: those that failed together are not to come again together."""
GONE = 410
log = structlog.get_logger(__name__)


class WebhookRunner:
    """Runs on the running event loop. Each try is a job of the engine, and so survives whatever dies."""

    def __init__(self, settings: WorkerSettings, queue: JobQueue, plans: PlanStore, webhooks: WebhookStore) -> None:
        self._settings, self._queue, self._plans, self._webhooks = settings, queue, plans, webhooks
        self._rules = TargetRules(settings.webhook_hosts, settings.webhook_networks)
        self._trust = ssl.create_default_context(cafile=settings.webhook_ca_file)

    def look(self) -> None:
        """Have messages about jobs that have ended delivered. Several workers may: each message is begun once."""
        due = self._webhooks.due(BATCH)
        plan_ids = sorted({delivery.plan_id for delivery in due})
        jobs, plans = self._queue.jobs(plan_ids), {plan_id: self._plans.get(plan_id) for plan_id in plan_ids}
        for delivery in due:
            job, plan = jobs.get(delivery.plan_id), plans[delivery.plan_id]
            # Either may have been deleted meanwhile.
            if job is not None and plan is not None:
                outcome = plan.outcome if job.state is JobState.SUCCEEDED else None
                body = message(plan, job.state.value, job.state, outcome)
                self._webhooks.begin(delivery, body, partial(self._enqueue, delivery, 1, 0.0))

    async def attempt(self, delivery_id: str, number: int) -> str:
        """Make one try, and have the next one made later if it fails; return where the message stands."""
        delivery = await once_it_is_there(self._webhooks.delivery, delivery_id)
        webhook = None if delivery is None else await once_it_is_there(self._webhooks.get, delivery.webhook_id)
        if delivery is None or delivery.body is None or webhook is None:
            return DeliveryState.FAILED.value
        result = await self._send(webhook, delivery, delivery.body)
        pauses = self._settings.webhook_retry_seconds
        if result.status == GONE:
            await once_it_is_there(self._webhooks.disable, webhook.id)
        if result.failure is None:
            state = DeliveryState.DELIVERED
        elif result.status == GONE or webhook.disabled_us is not None or number > len(pauses):
            state = DeliveryState.FAILED
        else:
            state = DeliveryState.PENDING
        again = None
        if state is DeliveryState.PENDING:
            pause = max(pauses[number - 1] * random.uniform(1.0, 1.0 + JITTER), result.retry_after)
            again = partial(self._enqueue, delivery, number + 1, pause)
        attempt = Attempt(number, now_us(), result.status, result.failure)
        await once_it_is_there(self._webhooks.note, delivery, attempt, state, again)
        log.info("webhook", delivery=delivery_id, job_id=delivery.plan_id, attempt=number, state=state.value)
        return state.value

    async def _send(self, webhook: Webhook, delivery: Delivery, body: str) -> PostResult:
        if webhook.disabled_us is not None:
            return PostResult(None, "the webhook is disabled")
        signed = signed_headers(f"msg_{delivery.id}", datetime.now(UTC), body, webhook.secrets_at(now_us()))
        headers = {"Content-Type": "application/json", "User-Agent": "liftwright", **signed}
        seconds = self._settings.webhook_timeout_seconds
        return await post(webhook.url, headers, body.encode(), self._rules, self._trust, seconds)

    def _enqueue(self, delivery: Delivery, number: int, pause: float, transaction: sa.Connection) -> None:
        self._queue.enqueue_delivery(transaction, delivery.plan_id, delivery.id, number, pause)


def signed_headers(message_id: str, at: datetime, body: str, secrets: Sequence[str]) -> dict[str, str]:
    """Return the headers of a message by Standard Webhooks: its receiver knows who sent it, when, and that it is whole.

    Args:
        message_id: the same at every try, so that the receiver can tell a repeat.
        at: when it is sent, UTC.
        body: the text that is sent, as UTF-8.
        secrets: one, or two while one is being replaced: there is a signature with each.
    """
    return {
        "webhook-id": message_id,
        "webhook-timestamp": str(int(at.timestamp())),
        "webhook-signature": " ".join(standardwebhooks.Webhook(each).sign(message_id, at, body) for each in secrets),
    }


def message(plan: PlanRecord, happened: str, state: JobState, outcome: str | None) -> str:
    """Return a thin message: what has happened to a plan, and how it stands; the rest is to be fetched with a key."""
    return json.dumps(
        {
            "type": f"plan.{happened}",
            "timestamp": datetime.now(UTC).isoformat(),
            "data": {
                "id": plan.id,
                "external_id": plan.external_id,
                "state": state.value,
                "outcome": outcome,
                "physics": plan.physics,
                "links": {"self": f"/v1/plans/{plan.id}"},
            },
        }
    )
