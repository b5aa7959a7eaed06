"""Remedies of suction-tool tasks: what is told to help does help whoever posts it."""

from __future__ import annotations

import itertools
import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planners import read_task
from planners.cell.cell import ShippedCells
from planners.contract.problems import pad_beyond
from planners.contract.task_change import changed
from planners.contract.task_spec import CustomTool, SuctionToolTask, ToolCup, write_task
from planners.geometry.pose import from_pose7, to_pose7
from planners.plan.plan import Plan
from planners.plan.verdicts import Cause, Certificate
from planners.planning import TaskSolver
from planners.progress import silent
from planners.regrasp.suction.suction_hold import SuctionLimit
from planners.regrasp.suction.suction_poses import SuctionFault
from planners.remedies.change import TaskChange, moved_pose
from planners.remedies.tool_changes import CUP_REASONS, ToolChanges
from planners.scene.scene import build_scene
from planners.scene.shape_source import no_uploads
from planners.scene.suction_tool import load_tools, tool_descriptions
from planners.scene.tool_scene import SuctionToolScene
from tests.support.deep_bin import NAMES, PART, WALLS
from tests.support.plan_shelf import PlanShelf
from tests.support.samples import among, sample

TASKS = Path(__file__).resolve().parents[2] / "assets" / "tasks"
DIE = {
    "name": "die", "shape": {"type": "box", "size": [0.03, 0.03, 0.03]}, "mass": 0.05,
    "pose": [0.35, 0.28, 1.109, 1, 0, 0, 0], "goal_pose": [0.38, -0.05, 1.109, 1, 0, 0, 0],
}  # fmt: skip
UNSOLVED: dict[str, dict[str, Any]] = {
    "smaller than the pad": {"objects": [DIE], "options": {"simulate": False}},
    "under a roof": {},
    "too heavy for cup and hand": {
        "objects": [{**DIE, "mass": 3.0, "shape": {"type": "box", "size": [0.1, 0.1, 0.03]}}]
    },
}

BIN: dict[str, Any] = {"objects": [PART], "obstacles": WALLS}
UNSOLVED["into a deep bin"] = {**BIN, "tool": "long_symmetric", "options": {"simulate": False}}


def never(_: TaskChange) -> bool:
    """Find no plan."""
    return False


def posted(more: dict[str, Any]) -> dict[str, Any]:
    return json.loads((TASKS / "lid_under_roof.json").read_bytes()) | ({"obstacles": []} if more else {}) | more


@pytest.fixture(scope="module")
def solver(shelf: PlanShelf) -> TaskSolver:
    """Return what `planners.solve` asks, which finds a tool's handovers once and not for each task."""
    return TaskSolver(ShippedCells(), load_tools(), shelf.handovers)


@pytest.fixture(scope="module", params=among(UNSOLVED, ["too heavy for cup and hand"]))
def unsolved(request: pytest.FixtureRequest, solver: TaskSolver) -> tuple[dict[str, Any], Plan]:
    body = posted(UNSOLVED[request.param])
    return body, solver.solve(read_task(body))


@pytest.mark.slow
def test_every_remedy_stands_a_plan_of_the_changed_task(
    unsolved: tuple[dict[str, Any], Plan], solver: TaskSolver
) -> None:
    """Applied to the task as it was posted, and to the one that the plan states."""
    body, plan = unsolved
    assert plan.explanation.remedies
    remedies = plan.explanation.remedies
    for remedy in sample(remedies[:1], remedies):
        for task in (body, write_task(plan.task)):
            again = solver.solve(read_task(changed(task, remedy.patch)))
            assert (again.outcome, again.certificate and again.certificate.passed) == ("solved", True), remedy.sentence


def test_an_obstacle_that_is_named_is_changed_first(unsolved: tuple[dict[str, Any], Plan]) -> None:
    body, plan = unsolved
    assert plan.explanation.remedies
    assert (plan.explanation.remedies[0].kind == "obstacle") == bool(body["obstacles"])


