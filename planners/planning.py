"""From a task to its scene, its plan, and the certificate, which is made apart from the bytes that are sent."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from importlib.metadata import version
from typing import Any, Protocol

import numpy as np

from assets import assets_folder
from planners.cell.asset_shelf import MESHES
from planners.cell.cell import Cell, ShippedCells
from planners.certify import (
    CellReference,
    Certificate,
    LifterReference,
    RobotSurfaces,
    certify,
    load_meshes,
    load_surfaces,
)
from planners.contract.task_spec import PlateLiftOptions, PlateLiftTask, SuctionToolTask, read_task, write_task
from planners.errors import LiftwrightError, SceneError
from planners.geometry.pose import pose_row, to_pose7
from planners.manipulation import plan_segments as lift_segments
from planners.manipulation.contacts.dense_contact_states import ContactSampling
from planners.manipulation.cup_place import CupPlace, CupPlaceSearch
from planners.manipulation.lift_attempts import plan_lift
from planners.manipulation.lift_plan import LiftPlan
from planners.manipulation.lift_settings import LiftSettings
from planners.manipulation.reach.reach_memory import ReachMemory
from planners.plan.plan import SCHEMA_VERSION, Plan
from planners.plan.scenery import JOINT_NAMES, BodyDocument
from planners.plan.segment import Segment
from planners.plan.simulation import Simulation, failure_of
from planners.plan.verdicts import Cause, Check, ChosenCupPlace, Explanation, Remedy, Software, StageTime, Statistics
from planners.progress import Progress, Report, silent
from planners.regrasp import plan_segments as tool_segments
from planners.regrasp.considered import considered_by
from planners.regrasp.grasps.handovers import HandoverDatabase, HandoverSettings, find_handovers, handover_key
from planners.regrasp.planner import infeasible_plan
from planners.regrasp.reserve_search import plan_with_reserve
from planners.regrasp.tool_plan import ToolPlan
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.remedies.change import Effort, TaskChange, more_kept_back
from planners.remedies.find_remedies import (
    MOST_REMEDIES,
    MOST_SIMULATED,
    MOST_STEPS,
    STEPS_OF_A_CERTIFICATE,
    STEPS_OF_A_PLAN,
    STEPS_OF_A_SCENE,
    STEPS_OF_LESS_RESERVE,
    STEPS_OF_PAIRS,
    STEPS_OF_SIMULATION,
    STEPS_WITH_PHYSICS,
    PlanMemory,
    find_remedies,
    in_vain,
    why_none,
    with_cup_at,
)
from planners.remedies.lift_changes import LiftChanges
from planners.remedies.tool_changes import ToolChanges
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.scene import build_scene, with_centres
from planners.scene.shape_source import Uploads, no_uploads
from planners.scene.suction_tool import SuctionTool, load_tools, tool_descriptions
from planners.scene.tool_scene import SuctionToolScene

MOST_HANDOVERS = 8
"""Databases that are remembered, of some megabytes each: more are of tools that one tries once."""
THIS_SOFTWARE = Software(name="liftwright", version=version("liftwright"), commit=None)


class HandoverSource(Protocol):
    """Where the handovers of a cell and a tool come from: computed, or kept from earlier."""

    def __call__(
        self, cell: Cell, tool: SuctionTool, settings: HandoverSettings, progress: Progress
    ) -> HandoverDatabase:
        """Return what `find_handovers` returns for the same arguments."""
        ...


class HandoverMemory:
    """Handovers that were asked for last, so that tasks that have them in common find them once."""

    def __init__(self, source: HandoverSource) -> None:
        """Keep what `source` returns."""
        self._source = source
        self._kept: dict[str, HandoverDatabase] = {}
        """By key, the last one asked for at the end."""

    def __call__(
        self, cell: Cell, tool: SuctionTool, settings: HandoverSettings, progress: Progress
    ) -> HandoverDatabase:
        """Return what the source returns."""
        key = handover_key(cell, tool, settings)
        database = self._kept.get(key) or self._source(cell, tool, settings, progress)
        # Put in place of the last one, which is never changed: several threads may plan.
        others = [(each, kept) for each, kept in self._kept.items() if each != key]
        self._kept = dict([*others, (key, database)][-MOST_HANDOVERS:])
        return database


class LiftPlanner(Protocol):
    """Plans a plate lift: `plan_lift`, or what remembers other lifts."""

    def __call__(
        self, scene: PlateLiftScene, settings: LiftSettings, progress: Progress, /, *, persistent: bool
    ) -> LiftPlan:
        """Return what `plan_lift` returns for the same arguments."""
        ...


class CertificateFailed(LiftwrightError):
    """A plan was found and did not stand its independent re-check. The fault is ours."""

    def __init__(self, plan: Plan, failures: Sequence[Check]) -> None:
        self.plan = plan
        """With its certificate: to find out why, not to be used."""
        failed = [f"{check.name} (margin {check.margin} {check.unit} at {check.where})" for check in failures]
        super().__init__(f"the plan that was found failed its certificate: {'; '.join(failed)}")


def solve(
    task: PlateLiftTask | SuctionToolTask,
    *,
    cells: Mapping[str, Cell] | None = None,
    uploads: Uploads = no_uploads,
    on_progress: Progress = silent,
) -> Plan:
    """Plan a task and certify the plan; that there is no plan is an answer, with its reasons.

    >>> from pathlib import Path
    >>> from planners import read_task, solve
    >>> task = read_task(Path("assets/tasks/pb1_weak_cup.json"))
    >>> stages = []
    >>> plan = solve(task, on_progress=lambda report: stages.append(report.stage))
    >>> list(dict.fromkeys(stages))
    ['scene', 'certify', 'remedies']
    >>> plan.outcome, plan.certificate.passed
    ('infeasible', True)

    Args:
        task: as `read_task` gives it.
        cells: by name; those that are shipped, if it is left out.
        uploads: finds the meshes that the task names as uploads.
        on_progress: told what is being done; may raise `PlanningCancelled`.

    Returns:
        The plan, without a simulation. What was not found claims nothing: its certificate is None.

    Raises:
        SceneError: the task names what cannot stand as it says.
        CertificateFailed: the plan must not be used.
        PlanningCancelled: `on_progress` asked for it.
    """
    solver = TaskSolver(ShippedCells() if cells is None else cells, _shipped_tools(), _handovers)
    return solver.solve(task, uploads=uploads, on_progress=on_progress)


def plan(
    task: PlateLiftTask | SuctionToolTask,
    scene: PlateLiftScene | SuctionToolScene,
    progress: Progress,
    clock: Callable[[], float],
    handovers: HandoverSource = find_handovers,
    lift: LiftPlanner = plan_lift,
    *,
    persistent: bool = True,
) -> Plan:
    """Plan a task; that there is no plan is an answer, with its reasons.

    Args:
        task: as accepted.
        scene: built from it.
        progress: told what is being done; may raise `PlanningCancelled`.
        clock: seconds, for the statistics only; no decision depends on it.
        handovers: asked once by a suction-tool task that may have a plan; computing them takes some seconds.
        lift: plans a plate lift.
        persistent: whether denser samplings, stopovers and smaller reserves are tried where nothing is found. What is
            found without is found with them.

    Returns:
        The plan, without id and certificate.

    Raises:
        SceneError: the scene is not of the task's kind.
        PlanningCancelled: `progress` asked for it.
    """
    stopwatch = _Stopwatch(clock, progress)
    if isinstance(task, PlateLiftTask) and isinstance(scene, PlateLiftScene):
        found = lift(scene, lift_settings(task.options), stopwatch, persistent=persistent)
        stopwatch.stop()
        kept = {} if found.reserve is None else {"reserve": found.reserve}
        statistics = _statistics(found, stopwatch.seconds, **kept)
        return _plan(task, scene, found, lift_segments.plan_segments(found, scene), statistics)
    if isinstance(task, SuctionToolTask) and isinstance(scene, SuctionToolScene):
        moved = infeasible_plan(scene) or _searched(scene, handovers, stopwatch, persistent=persistent)
        stopwatch.stop()
        reserve, considered = tool_segments.least_reserve(moved.segments), considered_by(moved)
        statistics = _statistics(moved, stopwatch.seconds, reserve=reserve, considered=considered)
        return _plan(task, scene, moved, tool_segments.plan_segments(moved.segments, scene), statistics)
    raise SceneError("/kind", f"the scene is not that of a task of kind {task.kind}")


@dataclass(frozen=True, eq=False)
class TaskSolver:
    """Plans and certifies tasks in the cells and with the tools that it knows."""

    cells: Mapping[str, Cell]
    tools: Mapping[str, SuctionTool]
    """By name."""
    handovers: HandoverSource = find_handovers
    """Asked once by a suction-tool task that may have a plan; computing them takes some seconds."""
    plan: Callable[..., Plan] = plan
    certify: Callable[[bytes, RobotSurfaces, CellReference], Certificate | None] | None = certify
    """None: plans are not certified."""
    simulate: Callable[[Plan, PlateLiftScene | SuctionToolScene, Progress, int], Simulation] | None = None
    """Executes a certified plan in its scene, telling its progress, by a seed; None: plans are not simulated."""
    software: Software = THIS_SOFTWARE
    """What is told to have made the plan."""
    seals: bool = True
    """Whether plans get their digest, for which all that they say is written once more."""
    clock: Callable[[], float] = time.perf_counter
    """[s], for the statistics only; no decision depends on it."""

    def solve(
        self,
        task: PlateLiftTask | SuctionToolTask,
        name: str = "",
        uploads: Uploads = no_uploads,
        on_progress: Progress = silent,
        on_certified: Callable[[Plan], bool] = lambda _: False,
    ) -> Plan:
        """Return what `planners.solve` returns, as the plan of this name (its `id`), and simulated if it shall be.

        A plan that is going to be simulated, and a proof that there is none for which remedies are going to be looked
        for, are handed to `on_certified` before, without those. Where that returns True they are returned so;
        `completed` adds what they lack.
        """
        begun = self.clock()
        on_progress(Report("scene", 0, 1))
        scene = build_scene(task, self.cells, uploads=uploads, tools=self.tools)
        on_progress(Report("scene", 1, 1))
        built = self.clock()
        if isinstance(task, PlateLiftTask) and isinstance(scene, PlateLiftScene) and task.cup.position is None:
            task, scene, found = self._with_best_cup_place(task, scene, uploads, on_progress)
        else:
            found = self.plan(task, scene, on_progress, self.clock, self.handovers)
        found = found.model_copy(update={"id": name, "software": self.software})
        planned = self.clock()
        on_progress(Report("certify", 0, 1))
        certificate = self.certificate_of(found)
        on_progress(Report("certify", 1, 1))
        certified = self.clock()
        times = [("scene", built - begun), *found.statistics.times, ("certify", certified - planned)]
        statistics = found.statistics.taking(times, certified - begun)
        found = found.model_copy(update={"certificate": certificate, "statistics": statistics})
        if certificate is not None and not certificate.passed:
            raise CertificateFailed(found, certificate.failures)
        found, options = found.sealed() if self.seals else found, task.options
        if not (self.simulate is not None and options.simulate if found.outcome == "solved" else options.remedies):
            return found
        # What was not found claims nothing yet: it is an answer when no change of the task has made it one.
        if certificate is not None and on_certified(found):
            return found
        return self.completed(found, uploads, on_progress, scene)

    def completed(
        self,
        certified: Plan,
        uploads: Uploads = no_uploads,
        on_progress: Progress = silent,
        scene: PlateLiftScene | SuctionToolScene | None = None,
    ) -> Plan:
        """Return what `solve` has handed to `on_certified`, with what it lacked: whatever became of that `solve`.

        That is a simulation, remedies, or both where physics does not carry the plan out. `scene` is that of its task;
        None: it is built.
        """
        if certified.outcome != "solved":
            return self._with_remedies(certified, uploads, on_progress).sealed()
        scene = scene or build_scene(certified.task, self.cells, uploads=uploads, tools=self.tools)
        plan = self.simulated(certified, scene, certified.task.seed, on_progress)
        if failure_of(plan.simulation) is None:
            return plan
        if plan.task.options.remedies:
            return self._with_remedies(plan, uploads, on_progress).sealed()
        told = plan.explanation.model_copy(update={"summary": plan.explanation.summary + _failure_told(plan)})
        return plan.model_copy(update={"explanation": told}).sealed()

    def simulated(
        self, certified: Plan, scene: PlateLiftScene | SuctionToolScene, seed: int, on_progress: Progress
    ) -> Plan:
        """Return a certified plan with what became of it in physics, in its scene, by a seed."""
        assert self.simulate is not None
        begun = self.clock()
        simulation = self.simulate(certified, scene, on_progress, seed)
        seconds, statistics = self.clock() - begun, certified.statistics
        times = [*statistics.times, ("simulate", seconds)]
        statistics = statistics.taking(times, (statistics.total_seconds or 0.0) + seconds)
        return certified.model_copy(update={"simulation": simulation, "statistics": statistics}).sealed()

    def certificate_of(self, plan: Plan) -> Certificate | None:
        """Return what the certificate says of a plan; None: plans are not certified, or nothing is claimed."""
        if self.certify is None:
            return None
        return certificate_of(plan.write(), self.cells[plan.task.cell], self.certify)

    def _with_best_cup_place(
        self, task: PlateLiftTask, scene: PlateLiftScene, uploads: Uploads, on_progress: Progress
    ) -> tuple[PlateLiftTask, PlateLiftScene, Plan]:
        """Plan a lift that leaves the cup's place open with the cup where most is kept back.

        Args:
            task: of the lift.
            scene: of it, with the cup anywhere.
            uploads: finds the meshes that the task names as uploads.
            on_progress: told of it; may raise `PlanningCancelled`.

        Returns:
            The task with the place, its scene, and its plan: what planning that task alone returns.
        """
        begun = self.clock()
        build = partial(build_scene, cells=self.cells, uploads=uploads, tools=self.tools)
        search = CupPlaceSearch(task, build, lift_settings(task.options), on_progress)
        candidates = search.candidates(scene)
        examining = self.clock() - begun

        def planned(place: CupPlace | None, *, persistent: bool) -> tuple[PlateLiftTask, PlateLiftScene, Plan]:
            x, y = scene.cup.position.tolist() if place is None else place.position
            placed = task.with_cup_at((x, y))
            built = build(placed)
            return placed, built, self.plan(placed, built, on_progress, self.clock, persistent=persistent)

        wanted = 1.0 if task.options.minimise == "risk" else task.options.reserve
        best, kept, chosen = None, -1.0, candidates[0] if candidates else None
        for place in candidates:
            if place.promises_more_than(kept, wanted):
                tried = planned(place, persistent=False)
                reserve = tried[2].statistics.reserve
                if tried[2].outcome == "solved" and reserve is not None and reserve.value > kept:
                    best, kept, chosen = tried, reserve.value, place
        placed, built, found = planned(chosen, persistent=True) if best is None else best
        told = _cup_place(found, placed.cup.place, chosen, search.tried)
        explanation = found.explanation.model_copy(
            update={"summary": f"{found.explanation.summary} {told.sentence}", "cup_place": told}
        )
        times = [("cup places", examining), *found.statistics.times]
        statistics = found.statistics.taking(times, sum(seconds for _, seconds in times))
        return placed, built, found.model_copy(update={"explanation": explanation, "statistics": statistics})

    def _with_remedies(self, found: Plan, uploads: Uploads, on_progress: Progress) -> Plan:
        """Look for changes of a task that has no plan, and add what helps to the explanation.

        Of a task whose plan failed in physics what helps is what physics carries out.
        """
        begun, explanation = self.clock(), found.explanation
        remedies, tried = _RemedySearch(self, found, uploads, on_progress).found()
        if explanation.cup_place is not None:
            # They are for the cup where it was put, which the task as posted leaves open.
            remedies = [with_cup_at(explanation.cup_place.position, remedy) for remedy in remedies]
        helps = (
            f"{in_vain(explanation.causes, remedies, tried)}What helps: {remedies[0].sentence}"
            if remedies
            else why_none(tried)
        )
        summary = f"{explanation.summary}{_failure_told(found)} {helps}"
        explanation = explanation.model_copy(update={"summary": summary, "remedies": remedies})
        seconds, statistics = self.clock() - begun, found.statistics
        times = [*statistics.times, ("remedies", seconds)]
        statistics = statistics.taking(times, (statistics.total_seconds or 0.0) + seconds)
        return found.model_copy(update={"explanation": explanation, "statistics": statistics})


def _failure_told(plan: Plan) -> str:
    """Return what to add to the summary of a plan that failed in physics, beginning with a space; else nothing."""
    failure = failure_of(plan.simulation)
    return "" if failure is None else f" In physics it failed: {failure.words()}."


class _TakesTooLong(Exception):
    """Planning a changed task takes more than may be tried."""


class _RemedySearch:
    """The search for changes of a task that has no plan, or one that fails in physics."""

    def __init__(self, solver: TaskSolver, failed: Plan, uploads: Uploads, on_progress: Progress) -> None:
        self._solver, self._failed, self._task = solver, failed, failed.task
        self._fails_in_physics = failure_of(failed.simulation) is not None
        self._effort = Effort(STEPS_WITH_PHYSICS if self._fails_in_physics else MOST_STEPS)
        self._on_progress = on_progress
        self._attempt = PlanMemory(self._planned, self._effort)
        self._build = partial(build_scene, cells=solver.cells, uploads=uploads, tools=solver.tools)
        # Whether a change leaves a way is asked before it is planned: both need the same reach. Of what does not help
        # nobody asks why.
        self._memory = ReachMemory()
        self._plan_lift = partial(plan_lift, memory=self._memory, explained=False)
        self._handovers_of = HandoverMemory(solver.handovers)

    def found(self) -> tuple[list[Remedy], set[str]]:
        """Return what helps, and the kinds of changes that were tried."""
        changes, with_less_reserve, pairs = self._changes()
        if self._fails_in_physics:
            return self._search([more_kept_back(self._task), *changes], MOST_SIMULATED), self._effort.tried
        remedies = self._search(changes)
        if not remedies and (chief := with_less_reserve()):
            # A hold that is short of force may do it and keep less back than is asked for, as any plan may.
            effort = self._effort
            left, effort.steps = effort.steps - effort.spent, effort.spent + STEPS_OF_LESS_RESERVE
            attempt = PlanMemory(partial(self._planned, persistent=True), effort)
            remedies = find_remedies(chief, attempt, self._task, effort, self._on_progress)
            effort.steps = effort.spent + left
        if not remedies:
            self._effort.steps += STEPS_OF_PAIRS
            remedies = self._search(pairs())
        return remedies, self._effort.tried

    def _changes(
        self,
    ) -> tuple[
        Sequence[Iterator[TaskChange | None]],
        Callable[[], Sequence[Iterator[TaskChange | None]]],
        Callable[[], Iterable[Iterator[TaskChange | None]]],
    ]:
        """Return the changes of every kind, and what gives those that may keep less back, and pairs of them."""
        task, failed = self._task, self._failed
        if isinstance(task, PlateLiftTask):
            settings, is_open = lift_settings(task.options), failed.explanation.cup_place is not None
            lift = LiftChanges(
                task,
                self._build,
                settings,
                self._effort,
                self._quiet,
                self._memory,
                place_is_open=is_open,
            )
            # What physics does not carry out keeps less back than is asked for, most often.
            chief = next((cause.reason for cause in failed.explanation.causes), "")
            return lift.by_kind(chief, whole_reserve=self._fails_in_physics), list, lift.in_pairs
        tool = ToolChanges(task, self._build, failed, self._solves)
        return tool.by_kind(), tool.pressed_hardest, tool.in_pairs

    def _search(self, changes: Iterable[Iterator[TaskChange | None]], most: int = MOST_REMEDIES) -> list[Remedy]:
        return find_remedies(changes, self._attempt, self._task, self._effort, self._on_progress, most)

    def _solves(self, change: TaskChange) -> bool:
        """Tell whether a change leads to a plan, if that may still be tried."""
        changed = change.applied(self._task)
        if changed is None or self._effort.ended:
            return False
        self._effort.trying = change.kind
        self._effort.tried.add(change.kind)
        return self._attempt(changed) is not None

    def _planned(self, changed: PlateLiftTask | SuctionToolTask, *, persistent: bool = False) -> Plan | None:
        """Plan a changed task, certify the plan, and simulate it if the task's own failed there; None: no help.

        `persistent`: whether less may be kept back than the task asks for.
        """
        solver, effort = self._solver, self._effort
        try:
            scene = self._build(changed)
        except SceneError:
            return None
        effort.take(STEPS_OF_A_SCENE)
        most = effort.steps if persistent else min(effort.steps, effort.spent + STEPS_OF_A_PLAN)

        def counted(report: Report, /) -> None:
            self._quiet(report)
            if effort.spent >= most:
                raise _TakesTooLong

        try:
            plan = solver.plan(
                changed, scene, counted, solver.clock, self._handovers_of, self._plan_lift, persistent=persistent
            )
        except _TakesTooLong:
            return None
        if plan.outcome != "solved":
            return None
        effort.take(STEPS_OF_A_CERTIFICATE * len(getattr(changed, "objects", ("plate",))))
        certificate = solver.certificate_of(plan)
        if certificate is None or not certificate.passed:
            return None
        plan = plan.model_copy(update={"certificate": certificate})
        if self._fails_in_physics:
            effort.take(STEPS_OF_SIMULATION)
            plan = solver.simulated(plan, scene, self._task.seed, self._without_counting)
        return plan if failure_of(plan.simulation) is None else None

    def _quiet(self, report: Report, /) -> None:
        """Count what is done, and ask whether to stop; the search for remedies tells how far it is."""
        self._effort.worked(report)
        self._without_counting(report)

    def _without_counting(self, _: Report, /) -> None:
        self._on_progress(self._effort.report())


def _cup_place(plan: Plan, position: tuple[float, float], chosen: CupPlace | None, tried: int) -> ChosenCupPlace:
    """Say where the cup was put, and why."""
    x, y = (f"{1e3 * each:.0f}" for each in position)
    at = f"({x}, {y}) mm from the plate's origin"
    kept = None if chosen is None or not chosen.leaves_a_way else chosen.kept
    if chosen is None:
        sentence = f"This holds wherever the cup sits; here it sits at {at}."
    elif plan.outcome == "solved" and kept is not None:
        share = f"poses and holds could keep back up to {100 * kept:.1f} % of every limit there"
        reserve = plan.statistics.reserve
        whole = "" if reserve is None else f", this plan with its motions keeps back {100 * reserve.value:.1f} %"
        sentence = f"The cup sits at {at}, the best of {tried} places tried: {share}{whole}."
    elif plan.outcome == "solved":
        sentence = f"The cup sits at {at}, which among {tried} places comes farthest."
    else:
        why = ""
        if kept is not None:
            why = f", where up to {100 * kept:.1f} % of every limit could be kept"
        elif chosen is not None and chosen.tilt > 0.0:
            why = ", where the plate is tilted farthest"
        sentence = f"Of {tried} places of the cup none leads to a plan; told is what hinders at {at}{why}."
    return ChosenCupPlace(position=position, tried=tried, reserve=kept, sentence=sentence)


MOST_CELLS = 16
"""Whose shapes are kept for the certificate: people may add any number of cells."""
_shipped_tools = cache(load_tools)
_handovers = HandoverMemory(find_handovers)
"""Of tasks that are planned without a service, one after the other."""
_tool_descriptions = cache(tool_descriptions)
_meshes = cache(load_meshes)


def certificate_of(
    document: bytes,
    cell: Cell,
    certify: Callable[[bytes, RobotSurfaces, CellReference], Certificate | None] = certify,
) -> Certificate | None:
    """Return what the certificate says of a plan document, checked against what is known of its cell.

    Args:
        document: as it is sent.
        cell: in which it was planned.
        certify: checks it, as `planners.certify.certify` does.
    """
    return certify(document, _surfaces(cell), reference_of(cell))


@lru_cache(maxsize=MOST_CELLS)
def _surfaces(cell: Cell) -> RobotSurfaces:
    """Read the shapes of a cell's arms and hands, which the certificate checks against."""
    return load_surfaces({name: (arm.robot.name, arm.hand.name) for name, arm in cell.arms.items()}, cell.shelf.folders)


