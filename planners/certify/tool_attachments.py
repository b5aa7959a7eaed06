"""What is attached in a suction-tool plan: the tool to the hands that hold it, an object to the tool."""

from __future__ import annotations

from planners.certify.attachments import drift_checks, resting_check
from planners.certify.finding import Finding
from planners.certify.motion import SegmentMotion
from planners.certify.plan_view import PlanView
from planners.certify.settings import CertifySettings
from planners.certify.tool_course import CourseStep, ToolCourse
from planners.certify.tool_task import TOOL
from planners.plan.verdicts import Check


def tool_attachment_checks(
    plan: PlanView, motions: list[SegmentMotion], course: ToolCourse, settings: CertifySettings
) -> list[Check]:
    """Check drift and turn of attached bodies, what may be attached to what, and bodies at rest."""
    finding = Finding("attachment_rules", "1")
    for step in course.steps:
        _rules(step, finding)
    return [
        *drift_checks(motions, settings),
        finding.check(),
        resting_check(plan, motions, lambda segment: {one.body for one in segment.attached}, settings),
    ]


def _rules(step: CourseStep, finding: Finding) -> None:
    segment, where = step.segment, step.segment.place()
    attached = {(one.body, one.to) for one in segment.attached}
    finding.require(len(attached) == len(segment.attached), where, "a body is attached twice to the same")
    hands = {(TOOL, arm) for arm in step.bearers}
    if segment.kind in ("grip", "release"):
        text = "the tool is attached while fingers open or close on it"
        finding.require(not any(body == TOOL for body, _ in attached), where, text)
        hands = set()
    sucked = {(name, TOOL) for name in step.on_cup}
    if segment.kind in ("attach", "detach"):
        attached -= sucked
        sucked = set()
    missing, stray = (hands | sucked) - attached, attached - hands - sucked
    for body, to in sorted(missing):
        finding.require(False, where, f"{body} is held by {to} and not attached to it")
    for body, to in sorted(stray):
        finding.require(False, where, f"{body} is attached to {to}, which does not hold it")
    finding.require(not missing and not stray, where, "attachments are not what is held")
