"""What is checked of a suction-tool plan."""

from __future__ import annotations

from planners.certify.common.cones import ConeChecks
from planners.certify.common.contact_sets import balance_checks, inertia_checks, spacing_check
from planners.certify.common.holds import hold_checks, squeeze_check
from planners.certify.common.joint_torque import torque_check
from planners.certify.common.reserve import PayloadCheck, reserve_check
from planners.certify.common.segments import SUCTION_TOOL, join_checks, joint_checks, kind_check
from planners.certify.evidence import Evidence
from planners.certify.motion.collision import CollisionCheck
from planners.certify.motion.segment_motion import contact_sets, motions_of
from planners.certify.motion.solids import solids_of
from planners.certify.tool.course import ToolCourse
from planners.certify.tool.goals import goal_checks
from planners.certify.tool.infeasibility import tool_infeasibility_check
from planners.certify.tool.loads import CupHold, carrying_check
from planners.certify.tool.standing import standing_check
from planners.certify.tool.task import TOOL, read_tool_task, tool_bodies_check
from planners.certify.tool.touch import ToolContactPlaces, ToolTouchRule, tool_attachment_checks
from planners.contract.task_spec import SuctionToolTask
from planners.plan.verdicts import Check


class ToolExamination:
    """The second opinion on one suction-tool plan."""

    def __init__(self, evidence: Evidence, task: SuctionToolTask) -> None:
        """Read the task.

        Raises:
            MalformedDocument: A member of the task is missing or of the wrong type, or a body that it needs is.
        """
        self._evidence = evidence
        self._task = read_tool_task(task, evidence.reference)
        evidence.require_bodies((TOOL, *(stated.body.name for stated in self._task.objects)))

    def scene(self) -> list[Check]:
        """Check bodies and cell."""
        bodies = tool_bodies_check(self._evidence.plan, self._task, self._evidence.settings)
        return [*self._evidence.cell_checks(), bodies]

    def proof(self) -> Check:
        """Check that there is no plan."""
        return tool_infeasibility_check(self._evidence.plan, self._task, self._evidence.settings)

    def motion(self) -> list[Check]:
        """Check everything that happens."""
        plan, task, settings = self._evidence.plan, self._task, self._evidence.settings
        motions = motions_of(plan)
        sets = [contact_sets(motion) for motion in motions]
        solids = solids_of(plan, self._evidence.surfaces)
        course = ToolCourse(plan, settings)
        followed = course.follow(motions, sets, solids)
        steps, every_set = course.steps, [one for group in sets for one in group]
        payload = PayloadCheck(plan, settings)
        payload.note_contacts(every_set)
        start = self._evidence.start_positions(task.start_positions)
        return [
            *joint_checks(plan, settings),
            kind_check(motions, SUCTION_TOOL, settings),
            *join_checks(plan, motions, start, settings),
            *followed,
            standing_check(plan, motions, steps, settings),
            *tool_attachment_checks(plan, motions, course, settings),
            *hold_checks(plan, motions, settings),
            *balance_checks(plan, sets, settings),
            *inertia_checks(plan, motions, sets, settings),
            spacing_check(plan, motions, sets, lambda m, b: steps[m.segment.index].needs_sets(b.name), settings),
            *CupHold(plan, task, settings).run(motions, course),
            *ConeChecks(task.limits(plan), settings).run(every_set),
            squeeze_check(plan, every_set, settings),
            carrying_check(plan, motions, steps, task.carry_limits(plan), payload, settings),
            payload.check(),
            reserve_check(plan, every_set, task.carry_limits(plan), "dexnet", settings),
            torque_check(plan, motions, sets, self._evidence.known_cell, settings),
            *ToolContactPlaces(plan, settings).run(motions, sets),
            *CollisionCheck(plan, solids, lambda s: ToolTouchRule(plan, course, s.index), settings).run(motions),
            *goal_checks(plan, motions, task, settings),
        ]