def reference_of(cell: Cell) -> CellReference:
    """Return what the certificate may take for known about a cell."""
    home = np.concatenate([cell.arms[arm].home for arm in ("left", "right")])
    rest = None if cell.tool_rest is None else to_pose7(cell.tool_rest.T_world_tool)
    lifter = LifterReference(cell.lifter.cup_height, cell.lifter.cable_radius, cell.lifter.cable_length)
    meshes = _meshes(assets_folder() / MESHES)
    return CellReference(cell.document(), cell.body_documents(), home, lifter, rest, _tool_descriptions(), meshes)


def _plan(
    task: PlateLiftTask | SuctionToolTask,
    scene: PlateLiftScene | SuctionToolScene,
    found: LiftPlan | ToolPlan,
    segments: Iterable[Segment],
    statistics: Statistics,
) -> Plan:
    """Return the plan of a planner of either kind."""
    causes = [
        Cause(
            reason=cause.reason,
            needed=cause.needed,
            available=cause.available,
            unit=cause.unit,
            where=cause.where or cause.stage,
        )
        for cause in found.causes
    ]
    return Plan(
        schema_version=SCHEMA_VERSION,
        id="",
        # Read again, so that every default is stated.
        task=read_task(write_task(with_centres(task, scene))),
        seed=task.seed,
        software=THIS_SOFTWARE,
        outcome=found.outcome.value,
        explanation=Explanation(summary=found.summary, causes=causes),
        cell=scene.cell.document(),
        joint_names=list(JOINT_NAMES),
        bodies=stated_bodies(scene),
        segments=list(segments),
        certificate=None,
        simulation=None,
        statistics=statistics,
    )


