"""Where the lifter's cup best sits on a plate: where the forces of a lift leave most of their limits.

Places are compared by program (5) of paper B: the largest share of every limit that a way of held poses can keep back
(`PlateLiftPlanner.may_keep`). Whether the arms find a way too is told by planning, which begins with the best place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from planners.contract.task_spec import PlateLiftTask
from planners.errors import SceneError
from planners.manipulation.lift_attempts import most_passable
from planners.manipulation.lift_settings import LiftSettings
from planners.manipulation.planner import PlateLiftPlanner
from planners.manipulation.reach.reach_memory import ReachMemory
from planners.progress import Progress, Report
from planners.scene.body import PlateBody
from planners.scene.lift_placements import LEAST_CUP_STEP, cup_places, cup_places_on, cup_step
from planners.scene.lift_scene import PlateLiftScene

MOST_PLACES = 60
"""That are examined, each some tenth of a plan."""
MOST_PLANS = 4
"""Places at which a plan is looked for."""
RESERVE_STEP = 0.01
"""Reserves that differ by less are the same [1]."""
_APART = 0.9
"""How far these are from each other at least, in steps of the lattice of places [1]."""
_HALVINGS = 3
"""How often the best place is looked for among neighbours half as far."""


@dataclass(frozen=True, order=True)
class CupPlace:
    """A place of the cup, the better the larger."""

    rises: bool
    """Whether a plan could end where the lift can go on straight up."""
    kept: float
    """The largest share of every limit that a way of held poses keeps back [1]; -1: there is no such way."""
    tilt: float
    """How far the plate is tilted at most on ways that are held [rad]."""
    nearness: float
    """To the plate's centre of mass: its distance, negative [m]."""
    position: tuple[float, float]
    """In plate axes [m]."""

    @property
    def leaves_a_way(self) -> bool:
        """Whether the plate could be held all along a lift."""
        return self.kept >= 0.0

    def promises_more_than(self, kept: float, wanted: float) -> bool:
        """Tell whether a plan here may keep back more than one elsewhere does.

        Args:
            kept: by that one [1].
            wanted: more is not asked for [1].
        """
        return self.leaves_a_way and min(self.kept, wanted) >= min(kept, wanted) + RESERVE_STEP


class CupPlaceSearch:
    """Examines places of the cup of one lift."""

    def __init__(
        self,
        task: PlateLiftTask,
        build: Callable[[PlateLiftTask], PlateLiftScene],
        settings: LiftSettings,
        progress: Progress,
    ) -> None:
        """Prepare.

        Args:
            task: that leaves the place open.
            build: makes scenes of tasks.
            settings: with which it is planned; the sampling that is examined is the first one.
            progress: told of the places; may raise `PlanningCancelled`.
        """
        self._task, self._build, self._progress = task, build, progress
        self._settings = replace(settings, reserve=0.0, most_reserve=False, full=False)
        self._memory = ReachMemory()
        self._known: dict[tuple[float, float], CupPlace | None] = {}

    @property
    def tried(self) -> int:
        """How many places were examined."""
        return sum(place is not None for place in self._known.values())

    def candidates(self, scene: PlateLiftScene) -> list[CupPlace]:
        """Return the places at which to look for a plan, the best first: so far apart that they differ.

        Args:
            scene: of the task, with the cup anywhere.

        Returns:
            `MOST_PLANS` places that leave a way, or where none does the one that came farthest; none at all where it is
            proven that there is no plan wherever the cup sits.
        """
        if PlateLiftPlanner(scene, self._settings, self._progress).proof(explained=False) is not None:
            return []
        step = cup_step(scene.plate, scene.cup.radius)
        ranked = self._ranked(scene.plate, scene.cup.radius, step)
        apart: list[CupPlace] = []
        for place in ranked:
            near = any(math.dist(place.position, other.position) < _APART * step for other in apart)
            if place.leaves_a_way and not near and len(apart) < MOST_PLANS:
                apart.append(place)
        return apart or ranked[:1]

    def _ranked(self, plate: PlateBody, radius: float, step: float) -> list[CupPlace]:
        """Return the places that are not refused, the best first: all over the plate, and closer about the best."""
        self._examine(cup_places(plate, radius, step))
        if not any(place.leaves_a_way for place in self._found()):
            # Where few places leave a way, one is found between those.
            step = max(LEAST_CUP_STEP, 0.5 * step)
            self._examine(cup_places(plate, radius, step))
        for _ in range(_HALVINGS):
            step = 0.5 * step
            best = max(self._found(), default=None)
            if best is None or not best.leaves_a_way or step < LEAST_CUP_STEP:
                break
            around = [(x, y) for x in (-step, 0.0, step) for y in (-step, 0.0, step)]
            self._examine(cup_places_on(plate, radius, np.array(best.position) + np.array(around)))
        return sorted(self._found(), reverse=True)

    def _found(self) -> list[CupPlace]:
        return [place for place in self._known.values() if place is not None]

    def _examine(self, places: Iterable[tuple[float, float]]) -> None:
        for place in places:
            if place not in self._known and len(self._known) < MOST_PLACES:
                self._progress(Report("cup places", len(self._known), MOST_PLACES))
                self._known[place] = self._examined(place)

    def _examined(self, place: tuple[float, float]) -> CupPlace | None:
        """Return what becomes of a lift with the cup at a place; None where such a task is refused."""
        try:
            scene = self._build(self._task.with_cup_at(place))
        except SceneError:
            return None

        def quiet(report: Report, /) -> None:
            """Ask whether to stop; how far the work is, is counted in places."""
            self._progress(Report("cup places", len(self._known), MOST_PLACES))

        planner = PlateLiftPlanner(scene, self._settings, quiet, self._memory)
        nearness = -round(float(np.linalg.norm(np.array(place) - scene.plate.com[:2])), 6)
        if not planner.fits:
            return CupPlace(False, -1.0, 0.0, nearness, place)
        if planner.may_keep(0.0, low=True):
            rises = planner.may_keep(0.0, low=False)
            kept = most_passable(planner, 0.0, self._settings.largest_reserve, low=not rises) or 0.0
            return CupPlace(rises, kept, 0.0, nearness, place)
        search = planner.search
        assert search is not None
        reached = {int(pose) for pose in search.graph.node_pose[search.graph.reachable()]}
        poses = search.sampling.poses.poses
        tilt = max((float(np.linalg.norm(poses[pose].tilt)) for pose in reached), default=0.0)
        return CupPlace(False, -1.0, round(tilt, 3), nearness, place)
