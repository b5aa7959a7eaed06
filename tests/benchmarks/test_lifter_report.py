"""What the report on lifters of all speeds must ask for and must not leave out. No figure is asserted."""

from __future__ import annotations

import re

import pytest

from tests.benchmarks.bench_lifters import KINDS, LIFTED, SPEEDS, SUDDEN_STOP, LifterFigures, LifterKind, LifterRun
from tests.benchmarks.lifter_report import limits, sections
from workers.simulation.settings import WinchSettings


def figures_of(lost: dict[LifterKind, int]) -> list[LifterFigures]:
    return [
        LifterFigures(
            task,
            kind,
            [
                LifterRun(task, kind.speed, kind.sudden, seed, LIFTED, off_goal=0.1)
                if seed >= lost.get(kind, 0) or task == "pb1"
                else LifterRun(task, kind.speed, kind.sudden, seed, "cup_lost", "the cup was over its 20 N")
                for seed in range(20)
            ],
        )
        for task in ("ab1", "pb1")
        for kind in KINDS
    ]


@pytest.mark.parametrize("speed", SPEEDS)
@pytest.mark.parametrize(("lost", "kept"), [(1, True), (2, False)])
def test_nineteen_of_twenty_lifters_of_each_speed_are_asked_for(speed: float, lost: int, kept: bool) -> None:
    found = limits(figures_of({LifterKind(speed): lost}))
    assert [limit.kept for limit in found] == [kept or each != speed for each in SPEEDS]


def test_the_first_speed_that_fails_is_told_with_its_cause() -> None:
    (text,) = sections(figures_of({LifterKind(4.0): 2, LifterKind(5.0): 20, LifterKind(1.0, sudden=True): 3}))
    assert "ab1: less than 95 % from 4 times the speed on; 2 times cup lost" in text
    assert "ab1, with sudden stops: less than 95 % from 1 times the speed on; 3 times cup lost" in text
    assert "pb1: followed at every speed that was tried" in text
    for block in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        assert len({line.count("|") for line in block.splitlines()}) == 1


def test_kinds_differ_in_speed_and_in_how_they_stop_alone() -> None:
    usual = WinchSettings()
    assert LifterKind(1.0).winch() == usual
    fast, sudden = LifterKind(3.0).winch(), LifterKind(3.0, sudden=True).winch()
    assert fast.speed == pytest.approx([3.0 * each for each in usual.speed])
    assert (fast.acceleration, fast.deceleration) == (usual.acceleration, usual.deceleration)
    assert (sudden.speed, sudden.acceleration, sudden.deceleration) == (fast.speed, fast.acceleration, SUDDEN_STOP)
