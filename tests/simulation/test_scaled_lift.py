"""The physics of a lift in a cell of another size, and on hands of another size."""

from __future__ import annotations

from dataclasses import asdict
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from planners.cell.cell_size import pad_stiffness, tip_stiffness
from planners.contract.task_spec import read_task
from planners.lifting.hand_admittance import HandAdmittance
from planners.planning import solve
from planners.program.schedule import Schedule
from planners.progress import silent
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.scene import build_scene
from tests.manipulation.lift_probe import task_body
from tests.simulation.conftest import SHORTEST, Run
from tests.simulation.node_tolerance import largest_excess
from tests.support.scaled_cell import OWN, scaled_cell, scaled_task
from tests.support.service import task
from workers.simulation.lift_reference import LiftReference
from workers.simulation.settings import SimulationSettings
from workers.simulation.simulate import simulate_lift

TWICE = 2.0


def lift_scene(name: str) -> PlateLiftScene:
    scene = build_scene(read_task(task(f"{name}.json")))
    assert isinstance(scene, PlateLiftScene)
    return scene


@pytest.mark.parametrize("name", ["ab1", "pb2_weak_cup", "ab1_ur3"])
def test_the_papers_lifts_have_the_physics_that_is_written_down(name: str) -> None:
    assert SimulationSettings.of(lift_scene(name)) == SimulationSettings()


@pytest.mark.parametrize("careful", [{"hand_force_limit": {"normal": 5.0, "net": 8.0}}, {"friction": {"eps": 0.002}}])
def test_hands_of_a_careful_task_have_the_same_rubber(careful: dict[str, dict[str, float]]) -> None:
    scene = build_scene(read_task({**task("ab1.json"), **careful}))
    assert isinstance(scene, PlateLiftScene)
    assert SimulationSettings.of(scene) == SimulationSettings()


def hertz(radius: float, depth: float) -> float:
    """Return the force on a ball pressed into a plane so deep, of some rubber: F ~ √R d^(3/2)."""
    return radius**0.5 * depth**1.5


@pytest.mark.parametrize(("radius", "force"), [(0.01, 120.0), (0.02, 68.0), (0.005, 4.0)])
def test_a_tip_is_as_stiff_as_hertz_says(radius: float, force: float) -> None:
    """Slopes of force over depth, found by differences, where the ball presses as hard as it does."""
    slopes = []
    for ball, press in ((0.01, 17.0), (radius, force)):
        depth = (press / ball**0.5) ** (2.0 / 3.0)
        slopes.append((hertz(ball, 1.001 * depth) - hertz(ball, 0.999 * depth)) / (0.002 * depth))
    assert tip_stiffness(radius, force) == pytest.approx(slopes[1] / slopes[0], rel=1e-6)


def test_two_pads_side_by_side_are_twice_as_stiff_and_two_in_a_row_half() -> None:
    pad = np.array([0.03, 0.01, 0.04])
    for change, times in (([2.0, 1.0, 1.0], 2.0), ([1.0, 1.0, 2.0], 2.0), ([1.0, 2.0, 1.0], 0.5)):
        assert pad_stiffness(pad * change) == pytest.approx(times * pad_stiffness(pad), rel=1e-12)


def test_a_stick_is_told_the_largest_push_that_comes_before_it_leaves_its_place(run: Run) -> None:
    arm = run.scene.cell.pusher_arms[0]
    pushes = LiftReference(run.plan, run.scene.cup.T_plate_cup[:3, 3]).largest_pushes(arm)
    forces = [
        [np.linalg.norm(contact.wrench[:3]) for contact in segment.contacts if contact.by == arm]
        for segment in run.plan.segments
    ]
    pushing = [number for number, segment in enumerate(run.plan.segments) if segment.push is not None]
    assert pushing
    for number, push in enumerate(pushes):
        if number not in pushing:
            assert push == 0.0
            continue
        # A force is its normal part, and as much across it as friction bears.
        most = max(forces[number], default=0.0)
        assert push >= most / np.hypot(1.0, run.scene.friction.push) - 1e-9
        assert push <= max(max(each, default=0.0) for each in forces) + 1e-9
    for number, after in pairwise(pushing):
        if np.array_equal(run.plan.segments[number].push.point, run.plan.segments[after].push.point):
            assert pushes[number] >= pushes[after]


@pytest.mark.slow
def test_a_lift_in_a_cell_twice_as_large_goes_as_in_the_small_one(run: Run, tmp_path: Path) -> None:
    """Masses are four times as large: so are forces, and ways are twice as long."""
    large_task = scaled_task({**task_body(SHORTEST), "options": {"remedies": False}}, TWICE)
    cells = {OWN: scaled_cell("dual_ur3e_lift", TWICE, tmp_path)}
    scene = build_scene(large_task, cells)
    assert isinstance(scene, PlateLiftScene)
    plan = solve(large_task, cells=cells)
    large, small = simulate_lift(plan, scene, silent, 3), run.simulation
    assert large.outcome == "lifted", large.cause
    assert largest_excess(large.manipulation) < 1.0
    assert large.lift is not None
    assert small.lift is not None
    assert large.lift.reachable_height == pytest.approx(TWICE * small.lift.reachable_height, rel=0.02)
    assert large.lift.height == pytest.approx(TWICE * small.lift.height, rel=0.02)
    assert large.lift.goal_force == pytest.approx(TWICE**2 * small.lift.goal_force, rel=0.03)
    ends = [
        next(curve for curve in each.force_curves if curve.name == "both hands").value[-10:].mean()
        for each in (small, large)
    ]
    assert ends[1] == pytest.approx(TWICE**2 * ends[0], rel=0.15)
    # Programs have the admittance of the simulated hands.
    hand = asdict(SimulationSettings.of(scene).hand)
    assert asdict(Schedule.of(plan).admittance) == {name: hand[name] for name in asdict(HandAdmittance())}
