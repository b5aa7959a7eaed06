"""A whole plan in physics, and the lift that follows it."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from planners.plan.simulation import LiftSimulation
from planners.progress import silent
from tests.simulation.conftest import execute, squeezing
from tests.simulation.node_tolerance import largest_excess
from tests.support.plan_shelf import PlanShelf
from workers.simulation.lift_reference import LiftReference
from workers.simulation.settings import SimulationSettings
from workers.simulation.simulate import simulate_lift


def curve(run, name: str, since: float = 0.0) -> np.ndarray:
    found = next(c for c in run.simulation.force_curves if c.name == name)
    return found.value[found.time >= since]


def test_the_plate_is_lifted_behind_an_uneven_lifter(run) -> None:
    lift = run.simulation.lift
    assert run.simulation.outcome == "lifted"
    assert run.simulation.cause is None
    assert lift.height > 0.8 * lift.lifter_travel
    assert curve(run, "plate height")[-1] > 0.8 * lift.lifter_travel


def test_the_document_is_what_the_contract_says(run) -> None:
    LiftSimulation.model_validate(run.simulation.model_dump(mode="json"))
    for each in run.simulation.force_curves:
        assert len(each.time) == len(each.value)
        assert np.all(np.diff(each.time) > 0.0)
        assert np.all(np.isfinite(each.value))


def test_the_motion_is_told_from_start_to_end(run) -> None:
    motion, period = run.simulation.motion, 2.0 * SimulationSettings().record_period
    times = np.array([0.0, *motion.time, run.simulation.time])
    assert np.diff(times).max() < period + 1e-6
    assert len(motion.positions) == len(motion.plate) == len(motion.time)


def test_simulated_forces_at_the_nodes_are_those_of_the_plan(run) -> None:
    manipulation = run.simulation.manipulation
    transfers = [i for i, segment in enumerate(run.plan.segments) if segment.kind == "transfer"]
    assert [node.segment for node in manipulation.nodes] == transfers
    assert largest_excess(manipulation) < 1.0


def test_all_simulated_forces_together_bear_the_plate(run) -> None:
    """Newton's third law through every part: hands, cup and support bear the weight when the plate nearly stands."""
    weight = run.scene.plate.mass * 9.81
    for node in run.simulation.manipulation.nodes:
        total = np.sum(list(node.simulated.values()), axis=0)
        assert np.linalg.norm(total - [0.0, 0.0, weight]) < 0.05 * weight


def test_the_plate_is_tilted_and_taken_off_its_support_on_the_way(run) -> None:
    planned = LiftReference(run.plan, run.scene.cup.T_plate_cup[:3, 3])
    end = planned.duration
    tilt = np.degrees(np.arccos(planned.T_world_plate[-1, 2, 2]))
    assert abs(curve(run, "plate tilt", end)[0] - tilt) < 1.5
    assert "support" not in run.simulation.manipulation.nodes[-1].planned
    assert run.simulation.manipulation.largest_distance < 0.005


def test_hands_never_rise_but_when_told_and_never_go_down(run) -> None:
    assert curve(run, "commanded velocity").min() >= 0.0


def test_the_load_is_shared_as_the_goal_says_when_the_lifter_has_stopped(run) -> None:
    last = curve(run, "pushing hand")[-10:].mean()
    # The hands cannot go down, so the pushing hand may keep a little more than its goal.
    assert -1.0 < last - run.simulation.lift.goal_force < 5.0


def test_progress_never_falls_and_ends(run) -> None:
    fractions = [fraction for stage, fraction in run.stages if stage == "simulate"]
    assert len(fractions) == len(run.stages)
    assert np.all(np.diff(fractions) >= 0.0)
    assert fractions[-1] == 1.0


@pytest.mark.slow
def test_the_same_lift_without_the_controller_fails_and_says_why(run) -> None:
    blind = simulate_lift(run.plan, run.scene, silent, 3, replace(SimulationSettings(), controlled=False))
    assert blind.outcome in ("overload", "slipped", "cup_lost")
    assert blind.cause
    assert blind.time < run.simulation.time


@pytest.mark.slow
def test_the_same_seed_gives_the_same_document(run) -> None:
    """In another process state: the physics has no memory of earlier runs."""
    short = replace(SimulationSettings(), settle=0.3, rest=0.1, headroom=0.25)
    runs = (simulate_lift(run.plan, run.scene, silent, 5, short) for _ in range(2))
    first, second = (each.model_dump(mode="json") for each in runs)
    assert first == second


def test_a_cup_too_weak_for_its_plan_is_lost_or_lets_the_plate_slip(run) -> None:
    weak = replace(run.scene, cup=replace(run.scene.cup, max_force=0.5 * run.scene.cup.max_force))
    simulation = simulate_lift(run.plan, weak, silent, 3)
    assert simulation.outcome != "lifted"
    assert simulation.cause


@pytest.mark.slow
def test_importing_the_simulation_prints_nothing_on_stdout() -> None:
    command = [sys.executable, "-c", "import workers.simulation.simulate"]
    assert subprocess.run(command, capture_output=True, check=True).stdout == b""


def test_a_plate_on_a_cable_is_lifted_as_it_was_planned(cable_run) -> None:
    simulation = cable_run.simulation
    assert simulation.outcome == "lifted"
    assert simulation.lift.height > 0.15
    assert largest_excess(simulation.manipulation) < 1.0
    assert max(curve(cable_run, "plate tilt")) > 10.0
    for node in simulation.manipulation.nodes:
        assert not node.simulated["cup"][:2].any()


def test_fingers_squeeze_as_the_plan_commands(run) -> None:
    """With 2 N at each finger the gripping hand cannot bear its part, and the plate slides."""
    simulation = simulate_lift(squeezing(run.plan, 2.0), run.scene, silent, 3)
    assert simulation.outcome == "slipped"


@pytest.mark.slow
def test_fingers_squeeze_with_a_stated_force_where_an_older_plan_commands_none(run) -> None:
    short = replace(SimulationSettings(), settle=0.3, rest=0.1, headroom=0.25)
    plans = (squeezing(run.plan, None), squeezing(run.plan, short.contact.squeeze))
    unsaid, stated = (simulate_lift(each, run.scene, silent, 5, short).model_dump(mode="json") for each in plans)
    assert unsaid == stated


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ab1", "ab2", "ab3", "pb1", "pb2"])
def test_every_lift_of_the_paper_goes_as_it_was_planned(name: str, shelf: PlanShelf) -> None:
    lifted = execute(shelf, name)
    assert lifted.simulation.outcome == "lifted", lifted.simulation.cause
    assert largest_excess(lifted.simulation.manipulation) < 1.0
