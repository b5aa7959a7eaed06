"""What a plan tells while it is made: the seconds of paper A's Table I are counted by it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from planners.contract.task_spec import SuctionToolTask, read_task
from planners.progress import Report
from planners.regrasp.graph.object_progress import ObjectProgress, ObjectStage
from planners.regrasp.grasps.handovers import HandoverSettings, find_handovers
from planners.regrasp.planner import SuctionToolPlanner
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.scene.tool_scene import build_tool_scene

TASK = Path(__file__).parents[2] / "assets" / "tasks" / "can_stack.json"


class Reports:
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.told: list[Report] = []

    def __call__(self, report: Report, /) -> None:
        self.told.append(report)


@pytest.fixture(scope="module")
def told() -> list[Report]:
    """Return all that is told while the cans are stacked; few handovers suffice."""
    task = read_task(json.loads(TASK.read_text()))
    assert isinstance(task, SuctionToolTask)
    scene = build_tool_scene(task)
    handovers = find_handovers(scene.cell, scene.tool, HandoverSettings(axis_rolls=1))
    reports = Reports()
    SuctionToolPlanner(scene, ToolPlannerSettings(), handovers, reports).plan()
    return reports.told


@pytest.mark.parametrize("name", ["can_1", "can_2"])
def test_every_part_of_planning_an_object_is_told(told: list[Report], name: str) -> None:
    assert {stage.value for stage in ObjectStage} <= {report.stage for report in told if report.object == name}


@pytest.mark.parametrize("name", ["can_1", "can_2"])
def test_grasps_come_before_the_graph_and_the_graph_before_motion(told: list[Report], name: str) -> None:
    first = {
        stage: next(i for i, report in enumerate(told) if (report.stage, report.object) == (stage.value, name))
        for stage in ObjectStage
    }
    assert sorted(first, key=first.__getitem__) == [
        ObjectStage.FIRST_REGRASP,
        ObjectStage.SECOND_REGRASP,
        ObjectStage.GRAPH,
        ObjectStage.FIRST_MOTION,
        ObjectStage.SECOND_MOTION,
    ]


def test_the_suction_poses_tried_never_exceed_those_there_are(told: list[Report]) -> None:
    stages = tuple(stage.value for stage in ObjectStage)
    parts = [(report.done, report.total) for report in told if report.stage in stages]
    assert parts
    assert all(0 <= done <= total for done, total in parts)


def test_a_report_names_its_object_after_the_part() -> None:
    reports = Reports()
    tell = ObjectProgress(reports, "box", 40)
    tell(ObjectStage.motion(0))
    tell.tried = 8
    tell(ObjectStage.motion(1))
    assert [(report.name, report.done, report.total) for report in reports.told] == [
        ("first motion box", 0, 40),
        ("second motion box", 8, 40),
    ]
