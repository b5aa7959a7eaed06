"""The second opinion: one document in, one certificate out."""

from __future__ import annotations

from typing import Any

import numpy as np

from planners.certify.certificate import Certificate, Check
from planners.certify.document_view import MalformedDocument, PlanView, read_document, read_member, read_text
from planners.certify.evidence import Evidence
from planners.certify.lift_checks import LiftExamination
from planners.certify.scene_facts import CellReference
from planners.certify.settings import CertifySettings
from planners.certify.surfaces import RobotSurfaces
from planners.certify.tool_checks import ToolExamination

_EXAMINATIONS = {"plate_lift": LiftExamination, "suction_tool": ToolExamination}


def certify(
    document: dict[str, Any],
    surfaces: RobotSurfaces,
    reference: CellReference | None = None,
    settings: CertifySettings | None = None,
) -> Certificate | None:
    """Check a finished plan document against its own words, whatever is in it.

    Args:
        document: A PlanDocument of schema 1.0; its members `certificate` and `simulation` are not read, of
            `statistics` only `reserve`.
        surfaces: The robots' meshes, see `load_surfaces`.
        reference: What the cell is known to be; without it the document's own cell is believed.
        settings: Tolerances.

    Returns:
        Every check with its smallest margin and where that is. A member that is missing or of the wrong type fails the
        check `structure`, and nothing else is looked at. Of documents without a solution those that call themselves
        infeasible have their scene and their proof checked; those that found nothing claim nothing, so that there is
        nothing to certify: None.
    """
    settings = settings or CertifySettings()
    try:
        plan = read_document(document)
        kind = read_text(read_member(plan.task, "kind", "/task"), "/task/kind", tuple(_EXAMINATIONS))
        examination = _EXAMINATIONS[kind](Evidence(plan, document, surfaces, reference, settings))
        _refuse_nonsense(plan)
    except MalformedDocument as problem:
        return Certificate((Check("structure", False, -1.0, "1", str(problem)),))
    if plan.outcome == "not_found":
        return None
    structure = Check("structure", True, 0.0, "1", "the whole document")
    # Numbers that make no sense overflow to inf or nan, which fail the check that meets them.
    with np.errstate(all="ignore"):
        if plan.outcome == "infeasible":
            return Certificate((structure, *examination.scene(), examination.proof()))
        return Certificate((structure, *examination.scene(), *examination.motion()))


def _refuse_nonsense(plan: PlanView) -> None:
    """Refuse what no check could make sense of."""
    if plan.outcome != "solved":
        if plan.segments:
            raise MalformedDocument("/segments", f"a plan that is {plan.outcome} has no segments")
        if plan.explanation is None or not plan.explanation.summary:
            raise MalformedDocument("/explanation/summary", f"a plan that is {plan.outcome} says why")
    elif not plan.segments:
        raise MalformedDocument("/segments", "a solved plan has segments")
