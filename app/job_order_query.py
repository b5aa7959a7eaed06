"""What can be said about a job when its task is posted."""

from __future__ import annotations

from datetime import datetime

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from planners.contract.quantities import ExternalId
from workers.job_order import HIGHEST_PRIORITY, JobOrder


class JobOrderQuery(BaseModel):
    """The query of `POST /v1/plans`: the task says what is planned, this says when, and who is told."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    webhook: str | None = None
    """A webhook of yours that is to know when the job ends."""
    work_master: ExternalId | None = None
    """The recipe by which you made the task; ISA-95's WorkMasterID. It is handed back."""
    priority: int = Field(default=0, ge=0, le=HIGHEST_PRIORITY)
    """The highest goes first, and of equal ones the oldest."""
    start_time: AwareDatetime | None = None
    """The job is not begun before (RFC 3339, with an offset)."""
    end_time: AwareDatetime | None = None
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
