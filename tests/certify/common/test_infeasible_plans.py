"""A task is called infeasible only where its own numbers prove it, and with these numbers."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

from planners.certify import CellReference, RobotSurfaces
from planners.certify.common.cones import StatedCup
from planners.certify.common.infeasibility import largest_lift, stated_lift
from planners.certify.geometry.body_shape import prism
from planners.certify.lift.infeasibility import face_distances
from tests.support.documents import certified

Document = dict[str, Any]
WIDE_OPEN = 0.085


def unsolved(document: Document, outcome: str = "infeasible", **cause: Any) -> Document:
    """Turn the honest plan into one without a solution, with one cause."""
    document = copy.deepcopy(document)
    document["segments"] = []
    document["outcome"] = outcome
    cause = {"reason": "so it is", "needed": None, "available": None, "unit": None, "where": "capacity"} | cause
    document["explanation"] = {"summary": "because", "causes": [cause]}
    return document


def make_heavy(document: Document, weight: float) -> None:
    for plate in (document["task"]["plate"], document["bodies"]["plate"]):
        plate["mass"] = weight / 9.81


def make_thick(document: Document, size: list[float]) -> None:
    """Change the plate's size; the cup stays on its top face."""
    lift = (size[2] - document["bodies"]["plate"]["shape"]["size"][2]) / 2
    for plate in (document["task"]["plate"], document["bodies"]["plate"]):
        plate["shape"] = {"type": "box", "size": size}
    document["task"]["plate_pose"][2] += lift
    document["bodies"]["plate"]["pose"] = list(document["task"]["plate_pose"])
    for name in ("cup", "cable"):
        document["bodies"][name]["pose"][2] += 2 * lift


def hands_of(document: Document) -> list[float]:
    """The most that each hand bears [N]: its net limit, and what its arm's payload leaves beside it."""
    cell = document["cell"]
    left = [9.81 * (cell["arms"][arm]["payload"] - cell["hands"][arm]["mass"]) for arm in ("left", "right")]
    return [min(19.0, most) for most in left]


def most_that_lifts(document: Document, mu: float = 0.5) -> float:
    """Cup by a scan over tilts, and both hands."""
    tilts = np.linspace(0.0, np.pi / 2, 100_001)
    pull = document["task"]["cup"]["max_force"]
    return float((pull * (np.cos(tilts) + np.sqrt(2 / 3) * mu * np.sin(tilts))).max()) + sum(hands_of(document))


def infeasibility(document: Document, surfaces: RobotSurfaces) -> tuple[bool, str]:
    checks = {check.name: check for check in certified(document, surfaces).checks}
    if not checks["structure"].passed:
        # Figures that say of what there is enough are no cause at all; nothing else may be wrong with a document here.
        assert checks["structure"].where.startswith("/explanation/causes/0: a cause has")
        return False, checks["structure"].where
    others = [name for name, check in checks.items() if not check.passed and name != "infeasibility"]
    assert others == []
    return checks["infeasibility"].passed, checks["infeasibility"].where


def test_a_solved_plan_rewritten_as_infeasible_fails(document: Document, surfaces: RobotSurfaces) -> None:
    assert not infeasibility(unsolved(document), surfaces)[0]
    made_up = unsolved(document, needed=2.0 * 9.81, available=1.0, unit="N")
    assert not infeasibility(made_up, surfaces)[0]


def test_a_plate_heavier_than_all_can_lift_is_infeasible(
    document: Document, surfaces: RobotSurfaces, reference: CellReference
) -> None:
    most = most_that_lifts(document)
    weight = most * 1.001
    make_heavy(document, weight)
    honest = unsolved(document, needed=weight, available=most, unit="N")
    assert infeasibility(honest, surfaces)[0]
    assert certified(honest, surfaces, reference).passed


def test_a_plate_that_could_just_be_lifted_is_not_proven_infeasible(
    document: Document, surfaces: RobotSurfaces
) -> None:
    most = most_that_lifts(document)
    weight = most * 0.999
    make_heavy(document, weight)
    assert not infeasibility(unsolved(document, needed=weight, available=0.99 * weight, unit="N"), surfaces)[0]


@pytest.mark.parametrize("thick", [[0.3, 0.3, 0.1], [0.12, 0.3, 0.0851]])
def test_a_plate_thicker_and_wider_than_the_gripper_opens_is_infeasible(
    thick: list[float], document: Document, surfaces: RobotSurfaces
) -> None:
    make_thick(document, thick)
    assert infeasibility(unsolved(document, needed=thick[2], available=WIDE_OPEN, unit="m"), surfaces)[0]


def test_an_opening_wider_than_the_plate_is_thick_proves_nothing(document: Document, surfaces: RobotSurfaces) -> None:
    """A cause may name the plate's width as what is needed, not an opening into which its thickness would fit."""
    make_thick(document, [0.3, 0.3, 0.1])
    assert infeasibility(unsolved(document, needed=0.3, available=0.099, unit="m"), surfaces)[0]
    passed, where = infeasibility(unsolved(document, needed=0.3, available=0.101, unit="m"), surfaces)
    assert not passed
    assert "would suffice" in where


