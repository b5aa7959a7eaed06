"""Who follows plans and studies: so many at once that they never hold all connections, nor one owner most of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import AsyncIterator, Hashable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TypeVar

from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from app.access.caller import Caller
from app.errors import TooManyFollowers
from app.resources.plan_feed import PlanFeed, wait_for_end
from app.server.leaving import leaving_of, unless_leaving, until_leaving

Holder = TypeVar("Holder", bound=Hashable)


@contextmanager
def counted(counts: Counter[Holder], holder: Holder, *, admitted: bool) -> Iterator[bool]:
    """Count a holder for the time of a block if it is admitted; who is not counted any more is not kept."""
    counts[holder] += admitted
    try:
        yield admitted
    finally:
        counts[holder] -= admitted
        if not counts[holder]:
            del counts[holder]


class Followers:
    """Places of those who follow something, by an event stream or by `Prefer: wait`. Belongs to one event loop."""

    def __init__(self, most: int, most_of_owner: int) -> None:
        """There are `most` places, and `most_of_owner` of them for one owner, where keys tell owners apart."""
        self.most, self.most_of_owner = most, most_of_owner
        self._following = Counter[str | None]()

    def place(self, caller: Caller) -> AbstractContextManager[bool]:
        """Give a caller a place for the time of a block, in which it is true unless there was none."""
        owner = caller.owner
        of_owner = self.most if owner is None else self.most_of_owner
        admitted = self._following.total() < self.most and self._following[owner] < of_owner
        return counted(self._following, owner, admitted=admitted)

    async def wait_for_end(
        self, caller: Caller, feed: PlanFeed, followed_id: str, seconds: float, scope: Scope
    ) -> None:
        """Wait until a job or study has ended, so long at most [s], and until the server of the request's scope stops.

        That is a caller's preference: without a place it is not followed, and what was posted is accepted all the same.
        """
        with self.place(caller) as admitted:
            waited = wait_for_end(feed, followed_id, seconds if admitted else 0.0)
            await unless_leaving(leaving_of(scope), waited)


class EventStream(StreamingResponse):
    """Server-sent events, for a caller who takes a place for as long as they are sent: until the server stops at most.

    Whoever was cut off so comes again, and resumes.
    """

    def __init__(self, events: AsyncIterator[bytes], followers: Followers, caller: Caller) -> None:
        super().__init__(events, media_type="text/event-stream", headers={"Cache-Control": "no-store"})
        self._followers, self._caller = followers, caller

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it.

        Raises:
            TooManyFollowers: There is no place, and nothing was sent.
        """
        with self._followers.place(self._caller) as admitted:
            if not admitted:
                raise TooManyFollowers(self._followers.most, self._followers.most_of_owner)
            self.body_iterator = until_leaving(leaving_of(scope), self.body_iterator)
            await super().__call__(scope, receive, send)
