"""Webhooks: what the routes ask for."""

from __future__ import annotations

from app.access.caller import ANYBODY, Caller, Scope
from app.errors import TooManyWebhooks, WebhookNotFound, WebhookUnusable
from app.resources.queries import page_of
from workers.stores.job_queue import JobQueue
from workers.stores.tables import Position
from workers.stores.webhook_store import Attempt, Delivery, WantedPlans, Webhook, WebhookStore
from workers.webhooks.target import Target, TargetRules


class WebhookCollection:
    """What one caller sees of all webhooks: what belongs to somebody else does not exist.

    All methods block on the database: call them from a thread.
    """

    def __init__(
        self, store: WebhookStore, queue: JobQueue, rules: TargetRules, most: int, caller: Caller = ANYBODY
    ) -> None:
        """`most` webhooks an owner may have [1]."""
        self._store, self._queue, self._rules, self._most, self._caller = store, queue, rules, most, caller

    def seen_by(self, caller: Caller) -> WebhookCollection:
        """Return what another caller sees."""
        return WebhookCollection(self._store, self._queue, self._rules, self._most, caller)

    def register(self, url: str, plans: WantedPlans, *, certified: bool = False) -> Webhook:
        """Register a webhook of the caller.

        Raises:
            TargetRefused: It leads where none may.
            TooManyWebhooks: The caller has as many as anybody may have.
        """
        self._rules.check(Target.of(url))
        # Of two that come at the same moment both may be the last: the limit is there against floods.
        if self._store.count(self._caller.owner) >= self._most:
            raise TooManyWebhooks(self._most)
        return self._store.add(self._caller.owner, url, plans, certified=certified)

    def webhook(self, webhook_id: str) -> Webhook:
        """Return one webhook.

        Raises:
            WebhookNotFound: There is none of that id.
        """
        webhook = self._store.get(webhook_id)
        if webhook is None or not self._caller.may_see(webhook.owner):
            raise WebhookNotFound(webhook_id)
        return webhook

    def require_usable(self, webhook_id: str) -> None:
        """Do nothing if the caller's plans may name a webhook.

        Raises:
            WebhookUnusable: It is not the caller's own, or disabled.
        """
        webhook = self._store.get(webhook_id)
        if webhook is None or webhook.owner != self._caller.owner or webhook.disabled_us is not None:
            raise WebhookUnusable(webhook_id)

    def page(self, size: int, before: Position | None) -> tuple[list[Webhook], Position | None]:
        """Return `size` webhooks, newest first, from behind `before`, and where the next page begins, if any."""
        everybody = self._caller.scope is Scope.ADMIN
        found = self._store.newest(size + 1, before, self._caller.owner, all_owners=everybody)
        return page_of(found, size)

    def rotate(self, webhook_id: str) -> Webhook:
        """Give a webhook a new secret.

        Raises:
            WebhookNotFound: There is none of that id.
        """
        self._store.rotate(self.webhook(webhook_id).id)
        return self.webhook(webhook_id)

    def delete(self, webhook_id: str) -> None:
        """Remove a webhook.

        Raises:
            WebhookNotFound: There is none of that id.
        """
        webhook = self.webhook(webhook_id)
        self._queue.forget_webhook(webhook.id)
        self._store.delete(webhook.id)

    def deliveries(
        self, webhook_id: str, size: int, before: Position | None
    ) -> tuple[list[tuple[Delivery, list[Attempt]]], Position | None]:
        """Return `size` messages to a webhook with how each try went, newest first, and where the next page begins.

        Raises:
            WebhookNotFound: There is none of that id.
        """
        found = self._store.deliveries(self.webhook(webhook_id).id, size + 1, before)
        shown, position = page_of(found, size)
        attempts = self._store.attempts([delivery.id for delivery in shown])
        return [(delivery, attempts[delivery.id]) for delivery in shown], position
