"""One small lift, built and planned once."""

from __future__ import annotations

import pytest

from planners.graph.search import GoalSearch
from planners.manipulation.lift_plan import LiftPlan
from planners.manipulation.motion.assignment import PostureAssigner
from planners.manipulation.motion.manipulation_sequence import ManipulationSequence
from planners.manipulation.planner import PlateLiftPlanner
from planners.plan.verdicts import PlanningOutcome
from tests.manipulation.lift_probe import FclCell, planner_of, task_body


@pytest.fixture(scope="session")
def lift() -> tuple[PlateLiftPlanner, LiftPlan]:
    """AB3: four starts, hands that regrasp, and motions in between that cannot be held."""
    planner = planner_of(task_body("ab3"))
    plan = planner.plan()
    assert plan.outcome is PlanningOutcome.SOLVED
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
    return FclCell(planner.sampling.workcell, holding=True)


@pytest.fixture(scope="session")
def open_cell(planner) -> FclCell:
    """The cell with the gripper open around the plate."""
    return FclCell(planner.sampling.workcell, holding=False)


@pytest.fixture(scope="session")
def assigner(planner, solved) -> PostureAssigner:
    """Of the sequence that was found: the cheapest path of its start, in the graph as it was left."""
    graph = planner.search.graph
    first = solved.steps[0].hands
    start = next(
        n for n in graph.starts for g, p in [graph.hold_of(n)] if (g and g.index, p and p.index) == first
    )  # fmt: skip
    path = GoalSearch(graph.graph, graph.knowledge, graph.goal, planner.search.examiner).path_from(start)
    assert path is not None
    assert [int(graph.node_pose[n]) for n in path.nodes] == [step.pose for step in solved.steps]
    return PostureAssigner(
        planner.reach.follower,
        ManipulationSequence.of(graph, path),
        planner.scene.start_positions,
        planner.search.rising,
    )
