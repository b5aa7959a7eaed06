"""The second opinion: one document in, one certificate out."""

from __future__ import annotations

import numpy as np

from planners.certify.common.scene import require_stated
from planners.certify.evidence import CellReference, Evidence
from planners.certify.lift.examination import LiftExamination
from planners.certify.motion.robot_surfaces import RobotSurfaces
from planners.certify.motion.solids import gripper_of
from planners.certify.plan_view import MalformedDocument, read_plan
from planners.certify.settings import CertifySettings
from planners.certify.tool.examination import ToolExamination
from planners.contract.task_spec import PlateLiftTask
from planners.plan.plan import Plan
from planners.plan.verdicts import Certificate, Check


def certify(
    document: bytes,
    surfaces: RobotSurfaces,
    reference: CellReference | None = None,
    settings: CertifySettings | None = None,
) -> Certificate | None:
    """Check a finished plan against its own words, whatever is in it.

    Args:
        document: A plan as it is sent, read again here: nothing is believed that is not in it. Its members
            `certificate` and `simulation` are not looked at, of `statistics` only `reserve`.
        surfaces: The shapes of the cell's arms and hands, see `load_surfaces`.
        reference: What the cell is known to be; without it the document's own cell is believed.
        settings: Tolerances.

    Returns:
        Every check with its smallest margin and where that is. A member that is missing or of the wrong type fails the
        check `structure`, and nothing else is looked at. Of documents without a solution those that call themselves
        infeasible have their scene and their proof checked; those that found nothing claim nothing, so that there is
        nothing to certify: None.
    """
    try:
        plan = read_plan(document)
        evidence, task = Evidence(plan, surfaces, reference, settings or CertifySettings()), plan.stated.task
        for arm in plan.grippers:
            gripper_of(arm, surfaces)
        require_stated(task)
        lifts = isinstance(task, PlateLiftTask)
        examination = LiftExamination(evidence, task) if lifts else ToolExamination(evidence, task)
        _refuse_nonsense(plan.stated)
    except MalformedDocument as problem:
        return _certificate(Check(name="structure", passed=False, margin=-1.0, unit="1", where=str(problem)))
    if plan.stated.outcome == "not_found":
        return None
    structure = Check(name="structure", passed=True, margin=0.0, unit="1", where="the whole document")
    # Numbers that make no sense overflow to inf or nan, which fail the check that meets them.
    with np.errstate(all="ignore"):
        if plan.stated.outcome == "infeasible":
            return _certificate(structure, *examination.scene(), examination.proof())
        return _certificate(structure, *examination.scene(), *examination.motion())


def _certificate(*checks: Check) -> Certificate:
    return Certificate(passed=all(check.passed for check in checks), checks=list(checks))


def _refuse_nonsense(plan: Plan) -> None:
    """Refuse what no check could make sense of."""
    if plan.outcome != "solved":
        if plan.segments:
            raise MalformedDocument("/segments", f"a plan that is {plan.outcome} has no segments")
        if not plan.explanation.summary:
            raise MalformedDocument("/explanation/summary", f"a plan that is {plan.outcome} says why")
    elif not plan.segments:
        raise MalformedDocument("/segments", "a solved plan has segments")
