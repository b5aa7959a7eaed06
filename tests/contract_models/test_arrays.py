"""Numbers in a document are as short as they may be and as long as they must."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.contract.arrays import SAMPLE_DIGITS, Numbers, rounded, significant


@given(st.floats(1e-3, 1e6), st.sampled_from([-1.0, 1.0]))
def test_contacts_keep_nine_significant_digits(size: float, sign: float) -> None:
    (told,) = significant(np.array([sign * size]))
    assert told == pytest.approx(sign * size, rel=0.51e-8)
    digits = json.dumps(float(abs(told))).replace(".", "").lstrip("0").rstrip("0")
    assert len(digits) <= 9


def test_what_is_nearly_nothing_is_nothing() -> None:
    assert json.dumps(significant(np.array([0.0, -0.0, 1e-14, -1e-14])).tolist()) == "[0.0, 0.0, 0.0, 0.0]"


@given(st.lists(st.floats(-1e9, 1e9, exclude_min=True, exclude_max=True), min_size=3, max_size=3))
def test_a_few_numbers_are_written_as_samples_are(numbers: list[float]) -> None:
    written = Numbers(3, SAMPLE_DIGITS).write(np.array(numbers))
    assert json.dumps(written) == json.dumps(rounded(np.array(numbers)).tolist())
