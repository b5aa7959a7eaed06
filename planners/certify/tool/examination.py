"""What is checked of a suction-tool plan."""

from __future__ import annotations

from planners.certify.common.cones import ConeChecks
from planners.certify.common.contact_sets import balance_checks, inertia_checks, spacing_check
from planners.certify.common.holds import hold_checks, squeeze_check
from planners.certify.common.joint_torque import torque_check
from planners.certify.common.reserve import payload_check, reserve_check
from planners.certify.common.scene import cell_checks
from planners.certify.common.segments import SUCTION_TOOL, join_checks, joint_checks, kind_check
from planners.certify.evidence import Evidence
from planners.certify.motion.collision import CollisionCheck
from planners.certify.tool.goals import goal_checks
from planners.certify.tool.infeasibility import tool_infeasibility_check
from planners.certify.tool.loads import carried_forces, carrying_check, cup_hold_checks
from planners.certify.tool.standing import standing_check
from planners.certify.tool.task import TOOL, ToolTask, tool_bodies_check
from planners.certify.tool.tool_states import ToolStates
from planners.certify.tool.touch import ToolContactPlaces, tool_attachment_checks, tool_touch_rule
from planners.contract.task_spec import SuctionToolTask
from planners.plan.verdicts import Check


class ToolExamination:
    """The second opinion on one suction-tool plan."""

    def __init__(self, evidence: Evidence, task: SuctionToolTask) -> None:
        """Read the task.

        Raises:
            MalformedDocument: A member of the task is missing or of the wrong type, or a body that it needs is.
        """
        self._evidence, self._task = evidence, ToolTask.of(task, evidence.plan.stated.cell, evidence.reference)
        evidence.require_bodies((TOOL, *(stated.body.name for stated in self._task.objects)))

    def scene(self) -> list[Check]:
        """Check bodies and cell."""
        return [*cell_checks(self._evidence), tool_bodies_check(self._evidence, self._task)]

    def proof(self) -> Check:
        """Check that there is no plan."""
        return tool_infeasibility_check(self._evidence, self._task)

    def motion(self) -> list[Check]:
        """Check everything that happens."""
        evidence, task, plan = self._evidence, self._task, self._evidence.plan
        states, limits = ToolStates(evidence), task.carry_limits(plan)
        steps = states.steps
        carried = list(carried_forces(evidence, steps))
        collision = CollisionCheck(
            plan, evidence.solids, lambda segment: tool_touch_rule(plan, steps, segment.index), evidence.settings
        )
        return [
            *joint_checks(evidence),
            kind_check(evidence, SUCTION_TOOL),
            *join_checks(evidence, task.stated.start_positions),
            *states.checks(),
            standing_check(evidence, steps),
            *tool_attachment_checks(evidence, steps),
            *hold_checks(evidence),
            *balance_checks(evidence),
            *inertia_checks(evidence),
            spacing_check(evidence, lambda motion, body: steps[motion.segment.index].needs_sets(body.name)),
            *cup_hold_checks(evidence, steps, task.cup),
            *ConeChecks(task.limits(plan), evidence.settings).run(evidence.contacts),
            squeeze_check(evidence),
            carrying_check(evidence, carried, limits),
            payload_check(evidence, carried),
            reserve_check(evidence, limits, "dexnet", evidence.contacts),
            torque_check(evidence),
            *ToolContactPlaces(evidence).run(),
            *collision.run(evidence.motions),
            *goal_checks(evidence, task.objects),
        ]
