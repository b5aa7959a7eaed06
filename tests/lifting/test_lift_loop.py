"""The loop of law (11), its model and its gains, against the differential equations and the law themselves."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from planners.geometry.pose import Array
from planners.lifting.leader_follower import FollowerGains, FollowerMotion, LeaderFollower
from planners.lifting.lift_loop import (
    GAIN_MARGIN,
    MOVES,
    SERVO,
    SERVO_DOUBTS,
    STIFFNESS_DOUBTS,
    HungPlate,
    LiftLoop,
    box_inertia,
    design_gains,
    felt_mass,
    moved_stiffness,
)
from workers.simulation.settings import WinchSettings

PERIOD = FollowerGains().period
PLATES = [(2.0, 20.0), (4.0, 20.0), (6.4, 60.0), (9.0, 60.0)]
"""Mass [kg] and the cup's largest force [N]."""
SPEED = 2.0
"""Of all before they are disturbed: hands so fast never come to the end at which they stand [m/s]."""


def hung(mass: float, cup_force: float, seed: int = 0) -> tuple[HungPlate, float]:
    """Return a plate on hands and a cup at random places, and the mass that the hands accelerate at most."""
    rng = np.random.default_rng(seed)
    sides = np.array([0.4, 0.3, 0.04])
    inertia = box_inertia(sides, mass)
    places = np.array([[0.5, 0.3, 0.0], [-0.5, 0.0, 0.0], [0.0, -0.4, 0.5]]) * sides
    places += rng.uniform(-0.02, 0.02, (3, 3))
    up = np.array([0.3, 0.2, 1.0]) + rng.uniform(-0.3, 0.3, 3)
    up /= np.linalg.norm(up)
    grip = np.diag([80e3, 80e3, 60e3, 15.0, 12.0, 5.0])
    tip = np.diag([10e3, 10e3, 20e3, 0.0, 0.0, 0.0])
    cup = np.diag([*[cup_force / 0.02] * 3, 0.0, 0.0, 0.0])
    hands = moved_stiffness(grip, places[0]) + moved_stiffness(tip, places[1])
    plate = HungPlate(mass, inertia, hands, 0.004, moved_stiffness(cup, places[2]), 0.02, up)
    return plate, felt_mass(places[:2], up, mass, inertia)


@cache
def designed(mass: float, cup_force: float, seed: int = 0) -> FollowerGains:
    """Return the gains for such a plate."""
    return design_gains(*hung(mass, cup_force, seed), cup_force)


def integrate(
    plate: HungPlate, gains: FollowerGains, accelerations: Array, gain: float = 1.0, speed: float = SPEED
) -> Array:
    """Return the readings of the hands' force when the lifter speeds up so [m/s^2], one number a period.

    All rise with `speed` before [m/s].
    """
    up, law = plate.rising, LeaderFollower(gains)
    mass = np.concatenate([np.full(3, plate.mass), plate.inertia])
    # A law that begins at rest has no reading yet; one in motion has felt no error so far.
    felt = (0.0,) * gains.readings if speed > 0.0 else ()
    motion, reading, readings = FollowerMotion(speed, speed, felt), 0.0, []
    y = np.concatenate([np.zeros(6), speed * up, [0.0, speed, speed, 0.0, speed]])

    def forces(y: Array) -> tuple[Array, Array]:
        """Of the hands and of the cup on the plate."""
        stretch, rate = y[12] * up - y[:6], y[13] * up - y[6:12]
        hung_by, rising = y[15] * up - y[:6], y[16] * up - y[6:12]
        return (
            plate.hands @ (stretch + plate.hands_damping_time * rate),
            plate.cup @ (hung_by + plate.cup_damping_time * rising),
        )

    for lifted in accelerations:
        before = motion.velocity
        motion = law.follow(motion, 0.0, gain * reading)
        reading = float(up @ forces(y)[0])
        readings.append(reading)
        told = (motion.velocity - before) / PERIOD

        def slope(_: float, y: Array, told: float = told, lifted: float = lifted) -> Array:
            change = np.concatenate([y[6:12], sum(forces(y)) / mass])
            return np.concatenate([change, [y[13], (y[14] - y[13]) / SERVO, told, y[16], lifted]])

        y = solve_ivp(slope, (0.0, PERIOD), y, rtol=1e-9, atol=1e-11).y[:, -1]
    return np.array(readings)


def modelled(plate: HungPlate, gains: FollowerGains, accelerations: Array, gain: float = 1.0) -> Array:
    """Return the same of the model's matrices."""
    loop = LiftLoop(plate, PERIOD)
    closed = loop.closed(gains, gain)
    state, readings = np.zeros(len(closed)), []
    for lifted in accelerations:
        readings.append(loop.reading(state))
        state = closed @ state
        state[: loop.STATES] += lifted * loop.matrices[1][:, 1]
    return np.array(readings)


@pytest.mark.parametrize(
    "gains", [FollowerGains(), FollowerGains(1.5, 30.0, 2.0, readings=7), FollowerGains(3.0, 22.0, readings=1)]
)
def test_the_model_steps_as_the_differential_equations_and_the_law_do(gains: FollowerGains) -> None:
    plate, _ = hung(4.0, 20.0)
    accelerations = np.random.default_rng(1).uniform(-10.0, 10.0, 25)
    found, expected = modelled(plate, gains, accelerations), integrate(plate, gains, accelerations)
    assert np.abs(expected).max() > 1.0
    assert found == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("seed", range(2))
