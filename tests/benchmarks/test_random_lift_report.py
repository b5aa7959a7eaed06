"""What the report on random lifts must not leave out, and what its draws must keep to. No figure is asserted."""

from __future__ import annotations

import re
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from planners.cell.cell import load_cells
from tests.benchmarks.attempt_file import AttemptFile, Unfinished
from tests.benchmarks.bench_random_lifts import RandomLiftFigures
from tests.benchmarks.certified_plan import BROKEN, SOLVED, UNCERTIFIED
from tests.benchmarks.lift_attempt import DENSITIES, INFEASIBLE, NOT_FOUND, LiftAttempt
from tests.benchmarks.random_lift_report import limits, sections
from tests.benchmarks.random_lifts import (
    BOARDED,
    BOXES,
    CUP_FORCE,
    GRIP_DEPTH,
    HANDS,
    PLACE,
    USED,
    X,
    Y,
    drawn,
    refusal,
)

SEEDS = range(60)
DENSEST = DENSITIES[0]


def lift(seed: int, outcome: str = SOLVED, density: float | None = None, **figures) -> LiftAttempt:
    summary = f"what became of {seed}"
    return LiftAttempt(seed, density is not None, outcome, summary, density=density or 1.0, **figures)


def outline_of(body: dict) -> np.ndarray:
    shape = body["plate"]["shape"]
    if shape["type"] == "prism":
        return np.array(shape["outline"])
    return 0.5 * np.array(shape["size"][:2]) * [[-1, -1], [1, -1], [1, 1], [-1, 1]]


def figures_of(*attempts: LiftAttempt) -> RandomLiftFigures:
    first = [attempt for attempt in attempts if not attempt.dense]
    return RandomLiftFigures(Counter({"the pad sticks out": 2}), first, [each for each in attempts if each.dense])


def text_of(*attempts: LiftAttempt) -> str:
    return "\n\n".join(sections(figures_of(*attempts)))


def test_every_unsolved_lift_is_listed_with_its_reason_and_what_a_denser_search_said() -> None:
    text = text_of(
        lift(1), lift(2, INFEASIBLE), lift(3, NOT_FOUND), lift(4, NOT_FOUND), lift(5, UNCERTIFIED, reason="slips"),
        lift(3, density=DENSEST), lift(4, NOT_FOUND, DENSITIES[1]),
    )  # fmt: skip
    assert re.search(r"seed 2, infeasible: what became of 2", text)
    assert f"seed 3, not_found (×{DENSEST:g}: solved): what became of 3" in text
    assert f"seed 4, not_found (×{DENSITIES[1]:g}: not_found): what became of 4" in text
    assert re.search(r"seed 5, certificate failed: slips", text)
    assert not re.search(r"seed 1,", text)


@pytest.mark.parametrize(
    "attempts",
    [
        (lift(1, reserve=0.1, length=9, contact_changes=3),),
        (lift(1),),
        (lift(1, NOT_FOUND), lift(1, NOT_FOUND, DENSEST)),
    ],
)
def test_all_rows_of_a_table_are_as_wide_as_its_head_whatever_came_out(attempts: tuple[LiftAttempt, ...]) -> None:
    for block in re.findall(r"(?:^\|.*\n)+", text_of(*attempts), re.MULTILINE):
        assert len({line.count("|") for line in block.splitlines()}) == 1


def test_wrong_answers_and_broken_plans_break_limits() -> None:
    def kept(*attempts: LiftAttempt) -> list[bool]:
        return [limit.kept for limit in limits(figures_of(*attempts))[:2]]

    lost = [attempt for seed in range(100) for attempt in (lift(seed, NOT_FOUND), lift(seed, NOT_FOUND, DENSEST))]
    assert kept(*lost) == [True, True]
    right = [attempt for attempt in lost if not (attempt.dense and attempt.seed < 3)]
    assert kept(*right, lift(0, density=DENSEST), lift(1, density=DENSEST), lift(2, NOT_FOUND, DENSEST)) == [True, True]
    assert kept(*right, *(lift(seed, density=DENSEST) for seed in range(3))) == [True, False]
    assert kept(lift(1), lift(2, UNCERTIFIED)) == [False, True]
    assert kept(lift(1, NOT_FOUND), lift(1, BROKEN, DENSEST)) == [False, True]


