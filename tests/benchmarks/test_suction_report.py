"""What the report on the suction tool must not leave out, and what its runs must not forget. No figure is asserted."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

from planners.regrasp.graph.object_progress import ObjectStage
from tests.benchmarks.bench_handovers import HandoverFigures
from tests.benchmarks.bench_piles import PileFigures, attempt_file
from tests.benchmarks.bench_tool_motion import EMPTY, LADEN, FreeMotion, TaskMotion
from tests.benchmarks.certified_plan import SOLVED, UNCERTIFIED
from tests.benchmarks.pile_attempt import PileAttempt
from tests.benchmarks.random_piles import PILES, X, Y, strewn
from tests.benchmarks.suction_part import SuctionFigures
from tests.benchmarks.suction_plots import draw_planning
from tests.benchmarks.suction_report import limits, sections

DOMINO = PILES[0]
SECONDS = 2.5
FAST = FreeMotion(EMPTY, False, 1.0, 1.0, 1.0, 1.0, 0.5, None)
SLOW = FreeMotion(LADEN, True, 1.5, 1.0, 9.0, 4.0, 0.5, 0.9)


def solved(seed: int) -> PileAttempt:
    order = ["a", "b", "c"]
    stages = {f"{stage.value} {name}": SECONDS for stage in ObjectStage for name in order}
    stages |= {"scene": 0.1, "sample": 0.1, "forces": 0.1, "certify": 1.0}
    return PileAttempt(DOMINO.name, seed, SOLVED, planning=60.0, planning_cpu=50.0, stages=stages, order=order)


def figures(*attempts: PileAttempt) -> SuctionFigures:
    pile = PileFigures(DOMINO, Counter({"domino and table touch or overlap at the start": 2}), attempts)
    tool = HandoverFigures(DOMINO.tool, 9, 7, 6, 5, 4, 3, 2.0, 1.0, 0.1, 10.0)
    return SuctionFigures([tool], [pile], [TaskMotion("domino_pile", [FAST, SLOW], 30.0, 0.5, 1.0)])


def test_every_failure_is_listed_with_its_seed_and_reason() -> None:
    failed = [PileAttempt(DOMINO.name, 7, "not_found", "no way out"), PileAttempt(DOMINO.name, 8, UNCERTIFIED, "slips")]
    text = "\n\n".join(sections(figures(solved(1), *failed), "picture.svg"))
    for attempt in failed:
        assert re.search(rf"seed {attempt.seed}, {attempt.outcome}: {attempt.reason}", text)


@pytest.mark.parametrize("attempts", [(solved(1),), (PileAttempt(DOMINO.name, 7, "not_found", "no way out"),)])
def test_all_rows_of_a_table_are_as_wide_as_its_head_whatever_came_out(attempts: tuple[PileAttempt, ...]) -> None:
    text = "\n\n".join(sections(figures(*attempts), "picture.svg"))
    for block in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
        assert len({line.count("|") for line in block.splitlines()}) == 1


def test_too_few_solved_layouts_and_failed_certificates_break_limits() -> None:
    def kept(*attempts: PileAttempt) -> list[bool]:
        return [limit.kept for limit in limits(figures(*attempts))[:2]]

    many = [solved(seed) for seed in range(97)]
    lost = [PileAttempt(DOMINO.name, 100 + seed, "not_found") for seed in range(4)]
    assert kept(*many, *lost[:3]) == [True, True]
    assert kept(*many, *lost) == [False, True]
    assert kept(*many, PileAttempt(DOMINO.name, 200, UNCERTIFIED)) == [True, False]


def test_table_1_puts_the_seconds_of_each_stage_beside_the_papers() -> None:
    text = sections(figures(solved(1)), "picture.svg")[1]
    ours = [line for line in text.splitlines() if line.startswith("| domino") and "ours" in line]
    assert len(ours) == DOMINO.objects
    assert all(line.split(" | ")[2:7] == [f"{SECONDS:.2f}"] * 5 for line in ours)


def test_slow_motion_is_listed_and_fast_motion_is_not() -> None:
    listed = re.findall(r"^- domino_pile, free motion (\d+)", sections(figures(solved(1)), "p.svg")[-1], re.MULTILINE)
    assert listed == ["2"]


def test_layouts_without_a_solution_can_be_drawn(tmp_path: Path) -> None:
    pile = figures(solved(1), PileAttempt(DOMINO.name, 7, "not_found", planning_cpu=70.0)).piles
    drawn = tmp_path / draw_planning(pile, 1.0, 0.3, tmp_path)
    assert drawn.read_text().lstrip().startswith("<?xml")


def test_a_run_that_was_cut_off_goes_on_with_what_it_had(tmp_path: Path) -> None:
    file = attempt_file(tmp_path)
    for seed in (1, 2):
        file.add(solved(seed))
    (path,) = tmp_path.iterdir()
    path.write_text(path.read_text()[:-5])
    again = attempt_file(tmp_path)
    assert again.read() == {(DOMINO.name, 1): solved(1)}
    again.add(solved(3))
    assert sorted(seed for _, seed in again.read()) == [1, 3]


@pytest.mark.parametrize("pile", PILES, ids=lambda pile: pile.task)
def test_a_seed_strews_objects_over_the_region_in_one_way_and_leaves_their_goals(pile) -> None:
    one, other = strewn(pile, 5), strewn(pile, 5)
    assert one == other != strewn(pile, 6)
    assert len(one["objects"]) == pile.objects
    assert one["tool"] == pile.tool
    for strewn_, shipped in zip(one["objects"], strewn(pile, 6)["objects"], strict=True):
        x, y, z = strewn_["pose"][:3]
        assert X[0] <= x <= X[1]
        assert Y[0] <= y <= Y[1]
        assert z == shipped["pose"][2]
        assert strewn_["goal_pose"] == shipped["goal_pose"]


def test_both_tools_get_the_same_layouts() -> None:
    long, short = (strewn(pile, 3)["objects"] for pile in PILES if pile.paper == "tissue")
    assert long == short