def test_the_growth_is_what_a_disturbance_really_grows_by(seed: int) -> None:
    """Right below the gain at which the model begins to swing the integrated loop comes to rest; above it does not."""
    plate, felt = hung(4.0, 20.0, seed)
    gains = FollowerGains(inertia=0.6 * felt, carried=0.5 * felt)
    loop = LiftLoop(plate, PERIOD)
    gain = next(each for each in np.geomspace(0.3, 30.0, 60) if loop.growth(gains, each) > 1.0)
    jerk = np.concatenate([[0.5], np.zeros(119)])
    for factor, swings in ((0.8, False), (1.2, True)):
        readings = integrate(plate, gains, jerk, factor * gain)
        early, late = np.ptp(readings[30:60]), np.ptp(readings[-30:])
        assert bool(late > early) is swings


@pytest.mark.parametrize(("mass", "cup_force"), PLATES)
@pytest.mark.parametrize("seed", range(3))
def test_designed_gains_do_not_swing_with_other_contacts_than_were_said_and_arms_that_follow_at_once(
    mass: float, cup_force: float, seed: int
) -> None:
    plate, _ = hung(mass, cup_force, seed)
    gains = designed(mass, cup_force, seed)
    for servo in SERVO_DOUBTS:
        assert LiftLoop(plate, PERIOD, servo=servo).growth(gains, GAIN_MARGIN) < 1.0
        for stiffer in STIFFNESS_DOUBTS:
            assert LiftLoop(plate, PERIOD, stiffer, servo).growth(gains) < 1.0


@pytest.mark.parametrize(("mass", "cup_force"), PLATES)
def test_hands_with_designed_gains_follow_better_than_with_those_of_their_full_mass(
    mass: float, cup_force: float
) -> None:
    plate, felt = hung(mass, cup_force)
    heavy = FollowerGains(inertia=felt, damping=1.1 * cup_force)
    loop = LiftLoop(plate, PERIOD)
    best, worse = loop.deviations([designed(mass, cup_force), heavy])
    assert best < 0.6 * worse


@pytest.mark.parametrize(("mass", "cup_force"), PLATES)
def test_at_any_steady_speed_the_hands_bear_their_goal(mass: float, cup_force: float) -> None:
    """And nothing is told of it: a fixed V_d would leave B_d times the difference to the cup."""
    plate, _ = hung(mass, cup_force)
    gains = designed(mass, cup_force)
    readings = modelled(plate, gains, np.concatenate([np.full(20, 0.5), np.zeros(1000)]))
    assert abs(readings[-1]) < 1e-3 * np.abs(readings).max()


@pytest.mark.parametrize(("mass", "cup_force"), PLATES)
def test_a_lifter_of_three_times_the_usual_speed_leaves_the_cup_three_quarters_of_its_force(
    mass: float, cup_force: float
) -> None:
    """It moves at up to 0.15 m/s, and speeds up and brakes with 0.5 m/s^2."""
    plate, _ = hung(mass, cup_force)
    assert LiftLoop(plate, PERIOD).deviations([designed(mass, cup_force)]) < cup_force / 4.0


@pytest.mark.slow
def test_hands_of_many_gains_deviate_as_those_of_each_that_follow_the_law() -> None:
    """The differential equations are integrated with the law itself, for each gains and move."""
    plate, felt = hung(4.0, 20.0)
    usual = FollowerGains()
    many = [
        replace(usual, inertia=0.2 * felt, carried=0.9 * felt, readings=7, memory=0.3),
        replace(usual, inertia=1.4 * felt, damping=10.0, readings=5),
    ]
    moves = [
        np.concatenate([np.full(round(up * 200), 0.5), np.zeros(jerk), np.full(round((up - on) * 200), -0.5),
                        np.zeros(round(100 * seconds)), np.full(round(on * 200), -0.5), np.zeros(50)])
        for (up, on, seconds), jerk in zip(MOVES, (0, 6), strict=True)
    ]  # fmt: skip
    expected = [max(np.abs(integrate(plate, each, move, speed=0.0)).max() for move in moves) for each in many]
    assert min(expected) > 1.0
    assert LiftLoop(plate, PERIOD).deviations(many) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(("mass", "cup_force"), PLATES)
def test_sensor_noise_moves_the_hands_by_less_than_the_slowest_of_usual_lifters(mass: float, cup_force: float) -> None:
    """Of two FT300 together, once it has lasted."""
    plate, _ = hung(mass, cup_force)
    loop = LiftLoop(plate, PERIOD)
    closed = loop.closed(designed(mass, cup_force))
    state, velocities = np.zeros(len(closed)), []
    for noise in 0.5 * np.sqrt(2.0) * np.random.default_rng(5).normal(size=4000):
        state = closed @ state
        state[loop.STATES] += noise
        velocities.append(state[loop.TOLD])
    assert np.std(velocities) < WinchSettings().speed[0]
    assert np.std(velocities) == pytest.approx(loop.restlessness(designed(mass, cup_force)), rel=0.1)


@pytest.mark.parametrize("seed", range(4))
def test_a_moved_stiffness_answers_a_motion_with_the_same_force_about_the_other_place(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, arm, motion = rng.normal(size=(6, 6)), rng.normal(size=3), rng.normal(size=6)
    stiffness = A @ A.T
    at_point = np.concatenate([motion[:3] + np.cross(motion[3:], arm), motion[3:]])
    wrench = stiffness @ at_point
    about = np.concatenate([wrench[:3], wrench[3:] + np.cross(arm, wrench[:3])])
    assert moved_stiffness(stiffness, arm) @ motion == pytest.approx(about)
