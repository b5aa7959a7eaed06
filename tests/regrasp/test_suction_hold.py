"""The suction cones against cvxpy and by hand."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.geometry.pose import inverse, rotation_from_vector, rotation_z, transform
from planners.geometry.wrench import grasp_map
from planners.regrasp.suction.suction_hold import (
    SuctionLimit,
    cup_uses,
    cup_wrenches,
    least_margin,
    suction_margin,
    suction_margins,
    weight,
)


@dataclass(frozen=True)
class Lip:
    radius: float = 0.0175
    max_force: float = 20.0
    mu: float = 0.5
    kappa: float = 4.5


LIP = Lip()
PEEL = math.pi * LIP.radius * LIP.kappa / math.sqrt(2.0)
"""Torque at which the lip peels [Nm]."""


def dexnet_holds(wrench: np.ndarray, lip: Lip) -> bool:
    """Dex-Net's limits as printed, component by component."""
    fx, fy, pull, tx, ty, tz = wrench
    friction = lip.mu * (lip.max_force - pull)
    return bool(
        0.0 <= pull <= lip.max_force
        and math.sqrt(3.0) * max(abs(fx), abs(fy)) <= friction
        and math.sqrt(3.0) * abs(tz) <= lip.radius * friction
        and math.sqrt(2.0) * max(abs(tx), abs(ty)) <= math.pi * lip.radius * lip.kappa
    )


def turned_about_the_pad(wrench: np.ndarray, angle: float) -> np.ndarray:
    R = rotation_z(angle)
    return np.concatenate([R @ wrench[:3], R @ wrench[3:]])


def random_wrenches(seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 6)) * [8, 8, 30, 0.3, 0.3, 0.15]


def test_a_wrench_holds_exactly_if_dexnet_holds_it_in_all_axes_of_the_pad():
    angles = np.linspace(0.0, math.pi / 2, 721)
    for wrench in random_wrenches(0, 150):
        in_all_axes = all(dexnet_holds(turned_about_the_pad(wrench, angle), LIP) for angle in angles)
        margin = float(suction_margin(wrench, LIP))
        if abs(margin) > 1e-4:
            assert (margin > 0.0) == in_all_axes


@given(seed=st.integers(0, 10_000), angle=st.floats(-4, 4))
def test_the_roll_of_the_tool_changes_no_margin(seed, angle):
    wrench = random_wrenches(seed, 1)[0]
    assert suction_margin(turned_about_the_pad(wrench, angle), LIP) == pytest.approx(suction_margin(wrench, LIP))


def weakened(lip: Lip, part: float) -> Lip:
    return Lip(lip.radius, part * lip.max_force, part * lip.mu, part * lip.kappa)


def test_a_cup_that_is_weaker_by_its_reserve_just_holds() -> None:
    """Force, friction and stiffness all shrink; what needs all of them bears no weaker cup, what needs more, none."""
    held = [w for w in 0.3 * random_wrenches(5, 400) if suction_margin(w, LIP) >= 0.0]
    for wrench in held:
        part = float(cup_uses(wrench, LIP).max())
        assert suction_margin(wrench, weakened(LIP, part * (1.0 + 1e-9))) >= 0.0
        assert suction_margin(wrench, weakened(LIP, part * (1.0 - 1e-6))) < 0.0
    assert len(held) > 20


def test_a_cup_lets_go_of_just_what_uses_more_than_all_of_it() -> None:
    wrenches = 0.3 * random_wrenches(6, 500)
    held = suction_margin(wrenches, LIP) >= 0.0
    assert 0 < held.sum() < len(held)
    np.testing.assert_array_equal(cup_uses(wrenches, LIP).max(axis=1) <= 1.0, held)


def test_more_load_than_the_reserve_leaves_room_for_is_never_lost_before() -> None:
    """A load that grows by 1 / (1 - reserve) is held: friction and force do not both shrink then."""
    for wrench in 0.3 * random_wrenches(7, 400):
        part = float(cup_uses(wrench, LIP).max())
        if part <= 1.0:
            assert suction_margin(wrench / part * (1.0 - 1e-9), LIP) >= 0.0


@pytest.mark.parametrize(
    ("limit", "wrench"),
    [
        (SuctionLimit.PULL, [0, 0, LIP.max_force, 0, 0, 0]),
        (SuctionLimit.SLIP, [LIP.mu * LIP.max_force / math.sqrt(3.0), 0, 0, 0, 0, 0]),
        (SuctionLimit.SLIP, [0, LIP.mu * (LIP.max_force - 8.0) / math.sqrt(3.0), 8.0, 0, 0, 0]),
        (SuctionLimit.TWIST, [0, 0, 5.0, 0, 0, LIP.radius * LIP.mu * (LIP.max_force - 5.0) / math.sqrt(3.0)]),
        (SuctionLimit.PEEL, [0, 0, 5.0, PEEL, 0, 0]),
        (SuctionLimit.PEEL, [0, 0, 5.0, 0.6 * PEEL, -0.8 * PEEL, 0]),
    ],
)
def test_each_limit_is_met_where_its_formula_says(limit, wrench):
    wrench = np.array(wrench, dtype=float)
    assert suction_margin(wrench, LIP) == pytest.approx(0.0, abs=1e-12)
    assert suction_margins(wrench, LIP)[list(SuctionLimit).index(limit)] == pytest.approx(0.0, abs=1e-12)
    assert suction_margin(0.999 * wrench, LIP) > 0.0 > suction_margin(1.001 * wrench, LIP)


