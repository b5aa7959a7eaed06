"""One small lift, built and planned once."""

from __future__ import annotations

import pytest

from planners.manipulation.lift_plan import LiftOutcome, LiftPlan
from planners.manipulation.planner import PlateLiftPlanner
from tests.manipulation.lift_probe import FclCell, planner_of, task_body


@pytest.fixture(scope="session")
def lift() -> tuple[PlateLiftPlanner, LiftPlan]:
    """AB3: four starts, hands that regrasp, and motions in between that cannot be held."""
    planner = planner_of(task_body("ab3"))
    plan = planner.plan()
    assert plan.outcome is LiftOutcome.SOLVED
    return planner, plan


@pytest.fixture(scope="session")
def planner(lift) -> PlateLiftPlanner:
    return lift[0]


@pytest.fixture(scope="session")
def solved(lift) -> LiftPlan:
    return lift[1]


@pytest.fixture(scope="session")
def holding_cell(planner) -> FclCell:
    """The cell with the gripper closed on the plate."""
    return FclCell(planner.workcell, holding=True)


@pytest.fixture(scope="session")
def open_cell(planner) -> FclCell:
    """The cell with the gripper open around the plate."""
    return FclCell(planner.workcell, holding=False)