@pytest.mark.parametrize("size", [[0.08, 0.3, 0.1], [0.3, 0.08, 0.1], [0.3, 0.3, 0.0849]])
def test_a_plate_that_can_be_gripped_one_way_is_not_infeasible(
    size: list[float], document: Document, surfaces: RobotSurfaces
) -> None:
    make_thick(document, size)
    assert not infeasibility(unsolved(document, needed=size[2], available=WIDE_OPEN, unit="m"), surfaces)[0]


@pytest.mark.parametrize(
    ("x", "share", "available", "passes"),
    [
        (2.0, 1.0, 1.4, True),
        (2.0, 1.0, 1.0, False),
        (2.0, 1.01, 1.4, False),
        (2.0, 1.0, 2.1, False),
        (0.8, 1.0, 0.5, False),
    ],
)
def test_a_plate_that_neither_hand_reaches_is_infeasible(
    x: float, share: float, available: float, passes: bool, document: Document, surfaces: RobotSurfaces
) -> None:
    """The stick's arm reaches farther; both shoulders are as far from a plate between them."""
    for pose in (document["task"]["plate_pose"], document["bodies"]["plate"]["pose"]):
        shift = x - pose[0]
        pose[0] = x
    for name in ("cup", "cable"):
        document["bodies"][name]["pose"][0] += shift
    support = document["task"]["support"]["pose"], document["bodies"]["support"]["pose"]
    for pose in support:
        pose[0] = x
    shoulder = np.array([0.0, 0.258485, 1.610515]) + 0.15185 * np.array([0.0, 1.0, -1.0]) / np.sqrt(2.0)
    far = float(np.linalg.norm(np.array(document["task"]["plate_pose"][:3]) - shoulder))
    told = unsolved(document, needed=share * far, available=available, unit="m")
    assert infeasibility(told, surfaces)[0] == passes


@pytest.mark.parametrize(
    ("change", "member"),
    [
        ({"needed": 1.001}, "needed"),
        ({"needed": 0.999}, "needed"),
        ({"available": 0.999}, "available"),
        ({"available": 1.2}, "more needed than available"),
    ],
)
def test_a_cause_states_the_numbers_of_its_proof(
    change: dict[str, float], member: str, document: Document, surfaces: RobotSurfaces
) -> None:
    most = most_that_lifts(document)
    weight = most * 1.1
    make_heavy(document, weight)
    numbers = {"needed": weight, "available": most}
    told = unsolved(document, unit="N", **{key: value * change.get(key, 1.0) for key, value in numbers.items()})
    passed, where = infeasibility(told, surfaces)
    assert not passed
    assert member in where


def test_a_bound_that_is_looser_and_proves_it_all_the_same_may_be_stated(
    document: Document, surfaces: RobotSurfaces
) -> None:
    most = most_that_lifts(document)
    make_heavy(document, 1.1 * most)
    assert infeasibility(unsolved(document, needed=1.1 * most, available=1.05 * most, unit="N"), surfaces)[0]


def test_an_infeasible_task_needs_a_cause_with_numbers(document: Document, surfaces: RobotSurfaces) -> None:
    make_heavy(document, 1.1 * most_that_lifts(document))
    assert not infeasibility(unsolved(document), surfaces)[0]
    without = unsolved(document)
    without["explanation"]["causes"] = []
    assert not infeasibility(without, surfaces)[0]
    assert not infeasibility(unsolved(document, needed=2.0, available=1.0, unit="kg"), surfaces)[0]


def test_a_cell_with_a_gripper_that_opens_less_than_the_known_one_fails(
    document: Document, surfaces: RobotSurfaces, reference: CellReference
) -> None:
    document["cell"]["hands"]["right"]["tcp"] = document["cell"]["hands"]["right"]["tcp"][:3]
    opening = document["cell"]["hands"]["right"]["tcp"][-1][0]
    assert opening < 0.04
    told = unsolved(document, needed=0.04, available=opening, unit="m")
    assert {check.name for check in certified(told, surfaces, reference).failures} == {"cell"}


