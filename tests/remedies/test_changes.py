"""Changes of tasks: what is lowered stands where it stood, what hangs is raised, what is far off comes nearer."""

from __future__ import annotations

import itertools
import json
import math
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planners import read_task, solve
from planners.cell.cell import load_cell
from planners.contract.task_spec import Obstacle, PlateLiftTask, SuctionToolTask
from planners.geometry.pose import from_pose7
from planners.graph.rejections import CAPACITY
from planners.manipulation.lift_attempts import NOT_WITHIN_TOLERANCES
from planners.manipulation.lift_settings import LiftSettings
from planners.plan.verdicts import Cause, PlanningOutcome, Remedy
from planners.progress import silent
from planners.remedies.change import Effort, TaskChange, obstacle_out_of_the_way, put, told_cup_place
from planners.remedies.find_remedies import in_vain, why_none, with_cup_at
from planners.remedies.kinds import KINDS
from planners.remedies.lift_changes import LiftChanges
from planners.remedies.tool_changes import ToolChanges
from planners.scene.scene import build_scene
from tests.support.plan_shelf import PlanShelf
from tests.support.samples import among

TASKS = Path(__file__).resolve().parents[2] / "assets" / "tasks"
TOP = 1.094
BOX = {"type": "box", "size": [0.1, 0.2, 0.3]}
SHAPES = [
    BOX,
    {"type": "cylinder", "radius": 0.05, "height": 0.3},
    {"type": "prism", "outline": [[0, 0], [0.1, 0], [0, 0.1]], "height": 0.3},
]


def posted(name: str, **members: Any) -> Any:
    return read_task(json.loads((TASKS / f"{name}.json").read_bytes()) | members)


def heights(obstacle: Obstacle, shape: Any) -> tuple[float, float]:
    """Return bottom and top [m]."""
    half = 0.5 * (shape["size"][2] if shape["type"] == "box" else shape["height"])
    return obstacle.pose[2] - half, obstacle.pose[2] + half


def changed_heights(shape: dict[str, Any], z: float) -> list[tuple[float, float]]:
    obstacle = Obstacle.model_validate({"name": "it", "shape": shape, "pose": [0.5, 0.1, z, 1, 0, 0, 0]})
    changes = obstacle_out_of_the_way(0, obstacle, from_pose7(obstacle.pose), TOP)
    others = [Obstacle.model_validate(change.patch[0].value) for change in changes]
    assert all(other.pose[:2] == obstacle.pose[:2] for other in others)
    return [heights(other, other.shape.model_dump(mode="json")) for other in others]


@pytest.mark.parametrize("shape", SHAPES)
def test_what_stands_is_made_lower_and_stays_on_the_table(shape: dict[str, Any]) -> None:
    changed = changed_heights(shape, TOP + 0.15)
    assert len(changed) > 1
    tops = [top for _, top in changed]
    assert [bottom for bottom, _ in changed] == pytest.approx([TOP] * len(changed))
    assert all(TOP < lower < upper for upper, lower in zip([TOP + 0.3, *tops], tops, strict=False))


@pytest.mark.parametrize("shape", SHAPES)
def test_what_hangs_is_raised_as_it_is(shape: dict[str, Any]) -> None:
    changed = changed_heights(shape, TOP + 0.5)
    bottoms = [TOP + 0.35, *(bottom for bottom, _ in changed)]
    assert (np.diff(bottoms) > 0.0).all()
    assert [top - bottom for bottom, top in changed] == pytest.approx([0.3] * len(changed))


def test_two_changes_are_one_patch() -> None:
    one, other = (TaskChange(name, f"{name}.", (put(f"/{name}", 1),)) for name in ("here", "there"))
    both = one.then(other)
    assert (both.sentence, [step.path for step in both.patch]) == (
        "Both of these together: here. there.",
        ["/here", "/there"],
    )


