"""The leader-follower law, paper B, eq. (11)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from planners.errors import LiftwrightError
from planners.lifting.leader_follower import FollowerGains, FollowerMotion, LeaderFollower

SENSOR_NOISE = 0.5 * math.sqrt(2.0)
"""Of two FT300 together [N]."""
READING = FollowerGains(readings=1)
"""Gains of a law that takes each reading as it is."""


def run(
    law: LeaderFollower, errors: np.ndarray, motion: FollowerMotion | None = None, fastest: float = math.inf
) -> list[FollowerMotion]:
    motions = [motion or FollowerMotion()]
    for error in errors:
        motions.append(law.follow(motions[-1], error, 0.0, fastest))
    return motions


def test_a_lasting_error_speeds_the_hands_up_at_the_rate_of_error_over_inertia_and_memory() -> None:
    """What is the same for V and V_d in the end: M V' + B T V' = E."""
    law = LeaderFollower(READING)
    motions = run(law, np.full(800, 1.5))
    gained = (motions[-1].velocity - motions[-101].velocity) / (100 * law.gains.period)
    assert gained == pytest.approx(1.5 / (law.gains.inertia + law.gains.damping * law.gains.memory), rel=1e-3)


def test_at_the_goal_force_the_hands_go_on_as_they_did() -> None:
    motions = run(LeaderFollower(), np.zeros(500), FollowerMotion(0.03, 0.03))
    assert motions[-1].velocity == pytest.approx(0.03)


def test_the_estimate_follows_the_hands_as_its_memory_says() -> None:
    """One that stands for its memory has forgotten all but 1/e of the speed."""
    law = LeaderFollower()
    steps = round(law.gains.memory / law.gains.period)
    stopped = run(law, np.full(steps, -50.0), FollowerMotion(0.0, 0.1))[-1]
    assert stopped.velocity == 0.0
    assert stopped.lifter_velocity == pytest.approx(0.1 / math.e)


def test_a_force_that_drops_speeds_the_hands_up_and_one_that_rises_slows_them_down() -> None:
    law, motion = LeaderFollower(), FollowerMotion(0.02, 0.02)
    assert law.follow(motion, 10.0, 8.0).velocity > law.follow(motion, 10.0, 9.6).velocity
    assert law.follow(motion, 10.0, 12.0).velocity < 0.02


@pytest.mark.parametrize("seed", range(5))
def test_the_hands_never_move_down_nor_faster_than_they_can(seed: int) -> None:
    rng = np.random.default_rng(seed)
    velocities = [m.velocity for m in run(LeaderFollower(), 20.0 * rng.normal(size=400), fastest=0.05)]
    assert min(velocities) >= 0.0
    assert max(velocities) == 0.05


def test_hands_that_were_held_down_by_force_start_at_once_when_it_drops() -> None:
    law = LeaderFollower(READING)
    held = run(law, np.full(1000, -10.0))[-1]
    assert law.follow(held, 1.0, 0.0).velocity == pytest.approx(law.follow(FollowerMotion(), 1.0, 0.0).velocity)


def test_the_law_is_the_differential_equation_with_the_mean_error_held() -> None:
    gains = FollowerGains()
    law = LeaderFollower(gains)
    errors = np.random.default_rng(1).uniform(-0.5, 1.5, 30)
    state = np.array([0.1, 0.05])
    for number, motion in enumerate(run(law, errors, FollowerMotion(*state))[1:], start=1):
        error = errors[max(0, number - gains.readings) : number].mean()
        state = solve_ivp(
            lambda _, x, error=error: [
                (error - gains.damping * (x[0] - x[1])) / gains.inertia,
                (x[0] - x[1]) / gains.memory,
            ],
            (0.0, gains.period),
            state,
            rtol=1e-10,
            atol=1e-13,
        ).y[:, -1]
        assert (motion.velocity, motion.lifter_velocity) == pytest.approx(tuple(state), abs=1e-9)


def test_half_the_period_twice_is_the_whole_period_once() -> None:
    whole = LeaderFollower(READING)
    half = LeaderFollower(FollowerGains(readings=1, period=0.5 * READING.period))
    start = FollowerMotion(0.05, 0.01)
    twice, once = half.follow(half.follow(start, 2.0, 1.0), 2.0, 1.0), whole.follow(start, 2.0, 1.0)
    assert twice.velocity == pytest.approx(once.velocity)
    assert twice.lifter_velocity == pytest.approx(once.lifter_velocity)


def test_the_law_gives_back_no_more_energy_than_it_was_given() -> None:
    """Passive: the work of E on V is at least the energy of M_d and of B_d's memory, a mass of B_d T behind B_d."""
    law = LeaderFollower(READING)
    begin = FollowerMotion(10.0, 10.0)
    errors = np.random.default_rng(3).normal(size=500)
    motions = run(law, errors, begin)
    # Between two readings V is nearly straight.
    work = np.cumsum(
        [
            e * 0.5 * (a.velocity + b.velocity) * READING.period
            for e, a, b in zip(errors, motions, motions[1:], strict=False)
        ]
    )
    memory = READING.damping * READING.memory

    def stored(m: FollowerMotion) -> float:
        return 0.5 * READING.inertia * m.velocity**2 + 0.5 * memory * m.lifter_velocity**2

    assert np.all(work >= np.array([stored(m) for m in motions[1:]]) - stored(begin) - 1e-3)


def test_sensor_noise_moves_the_hands_by_less_than_a_slow_lifter_does() -> None:
    law = LeaderFollower()
    noise = SENSOR_NOISE * np.random.default_rng(5).normal(size=4000)
    moved = np.array([m.velocity - m.lifter_velocity for m in run(law, noise, FollowerMotion(1.0, 1.0))])
    assert moved.std() < 0.010


def test_known_inertia_is_taken_off_the_reading_that_it_was_in() -> None:
    """A reading is of a period ago, and hands that speed up feel the plate's mass in it."""
    law = LeaderFollower(FollowerGains(carried=3.0, readings=1))
    blind = LeaderFollower(FollowerGains(readings=1))
    pushed = law.follow(FollowerMotion(0.1, 0.1), 2.0, 0.0)
    acceleration = (pushed.velocity - 0.1) / law.gains.period
    after = law.follow(pushed, 0.0, 0.0)
    felt = law.follow(after, 0.0, 3.0 * acceleration)
    assert felt.velocity == pytest.approx(blind.follow(after, 0.0, 0.0).velocity)


def test_hands_stay_at_the_speed_they_can_make_and_slow_down_at_once_when_the_force_returns() -> None:
    law = LeaderFollower(READING)
    driven = run(law, np.full(500, 10.0), fastest=0.05)[-1]
    assert driven.velocity == 0.05
    assert law.follow(driven, 0.0, 0.5, 0.05).velocity < 0.05


def test_a_limit_does_not_wind_the_estimate_up() -> None:
    """The lifter's speed is taken from the way that the hands went, not from the one that they were refused."""
    assert max(m.lifter_velocity for m in run(LeaderFollower(), np.full(500, 10.0), fastest=0.05)) <= 0.05


@pytest.mark.parametrize(
    "wrong", [{"inertia": 0.0}, {"damping": -1.0}, {"memory": 0.0}, {"readings": 0}, {"period": 0.0}]
)
def test_gains_that_store_or_make_no_sense_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(LiftwrightError):
        FollowerGains(**wrong)
