"""The list of holds and their order."""

from __future__ import annotations

import pytest

from planners.errors import LiftwrightError
from planners.manipulation.holds import Hold, HoldList


def contacts(hold: Hold) -> set[tuple[str, int]]:
    return {(kind, index) for kind, index in (("grip", hold.grip), ("push", hold.push)) if index is not None}


def test_every_grip_every_push_and_every_pair_is_listed_once():
    holds = list(HoldList(3, 4))
    expected = [{("grip", g)} for g in range(3)] + [{("push", p)} for p in range(4)]
    expected += [{("grip", g), ("push", p)} for g in range(3) for p in range(4)]
    assert [contacts(hold) for hold in holds] == expected
    assert len(HoldList(3, 4)) == len(expected)


@pytest.mark.parametrize(("grips", "pushes", "total"), [(30, 64, 2014), (36, 72, 2700), (0, 5, 5), (5, 0, 5)])
def test_the_number_of_holds_is_the_papers(grips, pushes, total):
    assert len(list(HoldList(grips, pushes))) == total


def test_a_hold_is_found_at_its_number():
    holds = HoldList(3, 4)
    assert [holds.number(hold) for hold in holds] == list(range(len(holds)))


def test_the_order_is_that_of_the_sets_of_contacts():
    holds = [Hold(), *HoldList(2, 3)]
    for a in holds:
        for b in holds:
            assert (a <= b) == (contacts(a) <= contacts(b))
            assert (a < b) == (contacts(a) < contacts(b))


@pytest.mark.parametrize("hold", [Hold(), Hold(3, None), Hold(None, 4), Hold(-1, 0), Hold(0, 9)])
def test_holds_that_are_not_listed_have_no_number(hold):
    with pytest.raises(LiftwrightError):
        HoldList(3, 4).number(hold)


@pytest.mark.parametrize("number", [-1, 19])
def test_numbers_beyond_the_list_are_refused(number):
    with pytest.raises(IndexError):
        HoldList(3, 4)[number]
