"""Why a lift is not found, in the words and figures that help whoever posted it."""

from __future__ import annotations

import re
from itertools import product
from typing import Any

import pytest

from planners import read_task, solve
from planners.balance.balanced import Balanced
from planners.cell.cell import ShippedCells
from planners.contract.task_spec import HandForceLimit, PlateLiftTask
from planners.manipulation.lift_sampling import LiftSampling
from planners.manipulation.lift_settings import LiftSettings
from planners.plan.plan import Plan
from planners.scene.lift_scene import build_lift_scene
from planners.scene.shape_source import no_uploads

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


def holds_at(x: float) -> dict[str, Any]:
    """Return options of a lift whose two grips and pushes are all at one end of the plate."""
    sides = (-0.15, 0.15)
    grips = [{"position": [x, y, 0.0], "approach": [-1.0, 0.0, 0.0]} for y in sides]
    pushes = [{"position": [x, y, -0.015], "normal": [0, 0, 1.0], "direction": [-0.6, 0, 0.8]} for y in sides]
    return {"options": {**UNEXPLORED, "grips": grips, "pushes": pushes}}


def is_held(task: PlateLiftTask) -> bool:
    """Ask of every pose in the air, with every grip and push, whether forces hold the plate as stated."""
    scene = build_lift_scene(task, None, no_uploads)
    sampling = LiftSampling.of(scene, LiftSettings().in_cell(scene.cell))
    balance = sampling.balance(0.0, tolerances=False)
    nodes = product(sampling.poses.goals, range(len(sampling.grips)), range(len(sampling.pushes)))
    return any(
        isinstance(balance.at(pose, (grip, push)), Balanced)
        for pose, grip, push in nodes
        if not balance.ruled_out[pose, 1 + grip, 1 + push]
    )


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({}, "The task's limit is short: "),
        ({"cup": {"position": [-0.2, 0.0], "radius": 0.05, "max_force": 20}, **holds_at(0.28)}, "and not alone"),
        ({"cup": {"position": [0.2, 0.0], "radius": 0.05, "max_force": 20}, **holds_at(0.28)}, "no forces were found"),
    ],
    ids=["the limit", "the limit and the cup", "neither"],
)
def test_what_is_told_to_be_enough_holds_the_plate_once_all_of_it_is_granted(more: dict[str, Any], told: str) -> None:
    """And not before, nor with a part of it. As forces go: whether the arms get there is another matter."""
    much = {"shape": {"type": "box", "size": [0.6, 0.4, 0.03]}, "mass": 23.0}
    plan = heavy(plate=much, **more)
    task, summary = plan.task, plan.explanation.summary
    assert isinstance(task, PlateLiftTask)
    assert told in summary
    assert not is_held(task)
    cell = ShippedCells()[task.cell]
    most = max(cell.payload_force(arm) for arm in cell.arms)
    granted = task.model_copy(update={"hand_force_limit": HandForceLimit(normal=most, net=most)})
    assert is_held(granted) == ("if the arms get it there" in summary)
    if stronger := re.search(r"if the cup pulls with ([0-9.]+) N as well", summary):
        force = float(stronger[1])
        assert is_held(with_cup_force(granted, force))
        assert not is_held(with_cup_force(task, force))


def with_cup_force(task: PlateLiftTask, force: float) -> PlateLiftTask:
    return task.model_copy(update={"cup": task.cup.model_copy(update={"max_force": force})})


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
