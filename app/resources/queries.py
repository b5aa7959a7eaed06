"""What can be asked of lists, page by page, and said about a job when its task is posted."""

from __future__ import annotations

import base64
import re
from datetime import datetime
from typing import Annotated, Any, Literal, Protocol, TypeVar

from pydantic import (
    AfterValidator,
    AwareDatetime,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
)

from app.errors import BadHeader
from app.resources.schemas import Outcome, PlanState
from planners.contract.quantities import ExternalId
from planners.plan.simulation import Physics
from workers.stores.jobs import HIGHEST_PRIORITY, JobOrder, JobState
from workers.stores.plan_store import PlanFilter
from workers.stores.tables import Position

_POSITION = re.compile(rb"(\d{1,18})-([0-9a-f]{32})")
YEARS = range(1970, 3000)
"""Outside of them a time is a mistake, and near the calendar's ends none that can be told in UTC."""
_RFC_3339 = re.compile(r"\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d(\.\d+)?([Zz]|[+-]\d\d:\d\d)", re.ASCII)


class Listed(Protocol):
    """An item of a list, which has the newest first."""

    @property
    def created_us(self) -> int:
        """Microseconds since 1970, UTC."""
        ...

    @property
    def id(self) -> str:
        """Tells items of the same time apart."""
        ...


ListedItem = TypeVar("ListedItem", bound=Listed)


def page_of(found: list[ListedItem], size: int) -> tuple[list[ListedItem], Position | None]:
    """Return the first `size` of what was found, and where the next page begins; None: there was no more."""
    shown = found[:size]
    return shown, (shown[-1].created_us, shown[-1].id) if len(found) > size else None


def write_page_token(position: Position | None) -> str | None:
    """Return the token by which a client asks for the page behind a position; None on the last page."""
    if position is None:
        return None
    created_us, item_id = position
    return base64.urlsafe_b64encode(f"{created_us}-{item_id}".encode()).decode().rstrip("=")


def read_page_token(token: str | None) -> Position | None:
    """Return what `write_page_token` was given; None: the list begins with the newest.

    Raises:
        BadHeader: It never wrote this.
    """
    if token is None:
        return None
    try:
        text = base64.urlsafe_b64decode(token + "=" * (-len(token) % 4))
    except ValueError:
        text = b""
    match = _POSITION.fullmatch(text)
    if match is None:
        raise BadHeader("page_token is not one this service gave")
    return int(match[1]), match[2].decode()


def _written_out(given: Any) -> Any:
    """Refuse what else might be taken for a time: numbers, for example."""
    if not isinstance(given, str) or not _RFC_3339.fullmatch(given):
        raise ValueError("must be a time as RFC 3339 writes it, like 2026-11-30T06:00:00Z; in a query + is %2B")
    return given


def _within_the_years(time: datetime) -> datetime:
    if time.year not in YEARS:
        raise ValueError(f"must lie in the years {YEARS.start} to {YEARS.stop - 1}")
    return time


Timestamp = Annotated[AwareDatetime, BeforeValidator(_written_out), AfterValidator(_within_the_years)]


class PlanQuery(BaseModel):
    """The query of `GET /v1/plans`. What is given must hold for every plan that is listed."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    page_size: int = Field(default=50, ge=1, le=200)
    page_token: str | None = None
    """`next_page_token` of the page before; repeat the rest of the query with it."""
    external_id: ExternalId | None = None
    """Exactly the task's own."""
    work_master: ExternalId | None = None
    """Exactly the order's own."""
    name: ExternalId | None = None
    """Part of `external_id` or `work_master`, or the beginning of the plan's id; in capitals or not."""
    created_from: Timestamp | None = None
    """Not before (RFC 3339, with an offset)."""
    created_until: Timestamp | None = None
    """Before (RFC 3339, with an offset)."""
    kind: Literal["plate_lift", "suction_tool"] | None = None
    state: PlanState | None = None
    outcome: Outcome | None = None
    """Of jobs that have succeeded."""
    physics: Physics | None = None
    """How the plan fared when it was simulated."""

    @property
    def position(self) -> Position | None:
        """Where the page begins: behind (created_us, id); None: with the newest.

        Raises:
            BadHeader: The token is none of ours.
        """
        return read_page_token(self.page_token)

    def filter(self, owner: str | None) -> PlanFilter:
        """Return which plans are asked for, of one owner or of all."""
        state = None if self.state is None else JobState(self.state)
        return PlanFilter(
            owner,
            self.kind,
            self.external_id,
            self.work_master,
            state,
            self.outcome,
            self.physics,
            self.name,
            _microseconds(self.created_from),
            _microseconds(self.created_until),
        )


class JobOrderQuery(BaseModel):
    """The query of `POST /v1/plans`: the task says what is planned, this says when, and who is told."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    webhook: str | None = None
    """A webhook of yours that is to know when the job ends."""
    work_master: ExternalId | None = None
    """The recipe by which you made the task; ISA-95's WorkMasterID. It is handed back."""
    priority: int = Field(default=0, ge=0, le=HIGHEST_PRIORITY)
    """Of your jobs the highest goes first, and of equal ones the oldest; owners take turns."""
    start_time: Timestamp | None = None
    """The job is not begun before (RFC 3339, with an offset)."""
    end_time: Timestamp | None = None
    """A job that has not ended by then is cancelled (RFC 3339, with an offset)."""

    @field_validator("end_time")
    @classmethod
    def _ends_after_it_starts(cls, end: datetime | None, info: ValidationInfo) -> datetime | None:
        start = info.data.get("start_time")
        if end is not None and start is not None and end <= start:
            raise ValueError("end_time must be later than start_time")
        return end

    @property
    def order(self) -> JobOrder:
        """Return the same for the store."""
        return JobOrder(
            self.webhook, self.work_master, self.priority, _microseconds(self.start_time), _microseconds(self.end_time)
        )


def _microseconds(time: datetime | None) -> int | None:
    return None if time is None else round(time.timestamp() * 1e6)