@pytest.mark.parametrize("strong", [False, True])
@pytest.mark.slow
def test_an_object_that_is_too_heavy_is_made_as_light_as_cup_and_hand_bear(strong: bool, solver: TaskSolver) -> None:
    """First as heavy as the weaker of the two bears, to 10 g; whichever of them that is."""
    force = 400.0 if strong else 12.0
    tool = tool_descriptions()["short_asymmetric"].model_dump(mode="json")
    tool["cup"] |= {"max_force": force}
    task = read_task(posted({"objects": [{**DIE, "mass": 5.0}], "tool": tool, "options": {"remedies": False}}))
    assert isinstance(task, SuctionToolTask)
    scene, plan = build_scene(task), solver.solve(task)
    assert isinstance(scene, SuctionToolScene)
    kinds = [list(kind) for kind in ToolChanges(task, build_scene, plan, never).by_kind()]
    told = [change.patch[0].value for kind in kinds for change in kind if change and change.kind == "mass"]
    masses = [each for each in told if isinstance(each, float)]
    borne = min(force, max(scene.carry_force_limits.values()) - 9.81 * scene.tool.mass) / 9.81
    assert 0.0 <= borne - masses[0] < 0.01
    assert len(told) > 1
    assert told == sorted(masses, reverse=True)


@pytest.mark.slow
def test_all_changes_are_tasks_that_the_contract_takes(unsolved: tuple[dict[str, Any], Plan]) -> None:
    body, plan = unsolved
    task = read_task(body)
    assert isinstance(task, SuctionToolTask)
    for kind in ToolChanges(task, build_scene, plan, never).by_kind():
        for change in filter(None, kind):
            assert read_task(changed(body, change.patch)) == change.applied(task), change.sentence


def obstacle_changes(
    helps: Callable[[SuctionToolTask], bool], failed: Plan, **more: Any
) -> tuple[list[TaskChange], int]:
    """Return the changes of a bin's walls, and how many changed tasks were planned to find them.

    Args:
        helps: whether there is a plan of a changed task.
        failed: the plan that names what is changed.
        more: other members of the task.
    """
    task = read_task(posted(BIN | more))
    assert isinstance(task, SuctionToolTask)
    asked = list[SuctionToolTask]()

    def solves(change: TaskChange) -> bool:
        other = change.applied(task)
        assert other is not None
        asked.append(other)
        return helps(other)

    changes = ToolChanges(task, build_scene, failed, solves)._obstacles()
    return [change for change in changes if change is not None], len(asked)


def left_in(task: SuctionToolTask) -> set[str]:
    """Return the names of the obstacles."""
    return {each.name for each in task.obstacles}


def highest(task: SuctionToolTask, names: set[str]) -> float:
    """Return the height of the highest of some obstacles that are boxes [m]."""
    return max((each.shape.size[2] for each in task.obstacles if each.name in names), default=0.0)  # type: ignore[union-attr]


@pytest.fixture(scope="module")
def too_heavy(shelf: PlanShelf) -> Plan:
    """Return a plan that names no obstacle."""
    return shelf.plan(
        read_task(json.loads((TASKS / "lid_too_heavy.json").read_bytes()) | {"options": {"remedies": False}})
    )


HEIGHT = WALLS[0]["shape"]["size"][2]


@pytest.mark.parametrize(("enough", "told"), [(0.04, [0.05, 0.2]), (0.08, [0.1, 0.2]), (0.15, [0.2]), (0.22, [])])
def test_walls_that_are_in_the_way_together_are_taken_away_or_made_lower_together(
    enough: float, told: list[float], too_heavy: Plan
) -> None:
    """By the least that helps, and by the most; and where the most does not help, nothing less is planned."""
    changes, planned = obstacle_changes(lambda task: highest(task, NAMES) <= HEIGHT - enough, too_heavy)
    assert all(name in change.sentence for change in changes for name in NAMES)
    assert [step.op for step in changes[0].patch] == ["remove"] * len(WALLS)
    lower = [[step.value["shape"]["size"][2] for step in change.patch] for change in changes[1:]]  # type: ignore[index, call-overload]
    assert lower == [[pytest.approx(HEIGHT - each)] * len(WALLS) for each in told]
    # One after the other, the least number of them by halving, and the most and what is less of one way.
    assert planned <= 3 + len(WALLS) + (3 if told else 1)
    for change in changes:
        assert change.built(read_task(posted(BIN)), build_scene) is not None  # type: ignore[arg-type]


