from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.progress import Report
from workers.solver.progress import STAGE_SHARES, ProgressScale

TASKS = [
    {"kind": "plate_lift", "cup": {"position": [0.0, 0.1]}},
    {"kind": "plate_lift", "cup": {}},
    {"kind": "suction_tool", "objects": [{}, {}, {}]},
]
STAGES = sorted({stage for shares in STAGE_SHARES.values() for stage in shares})
COUNT = st.integers(0, 10**6)
REPORTS = st.lists(
    st.builds(
        Report,
        st.sampled_from([*STAGES, "second regrasp", "unheard of"]),
        COUNT,
        COUNT,
        st.sampled_from([None, *"abcd"]),
    )
)


@given(REPORTS, st.floats(0.0, 1.0), st.sampled_from(TASKS))
def test_the_fraction_never_falls_and_stays_within_the_whole(
    reports: list[Report], begun: float, task: dict[str, object]
) -> None:
    scale = ProgressScale.of(task, begun)
    shown = [begun] + [scale.advance(report) for report in reports]
    assert shown == sorted(shown)
    assert 0.0 <= shown[-1] <= 1.0 + 1e-12


@pytest.mark.parametrize("task", TASKS)
def test_all_stages_together_are_the_whole(task: dict[str, object]) -> None:
    scale = ProgressScale.of(task)
    for stage in STAGE_SHARES[str(task["kind"])]:
        scale.advance(Report(stage, 7, 7))
    assert scale.fraction == pytest.approx(1.0)


def test_a_stage_of_unknown_length_moves_but_does_not_end_by_itself() -> None:
    scale = ProgressScale({"first": 0.5, "second": 0.5})
    assert 0.0 < scale.advance(Report("first", 10, 0)) < scale.advance(Report("first", 10_000, 0)) < 0.5


def test_kinds_of_changes_are_no_parts_of_looking_for_remedies() -> None:
    """Each report is of the whole search, whatever kind of change is tried; and it takes the place of physics."""
    scale = ProgressScale({"certify": 0.4, "simulate": 0.6}, objects=3)
    assert scale.advance(Report("remedies", 5, 10, "tool")) == pytest.approx(0.4 + 0.3)
    assert scale.advance(Report("remedies", 10, 10, "mass")) == pytest.approx(1.0)


def test_objects_share_a_stage_in_whatever_order_they_come() -> None:
    scale = ProgressScale({"scene": 0.2, "regrasp": 0.6, "certify": 0.2}, objects=3)
    assert scale.advance(Report("regrasp", 5, 10, "second")) == pytest.approx(0.2 + 0.2 * 0.5)
    assert scale.advance(Report("regrasp", 0, 10, "first")) == pytest.approx(0.2 + 0.2)
    assert scale.advance(Report("regrasp", 5, 10, "first")) == pytest.approx(0.2 + 0.3)
    assert scale.advance(Report("regrasp", 10, 10, "third")) == pytest.approx(0.8)


def test_an_object_that_is_planned_again_takes_no_other_objects_share() -> None:
    scale = ProgressScale({"regrasp": 1.0}, objects=2)
    scale.advance(Report("regrasp", 10, 10, "first"))
    assert scale.advance(Report("regrasp", 10, 10, "first")) == pytest.approx(0.5)
