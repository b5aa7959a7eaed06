"""What is checked of a suction-tool plan."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from planners.certify.balances import balance_checks, contact_sets
from planners.certify.certificate import Check
from planners.certify.collision import CollisionCheck
from planners.certify.cones import ConeChecks
from planners.certify.document_view import MalformedDocument, PlanView
from planners.certify.goals import goal_checks
from planners.certify.holds import hold_checks
from planners.certify.joins import join_checks
from planners.certify.kinds import SUCTION_TOOL, kind_check
from planners.certify.limits import joint_checks
from planners.certify.motion import motions_of
from planners.certify.scene_facts import CellReference, scene_checks
from planners.certify.settings import CertifySettings
from planners.certify.solids import solids_of
from planners.certify.surfaces import RobotSurfaces
from planners.certify.tool_attachments import tool_attachment_checks
from planners.certify.tool_bodies import tool_bodies_check
from planners.certify.tool_contact_places import ToolContactPlaces
from planners.certify.tool_course import ToolCourse
from planners.certify.tool_infeasibility import tool_infeasibility_check
from planners.certify.tool_pairs import ToolTouchRule
from planners.certify.tool_task import TOOL, read_tool_task


class ToolExamination:
    """The second opinion on one suction-tool plan."""

    def __init__(
        self,
        plan: PlanView,
        document: Mapping[str, Any],
        surfaces: RobotSurfaces,
        reference: CellReference | None,
        settings: CertifySettings,
    ) -> None:
        """Read the task.

        Raises:
            MalformedDocument: A member of the task is missing or of the wrong type, or a body that it needs is.
        """
        self._plan, self._document, self._surfaces = plan, document, surfaces
        self._reference, self._settings = reference, settings
        self._task = read_tool_task(plan.task, reference)
        for name in (TOOL, *(stated.body.name for stated in self._task.objects)):
            if name not in plan.bodies:
                raise MalformedDocument(f"/bodies/{name}", "is missing")

    def scene(self) -> list[Check]:
        """Check bodies and cell."""
        plan, settings = self._plan, self._settings
        bodies = tool_bodies_check(plan, self._task, settings)
        return [*scene_checks(plan, self._document, self._reference, settings), bodies]

    def proof(self) -> Check:
        """Check that there is no plan."""
        return tool_infeasibility_check(self._plan, self._task, self._settings)

    def motion(self) -> list[Check]:
        """Check everything that happens."""
        plan, task, settings = self._plan, self._task, self._settings
        motions = motions_of(plan)
        sets = [contact_sets(motion) for motion in motions]
        solids = solids_of(plan, self._surfaces)
        course = ToolCourse(plan, settings)
        followed = course.follow(motions, sets, solids)
        steps = course.steps
        home = None if self._reference is None else self._reference.home
        return [
            *joint_checks(plan, settings),
            kind_check(motions, SUCTION_TOOL, settings),
            *join_checks(plan, motions, home if task.start_positions is None else task.start_positions, settings),
            *followed,
            *tool_attachment_checks(plan, motions, course, settings),
            *hold_checks(plan, motions, settings),
            *balance_checks(plan, motions, sets, lambda m, b: steps[m.segment.index].needs_sets(b.name), settings),
            *ConeChecks(task.limits, settings).run([one for group in sets for one in group]),
            *ToolContactPlaces(plan, settings).run(motions, sets),
            *CollisionCheck(plan, solids, lambda s: ToolTouchRule(plan, course, s.index), settings).run(motions),
            *goal_checks(plan, motions, task, settings),
        ]
