"""A cell in another size: what planning samples and keeps, and the plans it makes, are in that size too."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planners.cell.cell import Cell, ShippedCells, known_cells, load_cell
from planners.cell.cell_size import size_of
from planners.certify import certify
from planners.contract.task_spec import PlateLiftTask, SuctionToolTask, read_task, write_task
from planners.hands.workcell import Clearance
from planners.manipulation.lift_attempts import plan_lift
from planners.manipulation.lift_sampling import LiftSampling
from planners.manipulation.lift_settings import LiftSettings
from planners.manipulation.motion.choreography import PaceSettings
from planners.manipulation.motion.posture_follower import SweepSettings
from planners.manipulation.planner import PlateLiftPlanner
from planners.manipulation.statics.hold_balance import MotionSampling
from planners.motion.timing import TimingSettings
from planners.plan.loads import largest_load
from planners.plan.plan import Plan
from planners.planning import certificate_of, lift_settings, solve
from planners.progress import silent
from planners.regrasp.grasps.tool_grasps import tool_grasps
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.remedies.change import obstacle_out_of_the_way
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.scene import build_scene
from planners.scene.tool_scene import SuctionToolScene
from planners.survey.reach_map import ReachMapSettings, map_reach
from tests.manipulation.lift_probe import task_body
from tests.support.scaled_cell import OWN, scaled_cell, scaled_task

LIFT, TOOL = "dual_ur3e_lift", "dual_ur3e_tool"
LONG = "long_symmetric"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cells")


@pytest.fixture(scope="module")
def twice(folder: Path) -> Cell:
    """The papers' cell for lifts, all of it twice as large."""
    return scaled_cell(LIFT, 2.0, folder)


@pytest.mark.parametrize("name", known_cells())
def test_shipped_cells_have_the_size_that_lengths_are_written_down_for(name: str) -> None:
    cell = load_cell(name)
    assert cell.size == 1.0
    assert LiftSettings().in_cell(cell) == LiftSettings()
    assert ToolPlannerSettings().in_cell(cell) == ToolPlannerSettings()
    assert SweepSettings.of(cell) == SweepSettings()
    assert PaceSettings.of(cell) == PaceSettings()
    assert MotionSampling.of(cell) == MotionSampling()
    assert repr(Clearance.of(cell)) == repr(Clearance())


@pytest.mark.parametrize(("times", "size"), [(2.0, 2.0), (1.25, 1.25), (0.5, 1.0)])
def test_a_cell_all_of_which_is_larger_is_as_much_larger_and_none_is_smaller_than_the_papers(
    times: float, size: float, folder: Path
) -> None:
    assert scaled_cell(LIFT, times, folder).size == pytest.approx(size, rel=1e-12)


def test_what_is_least_in_a_cell_says_how_large_it_is(twice: Cell) -> None:
    """Shipped hands on arms twice as large, and one shipped hand beside one twice as large."""
    small, left, right = load_cell(LIFT).arms, twice.arms["left"], twice.arms["right"]
    assert size_of([left, replace(right, hand=small["right"].hand)]) == 1.0
    assert size_of([replace(left, hand=small["left"].hand), right]) == 1.0
    assert size_of([replace(left, robot=small["left"].robot), right]) == 1.0
    assert size_of([left, right]) == 2.0


def test_steps_are_as_long_as_margins_allow_and_ways_as_long_as_the_cell_is_large(folder: Path, twice: Cell) -> None:
    """A large cell that is known as well as a small one has its margins, and is looked at as finely."""
    ordinary = SweepSettings()
    wide = SweepSettings.of(twice)
    assert (wide.approach_step, wide.grip_approach) == (2.0 * ordinary.approach_step, 2.0 * ordinary.grip_approach)
    fine = SweepSettings.of(replace(twice, margins=None))
    assert (fine.approach_step, fine.grip_approach) == (ordinary.approach_step, wide.grip_approach)
    tool = scaled_cell(TOOL, 2.0, folder, tool=LONG)
    steps = [ToolPlannerSettings().in_cell(each).handovers.grasps.step for each in (tool, replace(tool, margins=None))]
    assert steps == [2.0 * ToolPlannerSettings().handovers.grasps.step, ToolPlannerSettings().handovers.grasps.step]