def test_a_wall_that_is_in_the_way_alone_is_changed_alone(too_heavy: Plan) -> None:
    """What takes it away is known first."""
    wall = {"wall_left"}
    changes, _ = obstacle_changes(lambda task: highest(task, wall) <= HEIGHT - 0.08, too_heavy)
    assert [each.sentence.split(" by ")[0] for each in changes[:1]] == ["Take wall_left away."]
    assert [highest(each.applied(read_task(posted(BIN))), wall) for each in changes[1:]] == [  # type: ignore[arg-type]
        pytest.approx(HEIGHT - 0.1),
        pytest.approx(HEIGHT - 0.2),
    ]


NOT_ABOUT_A_CUP = {SuctionFault.NOT_CLOSED, SuctionFault.DOWN, SuctionLimit.PUSH}
"""No cup sits better on what is not closed, holds from below, or pushes."""


def test_every_reason_of_a_cup_leads_to_another_cup_unless_none_helps() -> None:
    reasons = {*SuctionFault, *SuctionLimit}
    led = {reason for reason in reasons if any(words in reason.value for words in CUP_REASONS)}
    assert reasons - led == NOT_ABOUT_A_CUP


def changes_of(failed: Plan, **more: Any) -> list[TaskChange]:
    """Return all changes of a task that come without planning, where nothing helps."""
    task = read_task(posted({"obstacles": []}) | more)
    assert isinstance(task, SuctionToolTask)
    kinds = ToolChanges(task, build_scene, failed, never).by_kind()
    return [change for kind in kinds for change in kind if change is not None]


@pytest.mark.parametrize("kappa", [0.02, None])
def test_another_cup_is_as_stiff_as_is_stated_or_as_its_force_makes_it(kappa: float | None, too_heavy: Plan) -> None:
    tool = tool_descriptions()["long_symmetric"].model_dump(mode="json")
    tool["cup"] = {"radius": 0.0175, "max_force": 20.0} | ({} if kappa is None else {"kappa": kappa})
    failed = saying(too_heavy, "The object is heavier than the cup bears.")
    changes = changes_of(failed, tool=tool)
    cups = [read_cup(change) for change in changes if change.kind in ("cup_force", "cup_radius")]
    assert len(cups) > 2
    for cup in cups:
        assert cup.kappa == pytest.approx(kappa or 0.5 * np.sqrt(2.0) * cup.max_force / np.pi)


@pytest.mark.parametrize("name", ["long_symmetric", "carton_lifter"])
def test_the_rim_of_a_larger_cup_is_among_the_shapes_that_must_touch_nothing(name: str, too_heavy: Plan) -> None:
    tool = tool_descriptions()[name].model_dump(mode="json")
    failed = saying(too_heavy, "No flat place of the object is as large as the pad.")
    radii = []
    for change in changes_of(failed, tool=tool, tool_pose=[0.5, -0.6, 1.094, 1, 0, 0, 0]):
        if change.kind == "cup_radius":
            (step,) = change.patch
            other = CustomTool.model_validate(step.value)
            radii.append(other.cup.radius)
            assert pad_beyond(other) < 1e-9
    assert max(radii) > tool["cup"]["radius"] > min(radii)


def read_cup(change: TaskChange) -> ToolCup:
    """Return the cup of the tool that a change puts in."""
    (step,) = change.patch
    assert isinstance(step.value, dict)
    return ToolCup.model_validate(step.value["cup"])


def saying(plan: Plan, reason: str, where: str = "", summary: str = "") -> Plan:
    """Return a plan that was not found for one reason alone."""
    cause = Cause(reason=reason, where=where, needed=None, available=None, unit=None)
    explanation = plan.explanation.model_copy(update={"causes": [cause], "summary": summary})
    return plan.model_copy(update={"explanation": explanation})


def test_what_is_proven_not_to_be_moved_is_not_left_out_to_help(too_heavy: Plan) -> None:
    """Its name begins as that of another one does, which may be left out."""
    objects = [{**DIE, "name": "box_1"}, {**DIE, "name": "box_10", "pose": [0.35, 0.4, 1.109, 1, 0, 0, 0],
                "goal_pose": [0.35, -0.4, 1.109, 1, 0, 0, 0]}]  # fmt: skip
    assert too_heavy.outcome == "infeasible"
    failed = saying(too_heavy, "The object is heavier than the cup bears.", "box_1")
    left_out = [change.sentence for change in changes_of(failed, objects=objects) if change.kind == "object_aside"]
    assert len(left_out) == 1
    assert "box_10" in left_out[0]


