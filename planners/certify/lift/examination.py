"""What is checked of a plate lift."""

from __future__ import annotations

from functools import partial

from planners.certify.common.cones import ConeChecks
from planners.certify.common.contact_sets import balance_checks, inertia_checks, spacing_check
from planners.certify.common.holds import hold_checks, squeeze_check
from planners.certify.common.joint_torque import torque_check
from planners.certify.common.reserve import PayloadCheck, reserve_check
from planners.certify.common.segments import PLATE_LIFT, join_checks, joint_checks, kind_check
from planners.certify.evidence import Evidence
from planners.certify.lift.contact_states import contact_state_checks, needs_sets
from planners.certify.lift.infeasibility import lift_infeasibility_check
from planners.certify.lift.task import lift_bodies_check, read_lift_task
from planners.certify.lift.touch import LiftContactPlaces, LiftTouchRule, lift_attachment_checks
from planners.certify.lift.uncertainty import uncertainty_check
from planners.certify.motion.collision import CollisionCheck
from planners.certify.motion.segment_motion import contact_sets, motions_of
from planners.certify.motion.solids import solids_of
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
        return lift_infeasibility_check(self._evidence.plan, self._task, self._evidence.settings)

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