def _statistics(found: LiftPlan | ToolPlan, stages: Mapping[str, float], **more: Any) -> Statistics:
    """Return what it cost; `stages` are seconds by stage, in order."""
    graph: dict[str, Any] = {**found.graph}
    search: dict[str, Any] = {**found.search}
    return Statistics(
        total_seconds=sum(stages.values()),
        stages=[StageTime(name=name, seconds=seconds) for name, seconds in stages.items()],
        graph=graph,
        search=search,
        rejections=found.rejections.counts(),
        **more,
    )


def stated_bodies(scene: PlateLiftScene | SuctionToolScene) -> dict[str, BodyDocument]:
    """Return everything in the scene, where it is at the start: bodies of the cell first, then those of the task."""
    of_task = {
        body.name: BodyDocument(
            role=body.role,
            shape=body.shape,
            mass=body.mass,
            com=body.com,
            pose=pose_row(body.T_world_body),
            static=body.static,
        )
        for body in scene.bodies()
    }
    return scene.cell.body_documents() | of_task


def lift_settings(options: PlateLiftOptions) -> LiftSettings:
    """Return the planner's settings for the options of a task."""
    settings = LiftSettings(
        minimise="force" if options.minimise == "force" else "cost",
        reserve=options.reserve,
        most_reserve=options.minimise == "risk",
        full=options.search == "full",
        sampling=ContactSampling(goal_height=options.goal_height),
    )
    return settings.scaled(options.contact_density, options.hold_density)


def _searched(scene: SuctionToolScene, handovers: HandoverSource, progress: Progress, *, persistent: bool) -> ToolPlan:
    settings = ToolPlannerSettings().in_cell(scene.cell).starting_at(scene.tool.T_world_tool)
    database = handovers(scene.cell, scene.tool, settings.handovers, progress)
    settings = settings if persistent else settings.hasty()
    return plan_with_reserve(scene, settings, database, progress, persistent=persistent)


class _Stopwatch:
    """Passes progress on, and adds up the seconds between the first report of a stage and that of the next."""

    def __init__(self, clock: Callable[[], float], progress: Progress) -> None:
        self._clock, self._progress = clock, progress
        self._stage, self._begun = "sample", clock()
        self.seconds: dict[str, float] = {}

    def __call__(self, report: Report, /) -> None:
        if report.name != self._stage:
            self.stop()
            self._stage = report.name
        self._progress(report)

    def stop(self) -> None:
        """Close the stage that is running."""
        now = self._clock()
        self.seconds[self._stage] = self.seconds.get(self._stage, 0.0) + now - self._begun
        self._begun = now
