"""The second opinion: one document in, one certificate out."""

from __future__ import annotations

from typing import Any

import numpy as np

from planners.certify.attachments import attachment_checks
from planners.certify.balances import balance_checks, contact_sets
from planners.certify.certificate import Certificate, Check
from planners.certify.collision import CollisionCheck
from planners.certify.cones import ConeChecks
from planners.certify.contact_places import ContactPlaceChecks
from planners.certify.contact_states import contact_state_checks
from planners.certify.document_view import MalformedDocument, PlanView, read_document
from planners.certify.holds import hold_checks
from planners.certify.infeasibility import infeasibility_check
from planners.certify.joins import join_checks
from planners.certify.lift_task import LiftTask, read_lift_task
from planners.certify.limits import joint_checks
from planners.certify.motion import motions_of
from planners.certify.scene_facts import CellReference, scene_checks
from planners.certify.settings import CertifySettings
from planners.certify.solids import solids_of
from planners.certify.surfaces import RobotSurfaces


def certify(
    document: dict[str, Any],
    surfaces: RobotSurfaces,
    reference: CellReference | None = None,
    settings: CertifySettings | None = None,
) -> Certificate:
    """Check a finished plan document against its own words, whatever is in it.

    Args:
        document: A PlanDocument of schema 1.0; its members `certificate`, `simulation` and `statistics` are not read.
        surfaces: The robots' meshes, see `load_surfaces`.
        reference: What the cell is known to be; without it the document's own cell is believed.
        settings: Tolerances.

    Returns:
        Every check with its smallest margin and where that is. A member that is missing or of the wrong type fails the
        check `structure`, and nothing else is looked at. Of documents without a solution those that call themselves
        infeasible have their scene and their proof checked; those that found nothing claim nothing.
    """
    settings = settings or CertifySettings()
    try:
        plan = read_document(document)
        task = read_lift_task(plan.task)
        _refuse_nonsense(plan)
    except MalformedDocument as problem:
        return Certificate((Check("structure", False, -1.0, "1", str(problem)),))
    structure = Check("structure", True, 0.0, "1", "the whole document")
    if plan.outcome == "not_found":
        return Certificate((structure,))
    # Numbers that make no sense overflow to inf or nan, which fail the check that meets them.
    with np.errstate(all="ignore"):
        if plan.outcome == "infeasible":
            scene = scene_checks(plan, document, task, reference, settings)
            return Certificate((structure, *scene, infeasibility_check(plan, task, settings)))
        return Certificate((structure, *_checks(plan, document, task, surfaces, reference, settings)))


def _refuse_nonsense(plan: PlanView) -> None:
    """Refuse what no check could make sense of."""
    if plan.outcome != "solved":
        if plan.segments:
            raise MalformedDocument("/segments", f"a plan that is {plan.outcome} has no segments")
        if plan.explanation is None or not plan.explanation.summary:
            raise MalformedDocument("/explanation/summary", f"a plan that is {plan.outcome} says why")
    elif not plan.segments:
        raise MalformedDocument("/segments", "a solved plan has segments")
    for name in ("plate", plan.support):
        if name not in plan.bodies:
            raise MalformedDocument(f"/bodies/{name}", "is missing")


def _checks(
    plan: PlanView,
    document: dict[str, Any],
    task: LiftTask,
    surfaces: RobotSurfaces,
    reference: CellReference | None,
    settings: CertifySettings,
) -> list[Check]:
    motions = motions_of(plan)
    sets = [contact_sets(motion) for motion in motions]
    home = None if reference is None else reference.home
    return [
        *scene_checks(plan, document, task, reference, settings),
        *joint_checks(plan, settings),
        *join_checks(plan, motions, task, home, settings),
        *attachment_checks(plan, motions, settings),
        *hold_checks(plan, motions, settings),
        *contact_state_checks(plan, motions, task, settings),
        *balance_checks(plan, motions, sets, settings),
        *ConeChecks(task, settings).run([one for group in sets for one in group]),
        *ContactPlaceChecks(plan, task, settings).run(motions, sets),
        *CollisionCheck(plan, solids_of(plan, surfaces), settings).run(motions),
    ]
