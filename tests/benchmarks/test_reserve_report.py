"""What the reserve study must vary, and what its report must not leave out. No figure is asserted."""

from __future__ import annotations

import re

import pytest

from planners.contract.task_spec import PlateLiftTask, read_task
from tests.benchmarks.bench_reserve import LIFTED, NO_PLAN, RESERVES, ReserveFigures, ReserveRun
from tests.benchmarks.reserve_draws import COM, CUP, FRICTION, LIFTER, MASS, MULTIPLES, Deviation
from tests.benchmarks.reserve_report import limits, sections
from tests.benchmarks.tasks import task_body
from workers.simulation.settings import SimulationSettings

TOLERANCES = {
    "mass": (1.0, MASS), "com_x": (0.0, COM), "com_y": (0.0, COM), "grip": (1.0, FRICTION), "push": (1.0, FRICTION),
    "environment": (1.0, FRICTION), "pad": (1.0, FRICTION), "cup": (1.0, CUP), "lifter": (1.0, LIFTER),
}  # fmt: skip


def figures_of(*lost: ReserveRun) -> list[ReserveFigures]:
    figures = []
    for reserve in RESERVES:
        runs = {s: ReserveRun("ab1", reserve, s, LIFTED, multiple=Deviation.drawn(s).multiple) for s in range(60)}
        runs |= {run.seed: run for run in lost if run.reserve == reserve}
        figures.append(ReserveFigures("ab1", reserve, list(runs.values())))
    return figures


@pytest.mark.parametrize("multiple", MULTIPLES)
def test_deviations_fill_their_tolerances_and_do_not_leave_them(multiple: int) -> None:
    drawn = [each for each in map(Deviation.drawn, range(300)) if each.multiple == multiple]
    assert len(drawn) == 300 / len(MULTIPLES)
    for name, (middle, tolerance) in TOLERANCES.items():
        off = [(getattr(each, name) - middle) / (multiple * tolerance) for each in drawn]
        assert max(map(abs, off)) <= 1.0
        assert min(off) < -0.8
        assert max(off) > 0.8


def test_things_really_are_as_drawn_and_the_task_stays_as_it_was() -> None:
    task = read_task(task_body("ab1"))
    assert isinstance(task, PlateLiftTask)
    deviation = Deviation(1, 1.02, 0.004, -0.003, 0.96, 0.97, 1.03, 1.04, 0.95, 1.5)
    actual, settings = deviation.actual(task), deviation.settings()
    assert task == read_task(task_body("ab1"))
    assert actual.plate.mass == pytest.approx(1.02 * task.plate.mass)
    # AB is a box: its centroid, which counts where no centre of mass is stated, is its origin.
    assert task.plate.com is None
    assert actual.plate.com == pytest.approx([0.004, -0.003, 0.0])
    shares = [getattr(actual.friction, name) / getattr(task.friction, name) for name in ("grip", "push", "environment")]
    assert shares == pytest.approx([0.96, 0.97, 1.03])
    assert actual.cup.mu == pytest.approx(1.04 * task.cup.mu)
    assert (settings.cup.strength, settings.contact.friction_factor) == (0.95, 1.0)
    assert settings.winch.usual_speed == pytest.approx(1.5 * SimulationSettings().winch.usual_speed)


def test_the_default_reserve_has_to_survive_what_is_told_and_no_more() -> None:
    seeds = {multiple: [s for s in range(60) if Deviation.drawn(s).multiple == multiple] for multiple in MULTIPLES}

    def kept(reserve: float, multiple: int, count: int) -> bool:
        lost = [ReserveRun("ab1", reserve, s, "slipped", multiple=multiple) for s in seeds[multiple][:count]]
        (limit,) = limits(figures_of(*lost))
        return limit.kept

    assert kept(0.1, 1, 1)
    assert not kept(0.1, 1, 2)
    assert kept(0.0, 1, 20)
    assert kept(0.1, 3, 20)


def test_shares_are_told_by_reserve_and_multiple_with_what_went_wrong() -> None:
    lost = [ReserveRun("ab1", 0.0, 2, "cup_lost", multiple=3), ReserveRun("ab1", 0.0, 1, NO_PLAN, multiple=2)]
    (text,) = sections(figures_of(*lost))
    (row,) = [line for line in text.splitlines() if line.startswith("| ab1, 0 ")]
    assert "58 of 60 | 20 of 20 | 19 of 20 | 19 of 20" in row
    assert "1 cup lost" in row
    assert "1 no plan" in row
    for block in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        assert len({line.count("|") for line in block.splitlines()}) == 1