def test_what_stands_on_something_is_not_moved_alone_and_goes_with_it(too_heavy: Plan) -> None:
    size = {"type": "box", "size": [0.1, 0.1, 0.2]}
    post = {"name": "post", "shape": size, "pose": [0.6, 0.3, 1.194, 1, 0, 0, 0]}
    roof = {"name": "roof", "shape": {"type": "box", "size": [0.3, 0.3, 0.02]}, "pose": [0.6, 0.3, 1.304, 1, 0, 0, 0]}
    alone = {"name": "alone", "shape": size, "pose": [0.6, -0.3, 1.194, 1, 0, 0, 0]}
    failed = saying(too_heavy, "post, roof and alone would be touched.")
    task = read_task(posted({"obstacles": [post, roof, alone]}))
    assert isinstance(task, SuctionToolTask)
    found = list(ToolChanges(task, build_scene, failed, never)._named_obstacles())
    kept = [{each.name for each in other.obstacles} for change in found if change and (other := change.applied(task))]
    moved = [change.sentence for change in found if change and change.patch[0].op == "replace"]
    assert moved
    assert all("alone" in sentence for sentence in moved)
    assert {"alone"} in kept
    assert {"post", "alone"} in kept
    assert {"roof", "alone"} not in kept


@pytest.mark.parametrize(("enough", "offered"), [(70.0, 2), (200.0, 1), (1e3, 0)])
def test_fingers_press_no_harder_than_helps(enough: float, offered: int, too_heavy: Plan) -> None:
    """More than what the plan tells to be missing, less than the gripper's most; what does not help is not offered."""
    task = read_task({"kind": "suction_tool", "objects": [PART]})
    assert isinstance(task, SuctionToolTask)
    most = build_scene(task).cell.gripper("left").force_max  # type: ignore[union-attr]
    missing = Cause(reason="The tool needs a harder squeeze.", needed=48.0, available=41.0, unit="N", where="part")
    failed = too_heavy.model_copy(
        update={"explanation": too_heavy.explanation.model_copy(update={"causes": (missing,)})}
    )
    asked = list[float]()

    def helps(change: TaskChange) -> bool:
        other = change.applied(task)
        assert other is not None
        asked.append(other.grip_force_limit)
        return other.grip_force_limit >= enough

    changes = [each for each in ToolChanges(task, build_scene, failed, helps)._limits(alone=True) if each is not None]
    assert asked[0] == most
    assert all(task.grip_force_limit + 7.0 < force <= most for force in asked)
    tried = sorted(asked)
    helping = [force for force in tried if force >= enough]
    assert [change.applied(task).grip_force_limit for change in changes] == sorted({*helping[:1], *helping[-1:]})  # type: ignore[union-attr]
    assert len(changes) == offered
    # It may help beside another change.
    pairs = itertools.chain(*ToolChanges(task, build_scene, failed, helps).in_pairs())
    assert any(step.value == most for pair in pairs for step in pair.patch if step.path == "/grip_force_limit")


