"""What is checked of a plate lift."""

from __future__ import annotations

from functools import partial

from planners.certify.balances import balance_checks, contact_sets
from planners.certify.collision import CollisionCheck
from planners.certify.cones import ConeChecks
from planners.certify.contact_states import contact_state_checks, needs_sets
from planners.certify.evidence import Evidence
from planners.certify.holds import hold_checks
from planners.certify.inertia import inertia_checks
from planners.certify.infeasibility import infeasibility_check
from planners.certify.joins import join_checks
from planners.certify.joint_torque import torque_check
from planners.certify.kinds import PLATE_LIFT, kind_check
from planners.certify.lift_attachments import lift_attachment_checks
from planners.certify.lift_bodies import lift_bodies_check
from planners.certify.lift_contact_places import LiftContactPlaces
from planners.certify.lift_pairs import LiftTouchRule
from planners.certify.lift_task import read_lift_task
from planners.certify.limits import joint_checks
from planners.certify.motion import motions_of
from planners.certify.payload import PayloadCheck
from planners.certify.reserve import reserve_check
from planners.certify.set_spacing import spacing_check
from planners.certify.solids import solids_of
from planners.certify.squeeze import squeeze_check
from planners.certify.uncertainty import uncertainty_check
from planners.contract.task_spec import PlateLiftTask
from planners.plan.verdicts import Check


class LiftExamination:
    """The second opinion on one plate lift."""

    def __init__(self, evidence: Evidence, task: PlateLiftTask) -> None:
        """Read the task.

        Raises:
            MalformedDocument: A member of the task is missing or of the wrong type, or a body that it needs is.
        """
        self._evidence = evidence
        self._task = read_lift_task(task)
        evidence.require_bodies(("plate", evidence.plan.support))

    def scene(self) -> list[Check]:
        """Check bodies and cell."""
        bodies = lift_bodies_check(self._evidence.plan, self._task, self._evidence.settings)
        return [*self._evidence.cell_checks(), bodies]

    def proof(self) -> Check:
        """Check that there is no plan."""
        return infeasibility_check(self._evidence.plan, self._task, self._evidence.settings)

    def motion(self) -> list[Check]:
        """Check everything that happens."""
        plan, task, settings = self._evidence.plan, self._task, self._evidence.settings
        motions = motions_of(plan)
        sets = [contact_sets(motion) for motion in motions]
        start = self._evidence.start_positions(task.start_positions)
        solids = solids_of(plan, self._evidence.surfaces)
        every_set = [one for group in sets for one in group]
        payload = PayloadCheck(plan, settings)
        payload.note_contacts(every_set)
        return [
            *joint_checks(plan, settings),
            kind_check(motions, PLATE_LIFT, settings),
            *join_checks(plan, motions, start, settings),
            *lift_attachment_checks(plan, motions, settings),
            *hold_checks(plan, motions, settings),
            *contact_state_checks(plan, motions, task, settings),
            *balance_checks(plan, sets, settings),
            *inertia_checks(plan, motions, sets, settings),
            spacing_check(plan, motions, sets, lambda m, b: needs_sets(plan, m, b, settings), settings),
            *ConeChecks(task.limits(plan), settings).run(every_set),
            squeeze_check(plan, every_set, settings, required=task.contact_model == "squeeze"),
            payload.check(),
            reserve_check(plan, every_set, task.hand_limits(plan), task.lifter_model, settings),
            uncertainty_check(plan, every_set, task.tolerances, task.bounds(plan), settings),
            torque_check(plan, motions, sets, self._evidence.known_cell, settings),
            *LiftContactPlaces(plan, task, settings).run(motions, sets),
            *CollisionCheck(plan, solids, partial(LiftTouchRule, plan), settings).run(motions),
        ]
