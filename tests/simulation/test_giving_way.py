"""What is weaker in truth than it was planned with gives way, and it is told when, and why."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from planners.plan.simulation import LiftSimulation
from planners.progress import silent
from workers.simulation.settings import ContactSettings, CupSettings, SimulationSettings, WinchSettings
from workers.simulation.simulate import simulate_lift

SETTINGS = SimulationSettings()
LATE = WinchSettings(hold=(3.0, 3.1))
"""Nobody presses the switch for three seconds."""


def curve(simulation: LiftSimulation, name: str, since: float = 0.0) -> np.ndarray:
    found = next(each for each in simulation.force_curves if each.name == name)
    return found.value[found.time >= since]


def ends_there(simulation: LiftSimulation) -> bool:
    """Whether nothing is told of the time after something gave way."""
    last = simulation.force_curves[0].time[-1]
    # What gives way at the moment of a record ends before it is written: then a whole period is missing.
    return simulation.time - SETTINGS.record_period <= last + 1e-9 <= simulation.time + 2e-9


def test_a_cup_that_bears_less_than_planned_is_lost_over_what_it_bears(run) -> None:
    weak = replace(SETTINGS, cup=CupSettings(strength=0.6))
    simulation = simulate_lift(run.plan, run.scene, silent, 3, weak)
    borne = 0.6 * run.scene.cup.max_force
    assert simulation.outcome == "cup_lost"
    assert f"{borne:g} N" in simulation.cause
    assert curve(simulation, "suction load")[-1] > 0.97 * borne
    assert ends_there(simulation)


def test_hands_that_slide_on_the_plate_have_slipped(run) -> None:
    slippery = replace(SETTINGS, contact=ContactSettings(friction_factor=0.3))
    simulation = simulate_lift(run.plan, run.scene, silent, 3, slippery)
    assert simulation.outcome == "slipped"
    assert "hand" in simulation.cause
    assert simulation.lift is None
    assert ends_there(simulation)


def test_a_plate_that_turns_away_from_its_plan_is_told_before_a_hand_has_lost_it(run) -> None:
    strict = replace(SETTINGS, hand=replace(SETTINGS.hand, largest_turn=math.radians(0.05)))
    simulation = simulate_lift(run.plan, run.scene, silent, 3, strict)
    assert simulation.outcome == "slipped"
    assert simulation.cause.startswith("the plate turned by")
    assert simulation.lift is None
    assert ends_there(simulation)


@pytest.fixture(scope="module")
def alone(run) -> LiftSimulation:
    """The hands rise blindly, and the lifter does not; nothing slides."""
    rough = ContactSettings(friction_factor=3.0)
    return simulate_lift(run.plan, run.scene, silent, 3, replace(SETTINGS, controlled=False, winch=LATE, contact=rough))


def test_hands_that_rise_without_the_lifter_are_overloaded(alone) -> None:
    assert alone.outcome == "overload"
    assert "hand bore" in alone.cause
    assert ends_there(alone)


def test_the_hands_are_no_stiffer_than_their_gains_were_laid_out_for(run, alone) -> None:
    """Their force over the way that they rise against a lifter that stands; see the tests of the gains."""
    begin = alone.lift.begin
    rise = np.cumsum(curve(alone, "commanded velocity", begin)) * SETTINGS.record_period
    force = curve(alone, "both hands", begin)
    slope = np.polyfit(rise, force, 1)[0]
    assert 0.0 < slope < 32.0 * run.scene.cup.max_force


@pytest.mark.slow
def test_hands_that_follow_wait_for_a_lifter_that_is_late(run) -> None:
    """They move by what noise in their sensors moves them, and no further than the force on them allows."""
    low = replace(SETTINGS, winch=replace(LATE, hold_chance=0.0), headroom=0.25)
    simulation = simulate_lift(run.plan, run.scene, silent, 3, low)
    begin = simulation.lift.begin
    waiting = round(2.9 / SETTINGS.record_period)
    assert simulation.outcome == "lifted"
    assert np.sum(curve(simulation, "commanded velocity", begin)[:waiting]) * SETTINGS.record_period < 0.006
