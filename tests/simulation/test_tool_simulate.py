"""A suction-tool plan in physics: it arrives, and what is weaker, heavier or told otherwise is found."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planners.contract.task_spec import SuctionToolTask, read_task
from planners.geometry.pose import rotation_y, rotation_z, transform
from planners.plan.plan import Plan
from planners.plan.segment import Segment
from planners.plan.simulation import ToolSimulation
from planners.progress import silent
from planners.scene.scene import build_scene
from planners.scene.tool_scene import SuctionToolScene, build_tool_scene
from tests.simulation.conftest import squeezing, tampered
from tests.support.plan_shelf import PlanShelf
from workers.simulation.holds import Endurance
from workers.simulation.settings import EnduranceSettings, ToolSimulationSettings, TruthSettings
from workers.simulation.simulate import simulate_plan, simulate_tool
from workers.simulation.tool_execution import goal_error

TASK = json.loads((Path(__file__).resolve().parents[2] / "assets" / "tasks" / "domino_pile.json").read_text())
NAME = "domino_1"
WEIGHT = 0.1 * 9.81


@dataclass(frozen=True, eq=False)
class ToolRun:
    scene: SuctionToolScene
    plan: Plan
    simulation: ToolSimulation
    progress: list[float]


@pytest.fixture(scope="module")
def tool_run(shelf: PlanShelf) -> ToolRun:
    """The first domino of the shipped pile, executed as it is planned."""
    task = read_task({**TASK, "objects": TASK["objects"][:1], "external_id": "one domino"})
    scene = build_scene(task)
    assert isinstance(scene, SuctionToolScene)
    found = shelf.plan(task).model_copy(update={"simulation": None})
    seen: list[float] = []
    simulation = simulate_plan(found, scene, lambda report: seen.append(report.done / report.total), 0)
    assert isinstance(simulation, ToolSimulation)
    return ToolRun(scene, found, simulation, seen)


def execute(run: ToolRun, changed: Plan | None = None, **truth: float) -> ToolSimulation:
    settings = replace(ToolSimulationSettings(), truth=TruthSettings(**truth))
    return simulate_tool(changed or run.plan, run.scene, silent, settings)


def without_object(run: ToolRun, indices: list[int]) -> Plan:
    """Return the plan in which the object rides on nothing in these segments."""

    def change(index: int, segment: Segment) -> dict[str, Any]:
        others = {name: rides for name, rides in segment.attached.items() if name != NAME}
        return {"attached": others} if index in indices else {}

    return tampered(run.plan, change)


def carried(run: ToolRun) -> list[int]:
    """Return the segments in which the object is on the cup."""
    return [i for i, segment in enumerate(run.plan.segments) if NAME in segment.attached]


def span(run: ToolRun, segments: list[int]) -> tuple[float, float]:
    parts = [run.plan.segments[i].time for i in segments]
    return float(parts[0][0]), float(parts[-1][-1])


def height(simulation: ToolSimulation, time: float) -> float:
    track = simulation.motion.bodies[NAME]
    return float(np.interp(time, track.time, track.poses[:, 2]))


def test_the_object_arrives_and_the_document_is_what_the_contract_says(tool_run: ToolRun) -> None:
    simulation = tool_run.simulation
    ToolSimulation.model_validate(simulation.model_dump(mode="json"))
    assert (simulation.outcome, simulation.cause, simulation.failed_at) == ("done", None, None)
    assert simulation.goals[NAME].distance < 0.003
    assert simulation.time >= tool_run.plan.segments[-1].end
    assert np.all(np.diff(tool_run.progress) >= 0.0)
    assert tool_run.progress[-1] == 1.0


def test_the_cup_bears_the_weight_while_the_object_is_carried_and_nothing_before_and_after(tool_run: ToolRun) -> None:
    curves = {curve.name: curve.value for curve in tool_run.simulation.force_curves}
    time = tool_run.simulation.force_curves[0].time
    begin, end = span(tool_run, carried(tool_run))
    inside = (time > begin + 0.3) & (time < end - 0.3)
    assert np.median(curves["suction load"][inside]) == pytest.approx(WEIGHT, rel=0.02)
    assert not curves["suction load"][(time < begin - 0.3) | (time > end + 0.3)].any()
    assert curves["left squeeze"].any() != curves["right squeeze"].any()


def test_the_motion_is_that_of_the_plan(tool_run: ToolRun) -> None:
    motion, segments = tool_run.simulation.motion, tool_run.plan.segments
    planned_time = np.concatenate([segment.time for segment in segments])
    planned = np.concatenate([segment.positions for segment in segments])
    for joint in range(12):
        wanted = np.interp(motion.time, planned_time, planned[:, joint])
        assert np.abs(wanted - motion.positions[:, joint]).max() < 0.02
    assert tool_run.simulation.largest.tool_off_plan < 0.005


def test_a_cup_too_weak_loses_the_object_on_the_way_and_it_falls(tool_run: ToolRun) -> None:
    simulation = execute(tool_run, cup_strength=0.05)
    begin, end = span(tool_run, carried(tool_run))
    assert simulation.outcome == "object_dropped"
    assert begin < simulation.failed_at < end
    assert f"{NAME} came off the cup" in simulation.cause
    assert height(simulation, simulation.time) < height(simulation, simulation.failed_at) - 0.002
    assert simulation.time > simulation.failed_at


def test_an_object_heavier_than_planned_is_dropped(tool_run: ToolRun) -> None:
    simulation = execute(tool_run, object_mass=30.0)
    assert simulation.outcome == "object_dropped"
    assert NAME in simulation.cause


def test_fingers_too_weak_lose_the_tool(tool_run: ToolRun) -> None:
    simulation = execute(tool_run, grip_strength=0.05)
    assert simulation.outcome == "tool_slipped"
    assert "3 N" in simulation.cause


def test_fingers_squeeze_as_the_plan_commands_and_with_the_tasks_friction(tool_run: ToolRun) -> None:
    grips = tool_run.plan.segments[-1].grips
    for simulation, squeeze in (
        (execute(tool_run, squeezing(tool_run.plan, 4.0)), 4.0),
        (execute(tool_run, grip_friction=0.05), grips[0].squeeze),
    ):
        assert simulation.outcome == "tool_slipped"
        assert f"squeeze with {squeeze:.0f} N" in simulation.cause


def test_a_plan_that_lets_the_object_go_too_early_is_found(tool_run: ToolRun) -> None:
    last = carried(tool_run)[-1:]
    begin, _ = span(tool_run, last)
    simulation = execute(tool_run, without_object(tool_run, last))
    assert simulation.outcome == "object_dropped"
    assert f"{NAME} fell" in simulation.cause
    assert begin < simulation.failed_at < begin + 0.5


def test_a_plan_that_leaves_the_object_where_it_was_is_found(tool_run: ToolRun) -> None:
    simulation = execute(tool_run, without_object(tool_run, carried(tool_run)))
    assert simulation.outcome == "off_goal"
    assert simulation.goals[NAME].distance == pytest.approx(np.hypot(0.08, 0.3), abs=0.005)


def test_a_hand_that_opens_on_the_way_drops_the_tool(tool_run: ToolRun) -> None:
    opened = carried(tool_run)[1:]
    simulation = execute(tool_run, tampered(tool_run.plan, lambda index, _: {"hold": None} if index in opened else {}))
    assert simulation.outcome == "tool_slipped"
    assert "no hand held it" in simulation.cause


def test_fingers_that_close_beside_the_tool_are_found(tool_run: ToolRun) -> None:
    scene = tool_run.scene
    T_elsewhere = scene.tool.body.T_world_body @ transform(position=[0.3, 0.3, 0.0])
    moved = replace(scene, tool=replace(scene.tool, body=replace(scene.tool.body, T_world_body=T_elsewhere)))
    simulation = simulate_tool(tool_run.plan, moved, silent)
    assert simulation.outcome == "tool_slipped"
    assert "beside the tool" in simulation.cause


def test_the_same_plan_gives_the_same_simulation(tool_run: ToolRun) -> None:
    again = simulate_tool(tool_run.plan, tool_run.scene, silent)
    assert again.model_dump(mode="json") == tool_run.simulation.model_dump(mode="json")


@pytest.mark.parametrize(
    ("loads", "lost"),
    [([1.29] * 20 + [0.9] + [1.29] * 20, False), ([1.01] * 21, True), ([0.5, 1.31], True), ([1.0] * 100, False)],
)
def test_a_hold_lets_go_after_its_grace_or_at_once_when_it_is_far_over(loads: list[float], lost: bool) -> None:
    endurance = Endurance(EnduranceSettings(grace=0.205, burst=1.3))
    assert any([endurance.lets_go(load, 0.01) for load in loads]) is lost


@pytest.mark.parametrize(
    ("symmetry", "turn", "angle"),
    [
        ("none", rotation_z(np.pi), np.pi),
        ("shape", rotation_z(np.pi), 0.0),
        ("shape", rotation_z(np.pi + 0.1), 0.1),
        ("axis", rotation_z(0.4), 0.0),
        ("axis", rotation_z(0.4) @ rotation_y(0.2), 0.2),
    ],
)
def test_a_goal_is_missed_by_what_its_symmetry_does_not_forgive(symmetry: str, turn: np.ndarray, angle: float) -> None:
    body = {**TASK, "objects": [{**TASK["objects"][0], "goal_symmetry": symmetry}]}
    task = read_task(body)
    assert isinstance(task, SuctionToolTask)
    (moved,) = build_tool_scene(task).objects
    error = goal_error(moved, moved.T_world_goal @ transform(turn, [0.0, 0.003, 0.0]))
    assert error.distance == pytest.approx(0.003)
    assert error.angle == pytest.approx(angle, abs=1e-6)
