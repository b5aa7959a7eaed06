"""Find out how the task fares at the points of a study, with what one of them teaches about the next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from pydantic import ValidationError

from planners.cell.cell import Cell
from planners.contract.problems import reasons_of
from planners.contract.task_spec import PlateLiftTask, SuctionToolTask
from planners.errors import SceneError
from planners.manipulation.lift_attempts import plan_lift
from planners.manipulation.reach.reach_memory import ReachMemory
from planners.planning import CertificateFailed, TaskSolver, plan
from planners.scene.shape_source import Uploads, no_uploads
from planners.study.study import Study
from planners.study.study_map import StudyPoint


class PointExaminer:
    """Examines points of studies one after the other; what they have in common is found once."""

    def __init__(self, solver: TaskSolver) -> None:
        remembering = partial(plan, lift=partial(plan_lift, memory=ReachMemory()))
        # No point tells of a simulation, which takes longer than the plan; and its plan is not kept.
        self._planning = replace(solver, plan=remembering, simulate=None, seals=False)
        # Where nothing is found, denser samplings seldom help, and take longest.
        self._searching = replace(self._planning, plan=partial(remembering, persistent=False), certify=None)

    def examine(
        self,
        study: Study,
        index: int,
        uploads: Uploads = no_uploads,
        cells: Mapping[str, Cell] | None = None,
    ) -> StudyPoint:
        """Return what comes of the task of a point; that there can be no such task is an answer, too.

        Args:
            study: that the point is of.
            index: number of the point.
            uploads: finds the meshes that the task names as uploads.
            cells: by name, as the task says it; None: those of the solver.
        """
        solver = self._planning if study.spec.certify else self._searching
        solver = solver if cells is None else replace(solver, cells=cells)
        clock = solver.clock
        begun = clock()
        try:
            found = solver.solve(_without_remedies(study.task_at(index)), uploads=uploads)
        except (ValidationError, SceneError) as error:
            return StudyPoint.without_plan(study, index, "refused", reasons_of(error), clock() - begun)
        except CertificateFailed as failure:
            return StudyPoint.without_plan(study, index, "failed", str(failure), clock() - begun)
        examined = "planned" if study.spec.certify else "searched"
        return StudyPoint.of_plan(study, index, found, examined, clock() - begun)


def _without_remedies(task: PlateLiftTask | SuctionToolTask) -> PlateLiftTask | SuctionToolTask:
    """Leave it to the plan of a point to tell what would help there: the map shows what does."""
    return task.model_copy(update={"options": task.options.model_copy(update={"remedies": False})})
