"""The leader-follower law, paper B, eq. (11)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from planners.errors import LiftwrightError
from planners.lifting.leader_follower import FollowerGains, FollowerMotion, LeaderFollower
from planners.lifting.loop_margin import loop_margin

SENSOR_NOISE = 0.5
"""FT300 [N]."""
STIFFEST = 15.0
"""Pushing hand's force over height of the hands against the lifter, over the cup's largest force [1/m]: a cup and its
suspension stretch by 20 mm at that force, and less than a third of what the cup loses comes to the pushing hand."""
STIFFNESS = STIFFEST * 20.0
"""With the papers' smaller cup [N/m]."""
ROBOT_DELAY = 0.02
"""One period of the sensor and as much of the robot [s]."""


def run(law: LeaderFollower, errors: np.ndarray, motion: FollowerMotion | None = None) -> list[FollowerMotion]:
    motions = [motion or FollowerMotion()]
    for error in errors:
        motions.append(law.follow(motions[-1], error, 0.0))
    return motions


def test_a_constant_error_ends_in_the_speed_error_over_damping() -> None:
    law = LeaderFollower()
    assert run(law, np.full(500, 1.5))[-1].velocity == pytest.approx(1.5 / law.gains.damping)


def test_at_the_goal_force_the_hands_move_with_the_target_velocity() -> None:
    law = LeaderFollower(target_velocity=0.03)
    assert run(law, np.zeros(500))[-1].velocity == pytest.approx(0.03)


def test_a_force_that_drops_speeds_the_hands_up_and_one_that_rises_slows_them_down() -> None:
    law, motion = LeaderFollower(), FollowerMotion(0.02)
    assert law.follow(motion, 10.0, 8.0).velocity > law.follow(motion, 10.0, 9.6).velocity
    assert law.follow(motion, 10.0, 12.0).velocity < 0.02


@pytest.mark.parametrize("seed", range(5))
def test_the_hands_never_move_down(seed: int) -> None:
    rng = np.random.default_rng(seed)
    law = LeaderFollower(FollowerGains(stiffness=float(rng.uniform(0, 50))), float(rng.uniform(0, 0.05)))
    assert min(m.velocity for m in run(law, 20.0 * rng.normal(size=400))) >= 0.0


def test_hands_that_were_held_down_by_force_start_at_once_when_it_drops() -> None:
    law = LeaderFollower()
    held = run(law, np.full(1000, -10.0))[-1]
    assert law.follow(held, 1.0, 0.0).velocity == pytest.approx(law.follow(FollowerMotion(), 1.0, 0.0).velocity)


@pytest.mark.parametrize("stiffness", [0.0, 40.0])
def test_the_law_is_the_differential_equation_with_the_error_held(stiffness: float) -> None:
    gains = FollowerGains(stiffness=stiffness)
    law, target = LeaderFollower(gains, 0.1), 0.1
    errors = np.random.default_rng(1).uniform(-0.5, 1.5, 30)
    state = np.array([0.0, -target])
    for error, motion in zip(errors, run(law, errors)[1:], strict=True):
        state = solve_ivp(
            lambda _, x, error=error: [
                x[1],
                (error - gains.damping * x[1] - gains.stiffness * x[0]) / gains.inertia,
            ],
            (0.0, gains.period),
            state,
            rtol=1e-10,
            atol=1e-13,
        ).y[:, -1]
        assert motion.velocity == pytest.approx(target + state[1], abs=1e-9)
        assert motion.lead == pytest.approx(state[0], abs=1e-9)


def test_half_the_period_twice_is_the_whole_period_once() -> None:
    whole = LeaderFollower(FollowerGains(stiffness=10.0))
    half = LeaderFollower(FollowerGains(stiffness=10.0, period=0.5 * whole.gains.period))
    start = FollowerMotion(0.05, 0.01)
    twice = half.follow(half.follow(start, 2.0, 1.0), 2.0, 1.0)
    assert twice.velocity == pytest.approx(whole.follow(start, 2.0, 1.0).velocity)
    assert twice.lead == pytest.approx(whole.follow(start, 2.0, 1.0).lead)


@pytest.mark.parametrize("stiffness", [0.0, 30.0])
def test_the_law_gives_back_no_more_energy_than_it_was_given(stiffness: float) -> None:
    """Passive: the work of E on V - V_d is at least the energy that M_d and K_d hold."""
    gains = FollowerGains(stiffness=stiffness)
    # With so high a V_d the limit V >= 0 never acts.
    law = LeaderFollower(gains, target_velocity=10.0)
    errors = np.random.default_rng(3).normal(size=500)
    motions = run(law, errors, FollowerMotion(10.0))
    work = np.cumsum([e * (b.lead - a.lead) for e, a, b in zip(errors, motions, motions[1:], strict=False)])
    stored = [0.5 * gains.inertia * (m.velocity - 10.0) ** 2 + 0.5 * gains.stiffness * m.lead**2 for m in motions[1:]]
    assert np.all(work >= np.array(stored) - 1e-12)


