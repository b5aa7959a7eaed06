"""As many objects as a task may have: its plan is long, and proven all the same."""

from __future__ import annotations

import pytest

from planners.certify import RobotSurfaces
from tests.support.documents import certified
from tests.support.many_boxes import many_boxes
from tests.support.tool_plans import planned, reference_of_the_tool_cell


@pytest.mark.parametrize("count", [2, pytest.param(50, marks=pytest.mark.slow)])
def test_a_plan_of_many_boxes_passes_its_certificate(count: int, surfaces: RobotSurfaces) -> None:
    document = planned(many_boxes(count))
    certificate = certified(document, surfaces, reference_of_the_tool_cell())
    assert certificate.passed, certificate.failures