def test_every_other_model_of_the_lifter_is_tried() -> None:
    for model in ("paper", "cable", "dexnet"):
        task = posted("ab1", lifter_model=model)
        assert isinstance(task, PlateLiftTask)
        changes = LiftChanges(task, build_scene, LiftSettings(), Effort(0), silent)
        changes._leaves_a_way = lambda *_, **__: True  # type: ignore[method-assign]
        others = [change.patch[0].value for change in changes._lifter()]
        assert sorted([model, *map(str, others)]) == ["cable", "dexnet", "paper"]


@pytest.mark.parametrize("place", [(-0.0, 0.02), (0.02, -0.0004)])
def test_no_place_on_a_plate_is_at_less_than_nothing(place: tuple[float, float]) -> None:
    assert "-0" not in told_cup_place(place)


def test_nobody_is_told_to_use_a_lifter_that_does_what_theirs_does() -> None:
    said = set()
    for model in ("paper", "cable", "dexnet"):
        task = posted("ab1", lifter_model=model)
        assert isinstance(task, PlateLiftTask)
        changes = LiftChanges(task, build_scene, LiftSettings(), Effort(0), silent)
        changes._leaves_a_way = lambda *_, **__: True  # type: ignore[method-assign]
        said |= {change.sentence.split(":")[0] for change in changes._lifter() if change is not None}
    assert len(said) == 3
    assert not any(one in other for one, other in itertools.permutations(said, 2))


@pytest.mark.parametrize("most", among([20.0, 24.3, 31.0, math.inf], [20.0, 31.0]))
def test_a_cup_is_made_no_stronger_than_what_the_cells_lifter_bears(most: float) -> None:
    shipped = load_cell("dual_ur3e_lift")
    cell = replace(shipped, lifter=replace(shipped.lifter, max_force=most))
    task = posted("ab1", plate={"shape": {"type": "box", "size": [0.3, 0.3, 0.04]}, "mass": 9.0})
    build = partial(build_scene, cells={cell.name: cell})
    changes = LiftChanges(task, build, LiftSettings(), Effort(10_000), silent)
    changes._leaves_a_way = lambda change, **_: change.built(task, build) is not None  # type: ignore[method-assign]
    forces = [float(change.patch[0].value) for change in changes._cup_force()]  # type: ignore[arg-type]
    assert bool(forces) == (most > task.cup.max_force)
    assert all(task.cup.max_force < force <= most for force in forces)
    # Nor does the search for its best place ask for more.
    for change in itertools.islice(changes._best_cup_places(), 1):
        assert change.built(task, build) is not None


def test_nobody_is_asked_to_know_a_plate_exactly() -> None:
    task = posted("ab1")
    assert isinstance(task, PlateLiftTask)
    changes = LiftChanges(task, build_scene, LiftSettings(), Effort(0), silent)
    changes._leaves_a_way = lambda *_, **__: True  # type: ignore[method-assign]
    plates = [task.plate, *(change.applied(task).plate for change in changes._tolerances())]  # type: ignore[union-attr]
    for before, after in itertools.pairwise(plates):
        assert 0.0 < after.mass_tolerance < before.mass_tolerance
        assert 0.0 < after.com_tolerance < before.com_tolerance


def test_a_board_under_a_plate_is_as_large_as_it_is() -> None:
    thin = {"shape": {"type": "box", "size": [0.3, 0.2, 0.012]}, "mass": 2.0}
    task = posted("ab1", plate=thin, plate_pose=[0.3, 0, TOP + 0.006, 0.9659258, 0, 0, 0.258819])
    assert isinstance(task, PlateLiftTask)
    changes = LiftChanges(task, build_scene, LiftSettings(), Effort(0), silent)
    scene = changes._on_board(0.03).built(task, build_scene)
    assert scene is not None
    assert scene.support is not None
    assert scene.support_top == pytest.approx(TOP + 0.03)
    assert scene.support.solid.surface()[0][:, :2].max(axis=0) == pytest.approx([0.15, 0.1])


