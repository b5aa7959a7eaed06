"""The figures of a "no": they say what is short, in a unit, or there are none."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from planners.graph.rejections import NoShortage, Rejection, Rejections
from planners.plan.verdicts import Cause

WRONG = [
    (0.0, -0.113, None),
    (5.0, 4.0, None),
    (1.7, 1.0, "1"),
    (5.0, 4.0, ""),
    (4.0, 5.0, "N"),
    (5.0, 5.0, "N"),
    (-0.0005, -0.0012, "m"),
    (0.1, -0.2, "N"),
    (5.0, None, "N"),
    (None, 5.0, "N"),
    (None, None, "N"),
    (float("inf"), 1.0, "N"),
    (float("nan"), 1.0, "N"),
    (1.0, float("nan"), "N"),
]


@pytest.mark.parametrize("figures", WRONG)
def test_figures_that_say_nothing_of_what_is_short_are_refused_where_they_are_made_and_written(figures: Any) -> None:
    with pytest.raises(NoShortage, match="more needed than available"):
        Rejection("hold", "It falls.", "", *figures)
    needed, available, unit = figures
    try:
        written = Cause(reason="It falls.", needed=needed, available=available, unit=unit)
    except ValidationError:
        return
    # Documents of the first days are read, with what they say; the certificate asks this, and refuses them.
    assert not written.says_what_is_short


@pytest.mark.parametrize(
    "figures", [(5.0, 4.0, "N"), (0.3, 0.0, "Nm"), (7, 6, "edges"), (0.003, -0.004, "m"), (None, None, None)]
)
def test_what_is_short_may_be_told_or_left_out(figures: Any) -> None:
    made = Rejection("hold", "It falls.", "", *figures)
    needed, available, unit = figures
    written = Cause(reason="It falls.", needed=needed, available=available, unit=unit)
    assert written.says_what_is_short
    assert (made.needed, made.available, made.unit) == (written.needed, written.available, written.unit)


def test_computed_figures_are_left_out_where_only_rounding_is_short() -> None:
    limit = 17.0
    assert Rejection.measured("grip", "x", "", limit * (1.0 + 1e-15), limit, "N").needed is None
    assert Rejection.measured("grip", "x", "", 1.01 * limit, limit, "N").needed == 1.01 * limit


def test_of_equal_reasons_the_one_that_lacks_the_least_part_of_its_need_is_remembered() -> None:
    tally = Rejections()
    for needed, available, unit in ((2.0, 1.0, "Nm"), (100.0, 90.0, "N"), (None, None, None)):
        tally.add(Rejection("suction", "It is weak.", "", needed, available, unit))
    ((nearest, count),) = tally.most_common()
    assert (nearest.needed, nearest.unit, count) == (100.0, "N", 3)
