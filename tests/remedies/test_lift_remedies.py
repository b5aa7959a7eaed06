"""Remedies of plate lifts: what is told to help does help whoever posts it, and nothing else is told."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from planners import read_task, solve
from planners.cell.cell import ShippedCells
from planners.contract.task_change import PatchOperation, changed
from planners.contract.task_spec import PlateLiftTask, write_task
from planners.plan.loads import largest_load
from planners.plan.plan import Plan
from planners.plan.simulation import LiftSimulation, failure_of
from planners.plan.verdicts import Certificate, Remedy
from planners.planning import TaskSolver
from planners.progress import Report, silent
from planners.remedies.change import Effort, TaskChange, more_kept_back
from planners.remedies.find_remedies import MOST_OF_A_KIND, MOST_REMEDIES, MOST_SIMULATED, find_remedies
from planners.scene.scene import build_scene
from planners.scene.suction_tool import load_tools
from tests.support.plan_shelf import PlanShelf
from tests.support.samples import among, sample

TASKS = Path(__file__).resolve().parents[2] / "assets" / "tasks"
UNSOLVED = {
    "too weak a cup": ("pb1_weak_cup", {}),
    "beams over the plate": ("ab1_under_beams", {}),
    "too heavy wherever the cup sits": (
        "ab1",
        {
            "plate": {"shape": {"type": "box", "size": [0.45, 0.35, 0.015]}, "mass": 8.5},
            "plate_pose": [0.36, 0.0, 1.1515, 1, 0, 0, 0],
            "support": {"shape": {"type": "box", "size": [0.45, 0.35, 0.05]}, "pose": [0.36, 0.0, 1.119, 1, 0, 0, 0]},
            "cup": {"radius": 0.0175, "max_force": 20},
        },
    ),
    "far corner of the table": ("ab1", {"plate_pose": [0.62, 0.1, 1.114, 1, 0, 0, 0]}),
    "beyond the reach of one arm": (
        "ab1",
        {
            "plate": {"shape": {"type": "box", "size": [0.3, 0.25, 0.03]}, "mass": 3.0},
            "plate_pose": [0.65, 0.6, 1.109, 1, 0, 0, 0],
            "cup": {"position": [0.08, 0], "radius": 0.02, "max_force": 25},
        },
    ),
}


def posted(name: str, more: dict[str, Any]) -> dict[str, Any]:
    return json.loads((TASKS / f"{name}.json").read_bytes()) | more


@pytest.fixture(scope="module", params=among(UNSOLVED, ["too weak a cup"]))
def unsolved(request: pytest.FixtureRequest, shelf: PlanShelf) -> tuple[dict[str, Any], Plan]:
    body = posted(*UNSOLVED[request.param])
    return body, shelf.plan(read_task(body))


@pytest.mark.slow
def test_every_remedy_stands_a_plan_of_the_changed_task(unsolved: tuple[dict[str, Any], Plan]) -> None:
    """Applied to the task as it was posted, and planned like any task."""
    body, plan = unsolved
    assert plan.explanation.remedies
    remedies = plan.explanation.remedies
    for remedy in sample(remedies[:1], remedies):
        again = solve(read_task(changed(body, remedy.patch)))
        assert (again.outcome, again.certificate and again.certificate.passed) == ("solved", True), remedy.sentence
        assert again.statistics.reserve is not None
        assert (again.statistics.reserve.value, largest_load(again)[0]) == (remedy.reserve, remedy.largest_force)


def test_a_remedy_fits_the_task_as_posted_and_as_the_plan_states_it(unsolved: tuple[dict[str, Any], Plan]) -> None:
    body, plan = unsolved
    for remedy in plan.explanation.remedies or ():
        short, full = (read_task(changed(task, remedy.patch)) for task in (body, write_task(plan.task)))
        assert isinstance(short, PlateLiftTask)
        filled = short.model_copy(update={"plate": full.plate}) if isinstance(full, PlateLiftTask) else short
        assert filled == full


def test_the_summary_names_the_first_remedy(unsolved: tuple[dict[str, Any], Plan]) -> None:
    _, plan = unsolved
    assert plan.explanation.remedies
    assert plan.explanation.summary.endswith(plan.explanation.remedies[0].sentence)


def test_remedies_are_left_out_where_nobody_wants_them() -> None:
    plan = solve(read_task(posted("pb1_weak_cup", {"options": {"remedies": False}})))
    assert plan.explanation.remedies is None


@pytest.mark.parametrize("name", among(("lid_too_heavy", "pb1_weak_cup"), ["lid_too_heavy"]))
@pytest.mark.slow
def test_a_proof_is_told_before_remedies_and_given_them_later_as_it_would_have_been_then(
    name: str, shelf: PlanShelf
) -> None:
    told: list[Plan] = []
    solver, task = TaskSolver(ShippedCells(), load_tools(), shelf.handovers), read_task(posted(name, {}))

    def enough(plan: Plan) -> bool:
        told.append(plan)
        return True

    whole, early = solver.solve(task), solver.solve(task, on_certified=enough)
    assert told == [early]
    assert early.certificate is not None
    assert early.certificate.passed
    assert early.explanation.remedies is None
    assert early.digest != whole.digest
    assert solver.completed(Plan.read(early.write())).digest == whole.digest


AB1 = read_task(posted("ab1", {}))

# Plans that fail in physics, with a physics that is told what to carry out.


CARRIED_OUT: dict[str, Callable[[PlateLiftTask], bool]] = {
    "anything else": lambda task: write_task(task) != write_task(AB1),
    "more kept back": lambda task: task.options.minimise == "risk",
    "a stronger cup": lambda task: task.cup.max_force > 20.5,
    "nothing": lambda task: False,
}
"""Tasks whose plans physics carries out."""


@pytest.mark.parametrize("case", among(CARRIED_OUT, ["anything else"]))
@pytest.mark.slow
def test_a_plan_that_fails_in_physics_is_given_what_physics_carries_out(case: str, shelf: PlanShelf) -> None:
    carried_out = CARRIED_OUT[case]
    plan, simulated = with_physics(shelf, carried_out, {})
    failure, remedies = failure_of(plan.simulation), plan.explanation.remedies
    assert failure is not None
    assert f"{failure.words()}." in plan.explanation.summary
    assert remedies is not None
    changes = [read_task(changed(write_task(plan.task), remedy.patch)) for remedy in remedies]
    assert all(remedy.simulated and carried_out(task) for remedy, task in zip(remedies, changes, strict=True))
    # Each of them was seen there, and whatever else was seen there failed.
    seen = [write_task(task) for task in simulated if carried_out(task)]
    assert sorted(map(str, seen)) == sorted(str(write_task(task)) for task in changes)
    assert plan.outcome == "solved"
    assert len(remedies) <= MOST_SIMULATED
    if remedies:
        assert plan.explanation.summary.endswith(remedies[0].sentence)
    else:
        assert case != "anything else"
        assert "Tried in vain: more of every limit kept back, " in plan.explanation.summary
        assert len(simulated) > 2


@pytest.mark.parametrize(("fails", "options"), [(False, {}), (True, {"remedies": False})])
def test_physics_is_asked_once_where_it_carries_a_plan_out_or_nobody_wants_remedies(
    fails: bool, options: dict[str, Any], shelf: PlanShelf
) -> None:
    plan, simulated = with_physics(shelf, lambda task: not fails, options)
    assert (plan.explanation.remedies, len(simulated)) == (None, 1)
    assert (failure_of(plan.simulation) is not None) == fails


def with_physics(
    shelf: PlanShelf, carried_out: Callable[[PlateLiftTask], bool], options: dict[str, Any]
) -> tuple[Plan, list[PlateLiftTask]]:
    """Plan AB1 with a physics that carries out some tasks; return the plan, and the tasks it was asked about."""
    a_plan, asked = shelf.plan(AB1), list[PlateLiftTask]()
    assert isinstance(AB1, PlateLiftTask)
    assert isinstance(a_plan.simulation, LiftSimulation)
    slipped = a_plan.simulation.model_copy(update={"outcome": "slipped", "cause": "the stick slid"})

    def simulate(plan: Plan, *_: object) -> LiftSimulation:
        assert isinstance(plan.task, PlateLiftTask)
        asked.append(plan.task)
        assert isinstance(a_plan.simulation, LiftSimulation)
        return a_plan.simulation if carried_out(plan.task) else slipped

    solver = TaskSolver(
        ShippedCells(), {}, plan=lambda task, *_, **__: a_plan.model_copy(update={"task": task}),
        certify=lambda *_: Certificate(passed=True, checks=[]), simulate=simulate,
    )  # fmt: skip
    body = write_task(AB1)
    return solver.solve(read_task({**body, "options": {**body["options"], **options}})), asked


@pytest.mark.parametrize("name", ["ab1", "domino_pile"])
@pytest.mark.parametrize("options", [{}, {"options": {"reserve": 0.25, "simulate": True}}])
def test_more_is_kept_back_than_the_task_asks_for(name: str, options: dict[str, Any]) -> None:
    body = {member: value for member, value in posted(name, {}).items() if member != "options"} | options
    task = read_task(body)
    changes = [*more_kept_back(task)]
    assert changes
    for change in changes:
        other = change.applied(task)
        assert other is not None
        assert read_task(changed(body, change.patch)) == other
        more = other.options.reserve > task.options.reserve
        assert more or (isinstance(other, PlateLiftTask) and other.options.minimise == "risk")
        # Nothing but that has changed, and nothing is offered twice.
        assert {**write_task(other), "options": None} == {**write_task(task), "options": None}
        assert change.sentence not in [again.sentence for again in more_kept_back(other)]


# The search for them, with planners that are told what to answer.


def force(newtons: float) -> TaskChange:
    patch = (PatchOperation(op="add", path="/cup/max_force", value=newtons),)
    return TaskChange("cup_force", f"{newtons:g} N.", patch)


@pytest.fixture(scope="module")
def a_plan(shelf: PlanShelf) -> Plan:
    return shelf.plan(AB1)


def found(kinds: Sequence[Sequence[TaskChange | None]], helps: Any, plan: Plan, steps: int = 1000) -> list[Remedy]:
    def attempt(task: Any) -> Plan | None:
        return plan if helps(task.cup.max_force) else None

    return find_remedies([iter(kind) for kind in kinds], attempt, AB1, Effort(steps), silent)


def test_only_what_was_planned_and_certified_is_told(a_plan: Plan) -> None:
    told = found([[force(21.0), force(22.0), force(23.0)]], lambda newtons: newtons == 22.0, a_plan)
    assert [remedy.sentence for remedy in told] == ["22 N."]
    assert (told[0].outcome, told[0].certified) == ("solved", True)


def test_kinds_take_turns_and_the_smallest_change_of_each_comes_first(a_plan: Plan) -> None:
    kinds = [[force(float(10 * kind + number)) for number in range(1, 10)] for kind in range(2, 5)]
    told = [remedy.sentence for remedy in found(kinds, lambda newtons: True, a_plan)]
    assert len(told) == MOST_REMEDIES
    assert told == ["21 N.", "22 N.", "31 N.", "32 N.", "41 N."]
    alone = found(kinds[:1], lambda newtons: True, a_plan)
    assert len(alone) == MOST_OF_A_KIND


def test_a_kind_that_is_still_looking_keeps_nobody_waiting(a_plan: Plan) -> None:
    kinds = [[None, None, force(21.0)], [force(31.0), force(32.0)]]
    assert [remedy.sentence for remedy in found(kinds, lambda newtons: True, a_plan, steps=12)] == ["31 N.", "32 N."]
    assert len(found(kinds, lambda newtons: True, a_plan)) == 3


def test_the_search_ends_with_its_steps(a_plan: Plan) -> None:
    def endless() -> Iterator[TaskChange]:
        while True:
            yield force(30.0)

    effort, asked = Effort(29, plan=7), []
    told = find_remedies([endless(), endless()], lambda task: asked.append(task), AB1, effort, silent)
    assert told == []
    assert len(asked) == 4


def test_progress_is_told_in_steps_and_may_stop_the_search(a_plan: Plan) -> None:
    class Enough(Exception):
        pass

    reports: list[Report] = []

    def progress(report: Report, /) -> None:
        reports.append(report)
        if len(reports) == 2:
            raise Enough

    with pytest.raises(Enough):
        find_remedies([iter([force(30.0), force(31.0)])], lambda _: a_plan, AB1, Effort(100, plan=7), progress)
    assert [(report.stage, report.done, report.total) for report in reports] == [
        ("remedies", 0, 100),
        ("remedies", 7, 100),
    ]


def test_a_scene_that_is_refused_is_no_change() -> None:
    outside = TaskChange("cup_place", "", (PatchOperation(op="add", path="/cup/position", value=[0.3, 0.0]),))
    assert isinstance(AB1, PlateLiftTask)
    assert outside.applied(AB1) is not None
    assert outside.built(AB1, build_scene) is None
    negative = TaskChange("cup_force", "", (PatchOperation(op="add", path="/cup/max_force", value=-1.0),))
    assert negative.applied(AB1) is None
