"""Why a lift is not found, in the words and figures that help whoever posted it."""

from __future__ import annotations

from typing import Any

import pytest

from planners import read_task, solve
from planners.cell.cell import ShippedCells
from planners.plan.plan import Plan

UNEXPLORED = {"remedies": False, "simulate": False}


def heavy(**more: Any) -> Plan:
    """Return the plan of a plate too heavy for the cup of a cell whose arms bear much more than a task allows them."""
    plate = {"shape": {"type": "box", "size": [0.6, 0.4, 0.03]}, "mass": 15}
    task = {
        "kind": "plate_lift", "cell": "dual_ur10e_lift", "plate": plate, "plate_pose": [0.6, 0, 0.915, 1, 0, 0, 0],
        "cup": {"position": [0.15, 0.1], "radius": 0.05, "max_force": 100}, "options": UNEXPLORED,
    }  # fmt: skip
    return solve(read_task(task | more))


def payload_forces() -> tuple[str, str]:
    """Return what the arms of that cell bear beside gripper and stick, as it is told."""
    cell = ShippedCells()["dual_ur10e_lift"]
    (gripper,), (pusher,) = cell.gripper_arms, cell.pusher_arms
    return f"{cell.payload_force(gripper):.1f} N beside the gripper", f"{cell.payload_force(pusher):.1f} N beside"


@pytest.mark.parametrize(
    ("limits", "told"),
    [
        ({}, "hand_force_limit allows 17 N (normal) and 19 N (net), the default, where"),
        ({"normal": 18.0, "net": 18.5}, "hand_force_limit allows 18 N (normal) and 18.5 N (net) where"),
        ({"normal": 500.0}, "hand_force_limit allows 19 N (net), the default, where"),
    ],
)
def test_a_limit_of_the_task_that_is_short_is_named_with_what_the_arms_bear(
    limits: dict[str, float], told: str
) -> None:
    plan = heavy(**({"hand_force_limit": limits} if limits else {}))
    assert plan.outcome == "infeasible"
    for sentence in (plan.explanation.summary, plan.explanation.causes[0].reason):
        assert told in sentence
        assert all(borne in sentence for borne in payload_forces())


def test_payloads_that_are_short_are_not_blamed_on_the_task() -> None:
    """All that the arms bear does not suffice either: the cause still names the limit, the verdict does not."""
    much = {"shape": {"type": "box", "size": [0.6, 0.4, 0.03]}, "mass": 60.0}
    plan = heavy(plate=much)
    assert "hand_force_limit" not in plan.explanation.summary
    assert "hand_force_limit" in plan.explanation.causes[0].reason
    all_of_it = heavy(plate=much, hand_force_limit={"normal": 500.0, "net": 500.0})
    assert "hand_force_limit" not in all_of_it.explanation.causes[0].reason


def test_reasons_of_a_lift_do_not_count_what_was_tried() -> None:
    plate = {"shape": {"type": "box", "size": [0.3, 0.25, 0.03]}, "mass": 3.0}
    task = {
        "kind": "plate_lift", "plate": plate, "plate_pose": [0.65, 0.6, 1.109, 1, 0, 0, 0],
        "cup": {"position": [0.08, 0], "radius": 0.02, "max_force": 25},
        "options": {**UNEXPLORED, "contact_density": 0.5, "hold_density": 0.5},
    }  # fmt: skip
    plan = solve(read_task(task))
    assert plan.outcome == "not_found"
    balance = [cause.reason for cause in plan.explanation.causes if cause.where == "balance"]
    assert balance
    assert not any("times" in reason for reason in balance)
    assert sum(plan.statistics.rejections.values()) > len(plan.explanation.causes)
