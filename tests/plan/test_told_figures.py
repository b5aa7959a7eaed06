"""What was needed and what there was, as a person reads it."""

from __future__ import annotations

import re

import pytest

from planners.plan.verdicts import shortage_words, told_apart
from tests.support.samples import among


@pytest.mark.parametrize("unit", ["N", "Nm", "m"])
@pytest.mark.parametrize("short", among([0.3, 1e-3, 1e-5, 1e-8], [0.3, 1e-5]))
def test_what_is_short_is_seen_in_the_figures(short: float, unit: str) -> None:
    needed = 0.17512345
    told = shortage_words(needed, needed * (1.0 - short), unit)
    more, less = map(float, re.findall(r"[\d.]+", told))
    assert more > less
    assert more == pytest.approx(needed * (1e3 if unit == "m" else 1.0), rel=1e-3)


def test_figures_have_no_more_digits_than_tell_them_apart() -> None:
    assert told_apart(112.62, 112.58, 1, "f") == ("112.62", "112.58")
    assert told_apart(112.6, 40.0, 1, "f") == ("112.6", "40.0")
    assert told_apart(1.0, 1.0)[0] == told_apart(1.0, 1.0)[1]