def test_a_bound_that_is_too_small_is_found_out_by_the_program(
    document: Document, surfaces: RobotSurfaces, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fault of ours: the formula forgets half of the cup."""
    weight = 0.95 * most_that_lifts(document)
    make_heavy(document, weight)
    told = unsolved(document, needed=weight, available=weight - 5.0, unit="N")
    monkeypatch.setattr("planners.certify.lift.infeasibility.largest_lift", lambda cup, _: 0.5 * cup.max_force)
    passed, where = infeasibility(told, surfaces)
    assert not passed
    assert "as the program finds" in where


@pytest.mark.parametrize("model", ["paper", "cable", "dexnet"])
@pytest.mark.parametrize("mu", [0.1, 0.5, 2.0])
def test_program_and_formula_find_the_same_bound(model: str, mu: float) -> None:
    cup = StatedCup(0.0175, 20.0, mu, 0.005)
    assert stated_lift(cup, model, (19.0, 7.0)) == pytest.approx(largest_lift(cup, model) + 26.0, rel=1e-6)


@pytest.mark.parametrize("model", ["paper", "cable", "dexnet"])
def test_a_weight_between_two_lifters_is_infeasible_for_the_weaker_one_alone(
    model: str, document: Document, surfaces: RobotSurfaces
) -> None:
    """Heavier than a cable lifts, lighter than a cup with friction at its best tilt."""
    with_a_cable = 20.0 + sum(hands_of(document))
    weight = 0.5 * (with_a_cable + most_that_lifts(document))
    make_heavy(document, weight)
    document["task"]["lifter_model"] = model
    told = unsolved(document, needed=weight, available=with_a_cable, unit="N")
    assert infeasibility(told, surfaces)[0] == (model != "paper")


def test_not_found_claims_nothing_and_has_no_certificate(document: Document, surfaces: RobotSurfaces) -> None:
    assert certified(unsolved(document, "not_found"), surfaces) is None


def test_not_found_is_read_all_the_same(document: Document, surfaces: RobotSurfaces) -> None:
    told = unsolved(document, "not_found")
    del told["task"]["cup"]
    certificate = certified(told, surfaces)
    assert certificate is not None
    assert [check.name for check in certificate.failures] == ["structure"]


@pytest.mark.parametrize("model", ["paper", "cable", "dexnet"])
@pytest.mark.parametrize("mu", [0.1, 0.5, 2.0])
def test_the_lifters_bound_is_the_best_of_a_linear_program_over_all_tilts(model: str, mu: float) -> None:
    """Forces along the plate's axes, at every tilt and about every axis of it."""
    cup = StatedCup(0.0175, 20.0, mu, 0.005)
    best = 0.0
    for tilt in np.linspace(0.0, np.pi, 61):
        for turn in (0.0, np.pi / 4):
            up = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
            if model == "cable":
                best = max(best, cup.max_force)
                continue
            slope, rest = (-mu, 0.0) if model == "paper" else (mu, mu * cup.max_force)
            rows = [[sign * np.sqrt(3.0) * axis[0], sign * np.sqrt(3.0) * axis[1], slope]
                    for axis in ((1, 0), (0, 1)) for sign in (1, -1)]  # fmt: skip
            bounds = [(None, None), (None, None), (0.0, cup.max_force)]
            answer = linprog(-up, A_ub=rows, b_ub=[rest] * 4, bounds=bounds)
            best = max(best, -answer.fun)
    assert best <= largest_lift(cup, model) * (1 + 1e-9)
    assert best >= largest_lift(cup, model) * (1 - 4e-4)


@pytest.mark.parametrize("friction", [0.1, 0.5, 0.9])
def test_no_two_points_between_which_pads_hold_a_plate_are_nearer_than_is_said(friction: float) -> None:
    """Brute force: points of the rim, and the lines between them that are within friction of square to both sides."""
    rng, cone, held = np.random.default_rng(5), math.atan(friction), 0
    for _ in range(20):
        angles = np.sort(rng.uniform(0, 2 * np.pi, 7))
        outline = np.column_stack([0.3 * np.cos(angles), 0.2 * np.sin(angles)])
        ends = np.roll(outline, -1, axis=0)
        shares = np.linspace(0.0, 1.0, 41)[:, None]
        rim = np.vstack([begin + shares * (end - begin) for begin, end in zip(outline, ends, strict=True)])
        along = (ends - outline) / np.linalg.norm(ends - outline, axis=1, keepdims=True)
        inward = np.repeat(np.column_stack([-along[:, 1], along[:, 0]]), len(shares), axis=0)
        lines = rim[None] - rim[:, None]
        lengths = np.linalg.norm(lines, axis=2)
        with np.errstate(invalid="ignore"):
            slants = np.arccos(np.clip(np.einsum("ijk,ik->ij", lines, inward) / lengths, -1.0, 1.0))
        holds = (slants < cone) & (slants.T < cone)
        held += holds.any()
        thickness, width = face_distances(prism(outline, 0.05), friction)
        assert thickness == pytest.approx(0.05)
        assert lengths[holds].min(initial=math.inf) >= width - 1e-9
    assert held > 5


def test_two_sides_of_a_box_are_as_far_apart_as_it_is_wide_and_a_taper_as_at_its_narrow_end() -> None:
    box = np.array([[-0.1, -0.06], [0.1, -0.06], [0.1, 0.06], [-0.1, 0.06]])
    assert face_distances(prism(box, 0.05), 0.5) == pytest.approx((0.05, 0.12))
    taper = np.array([[-0.2, -0.05], [0.2, -0.04], [0.2, 0.04], [-0.2, 0.05]])
    assert face_distances(prism(taper, 0.05), 0.5) == pytest.approx((0.05, 0.08))
    # As slippery as this, only the ends, which are parallel, can be held.
    assert face_distances(prism(taper, 0.05), 0.02) == pytest.approx((0.05, 0.4))