def thin_plate(thickness: float, *, beyond: float | None) -> Any:
    """Return the task of a thin plate on a board that reaches so far beyond it, or on the bare table."""
    options = {"remedies": False, "simulate": False, "contact_density": 0.25, "hold_density": 0.5}
    plate = {"shape": {"type": "box", "size": [0.3, 0.3, thickness]}, "mass": 2.0}
    if beyond is None:
        return posted("ab1", plate=plate, plate_pose=[0.3, 0, TOP + 0.5 * thickness, 1, 0, 0, 0], options=options)
    side = 0.3 + 2.0 * beyond
    support = {"shape": {"type": "box", "size": [side, side, 0.05]}, "pose": [0.3, 0, TOP + 0.025, 1, 0, 0, 0]}
    pose = [0.3, 0, TOP + 0.05 + 0.5 * thickness, 1, 0, 0, 0]
    return posted("ab1", plate=plate, support=support, plate_pose=pose, options=options)


@pytest.mark.parametrize("beyond", [None, 0.02])
def test_a_plate_too_thin_for_the_stick_is_told_so_in_millimetres(beyond: float | None) -> None:
    plan = solve(thin_plate(0.012, beyond=beyond))
    cause = plan.explanation.causes[0]
    assert plan.outcome == "not_found"
    assert (cause.needed, cause.available, cause.unit) == (pytest.approx(0.014), pytest.approx(0.012), "m")
    assert "14 mm" in plan.explanation.summary
    assert "board under it" in plan.explanation.summary or beyond is not None
    assert "board that is as large" in plan.explanation.summary or beyond is None


def test_a_plate_too_thin_for_any_board_is_told_which_tip_would_have_room_and_which_plate() -> None:
    told = solve(thin_plate(0.008, beyond=0.0)).explanation.summary
    assert "helps" not in told
    # A tip of r beside a side of 8 mm, 1 mm below its top, 3 mm off the board's edge: (r + 3)² = r² + 7².
    assert f"at most {math.floor(10 * (7.0**2 - 3.0**2) / 6.0) / 10:g} mm" in told
    # The tip of 10 mm: 13² = 10² + (t - 1)².
    enough = math.floor(10 * (math.sqrt(13.0**2 - 10.0**2) + 1.0)) / 10 + 0.1
    assert f"plates of {enough:g} mm and more" in told


@pytest.mark.parametrize("more", [-0.1, 0.0])
def test_a_plate_as_thick_as_is_told_has_room_on_a_board_and_a_thinner_one_has_not(more: float) -> None:
    told = solve(thin_plate(0.008, beyond=0.0)).explanation.summary
    enough = re.search(r"plates of ([0-9.]+) mm and more", told)
    assert enough is not None
    changes = LiftChanges(
        thin_plate(1e-3 * (float(enough[1]) + more), beyond=0.0), build_scene, LiftSettings(), Effort(0), silent
    )
    assert changes._is_too_thin == (more < 0.0)