def test_a_cup_cannot_push():
    assert suction_margin(np.array([0, 0, -0.5, 0, 0, 0]), LIP) == pytest.approx(-0.5 / LIP.max_force)
    assert suction_margin(np.zeros(6), LIP) == 1.0


@given(seed=st.integers(0, 10_000), growth=st.floats(1.0, 3.0))
def test_a_pulling_wrench_can_grow_until_one_over_the_used_share(seed, growth):
    wrench = random_wrenches(seed, 1)[0]
    wrench[2] = abs(wrench[2])
    margin = float(suction_margin(wrench, LIP))
    assert suction_margin(growth * wrench, LIP) == pytest.approx(1.0 - growth * (1.0 - margin), abs=1e-9)


@given(seed=st.integers(0, 10_000))
def test_the_cup_balances_what_it_bears(seed):
    """Moved to one point, the load and the cup's wrench cancel: the grasp map of paper B, (2), is the authority."""
    rng = np.random.default_rng(seed)
    T_world_object, T_object_tool = (
        transform(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)) for _ in range(2)
    )
    com, load = rng.normal(size=3), rng.normal(size=6)
    wrench = cup_wrenches(load, T_world_object, com, T_object_tool)
    T_com_tool = inverse(transform(position=com)) @ T_object_tool
    at_com = grasp_map(T_com_tool) @ wrench
    R = T_world_object[:3, :3]
    assert np.concatenate([R @ at_com[:3], R @ at_com[3:]]) == pytest.approx(-load, abs=1e-9)


def test_wrenches_of_many_poses_are_those_of_each():
    rng = np.random.default_rng(2)
    Ts = np.array([transform(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)) for _ in range(5)])
    com, loads = rng.normal(size=3), rng.normal(size=(5, 6))
    together = cup_wrenches(loads, Ts, com, Ts[0])
    assert together == pytest.approx(np.array([cup_wrenches(w, T, com, Ts[0]) for w, T in zip(loads, Ts, strict=True)]))


def test_wrenches_of_many_cups_are_those_of_each():
    rng = np.random.default_rng(3)
    Ts = np.array([transform(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)) for _ in range(5)])
    com, load = rng.normal(size=3), rng.normal(size=6)
    assert cup_wrenches(load, Ts[0], com, Ts) == pytest.approx(
        np.array([cup_wrenches(load, Ts[0], com, T) for T in Ts])
    )


def test_under_a_level_cup_the_weight_is_a_pull_and_nothing_else():
    T_object_tool = transform(position=np.array([0.0, 0.0, 0.03]))
    wrench = cup_wrenches(weight(0.3, np.array([0.0, 0.0, -9.81])), np.eye(4), np.zeros(3), T_object_tool)
    assert wrench == pytest.approx([0, 0, 0.3 * 9.81, 0, 0, 0])


def test_the_weakest_moment_names_its_limit():
    wrenches = np.array([[0, 0, 5, 0, 0, 0], [0, 0, 5, 0.9 * PEEL, 0, 0], [1, 0, 5, 0, 0, 0]], dtype=float)
    weakest = least_margin(wrenches, LIP)
    assert (weakest.sample, weakest.limit, weakest.holds) == (1, SuctionLimit.PEEL, True)
    assert weakest.margin == pytest.approx(0.1)


def test_figures_of_a_weak_hold_say_what_is_short_exactly_where_the_cup_lets_go():
    """Each limit alone is what its figures say; so is which of them are exceeded."""
    rng = np.random.default_rng(3)
    scale = np.array([LIP.max_force] * 3 + [PEEL] * 3)
    seen = set()
    for wrench in rng.normal(size=(3000, 6)) * scale * rng.choice([0.01, 1.0], size=(3000, 6)):
        weakest = least_margin(wrench[None], LIP)
        needed, available, unit = weakest.figures
        assert (needed > available) == (weakest.margin < 0.0)
        assert available >= 0.0
        assert unit == ("Nm" if weakest.limit in (SuctionLimit.TWIST, SuctionLimit.PEEL) else "N")
        seen.add((weakest.limit, weakest.holds))
    assert {limit for limit, holds in seen if not holds} == set(SuctionLimit)


def test_what_pulls_off_is_not_said_to_slip():
    weakest = least_margin(np.array([[1e-9, 0, 1.5 * LIP.max_force, 0, 0, 1e-9]]), LIP)
    assert weakest.limit is SuctionLimit.PULL
    assert weakest.figures == pytest.approx((1.5 * LIP.max_force, LIP.max_force, "N"))
