"""What a plan shows of what the store and the engine know."""

from __future__ import annotations

import pytest

from app.resources.schemas import plan_resource
from workers.stores.jobs import Job, JobState
from workers.stores.plan_store import PlanRecord

CREATED_US = 1_700_000_000_500_000
STARTED_US = CREATED_US + 200_000


def record(finished_us: int | None) -> PlanRecord:
    return PlanRecord(
        "a" * 32, "plate_lift", None, None, "0" * 64, CREATED_US, STARTED_US, finished_us, 1, None, 0.0, None, None, 0,
        None, None,
    )  # fmt: skip


@pytest.mark.parametrize("state", [state for state in JobState if state.done])
def test_whatever_ended_a_job_its_end_has_a_time_that_is_not_before_its_start(state: JobState) -> None:
    whole_second = CREATED_US // 1_000_000 * 1_000_000
    plan = plan_resource(record(None), Job(state, None, whole_second))
    assert plan.finished_at is not None
    assert plan.started_at is not None
    assert plan.finished_at >= plan.started_at


def test_our_own_finer_time_goes_before_the_engines() -> None:
    plan = plan_resource(record(STARTED_US + 1), Job(JobState.SUCCEEDED, None, STARTED_US + 700_000))
    assert plan.finished_at is not None
    assert plan.finished_at.microsecond == (STARTED_US + 1) % 1_000_000


def test_a_job_that_has_not_ended_has_no_end() -> None:
    assert plan_resource(record(STARTED_US + 1), Job(JobState.RUNNING, None, None)).finished_at is None
