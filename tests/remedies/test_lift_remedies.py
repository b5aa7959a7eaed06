"""Remedies of plate lifts: what is told to help does help whoever posts it, and nothing else is told."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import count
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
from planners.remedies.change import WORK, Effort, TaskChange, more_kept_back, put
from planners.remedies.find_remedies import (
    LESS,
    MOST_HALVINGS,
    MOST_IN_VAIN,
    MOST_OF_A_KIND,
    MOST_REMEDIES,
    MOST_SIMULATED,
    MOST_STEPS,
    MOST_TRIES,
    STEPS_OF_A_PLAN,
    STEPS_OF_A_SCENE,
    STEPS_OF_PAIRS,
    PlanMemory,
    find_remedies,
    why_none,
)
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
    "thin, and its cup too weak where it sits": (
        "ab1",
        {
            "plate": {"shape": {"type": "box", "size": [0.4, 0.3, 0.01]}, "mass": 1.5},
            "plate_pose": [0.4, 0.0, 1.099, 1, 0, 0, 0],
            "cup": {"position": [0, 0], "radius": 0.02, "max_force": 12},
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
    # Each of them was seen there, and whatever else was seen there failed, or is more of what is told.
    seen = [write_task(task) for task in simulated if carried_out(task)]
    told, stated = [write_task(task) for task in changes], write_task(plan.task)
    assert all(task in seen for task in told)
    changes_of_told = [differing(stated, task) for task in told]
    assert all(task in told or differing(stated, task) in changes_of_told for task in seen)
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


def differing(one: Any, other: Any, at: str = "") -> set[str]:
    """Return the JSON pointers at which two tasks differ; lists are compared as wholes."""
    if isinstance(one, dict) and isinstance(other, dict):
        names = one.keys() | other.keys()
        return set().union(*(differing(one.get(name), other.get(name), f"{at}/{name}") for name in names))
    return set() if one == other else {at}


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
    effort = Effort(steps)

    def attempt(task: Any) -> Plan | None:
        effort.take(6)
        came = helps(task.cup.max_force)
        return plan if came is True else came or None

    return find_remedies([iter(kind) for kind in kinds], PlanMemory(attempt, effort), AB1, effort, silent)


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
    kinds = [[None, force(21.0)], [force(31.0), force(32.0)]]
    assert [remedy.sentence for remedy in found(kinds, lambda newtons: True, a_plan, steps=6)] == ["31 N."]
    assert len(found(kinds, lambda newtons: True, a_plan)) == 3


def test_what_is_asked_in_vain_is_asked_on_only_where_nothing_else_helps(a_plan: Plan) -> None:
    kinds = [[None, None, force(21.0)], [force(31.0)]]
    assert [each.sentence for each in found(kinds, lambda newtons: True, a_plan)] == ["31 N."]
    assert [each.sentence for each in found(kinds, lambda newtons: newtons < 30.0, a_plan)] == ["21 N."]


def test_what_is_planned_in_vain_is_planned_on_only_where_nothing_else_helps(a_plan: Plan) -> None:
    planned = list[float]()

    def helps(newtons: float) -> bool:
        planned.append(newtons)
        return newtons in fine

    kinds = [[force(31.0)], [force(20.0 + number) for number in range(1, MOST_TRIES + 1)]]
    fine = {31.0}
    found(kinds, helps, a_plan)
    assert planned == [31.0, *(20.0 + number for number in range(1, MOST_IN_VAIN + 1))]
    fine = {20.0 + MOST_TRIES}
    assert len(found(kinds, helps, a_plan)) == 1


def test_what_does_less_than_what_was_planned_in_vain_is_not_planned(a_plan: Plan) -> None:
    """Of one way the larger change does all that the smaller does; another way is another matter."""
    planned = list[float]()

    def helps(newtons: float) -> bool:
        planned.append(newtons)
        return newtons in fine

    sizes = ((40.0, "up"), (31.0, "up"), (22.0, "down"), (50.0, "up"))
    kinds = [[replace(force(newtons), way=way, size=newtons) for newtons, way in sizes]]
    fine = {50.0}
    assert [each.sentence for each in found(kinds, helps, a_plan)] == ["50 N."]
    assert planned == [40.0, 22.0, 50.0]
    # Where the larger one helps, the smaller one is planned, and told if it helps, too.
    fine = {31.0, 40.0}
    assert [each.sentence for each in found(kinds, helps, a_plan)] == ["31 N."]


def of_any_size(newtons: float, none: float = 20.0) -> TaskChange:
    return replace(force(newtons), way="up", size=newtons, none=none, of_size=of_any_size)


@pytest.mark.parametrize("enough", [20.5, 24.9, 30.0, 33.3, 40.0])
def test_a_change_that_costs_something_is_told_no_larger_than_about_what_it_takes(a_plan: Plan, enough: float) -> None:
    """Within a part of the way from what did not help, or changes nothing; what was in vain is not planned again."""
    planned = list[float]()

    def helps(newtons: float) -> bool:
        planned.append(newtons)
        return newtons >= enough

    told = found([[of_any_size(30.0), of_any_size(40.0)]], helps, a_plan)
    known = max([20.0, *(newtons for newtons in planned if newtons < enough)])
    assert [remedy.sentence for remedy in told] == [f"{min(each for each in planned if each >= enough):g} N."]
    assert len(planned) == len(set(planned)) <= 2 + MOST_HALVINGS
    least, first = min(each for each in planned if each >= enough), 30.0 if enough <= 30.0 else 40.0
    assert known < enough <= least
    begin = 20.0 if enough <= 30.0 else 30.0
    assert least - known <= max((first - begin) / 2**MOST_HALVINGS, 2 * LESS * least)


def test_a_smaller_change_comes_in_the_place_of_the_larger_and_keeps_nothing_else_from_being_told(a_plan: Plan) -> None:
    """Although its plan keeps less back, so that the larger one would be worth telling beside it."""
    reserve = a_plan.statistics.reserve
    assert reserve is not None

    def helps(newtons: float) -> Plan:
        kept = reserve.model_copy(update={"value": 0.01 * (newtons - 20.0)})
        return a_plan.model_copy(update={"statistics": a_plan.statistics.model_copy(update={"reserve": kept})})

    others = [[force(float(60 + number))] for number in range(MOST_REMEDIES - 1)]
    told = found([[of_any_size(40.0)], *others], helps, a_plan)
    assert [remedy.sentence for remedy in told] == ["25 N.", *(f"{60 + number} N." for number in range(len(others)))]


def test_nothing_smaller_is_planned_where_no_step_is_left_or_none_can_be(a_plan: Plan) -> None:
    assert [each.sentence for each in found([[of_any_size(40.0)]], lambda _: True, a_plan, steps=6)] == ["40 N."]
    known = of_any_size(40.0, none=39.0)
    assert [each.sentence for each in found([[known]], lambda _: True, a_plan)] == ["40 N."]


def test_the_search_ends_with_its_steps(a_plan: Plan) -> None:
    def endless() -> Iterator[TaskChange]:
        for newtons in count(30):
            yield force(float(newtons))

    effort, asked = Effort(29), []

    def attempt(task: Any) -> None:
        asked.append(task)
        effort.take(10)

    assert find_remedies([endless(), endless()], PlanMemory(attempt, effort), AB1, effort, silent) == []
    assert len(asked) == 3
    assert why_none(effort.tried) == "Tried in vain: a stronger cup."


def test_what_is_known_is_told_at_no_cost_and_when_no_step_is_left(a_plan: Plan) -> None:
    effort, asked = Effort(10), []

    def attempt(task: Any) -> Plan:
        asked.append(task.cup.max_force)
        effort.take(10)
        return a_plan

    plans = PlanMemory(attempt, effort)
    assert isinstance(AB1, PlateLiftTask)
    probe = force(40.0).applied(AB1)
    assert probe is not None
    assert plans(probe) is a_plan
    told = find_remedies([iter([force(30.0)]), iter([force(40.0), force(41.0)])], plans, AB1, effort, silent)
    assert [remedy.sentence for remedy in told] == ["40 N."]
    assert (asked, effort.spent) == ([40.0], 10)


def test_progress_is_told_in_steps_with_the_kind_that_is_tried_and_may_stop_the_search(a_plan: Plan) -> None:
    class Enough(Exception):
        pass

    reports: list[Report] = []
    effort = Effort(100)

    def progress(report: Report, /) -> None:
        reports.append(report)
        if len(reports) == 2:
            raise Enough

    def attempt(_: Any) -> Plan:
        effort.take(7)
        return a_plan

    with pytest.raises(Enough):
        find_remedies([iter([force(30.0), force(31.0)])], attempt, AB1, effort, progress)
    assert reports == [Report("remedies", 0, 100, "cup_force"), Report("remedies", 7, 100, "cup_force")]


# What is worth telling.


def better(plan: Plan, *, reserve: float = 1.0, force: float = 1.0) -> Plan:
    """Return a plan with so many times the reserve and the forces."""
    kept = plan.statistics.reserve
    assert kept is not None
    statistics = plan.statistics.model_copy(update={"reserve": kept.model_copy(update={"value": reserve * kept.value})})
    segments = [
        each.model_copy(
            update={
                "contacts": [contact.model_copy(update={"wrench": force * contact.wrench}) for contact in each.contacts]
            }
        )
        for each in plan.segments
    ]
    return plan.model_copy(update={"statistics": statistics, "segments": segments})


@pytest.mark.parametrize(
    ("plans", "told"),
    [
        ([{}, {}, {}], [21]),
        ([{}, {"reserve": 1.3}, {"reserve": 1.3}], [21, 22]),
        ([{}, {"reserve": 1.2}, {"reserve": 1.6}], [21]),
        ([{}, {"force": 0.7}, {}], [21, 22]),
        ([{}, {"force": 0.9}, {}], [21]),
    ],
)
def test_a_larger_change_of_the_same_way_is_told_where_its_plan_is_clearly_better(
    plans: list[dict[str, float]], told: list[int], a_plan: Plan
) -> None:
    """And once a larger one adds nothing, none still larger is planned."""
    came = {21.0 + number: better(a_plan, **each) for number, each in enumerate(plans)}
    stronger = [replace(force(newtons), way="stronger", size=newtons) for newtons in came]
    sentences = [f"{newtons} N." for newtons in told]
    assert [each.sentence for each in found([stronger], came.get, a_plan)] == sentences
    others = [replace(change, way=f"way {number}") for number, change in enumerate(stronger)]
    assert len(found([others], came.get, a_plan)) == len(plans)


def test_of_each_kind_the_smallest_comes_first_in_whatever_order_they_were_found(a_plan: Plan) -> None:
    changes = [replace(force(newtons), size=newtons) for newtons in (23.0, 21.0, 22.0)]
    told = found([changes, [force(31.0)]], lambda newtons: True, a_plan)
    assert [each.sentence for each in told] == ["21 N.", "22 N.", "23 N.", "31 N."]


def test_no_remedy_does_what_another_one_does_and_more(a_plan: Plan) -> None:
    one = force(21.0)
    more = TaskChange("two_changes", "Both.", (put("/cup/radius", 0.018), *one.patch))
    other = TaskChange("two_changes", "Other.", (put("/cup/radius", 0.018), *force(22.0).patch))
    for kinds in ([[more], [one], [other]], [[one], [other], [more]], [[more, other, one]]):
        told = {each.sentence for each in found(kinds, lambda newtons: True, a_plan)}
        assert told == {"21 N.", "Other."}


# What it costs.


def searched(plan_changed: Callable[..., Plan], body: dict[str, Any], failed: Plan) -> Plan:
    """Solve a task whose plan failed, with what plans the changed ones."""

    def plan(task: Any, *args: Any, persistent: bool = True, **more: Any) -> Plan:
        return failed.model_copy(update={"task": task}) if persistent else plan_changed(task, *args, **more)

    certify = lambda *_: Certificate(passed=True, checks=[])  # noqa: E731
    return TaskSolver(ShippedCells(), {}, plan=plan, certify=certify).solve(read_task(body))


@pytest.fixture(scope="module")
def under_roof(shelf: PlanShelf) -> Plan:
    return shelf.plan(read_task(posted("lid_under_roof", {"options": {"remedies": False}})))


def test_no_changed_task_is_planned_twice_and_a_probe_that_helps_is_told(a_plan: Plan, under_roof: Plan) -> None:
    planned = list[str]()

    def plan_changed(task: Any, *_: Any, **__: Any) -> Plan:
        planned.append(task.model_dump_json())
        outcome = "not_found" if task.obstacles else "solved"
        return a_plan.model_copy(update={"task": task, "outcome": outcome})

    plan = searched(plan_changed, posted("lid_under_roof", {}), under_roof)
    assert [each.sentence for each in plan.explanation.remedies or ()] == ["Take roof away."]
    assert len(planned) == len(set(planned)) > 5


def test_planners_that_work_without_end_are_stopped_after_so_much_work(under_roof: Plan) -> None:
    """Counted in what they report, on any machine alike."""
    reports, plans = 0, 0

    def endless(task: Any, scene: Any, progress: Any, *_: Any, **__: Any) -> Plan:
        nonlocal reports, plans
        plans += 1
        while True:
            reports += 1
            progress(Report("first motion", 0, 1))

    plan = searched(endless, posted("lid_under_roof", {}), under_roof)
    assert plan.explanation.remedies == []
    assert plans >= MOST_STEPS / STEPS_OF_A_PLAN
    assert WORK["first motion"] * reports <= MOST_STEPS + STEPS_OF_PAIRS + plans * WORK["first motion"]


def test_what_ends_at_once_leaves_steps_for_everything_else(under_roof: Plan) -> None:
    planned = list[str]()

    def hopeless(task: Any, *_: Any, **__: Any) -> Plan:
        planned.append(task.model_dump_json())
        return under_roof.model_copy(update={"task": task})

    searched(hopeless, posted("lid_under_roof", {"obstacles": []}), under_roof)
    first = len(planned)
    assert first > MOST_TRIES * 5
    assert first * STEPS_OF_A_SCENE < MOST_STEPS


def test_a_scene_that_is_refused_is_no_change() -> None:
    outside = TaskChange("cup_place", "", (PatchOperation(op="add", path="/cup/position", value=[0.3, 0.0]),))
    assert isinstance(AB1, PlateLiftTask)
    assert outside.applied(AB1) is not None
    assert outside.built(AB1, build_scene) is None
    negative = TaskChange("cup_force", "", (PatchOperation(op="add", path="/cup/max_force", value=-1.0),))
    assert negative.applied(AB1) is None