def test_poses_grips_and_pushes_are_those_of_the_small_cell_in_another_size(twice: Cell) -> None:
    samplings = []
    for cell, task in ((load_cell(LIFT), read_task(task_body("ab1"))), (twice, scaled_task(task_body("ab1"), 2.0))):
        scene = build_scene(task, {cell.name: cell})
        assert isinstance(task, PlateLiftTask)
        assert isinstance(scene, PlateLiftScene)
        samplings.append(LiftSampling.of(scene, lift_settings(task.options).in_cell(cell)))
    small, large = samplings
    assert small.figures() == large.figures()
    assert small.grips
    same(small.T_world_plates, large.T_world_plates)
    for one, other in zip([*small.grips, *small.pushes], [*large.grips, *large.pushes], strict=True):
        same(one.T_plate_tcp, other.T_plate_tcp)
    assert large.least_thickness < 2.0 * small.least_thickness, "how true a plate lies does not grow"


def same(T: np.ndarray, T_twice: np.ndarray) -> None:
    """Poses (..., 4, 4) are the same but for lengths, which are twice as long."""
    assert T_twice[..., :3, :3] == pytest.approx(T[..., :3, :3], abs=1e-12)
    assert T_twice[..., :3, 3] == pytest.approx(2.0 * T[..., :3, 3], abs=1e-12)


def test_grasps_of_a_tool_are_those_of_the_small_cell_in_another_size(folder: Path) -> None:
    found = []
    for times in (1.0, 2.0):
        cell = scaled_cell(TOOL, times, folder, tool=LONG)
        scene = build_scene(scaled_task({**pile("domino_pile"), "tool": LONG}, times), {OWN: cell})
        assert isinstance(scene, SuctionToolScene)
        settings = ToolPlannerSettings().in_cell(cell).with_fingertips()
        found.append(tool_grasps(scene.tool, cell.gripper("left"), replace(settings.handovers.grasps, rolls=4)))
    small, large = found
    assert len(small) == len(large) > 50
    assert large.T_tool_tcp[:, :3, :3] == pytest.approx(small.T_tool_tcp[:, :3, :3], abs=1e-9)
    # Lines are tried a fraction of a micrometre beside the middle, whatever they are tried on.
    assert large.T_tool_tcp[:, :3, 3] == pytest.approx(2.0 * small.T_tool_tcp[:, :3, 3], abs=1e-6)
    assert large.open_widths == pytest.approx(2.0 * small.open_widths, abs=1e-6)


def test_hands_are_looked_for_and_obstacles_moved_in_the_size_of_the_cell(twice: Cell) -> None:
    coarse = ReachMapSettings(columns=4, rolls=1)
    heights = [map_reach(cell, coarse).z - cell.table_top for cell in (load_cell(LIFT), twice)]
    assert heights[1] == pytest.approx(2.0 * heights[0], abs=1e-12)
    body = {"name": "wall", "shape": {"type": "box", "size": [0.1, 0.1, 2.0]}, "pose": [0.6, 0.3, 2.0, 1, 0, 0, 0]}
    task = read_task({**task_body("ab1"), "obstacles": [body]})
    ways = [
        [each.size for each in obstacle_out_of_the_way(0, task.obstacles[0], np.eye(4), 0.0, s)] for s in (1.0, 2.0)
    ]
    assert ways[1] == [2.0 * way for way in ways[0]]


def test_how_fingers_resist_twisting_is_said_where_it_is_not_the_default() -> None:
    body = pile("domino_pile")
    for eps, said in ((0.0075, {}), (0.015, {"eps": 0.015})):
        task = read_task({**body, "friction": {"grip": 0.4, "eps": eps}})
        assert isinstance(task, SuctionToolTask)
        assert task.friction.eps == eps
        assert write_task(task)["friction"] == {"grip": 0.4, "environment": 0.4, **said}
        assert read_task(write_task(task)) == task


# Plans, which take a while.


def pile(name: str) -> dict[str, Any]:
    return json.loads((Path(__file__).parents[2] / f"assets/tasks/{name}.json").read_text())


@cache
def planned(name: str, times: float, folder: Path) -> tuple[Cell, Plan]:
    """Return the plan of a shipped task, as it is shipped where it is as large as that."""
    body = pile(name)
    body["options"] = {"remedies": False}
    if times == 1.0:
        task, cells = read_task(body), ShippedCells()
    else:
        task = scaled_task(body, times)
        cells = {OWN: scaled_cell(body["cell"], times, folder, tool=body.get("tool"))}
    return cells[task.cell], solve(task, cells=cells)


ALONG = np.linspace(0.0, 1.0, 200)


