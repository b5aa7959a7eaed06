from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from workers.progress_scale import STAGE_SHARES, ProgressScale

REPORTS = st.lists(
    st.tuples(st.sampled_from([*STAGE_SHARES, "unheard of"]), st.integers(0, 10**6), st.integers(0, 10**6))
)


@given(REPORTS, st.floats(0.0, 1.0))
def test_the_fraction_never_falls_and_stays_within_the_whole(reports: list[tuple[str, int, int]], begun: float) -> None:
    scale = ProgressScale(begun=begun)
    shown = [begun] + [scale.advance(*report) for report in reports]
    assert shown == sorted(shown)
    assert 0.0 <= shown[-1] <= 1.0 + 1e-12


def test_all_stages_together_are_the_whole() -> None:
    scale = ProgressScale()
    for stage in STAGE_SHARES:
        scale.advance(stage, 7, 7)
    assert scale.fraction == pytest.approx(1.0)


def test_a_stage_of_unknown_length_moves_but_does_not_end_by_itself() -> None:
    shares = {"first": 0.5, "second": 0.5}
    scale = ProgressScale(shares)
    assert 0.0 < scale.advance("first", 10, 0) < scale.advance("first", 10_000, 0) < 0.5
