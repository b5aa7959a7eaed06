"""What is checked of a plate lift."""

from __future__ import annotations

from functools import partial

from planners.certify.common.cones import ConeChecks
from planners.certify.common.contact_sets import balance_checks, inertia_checks, spacing_check
from planners.certify.common.holds import hold_checks, squeeze_check
from planners.certify.common.joint_torque import torque_check
from planners.certify.common.reserve import payload_check, reserve_check
from planners.certify.common.scene import cell_checks
from planners.certify.common.segments import PLATE_LIFT, join_checks, joint_checks, kind_check
from planners.certify.evidence import Evidence
from planners.certify.lift.contact_states import contact_state_checks, needs_sets
from planners.certify.lift.infeasibility import lift_infeasibility_check
from planners.certify.lift.rim import Rim
from planners.certify.lift.task import LiftTask, lift_bodies_check
from planners.certify.lift.touch import LiftContactPlaces, lift_attachment_checks, lift_touch_rule
from planners.certify.lift.uncertainty import uncertainty_check
from planners.certify.motion.collision import CollisionCheck
from planners.contract.task_spec import PlateLiftTask
from planners.plan.verdicts import Check


class LiftExamination:
    """The second opinion on one plate lift."""

    def __init__(self, evidence: Evidence, task: PlateLiftTask) -> None:
        """Read the task.

        Raises:
            MalformedDocument: A member of the task is missing or of the wrong type, or a body that it needs is.
        """
        self._evidence, self._task = evidence, LiftTask.of(task, evidence.reference)
        evidence.require_bodies(("plate", evidence.plan.support))

    def scene(self) -> list[Check]:
        """Check bodies and cell."""
        return [*cell_checks(self._evidence), lift_bodies_check(self._evidence, self._task)]

    def proof(self) -> Check:
        """Check that there is no plan."""
        return lift_infeasibility_check(self._evidence, self._task)

    def motion(self) -> list[Check]:
        """Check everything that happens."""
        evidence, task, plan = self._evidence, self._task, self._evidence.plan
        rim = Rim(plan, evidence.settings)
        either_way = rim.either_way(evidence.contacts)
        collision = CollisionCheck(plan, evidence.solids, partial(lift_touch_rule, plan), evidence.settings)
        return [
            *joint_checks(evidence),
            kind_check(evidence, PLATE_LIFT),
            *join_checks(evidence, task.stated.start_positions),
            *lift_attachment_checks(evidence),
            *hold_checks(evidence),
            *contact_state_checks(evidence, task.stated.options.goal_height),
            *balance_checks(evidence),
            *inertia_checks(evidence),
            spacing_check(evidence, lambda motion, body: needs_sets(evidence, motion, body)),
            *ConeChecks(task.limits(plan), evidence.settings).run(either_way),
            squeeze_check(evidence, required=task.contact_model == "squeeze"),
            payload_check(evidence),
            reserve_check(evidence, task.hand_limits(plan), task.stated.lifter_model, either_way),
            uncertainty_check(evidence, task.tolerances, task.bounds(plan), rim),
            torque_check(evidence),
            *LiftContactPlaces(evidence, task.stated.cup.place).run(),
            *collision.run(evidence.motions),
        ]
