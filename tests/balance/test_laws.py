"""What must hold of any balance, by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from planners.balance.balanced import Balanced, Unbalanced
from planners.balance.contacts import Cup, GripContacts, HandLimits, PushContact
from planners.balance.solver import Balance
from planners.errors import LiftwrightError
from planners.geometry.pose import rotation_x, rotation_y, rotation_z, transform

HALF = np.array([0.15, 0.15, 0.02])
CORNERS = HALF * np.array([[-1, -1, -1], [-1, 1, -1], [1, 1, -1], [1, -1, -1]])
NOTHING = np.empty((0, 3))
GRIP = GripContacts(np.array([[0.0, -0.13, -0.02], [0.0, -0.13, 0.02]]), np.array([[0, 0, 1.0], [0, 0, -1.0]]))
PUSH = PushContact(np.array([0.0, 0.14, -0.02]), np.array([0, 0, 1.0]))
MODELS = ("paper", "cable", "dexnet")


def balance(mass=4.0, cup_at=(0.0, 0.0), max_force=20.0, kappa=0.005, **rest) -> Balance:
    cup = Cup.on_top((*cup_at, 0.02), 0.0175, max_force, kappa=kappa)
    return Balance(mass, np.zeros(3), cup, **rest)


@pytest.mark.parametrize("model", MODELS)
def test_a_plate_flat_on_the_table_needs_no_hands(model):
    answer = balance(lifter_model=model).solve(np.eye(3), CORNERS)
    assert isinstance(answer, Balanced)
    assert answer.objective == pytest.approx(0.0, abs=1e-5)
    with_hands = balance(lifter_model=model).solve(np.eye(3), CORNERS, GRIP, PUSH)
    assert with_hands.objective == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("share", [0.999, 1.001])
def test_a_level_cup_above_the_centre_lifts_its_force_and_no_more(model, share):
    answer = balance(mass=share * 20.0 / 9.81, lifter_model=model).solve(np.eye(3), NOTHING)
    assert isinstance(answer, Balanced) == (share < 1.0)


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_a_cup_holds_a_slope_up_to_its_friction_over_root_three(share):
    """At tilt t about y the cup bears m g sin t along x by pulling m g cos t: tan t = mu / sqrt(3)."""
    light = Balance(0.5, np.array([0, 0, 0.02]), Cup.on_top((0, 0, 0.02), 0.0175, 20.0, mu=0.5))
    tilt = math.atan(share * 0.5 / math.sqrt(3.0))
    assert isinstance(light.solve(rotation_y(tilt), NOTHING), Balanced) == (share < 1.0)


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_a_pad_bears_a_bending_moment_up_to_its_stiffness(share):
    """A weight W at a lever d along y bends the pad about x: W d = pi r kappa / sqrt(2)."""
    lever = share * math.pi * 0.0175 * 9.0 / math.sqrt(2.0) / 15.0
    hung = balance(mass=15.0 / 9.81, cup_at=(0.0, lever), kappa=9.0)
    assert isinstance(hung.solve(np.eye(3), NOTHING), Balanced) == (share < 1.0)


@pytest.mark.parametrize("share", [0.999, 1.001])
def test_two_hands_and_the_cup_share_a_level_weight(share):
    """Lever arms: cup in the middle at its 20 N, the hands on either side balance each other's moment."""
    limits = HandLimits(normal=17.0, grip=10.0, push=10.0)
    grip = GripContacts(np.array([[0.0, -0.14, -0.02], [0.0, -0.14, 0.02]]), GRIP.normals)
    held = balance(mass=share * 40.0 / 9.81, limits=limits)
    answer = held.solve(np.eye(3), NOTHING, grip, PUSH)
    assert isinstance(answer, Balanced) == (share < 1.0)


@pytest.mark.parametrize("model", MODELS)
def test_a_weight_beyond_all_capacity_is_refused(model):
    heavy = balance(mass=100.0 / 9.81, lifter_model=model).solve(np.eye(3), NOTHING, GRIP, PUSH)
    assert isinstance(heavy, Unbalanced)


@pytest.mark.parametrize("model", MODELS)
def test_a_mirrored_lift_needs_the_same_effort(model):
    mirror = np.diag([-1.0, 1.0, 1.0])
    R = rotation_z(0.4) @ rotation_y(0.25) @ rotation_x(0.1)
    edge = CORNERS[:1]
    push = PushContact(PUSH.point + np.array([0.03, 0, 0]), np.array([0.6, 0.0, 0.8]))
    grip = GripContacts(GRIP.points + np.array([0.05, 0, 0]), GRIP.normals)
    one = balance(mass=2.5, cup_at=(0.06, 0.01), lifter_model=model).solve(R, edge, grip, push)
    other = balance(mass=2.5, cup_at=(-0.06, 0.01), lifter_model=model).solve(
        mirror @ R @ mirror,
        edge @ mirror,
        GripContacts(grip.points @ mirror, grip.normals @ mirror),
        PushContact(push.point @ mirror, push.normal @ mirror),
    )
    assert isinstance(one, Balanced)
    assert other.objective == pytest.approx(one.objective, rel=1e-6)


@pytest.mark.parametrize("model", MODELS)
def test_yaw_of_the_plate_changes_nothing(model):
    tilted = rotation_y(0.2)
    held = balance(cup_at=(0.05, 0.0), lifter_model=model)
    efforts = [held.solve(rotation_z(yaw) @ tilted, CORNERS[:2], GRIP, PUSH).objective for yaw in (0.0, 1.0, 2.5)]
    assert efforts == pytest.approx([efforts[0]] * 3, rel=1e-7)


@pytest.mark.parametrize("field", ["max_force", "mu", "kappa", "radius"])
def test_a_better_cup_never_needs_more_effort(random_lift, field):
    check_monotonic(random_lift, lambda plate: replace(plate, cup=scaled(plate.cup, field)))


@pytest.mark.parametrize("field", ["grip", "push", "environment", "eps"])
def test_more_friction_never_needs_more_effort(random_lift, field):
    check_monotonic(random_lift, lambda plate: replace(plate, friction=scaled(plate.friction, field)))


@pytest.mark.parametrize("field", ["normal", "grip", "push"])
def test_stronger_hands_never_need_more_effort(random_lift, field):
    check_monotonic(random_lift, lambda plate: replace(plate, limits=scaled(plate.limits, field)))


def scaled(record, field):
    return replace(record, **{field: 1.3 * getattr(record, field)})


def check_monotonic(random_lift, improve):
    held = 0
    for seed, environment in enumerate([0, 1, 2, 4] * 5):
        lift = random_lift(seed, "paper", environment, True, True)
        before = lift.solve()
        if isinstance(before, Balanced):
            after = replace(lift, plate=improve(lift.plate)).solve()
            assert isinstance(after, Balanced)
            assert after.objective <= before.objective + 2e-5
            held += 1
    assert held > 5


@pytest.mark.parametrize(
    "build",
    [
        lambda: balance(mass=0.0),
        lambda: balance(lifter_model="magnet"),
        lambda: balance(max_force=-1.0),
        lambda: PushContact(np.zeros(3), np.array([0.0, 0.0, 2.0])),
        lambda: GripContacts(np.zeros((3, 3)), GRIP.normals),
        lambda: Cup(transform(), 0.0, 20.0),
        lambda: HandLimits(normal=float("nan")),
    ],
)
def test_what_cannot_be_is_refused(build):
    with pytest.raises(LiftwrightError):
        build()


def test_a_contact_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        PUSH.point[0] = 1.0
