"""The winch, the cup and the sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planners.balance.contacts import Cup
from planners.balance.lifter import SuctionPad
from planners.geometry.pose import Array, rotation_from_vector, skew
from workers.simulation.hands import ForceSensor
from workers.simulation.lifter import SuctionLifter, WinchProfile
from workers.simulation.settings import ContactSettings, CupSettings, SensorSettings, WinchSettings

STEP = 0.002
WINCH = WinchSettings()


def profile(seed: int, travel: float = 0.3) -> WinchProfile:
    return WinchProfile.draw(travel, STEP, np.random.default_rng(seed), WINCH)


@pytest.mark.parametrize("seed", range(5))
def test_the_winch_goes_up_to_its_travel_and_never_down(seed: int) -> None:
    heights = profile(seed).heights
    assert heights[0] == 0.0
    assert heights[-1] == pytest.approx(0.3)
    assert np.diff(heights).min() >= 0.0


@pytest.mark.parametrize("seed", range(5))
def test_the_winch_is_uneven_but_not_faster_than_its_motor(seed: int) -> None:
    winch = profile(seed)
    speeds = np.diff(winch.heights) / STEP
    assert speeds.max() <= max(WINCH.speed[1], WINCH.jerk_speed) + 1e-9
    assert np.abs(np.diff(speeds[:-1])).max() <= WINCH.acceleration * STEP + 1e-9
    assert (speeds[100:] < 1e-9).any()
    assert speeds.std() > 0.2 * speeds.mean()


@pytest.mark.parametrize("seed", range(5))
def test_a_lifter_that_is_three_times_as_fast_brakes_no_harder_at_the_top_than_anywhere(seed: int) -> None:
    fast = WINCH.times(3.0)
    speeds = np.diff(WinchProfile.draw(0.3, STEP, np.random.default_rng(seed), fast).heights) / STEP
    assert speeds.max() > max(WINCH.speed)
    assert np.diff(speeds[:-1]).min() >= -fast.deceleration * STEP - 1e-9
    # The last of its way is less than a step of the simulation.
    assert speeds[-1] < 0.02


def test_the_usual_speed_is_the_mean_of_many_lifters() -> None:
    many = [profile(seed, travel=3.0) for seed in range(20)]
    mean = sum(winch.heights[-1] for winch in many) / sum(winch.duration for winch in many)
    assert mean == pytest.approx(WINCH.usual_speed, rel=0.05)


def test_the_same_seed_gives_the_same_lifter_and_another_a_different_one() -> None:
    assert np.array_equal(profile(1).heights, profile(1).heights)
    assert profile(1).duration != profile(2).duration


def lifter(scene, **changes: float) -> SuctionLifter:
    return SuctionLifter(scene, replace(CupSettings(), **changes), ContactSettings(), np.random.default_rng(0))


def standing(R: Array, com: Array) -> Array:
    """The motion of a plate that stands, (6, 3)."""
    return np.vstack([R, com, np.zeros((2, 3))])


def at_rest(cup: SuctionLifter, plate: Array) -> tuple[Array, Array]:
    """Where the pad is on a plate that stands, and its velocity."""
    return cup.place(plate), np.zeros(3)


def hang(cup: SuctionLifter, scene, force: Array) -> Array:
    """Attach it to a level plate that is pulled upwards."""
    plate = standing(np.eye(3), np.array([0.3, 0.0, 1.2]))
    place, velocity = at_rest(cup, plate)
    cup.give(np.concatenate([force, np.zeros(3)]), place, velocity, plate, STEP)
    cup.hang(plate, np.zeros(3))
    return plate


def test_a_cup_at_rest_keeps_its_force_and_stretches_by_its_travel_at_its_limit(scene) -> None:
    cup = lifter(scene, error=0.0)
    plate = hang(cup, scene, np.array([0.0, 0.0, 0.5 * cup.limit]))
    cup.hoist(0.0, 0.0, plate)
    assert cup.force == pytest.approx([0.0, 0.0, 0.5 * cup.limit])
    cup.hoist(0.5 * CupSettings().travel, 0.0, plate)
    assert cup.pull == pytest.approx(cup.limit)


def test_a_cup_never_pushes(scene) -> None:
    cup = lifter(scene, error=0.0)
    plate = hang(cup, scene, np.array([0.0, 0.0, 5.0]))
    cup.hoist(-0.1, 0.0, plate)
    assert cup.pull == 0.0


@pytest.mark.parametrize(("over", "steps"), [(1.05, 101), (1.29, 101), (1.31, 1)])
def test_a_cup_lets_go_a_fifth_of_a_second_over_its_limit_or_at_once_far_above(scene, over, steps) -> None:
    cup = lifter(scene, error=0.0)
    plate = hang(cup, scene, np.array([0.0, 0.0, 0.5 * cup.limit]))
    lasted = 0
    while True:
        cup.hoist((over - 0.5) * CupSettings().travel, 0.0, plate)
        lasted += 1
        if cup.lets_go(STEP) is not None:
            break
    assert abs(lasted - steps) <= 1


def test_a_short_jerk_is_borne(scene) -> None:
    cup = lifter(scene, error=0.0)
    plate = hang(cup, scene, np.array([0.0, 0.0, 0.5 * cup.limit]))
    for over in (1.2, 0.5) * 5:
        for _ in range(90):
            cup.hoist((over - 0.5) * CupSettings().travel, 0.0, plate)
            assert cup.lets_go(STEP) is None


def test_the_force_source_errs_by_its_error_and_ends_at_the_cups_limit(scene) -> None:
    cup = lifter(scene, error_time=0.01)
    plate = standing(np.eye(3), np.array([0.3, 0.0, 1.2]))
    place, velocity = at_rest(cup, plate)
    for wanted in (0.5, 0.99):
        pulls = []
        for _ in range(3000):
            cup.give(np.array([0, 0, wanted * cup.limit, 0, 0, 0.0]), place, velocity, plate, STEP)
            pulls.append(cup.pull / cup.limit)
        assert max(pulls) <= 1.0
        if wanted == 0.5:
            assert np.std(pulls) == pytest.approx(0.5 * CupSettings().error, rel=0.3)


def test_a_tared_sensor_reads_the_wrench_with_noise_alone() -> None:
    settings, wrench = SensorSettings(), np.array([1.0, -2.0, 15.0, 0.3, -0.1, 0.2])
    sensor = ForceSensor(np.random.default_rng(4), settings)
    readings = np.array([sensor.read(wrench) for _ in range(4000)])
    noise = np.repeat([settings.force_noise, settings.torque_noise], 3)
    assert readings.std(axis=0) == pytest.approx(noise, rel=0.1)
    assert np.all(np.abs(readings.mean(axis=0) - wrench) < 4.0 * noise / np.sqrt(settings.tare_readings))


def on_a_cable(scene) -> SuctionLifter:
    return lifter(replace(scene, lifter_model="cable"), error=0.0)


def test_a_cable_pulls_straight_up_on_a_tilted_plate_wherever_the_cup_is(scene) -> None:
    cup = on_a_cable(scene)
    R = rotation_from_vector([0.4, -0.2, 0.3])
    plate = standing(R, np.array([0.3, 0.0, 1.2]))
    place, velocity = at_rest(cup, plate)
    aside = np.array([0.01, 0.02, 0.0])
    wrench = cup.give(np.array([0, 0, 30.0, 0, 0, 0]), place + aside, velocity, plate, STEP)
    assert wrench[:3] == pytest.approx([0.0, 0.0, 30.0])
    assert wrench[3:] == pytest.approx(np.cross(place - plate[3], wrench[:3]))
    cup.hang(plate, np.zeros(3))
    moved = standing(R, plate[3] - 2.0 * aside)
    assert cup.hoist(0.0, 0.0, moved)[:3] == pytest.approx([0.0, 0.0, 30.0])


def test_a_slack_cable_does_not_push(scene) -> None:
    cup = on_a_cable(scene)
    plate = hang(cup, scene, np.array([0.0, 0.0, 5.0]))
    assert cup.hoist(-0.1, 0.0, plate) == pytest.approx(np.zeros(6))


def stiff(scene, kappa: float) -> SuctionLifter:
    return lifter(replace(scene, cup=replace(scene.cup, kappa=kappa)), error=0.0)


def torque_at_the_pad(cup: SuctionLifter, plate: Array, wrench: Array) -> Array:
    """What a wrench about the centre of mass is about the pad."""
    place = cup.place(plate)
    return wrench[3:] - skew(place - plate[3]) @ wrench[:3]


TURNED = standing(rotation_from_vector([0.4, -0.2, 0.7]), np.array([0.3, 0.0, 1.2]))


def given(cup: SuctionLifter, pull: float, torque: Array) -> tuple[Array, Array]:
    """The torques about the pad, (3,) each in world axes, of `give` and of `hoist`."""
    place, velocity = at_rest(cup, TURNED)
    force = pull * TURNED[:3] @ np.array([0.0, 0.0, 1.0])
    manipulated = cup.give(np.concatenate([force, torque]), place, velocity, TURNED, STEP)
    cup.hang(TURNED, torque)
    return torque_at_the_pad(cup, TURNED, manipulated), torque_at_the_pad(cup, TURNED, cup.hoist(0.0, 0.0, TURNED))


def test_a_cup_gives_a_planned_torque_that_its_pad_bears(scene) -> None:
    pad, kappa = scene.cup, 20.0
    bending = np.pi * pad.radius * kappa / np.sqrt(2.0)
    twist = ContactSettings().friction_factor * pad.mu * pad.radius * 0.5 * pad.max_force
    torque = TURNED[:3] @ pad.T_plate_cup[:3, :3] @ [0.99 * bending, -0.99 * bending, 0.99 * twist]
    for got in given(stiff(scene, kappa), 0.5 * pad.max_force, torque):
        assert got == pytest.approx(torque)


def test_a_cup_gives_no_more_torque_about_each_axis_than_its_pad_bears(scene) -> None:
    pad, kappa = scene.cup, 20.0
    limit = SuctionPad(Cup(pad.T_plate_cup, pad.radius, pad.max_force, pad.mu, kappa), 0.0, pad.mu)
    bending = limit.bending_limit * pad.radius
    axes = TURNED[:3] @ pad.T_plate_cup[:3, :3]
    for got in given(stiff(scene, kappa), 0.5 * pad.max_force, axes @ [0.5 * bending, -3.0 * bending, 0.0]):
        assert axes.T @ got == pytest.approx([0.5 * bending, -bending, 0.0])


def test_a_cup_that_is_nearly_a_hinge_gives_nearly_no_bending(scene) -> None:
    hinge = stiff(scene, 0.005)
    axes = TURNED[:3] @ scene.cup.T_plate_cup[:3, :3]
    for got in given(hinge, 0.5 * scene.cup.max_force, axes @ [1.6, 1.6, 0.0]):
        assert np.linalg.norm(got) < 0.001