def test_stopping_instead_of_going_back_only_takes_energy_out() -> None:
    law = LeaderFollower()
    errors = np.random.default_rng(4).normal(scale=5.0, size=500)
    motions = run(law, errors)
    # Between two readings the hands move with the velocity they were last told.
    work = sum(e * m.velocity * law.gains.period for e, m in zip(errors, motions[1:], strict=True))
    assert work >= 0.5 * law.gains.inertia * motions[-1].velocity ** 2


def test_sensor_noise_moves_the_hands_by_less_than_a_slow_lifter_does() -> None:
    """White noise through the sampled filter: sigma sqrt((1 - a) / (1 + a)) / B with a = exp(-B T / M)."""
    gains = FollowerGains()
    law = LeaderFollower(gains, target_velocity=1.0)
    noise = SENSOR_NOISE * np.random.default_rng(5).normal(size=20000)
    moved = np.std([m.velocity for m in run(law, noise, FollowerMotion(1.0))])
    a = math.exp(-gains.damping * gains.period / gains.inertia)
    assert moved == pytest.approx(SENSOR_NOISE / gains.damping * math.sqrt((1 - a) / (1 + a)), rel=0.05)
    assert moved < 0.010


@pytest.mark.parametrize(("mass", "cup_force"), [(4.0, 20.0), (6.4, 60.0), (4.0, 60.0)])
def test_the_chosen_gains_are_far_from_swinging_at_the_sensors_rate(mass: float, cup_force: float) -> None:
    margin = loop_margin(FollowerGains.for_lift(mass, cup_force), STIFFEST * cup_force, 0.5 * mass, ROBOT_DELAY)
    assert margin.gain > 1.5
    assert margin.phase > math.radians(30.0)
    assert margin.delay > 2.0 * ROBOT_DELAY


def test_following_the_fastest_lifter_takes_no_more_than_a_tenth_of_the_cups_force_off_the_hand() -> None:
    law = LeaderFollower(FollowerGains.for_lift(6.4, 60.0))
    assert run(law, np.full(800, 0.1 * 60.0))[-1].velocity > 0.05


def test_hands_lighter_than_what_they_accelerate_swing() -> None:
    assert loop_margin(FollowerGains(inertia=1.6, damping=20.0), STIFFNESS, 2.0, ROBOT_DELAY).gain < 1.0


def test_hands_stay_at_the_speed_they_can_make_and_slow_down_at_once_when_the_force_returns() -> None:
    law = LeaderFollower(largest_velocity=0.05)
    driven = run(law, np.full(500, 10.0))[-1]
    assert driven.velocity == 0.05
    assert law.follow(driven, 0.0, 0.5).velocity < 0.05


def test_a_limit_does_not_wind_the_stiffness_up() -> None:
    """The lead is the way that the hands went, not the one that they were refused."""
    law = LeaderFollower(FollowerGains(stiffness=30.0), largest_velocity=0.05)
    motions = run(law, np.full(300, 10.0))
    went = sum(m.velocity for m in motions[1:]) * law.gains.period
    assert motions[-1].lead == pytest.approx(went, rel=0.02)


@pytest.mark.parametrize("mass", [0.0, 2.0])
@pytest.mark.parametrize(("factor", "stable"), [(0.85, True), (1.2, False)])
def test_the_gain_margin_is_where_the_simulated_loop_begins_to_swing(mass: float, factor: float, stable: bool) -> None:
    gains = FollowerGains()
    law = LeaderFollower(gains, target_velocity=10.0)
    factor *= loop_margin(gains, STIFFNESS, mass, ROBOT_DELAY).gain
    held = round(ROBOT_DELAY / gains.period)
    motion, height, readings, speeds = FollowerMotion(10.0), 0.01, [0.0] * held, [0.0, 0.0]
    for _ in range(3000):
        inertial = mass * (speeds[-1] - speeds[-2]) / gains.period
        readings.append(factor * (STIFFNESS * height + inertial))
        motion = law.follow(motion, 0.0, readings[-1 - held])
        speeds.append(motion.velocity - 10.0)
        height += speeds[-1] * gains.period
        if abs(height) > 1.0:
            break
    assert (abs(height) < 1e-3) is stable


@pytest.mark.parametrize("wrong", [{"inertia": 0.0}, {"damping": -1.0}, {"stiffness": -1.0}, {"period": 0.0}])
def test_gains_that_store_or_make_no_sense_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(LiftwrightError):
        FollowerGains(**wrong)