def test_of_two_changes_at_once_both_are_made(too_heavy: Plan) -> None:
    """Although several kinds of changes write the whole tool, or the whole pose of an object."""
    turned = from_pose7((0.35, 0.28, 1.109, 3.0, 0.0, 0.0, 1.0))
    task = read_task({"kind": "suction_tool", "objects": [DIE, {**DIE, "name": "other", "pose": to_pose7(turned)}]})
    assert isinstance(task, SuctionToolTask)
    task = task.model_copy(update={"objects": task.objects[1:]})
    explanation = too_heavy.explanation.model_copy(
        update={"summary": "other is heavier than the cup bears.", "causes": []}
    )
    failed = too_heavy.model_copy(update={"explanation": explanation, "task": task, "outcome": "not_found"})
    pairs = [*itertools.chain(*ToolChanges(task, build_scene, failed, never).in_pairs())]
    told = Counter[tuple[str, ...]]()
    for pair in pairs:
        made = pair.applied(task)
        assert isinstance(made, SuctionToolTask)
        object_, tool = made.objects[0], made.tool
        T_start, T_goal = (from_pose7(pose) for pose in (object_.pose, object_.goal_pose))
        before, goal_before = (from_pose7(pose) for pose in (task.objects[0].pose, task.objects[0].goal_pose))
        done = {
            "pulls with": isinstance(tool, CustomTool) and tool.cup.max_force > 20.0,
            "mm radius": isinstance(tool, CustomTool) and tool.cup.radius != 0.0175,
            "Move other": not np.allclose(T_start[:2, 3], before[:2, 3], atol=1e-5),
            "Turn other": not np.allclose(T_start[:3, :3], before[:3, :3], atol=1e-5),
            "Move the goal": not np.allclose(T_goal[:2, 3], goal_before[:2, 3], atol=1e-5),
            "Turn the goal": not np.allclose(T_goal[:3, :3], goal_before[:3, :3], atol=1e-5),
        }
        said = tuple(words for words in done if words in pair.sentence)
        assert [words for words in done if done[words]] == [*said], pair.sentence
        told[said] += 1
    for kinds in (("pulls with", "mm radius"), ("Move other", "Turn other"), ("Move the goal", "Turn the goal")):
        assert told[kinds] > 1


@pytest.mark.parametrize("short", [True, False])
def test_fingers_that_hold_with_less_kept_back_than_is_asked_for_are_told_once_nothing_else_helps(
    short: bool, too_heavy: Plan
) -> None:
    """With planners that are told what to answer: as any plan may keep less back, so may that of a changed task."""
    task = read_task({"kind": "suction_tool", "objects": [PART]})
    assert isinstance(task, SuctionToolTask)
    most = build_scene(task).cell.gripper("left").force_max  # type: ignore[union-attr]
    reason = "The tool needs a harder squeeze." if short else "Something else."
    cause = Cause(reason=reason, needed=48.0, available=41.0, unit="N", where="part")
    explanation = too_heavy.explanation.model_copy(update={"causes": [cause], "cup_place": None})
    failed = too_heavy.model_copy(update={"explanation": explanation, "task": task, "outcome": "not_found"})

    def plan(changed: SuctionToolTask, *_: Any, persistent: bool, **__: Any) -> Plan:
        holds = persistent and changed.grip_force_limit == most
        return failed.model_copy(update={"outcome": "solved" if holds else "not_found", "task": changed})

    solver = TaskSolver(
        ShippedCells(), load_tools(), plan=plan, certify=lambda *_: Certificate(passed=True, checks=[])
    )  # fmt: skip
    remedies = solver._with_remedies(failed, no_uploads, silent).explanation.remedies
    assert remedies is not None
    assert [remedy.patch[0].value for remedy in remedies] == ([most] if short else [])


def test_of_many_obstacles_those_next_to_start_and_goal_are_tried(too_heavy: Plan) -> None:
    """However many stand elsewhere."""
    away = [
        {
            "name": f"far{k}",
            "shape": {"type": "box", "size": [0.02, 0.02, 0.1]},
            "pose": [0.75, 0.1 * k, 1.144, 1, 0, 0, 0],
        }
        for k in range(5)
    ]
    changes, planned = obstacle_changes(
        lambda task: not left_in(task) & NAMES, too_heavy, obstacles=[*away, *BIN["obstacles"]]
    )
    assert planned <= 3 + len(WALLS) + 1
    assert all(name in change.sentence for change in changes for name in NAMES)
    assert not any(other["name"] in change.sentence for change in changes for other in away)


def test_a_pose_moved_and_turned_keeps_its_height_and_its_axis() -> None:
    pose = (0.3, 0.2, 1.1, 0.96, 0.1, -0.2, 0.15)
    moved = from_pose7(tuple(moved_pose(pose, np.array([0.1, -0.2]), 0.7)))  # pyright: ignore[reportArgumentType]
    T = from_pose7(pose)
    assert moved[:3, 3] == pytest.approx([0.4, 0.0, 1.1])
    assert moved[2, :3] == pytest.approx(T[2, :3])
    turned = moved[:3, :3] @ T[:3, :3].T
    assert np.degrees(np.arctan2(turned[1, 0], turned[0, 0])) == pytest.approx(np.degrees(0.7))