@pytest.mark.parametrize("beyond", [None, 0.02])
def test_a_plate_that_a_board_alone_does_not_help_is_given_another_cup_on_it(
    beyond: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = thin_plate(0.012, beyond=beyond)
    monkeypatch.setattr(LiftChanges, "_leaves_a_way", lambda *_, **__: True)
    changes = LiftChanges(task, build_scene, LiftSettings(), Effort(1000), silent)
    board = next(changes._board())
    assert board is not None
    places, forces = changes.in_pairs()
    for other, kind in ((next(places), "position"), (next(forces), "max_force")):
        assert other is not None
        assert other.patch == (*board.patch, other.patch[-1])
        assert other.patch[-1].path == f"/cup/{kind}"
        assert other.built(task, build_scene) is not None


def test_a_thin_plate_that_is_too_heavy_as_well_is_put_on_a_board_under_a_cup_that_bears_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    task = thin_plate(0.012, beyond=None)
    plate, cup = task.plate.model_copy(update={"mass": 7.0}), task.cup.model_copy(update={"max_force": 12.0})
    task = task.model_copy(update={"plate": plate, "cup": cup})
    monkeypatch.setattr(LiftChanges, "_leaves_a_way", lambda *_, **__: True)
    changes = LiftChanges(task, build_scene, LiftSettings(), Effort(1000), silent)
    assert changes._most_force_steps * 0.5 + cup.max_force > 9.81 * plate.mass
    (forces,) = changes.in_pairs()
    other = next(forces)
    assert other is not None
    assert [step.path for step in other.patch] == ["/support", "/plate_pose", "/cup/max_force"]


def test_a_plate_too_thin_for_any_board_is_given_no_cup_on_one() -> None:
    for beyond in (None, 0.02, 0.0):
        task = thin_plate(0.008, beyond=beyond)
        assert LiftChanges(task, build_scene, LiftSettings(), Effort(1000), silent).in_pairs() == []


def test_a_plate_too_thin_for_the_board_that_it_lies_on_is_put_on_one_no_larger_than_itself() -> None:
    task = thin_plate(0.012, beyond=0.02)
    assert isinstance(task, PlateLiftTask)
    changes = LiftChanges(task, build_scene, LiftSettings(), Effort(0), silent)
    changes._leaves_a_way = lambda *_, **__: True  # type: ignore[method-assign]
    (change,) = changes._board()
    scene = change.built(task, build_scene)
    assert scene is not None
    assert scene.surface_beyond == pytest.approx(0.0, abs=1e-9)
    assert len(scene.at_the_rim) == len(scene.plate.outline)
    assert scene.support_top == pytest.approx(changes.scene.support_top)
    flush = LiftChanges(change.applied(task), build_scene, LiftSettings(), Effort(0), silent)  # type: ignore[arg-type]
    flush._leaves_a_way = lambda *_, **__: True  # type: ignore[method-assign]
    assert list(flush._board()) == []


@pytest.mark.parametrize(("place", "first"), [((0.65, 0.6), True), ((0.62, 0.1), False)])
def test_a_plate_far_off_is_moved_to_where_both_arms_reach_best_the_least_way_first(
    place: tuple[float, float], first: bool
) -> None:
    task = posted("ab1", plate_pose=[*place, TOP + 0.02, 1, 0, 0, 0], options={"contact_density": 0.25})
    assert isinstance(task, PlateLiftTask)
    changes = LiftChanges(task, build_scene, LiftSettings(), Effort(100), silent)
    changes._leaves_a_way = lambda *_, **__: True  # type: ignore[method-assign]
    kinds = [list(kind) for kind in changes.by_kind()]
    assert ({change.kind for change in kinds[0]} == {"plate_place"}) == first
    moves = [change for kind in kinds for change in kind if change.kind == "plate_place"]
    places = np.array([change.patch[0].value[:2] for change in moves])  # type: ignore[index]
    lengths = np.linalg.norm(places - place, axis=1)
    assert (np.diff(lengths) > -1e-6).all()
    if not first:
        return
    # The longest way leads to where either arm is neither bent nor stretched.
    arms = changes.scene.cell.arms.values()
    shares = [float(np.linalg.norm(places[-1] - arm.T_world_base[:2, 3])) / arm.robot.reach for arm in arms]
    assert all(0.5 < share < 0.9 for share in shares)


@pytest.mark.parametrize(
    ("chief", "kinds"),
    [
        ("no hold bears the plate, wherever the arms reach", ["hand_limits", "cup_place"]),
        ("the left arm does not reach so far", ["plate_yaw", "plate_place"]),
        (f"as stated, but {NOT_WITHIN_TOLERANCES} of 2 %", ["tolerances", "cup_place"]),
        ("", ["cup_place", "cup_force"]),
    ],
)
def test_what_the_failed_plan_names_first_is_changed_first(chief: str, kinds: list[str]) -> None:
    task = posted("sheet_ur10e", obstacles=[])
    assert isinstance(task, PlateLiftTask)
    changes = LiftChanges(task, build_scene, LiftSettings(), Effort(0), silent)
    changes._leaves_a_way = lambda *_, **__: True  # type: ignore[method-assign]
    changes.__dict__["_cut"] = []
    firsts = [next(filter(None, kind), None) for kind in changes.by_kind(chief)[:2]]
    assert [change and change.kind for change in firsts] == kinds


@pytest.mark.parametrize("chief", ["", f"as stated, but {NOT_WITHIN_TOLERANCES} of 2 %"])
def test_tolerances_that_are_blamed_are_made_as_small_as_may_be_first(chief: str) -> None:
    """What leaves most of them is told if it helps, too: it is the smaller change."""
    task = posted("sheet_ur10e", obstacles=[])
    assert isinstance(task, PlateLiftTask)
    changes = LiftChanges(task, build_scene, LiftSettings(), Effort(0), silent)
    asked: list[float | None] = []

    def leaves_a_way(change: TaskChange, *, forces: bool, kept: float | None = None) -> bool:
        if change.kind == "tolerances":
            asked.append(kept)
        return forces

    changes._leaves_a_way = leaves_a_way  # type: ignore[method-assign]
    found = [each for kind in changes.by_kind(chief) for each in kind if each and each.kind == "tolerances"]
    left = [step.value for each in found for step in each.patch if step.path == "/plate/mass_tolerance"]
    assert len(left) == 2
    assert left == sorted(left, reverse=not chief)
    assert asked == [0.0 if chief else None] * 2


@pytest.mark.parametrize("is_open", [True, False])
def test_a_place_of_the_cup_is_a_way_from_the_stated_one_if_there_is_one(is_open: bool) -> None:
    task = posted("ab1", cup={"position": [0.0, 0.02], "radius": 0.0175, "max_force": 20})
    scene = build_scene(task)
    told = LiftChanges(task, lambda _: scene, LiftSettings(), Effort(100), silent, place_is_open=is_open)
    change = told._cup_at((0.05, 0.02))
    assert change.sentence.startswith("Put the cup at (50, 20) mm" if is_open else "Move the cup 50 mm ")


def test_a_remedy_that_states_where_the_cup_stays_says_so_and_one_that_moves_it_is_as_it_was() -> None:
    def remedy(path: str) -> Remedy:
        return Remedy(
            kind="it", sentence="Do it.", patch=[put(path, 1)], outcome=PlanningOutcome.SOLVED, certified=True,
            reserve=None, largest_force=None,
        )  # fmt: skip

    pinned = with_cup_at((-0.12, 0.005), remedy("/plate_pose"))
    assert pinned.sentence == "Do it. The cup stays at (-120, 5) mm on the plate."
    assert [step.path for step in pinned.patch] == ["/cup/position", "/plate_pose"]
    moved = remedy("/cup/position")
    assert with_cup_at((-0.12, 0.005), moved) == moved


def test_force_of_the_hands_that_a_proof_names_is_told_to_be_in_vain_unless_it_helps() -> None:
    """A reader who raises it alone would plan in vain."""
    bound, other = (
        Cause(reason="r", needed=2.0, available=1.0, unit="N", where=where) for where in (CAPACITY, "reach")
    )

    def remedy(kind: str) -> Remedy:
        return Remedy(
            kind=kind, sentence="Do it.", patch=[], outcome=PlanningOutcome.SOLVED, certified=True,
            reserve=None, largest_force=None,
        )  # fmt: skip

    told = in_vain([bound], [remedy("two_changes")], ["hand_limits", "cup_force"])
    assert KINDS["hand_limits"] in told
    assert KINDS["cup_force"] not in told
    for quiet in (
        ([bound], [remedy("hand_limits")], ["hand_limits"]),
        ([bound], [remedy("two_changes")], ["cup_force"]),
        ([other], [remedy("two_changes")], ["hand_limits"]),
    ):
        assert in_vain(*quiet) == ""


def test_kinds_of_changes_that_were_tried_in_vain_are_told() -> None:
    assert why_none(["cup_force", "cup_place"]) == "Tried in vain: another place of the cup, a stronger cup."
    assert "No change is known" in why_none([])


def test_a_goal_far_off_comes_nearer_the_least_way_first(shelf: PlanShelf) -> None:
    lid = json.loads((TASKS / "lid_under_roof.json").read_bytes())["objects"][0]
    far = {**lid, "goal_pose": [0.78, -0.7, *lid["goal_pose"][2:]]}
    task = posted("lid_under_roof", objects=[far], obstacles=[])
    assert isinstance(task, SuctionToolTask)
    failed = shelf.plan(posted("lid_too_heavy", options={"remedies": False}))
    first, *_ = ToolChanges(task, build_scene, failed, lambda _: False).by_kind()
    goals = np.array([change.patch[0].value[:2] for change in list(first)[:3]])  # type: ignore[index]
    ways = np.linalg.norm(goals - [0.78, -0.7], axis=1)
    assert (np.diff(ways) > 0.05).all()
    assert ways[0] < 0.6


def test_what_is_far_off_for_a_small_arm_only_is_helped_in_all_ways_by_a_larger_one(shelf: PlanShelf) -> None:
    lid = json.loads((TASKS / "lid_under_roof.json").read_bytes())["objects"][0]
    top = load_cell("dual_ur5e_tool").table_top
    height = top + (lid["pose"][2] - load_cell("dual_ur3e_tool").table_top)
    start, goal = [0.75, 0.1, height, 1, 0, 0, 0], [0.75, -0.2, height, 1, 0, 0, 0]
    far = {**lid, "pose": start, "goal_pose": goal}
    task = posted("lid_under_roof", cell="dual_ur5e_tool", objects=[far], obstacles=[], tool="carton_lifter")
    assert isinstance(task, SuctionToolTask)
    kinds = ToolChanges(
        task, build_scene, shelf.plan(posted("lid_too_heavy", options={"remedies": False})), lambda _: False
    ).by_kind()
    firsts = [next(iter(kind), None) for kind in kinds]
    assert {"cup_force", "tool"} <= {change.kind for change in firsts if change is not None}


@pytest.mark.parametrize("degrees", [-90.0, 30.0, 180.0])
def test_a_plate_that_is_turned_stays_where_it_is_on_its_board(degrees: float) -> None:
    """The board's origin may be anywhere beside the plate's."""
    plate = [0.3, 0.1, TOP + 0.07, 1, 0, 0, 0]
    support = {"shape": {"type": "box", "size": [0.6, 0.6, 0.05]}, "pose": [0.35, 0.04, TOP + 0.025, 1, 0, 0, 0]}
    task = posted("ab1", support=support, plate_pose=plate)
    assert isinstance(task, PlateLiftTask)
    changes = LiftChanges(task, build_scene, LiftSettings(), Effort(0), silent)
    moved = {step.path: step.value for step in changes._plate_moved(np.array([0.02, -0.01]), math.radians(degrees))}
    T_plate, T_board = (from_pose7(np.array(moved[path], dtype=float)) for path in ("/plate_pose", "/support/pose"))
    np.testing.assert_allclose(T_plate[:2, 3], [0.32, 0.09], atol=1e-6)
    before = np.linalg.inv(from_pose7(np.array(plate))) @ from_pose7(np.array(support["pose"]))
    np.testing.assert_allclose(np.linalg.inv(T_plate) @ T_board, before, atol=1e-6)
