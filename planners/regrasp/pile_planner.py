"""Move objects one after the other, in an order that works; put one aside where all orders are blocked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from planners.geometry.pose import Transform
from planners.graph.rejections import Rejection
from planners.progress import Progress
from planners.regrasp.object_order import ObjectOrder
from planners.regrasp.object_planner import Following, ObjectPlanner
from planners.regrasp.object_report import ObjectReport
from planners.regrasp.set_aside import SetAside
from planners.regrasp.suction_poses import SuctionLoad, SuctionPoses, SuctionSettings, suction_poses
from planners.regrasp.tool_stage import ToolStage
from planners.scene.body import Body
from planners.scene.moved_object import MovedObject
from planners.scene.suction_tool import CupData


@dataclass(frozen=True, eq=False)
class Course:
    """How far a plan has come."""

    stage: ToolStage
    objects: Mapping[str, MovedObject]
    """All of them, those that wait where they stand now."""
    moved: frozenset[str]
    """Those that are at their goals."""
    aside: frozenset[str] = frozenset()
    """Those that were put aside; none is put aside twice."""
    reports: tuple[ObjectReport, ...] = ()
    """Of what was moved, in order."""

    def after(self, stage: ToolStage, report: ObjectReport) -> Course:
        """Return the course with one more move."""
        name, reports = report.name, (*self.reports, report)
        if not report.aside:
            return replace(self, stage=stage, moved=self.moved | {name}, reports=reports)
        target = self.objects[name]
        body = replace(target.body, T_world_body=stage.T_world_objects[name])
        objects = {**self.objects, name: replace(target, body=body)}
        return replace(self, stage=stage, objects=objects, aside=self.aside | {name}, reports=reports)


class SuctionFinder:
    """Suction poses of objects, each found once."""

    def __init__(self, cup: CupData, settings: SuctionSettings, progress: Progress) -> None:
        self.found: dict[str, SuctionPoses] = {}
        """By object, from its start to its goal."""
        self._cup, self._settings, self._progress = cup, settings, progress

    def to_goal(self, target: MovedObject) -> SuctionPoses:
        """Return the poses of an object on its way to its goal; put aside, it stands as upright as before."""
        if target.name not in self.found:
            self.found[target.name] = self.between(target)
        return self.found[target.name]

    def between(self, target: MovedObject) -> SuctionPoses:
        """Return the poses with which an object can be taken where it stands and put down at its goals."""
        body = target.body
        assert body.mass is not None
        self._progress(f"suction {target.name}", 0, 1)
        load = SuctionLoad(body.mass, body.com, body.T_world_body, target.goals)
        return suction_poses(body.solid.surface(), load, self._cup, self._settings)


class PilePlanner:
    """Searches the order of the objects, depth first: the one nearest to its goal first."""

    def __init__(
        self,
        objects: ObjectPlanner,
        suctions: SuctionFinder,
        set_aside: SetAside,
        most_plans: int,
    ) -> None:
        """Take what all orders share.

        Args:
            objects: plans one move.
            suctions: suction poses.
            set_aside: free places.
            most_plans: moves that are planned at all, whatever becomes of them.
        """
        self.objects, self.suctions, self.set_aside, self.most_plans = objects, suctions, set_aside, most_plans
        self.failed: list[ObjectReport] = []
        """Of moves that were not found, and of those that led nowhere."""
        self.counts = Counter[str]()
        self.planned = 0

    def plan(self, course: Course) -> Course | None:
        """Plan the moves that are left; None if none of the orders tried leads to the end."""
        if len(course.moved) == len(course.objects):
            return course
        order = ObjectOrder.of(tuple(course.objects.values()))
        for target, aside in self._moves(course, order):
            if self.planned >= self.most_plans:
                return None
            after = self._moved(course, target, aside)
            found = None if after is None else self.plan(after)
            if found is not None:
                return found
        return None

    def _moved(self, course: Course, target: MovedObject, aside: bool) -> Course | None:
        self.planned += 1
        suctions = self.suctions.between(target) if aside else self.suctions.to_goal(target)
        stage, report = self.objects.plan(course.stage, target, suctions, self._following(course, target, aside))
        report.aside = aside
        self.counts.update(report.counts)
        if stage is None:
            self.failed.append(report)
            return None
        return course.after(stage, report)

    def _following(self, course: Course, target: MovedObject, aside: bool) -> Following | None:
        """Return what is likely moved after a target, if anything is."""
        moved = course.moved if aside else course.moved | {target.name}
        order = ObjectOrder.of(tuple(course.objects.values()))
        name = next((name for name in order.next(moved) if name != target.name), None)
        return None if name is None else Following(course.objects[name], self.suctions.to_goal(course.objects[name]))

    def _moves(self, course: Course, order: ObjectOrder) -> Iterator[tuple[MovedObject, bool]]:
        """Yield what can be moved next, and whether it is only put aside."""
        for name in order.next(course.moved):
            yield course.objects[name], False
        for name in order.next_aside(course.moved):
            if name not in course.aside:
                target = self.set_aside.target(course.objects[name], _others(course, name))
                if target is None:
                    report = ObjectReport(name, aside=True)
                    report.rejections.add(Rejection("order", f"{name} is in the way and there is no room beside it"))
                    self.failed.append(report)
                else:
                    yield target, True


def _others(course: Course, name: str) -> list[tuple[Body, Transform]]:
    """Return all other objects where they are, and those that wait also where they are to go."""
    others = [each for each in course.objects.values() if each.name != name]
    here = [(each.body, course.stage.T_world_objects[each.name]) for each in others]
    return here + [(each.body, each.T_world_goal) for each in others if each.name not in course.moved]