def path(positions: np.ndarray) -> np.ndarray:
    """Return joint positions (200, 12) by equal shares of a path's length, whenever they are come to."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1)))
    return np.array([np.interp(ALONG * along[-1], along, column) for column in positions.T]).T


def likewise(small: Plan, large: Plan, times: float) -> None:
    """The same is done, and takes √times as long, but for what is stated in seconds: fingers, vacuum, smooth starts."""
    assert small.outcome == large.outcome == "solved"
    assert large.certificate is not None
    assert large.certificate.passed
    for one, other in zip(small.segments, large.segments, strict=True):
        assert (one.kind, one.movers) == (other.kind, other.movers)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "times"),
    [("ab1", 2.0), ("pb1", 2.0), ("sheet_ur10e", 2.0), ("carton_pile", 2.0), ("domino_pile", 4.0)],
)
def test_the_plan_in_a_larger_cell_moves_all_joints_through_the_same_positions(
    name: str, times: float, folder: Path
) -> None:
    """Samples lie elsewhere on the same curve, so that half a thousandth of a radian may be cut off between two.

    Where a gripper has its pads is interpolated, to two micrometres: so far the ends of motions are off. Contact sets
    are as far apart as in the small cell, so that there are more of them along a way, one of which may ask for more.
    """
    (_, small), (_, large) = planned(name, 1.0, folder), planned(name, times, folder)
    likewise(small, large, times)
    for one, other in zip(small.segments, large.segments, strict=True):
        for end in (0, -1):
            assert other.positions[end] == pytest.approx(one.positions[end], abs=5e-6)
        assert path(other.positions) == pytest.approx(path(one.positions), abs=5e-4)
        lasts = [float(each.time[-1] - each.time[0]) for each in (one, other)]
        # Fingers and vacuum take their time. Motions begin and end smoothly, which takes seconds as well.
        smooth = 2.0 * TimingSettings().smoothing_time * (math.sqrt(times) - 1.0)
        asked = (lasts[0], math.sqrt(times) * lasts[0])
        assert any(lasts[1] == pytest.approx(time, rel=0.02, abs=smooth) for time in asked)
    assert largest_load(large)[0] == pytest.approx(times**2 * largest_load(small)[0], rel=0.05)


@pytest.mark.slow
def test_of_a_graph_that_is_too_large_as_many_poses_and_holds_are_left_in_a_larger_cell(twice: Cell) -> None:
    left = []
    body = task_body("pb1", reserve=0.0)
    for cell, task in ((load_cell(LIFT), read_task(body)), (twice, scaled_task(body, 2.0))):
        scene = build_scene(task, {cell.name: cell})
        assert isinstance(task, PlateLiftTask)
        assert isinstance(scene, PlateLiftScene)
        settings = lift_settings(task.options)
        edges = PlateLiftPlanner(scene, settings, silent).reach.edge_count
        plan = plan_lift(scene, replace(settings, largest_graph=edges // 2), silent)
        assert f"{edges} edges" in plan.summary
        left.append((plan.outcome, plan.graph["nodes"], plan.graph["edges"]))
    assert left[0] == left[1]


@pytest.mark.slow
def test_a_pile_is_built_alike_where_hands_may_be_the_other_way_round(folder: Path) -> None:
    """Half a turn of a hand about its approach swaps two equal fingers, and costs the same: last digits decide."""
    (_, small), (_, large) = planned("domino_pile", 1.0, folder), planned("domino_pile", 2.0, folder)
    likewise(small, large, 2.0)
    for one, other in zip(small.segments, large.segments, strict=True):
        turned = (other.positions[-1] - one.positions[-1]) / math.pi
        assert np.delete(turned, (5, 11)) == pytest.approx(np.zeros(10), abs=5e-6)
        assert turned == pytest.approx(np.round(turned), abs=5e-6)
        bodies, others = small.at(float(one.time[-1])).body_poses, large.at(float(other.time[-1])).body_poses
        for body in ("tool", "domino_1", "domino_2", "domino_3"):
            assert others[body][:3] == pytest.approx(2.0 * bodies[body][:3], abs=1e-6)
            assert abs(float(others[body][3:] @ bodies[body][3:])) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.slow
def test_a_document_that_hides_how_fingers_resist_twisting_fails(folder: Path) -> None:
    cell, plan = planned("domino_pile", 2.0, folder)
    document = plan.document()
    assert document["task"]["friction"].pop("eps") == 0.015
    found = certificate_of(json.dumps(document).encode(), cell, certify)
    assert found is not None
    assert not found.passed
