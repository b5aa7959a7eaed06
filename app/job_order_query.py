"""What can be said about a job when its task is posted."""

from __future__ import annotations

import re
from datetime import datetime
from typing import Annotated, Any

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

from planners.contract.quantities import ExternalId
from workers.stores.jobs import HIGHEST_PRIORITY, JobOrder

YEARS = range(1970, 3000)
"""Outside of them a time is a mistake, and near the calendar's ends none that can be told in UTC."""
_RFC_3339 = re.compile(r"\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d(\.\d+)?([Zz]|[+-]\d\d:\d\d)", re.ASCII)


def _written_out(given: Any) -> Any:
    """Refuse what else might be taken for a time: numbers, for example."""
    if not isinstance(given, str) or not _RFC_3339.fullmatch(given):
        raise ValueError("must be a time as RFC 3339 writes it, like 2026-11-30T06:00:00Z; in a query + is %2B")
    return given


def _within_the_years(time: datetime) -> datetime:
    if time.year not in YEARS:
        raise ValueError(f"must lie in the years {YEARS.start} to {YEARS.stop - 1}")
    return time


Moment = Annotated[AwareDatetime, BeforeValidator(_written_out), AfterValidator(_within_the_years)]


class JobOrderQuery(BaseModel):
    """The query of `POST /v1/plans`: the task says what is planned, this says when, and who is told."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    webhook: str | None = None
    """A webhook of yours that is to know when the job ends."""
    work_master: ExternalId | None = None
    """The recipe by which you made the task; ISA-95's WorkMasterID. It is handed back."""
    priority: int = Field(default=0, ge=0, le=HIGHEST_PRIORITY)
    """The highest goes first, and of equal ones the oldest."""
    start_time: Moment | None = None
    """The job is not begun before (RFC 3339, with an offset)."""
    end_time: Moment | None = None
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