def test_a_run_in_pieces_makes_no_attempt_twice_and_keeps_their_order(tmp_path: Path) -> None:
    made: list[int] = []

    def make(seed: int) -> LiftAttempt:
        made.append(seed)
        if seed == 2:
            raise ValueError("no")
        return lift(seed)

    work = {(seed, False): partial(make, seed) for seed in (3, 1, 2)}
    file = AttemptFile(tmp_path / "lifts.jsonl", LiftAttempt)
    with ThreadPoolExecutor(1) as processes:
        with pytest.raises(Unfinished, match="1 of 3"):
            file.complete(processes, work, lambda _: None, most=2)
        done = file.complete(processes, work, lambda _: None, most=2)
    assert made == [3, 1, 2]
    assert list(done) == list(work)
    assert done[1, False] == lift(1)
    assert (done[2, False].outcome, done[2, False].reason) == (BROKEN, "ValueError: no")


def test_draws_are_spread_over_what_is_told_and_a_seed_draws_one_task() -> None:
    assert drawn(5) == drawn(5) != drawn(6)
    bodies = [drawn(seed) for seed in SEEDS]
    for values, (low, high) in (
        ([body["plate_pose"][0] for body in bodies], X),
        ([body["plate_pose"][1] for body in bodies], Y),
        ([body["cup"]["max_force"] for body in bodies], CUP_FORCE),
    ):
        assert low <= min(values) < low + 0.2 * (high - low)
        assert high - 0.2 * (high - low) < max(values) <= high
    boxes = sum(body["plate"]["shape"]["type"] == "box" for body in bodies) / len(bodies)
    boards = sum("support" in body for body in bodies) / len(bodies)
    assert [boxes, boards] == pytest.approx([BOXES, BOARDED], abs=0.2)


def test_only_the_checks_of_the_service_refuse_a_draw_and_most_pass() -> None:
    cells = load_cells()
    reasons = [reason for seed in SEEDS if (reason := refusal(seed, cells)) is not None]
    assert 0 < len(reasons) < 0.4 * len(SEEDS)
    assert not any(re.search(r"\d", reason) for reason in reasons)


def test_cup_and_hands_at_the_rim_nearly_balance_the_weight() -> None:
    """About the centre of mass the pull times its offset is what hands bear times their lever, but for `PLACE`."""
    for seed in SEEDS:
        body = drawn(seed)
        force, weight = body["cup"]["max_force"], 9.81 * body["plate"]["mass"]
        pulls = [pull for pull in np.linspace(USED[0], USED[1], 200) * force if HANDS[0] < weight - pull < HANDS[1]]
        com = np.array(body["plate"]["com"][:2])
        offset = np.array(body["cup"]["position"]) - com
        distance = float(np.linalg.norm(offset))
        lever = float(np.max(-(outline_of(body) - com) @ offset)) / distance - GRIP_DEPTH
        wanted = [(weight - pull) / pull * lever for pull in pulls]
        assert PLACE[0] * min(wanted) - 1e-3 < distance < PLACE[1] * max(wanted) + 1e-3


def test_lifts_without_a_plan_are_counted_by_their_remedies_and_the_helpless_are_named() -> None:
    text = text_of(lift(1), lift(2, NOT_FOUND, remedies=3), lift(3, INFEASIBLE, remedies=0), lift(4, NOT_FOUND))
    assert "| 3 | 1 |" in text
    assert "Without any: seeds 3." in text
    told = {
        each.what: each for each in limits(figures_of(lift(2, NOT_FOUND, remedies=3), lift(3, NOT_FOUND, remedies=0)))
    }
    assert not told["lifts without a plan that are told a certified change"].kept
