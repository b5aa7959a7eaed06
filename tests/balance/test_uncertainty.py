"""What is not known of a plate: corners against brute force, "held" against random plates, "no" against cvxpy."""

from __future__ import annotations

import itertools

import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import linprog

from planners.balance.balanced import Balanced, Unbalanced
from planners.balance.solver import Balance
from planners.balance.uncertainty import Uncertainty
from planners.errors import LiftwrightError
from planners.geometry.pose import Array
from tests.support.random_holds import Lift, random_lift

CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
KINDS = [(model, points, hands) for model in ("paper", "dexnet", "cable") for points in (0, 1, 2) for hands in (1, 3)]


def directions() -> list[Array]:
    """Random ones, and those along an axis, in a plane of axes, and next to both."""
    rng = np.random.default_rng(3)
    found = [*rng.standard_normal((20, 3)), *np.eye(3), *-np.eye(3), *(np.ones((3, 3)) - np.eye(3)), np.ones(3)]
    found += [[1e-9, 0.0, 1.0], [1.0, 1.0, 1e-9], [-1.0, 1.0, 0.0]]
    return [np.array(each) / np.linalg.norm(each) for each in found]


@pytest.mark.parametrize("up", directions())
def test_the_torques_of_all_eight_corners_are_means_of_those_returned(up: Array) -> None:
    com = 0.005
    returned = Uncertainty(0.0, com).corners(up)
    assert len(returned) <= 6
    assert np.abs(returned).max() <= com
    torques = np.cross(up, returned)
    for corner in com * CORNERS:
        rows = np.vstack([torques.T / com, np.ones(len(returned))])
        wanted = np.concatenate([np.cross(up, corner) / com, [1.0]])
        assert linprog(np.zeros(len(returned)), A_eq=rows, b_eq=wanted).status == 0


def test_a_plate_whose_centre_is_known_has_one_corner() -> None:
    assert np.array_equal(Uncertainty(0.1, 0.0).corners(np.array([0.0, 0.6, 0.8])), np.zeros((1, 3)))


def test_the_least_power_of_gravity_is_that_of_the_plate_it_helps_least() -> None:
    rng = np.random.default_rng(4)
    twists, ups = rng.standard_normal((50, 6)), rng.standard_normal((50, 3))
    ups /= np.linalg.norm(ups, axis=1, keepdims=True)
    mass, com, weight = 0.03, 0.007, 31.0
    found = Uncertainty(mass, com).least_power(weight, twists, ups)
    for twist, up, least in zip(twists, ups, found, strict=True):
        forces = [-weight * factor * up for factor in (1.0 - mass, 1.0 + mass)]
        powers = [twist[:3] @ f + twist[3:] @ np.cross(com * corner, f) for f in forces for corner in CORNERS]
        assert least == pytest.approx(min(powers), rel=1e-9)


@pytest.mark.parametrize(("mass", "com"), [(-0.01, 0.0), (1.0, 0.0), (0.0, -1e-3), (float("nan"), 0.0)])
def test_tolerances_that_cannot_be_are_refused(mass: float, com: float) -> None:
    with pytest.raises(LiftwrightError, match="cannot be"):
        Uncertainty(mass, com)


def tolerant(lift: Lift) -> Balance:
    return lift.balance.for_all(Uncertainty(0.05, 0.006))


def refusal(lift: Lift) -> Unbalanced | None:
    return tolerant(lift).refusal(lift.rotation, lift.environment_points, lift.grip, lift.push)


def some(kind: tuple[str, int, int], *, refused: bool, count: int) -> list[Lift]:
    """Random lifts of one kind whose plate as stated is held, though perhaps not every plate within the tolerances."""
    model, points, hands = kind
    found: list[Lift] = []
    for seed in range(200):
        lift = random_lift(seed, model, points, bool(hands & 1), bool(hands & 2))
        if isinstance(lift.solve(), Balanced) and (refusal(lift) is not None) == refused:
            found.append(lift)
        if len(found) == count:
            break
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_where_nothing_is_refused_every_plate_within_the_tolerances_is_held(kind: tuple[str, int, int]) -> None:
    """Lighter plates too, though only the heaviest are asked for."""
    rng = np.random.default_rng(5)
    for lift in some(kind, refused=False, count=2):
        plate = lift.plate
        for _ in range(12):
            mass, com = plate.mass * rng.uniform(0.95, 1.05), plate.com + rng.uniform(-0.006, 0.006, 3)
            other = Balance(mass, com, plate.cup, plate.friction, plate.limits, plate.lifter_model)
            assert isinstance(other.solve(lift.rotation, lift.environment_points, lift.grip, lift.push), Balanced)


def test_enough_kinds_of_lifts_are_held_and_refused() -> None:
    assert sum(bool(some(kind, refused=False, count=1)) for kind in KINDS) >= len(KINDS) // 2
    assert sum(bool(some(kind, refused=True, count=1)) for kind in KINDS) >= len(KINDS) // 3


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_refused_has_a_plate_that_cvxpy_cannot_balance_and_a_proof_that_holds(kind) -> None:
    for lift in some(kind, refused=True, count=1):
        answer, plate = refusal(lift), lift.plate
        assert answer is not None
        assert answer.proof is not None
        twist, statement = answer.proof.twist, lift.state()
        normals = [F[2] for name, F in statement.wrenches.items() if name.startswith("environment")]
        bound = [cp.sum(cp.hstack(normals)) <= tolerant(lift).environment_bound] if normals else []
        contacts = cp.Problem(cp.Maximize(twist @ statement.total), [*statement.limits, *bound]).solve(
            solver="CLARABEL"
        )
        force = -1.05 * plate.mass * 9.81 * lift.rotation[2]
        loads = [np.concatenate([force, np.cross(0.006 * corner, force)]) for corner in CORNERS]
        assert contacts + min(twist @ load for load in loads) < 0.0
        assert answer.power >= contacts + min(twist @ load for load in loads) - 1e-6
        assert not all(_borne(statement, load) for load in loads)


def _borne(statement, load: Array) -> bool:
    problem = cp.Problem(cp.Minimize(0), [statement.total + load == 0, *statement.limits])
    problem.solve(solver="CLARABEL")
    return problem.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)
