"""Plan a plate lift with one sampling of poses and holds: reach, graph, search, report (paper B, IV and V)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from functools import cached_property

import numpy as np

from planners.balance.balanced import UnbalanceProof
from planners.balance.capacity import LiftCapacity
from planners.cell.arm_span import ArmSpan, OutOfReach, out_of_reach
from planners.graph.search import GraphPath
from planners.manipulation.graph.failures import Failures
from planners.manipulation.holds.grips import least_opening
from planners.manipulation.impasse import NO_WAY, find_impasse
from planners.manipulation.lift_plan import LiftPlan
from planners.manipulation.lift_reach import LiftReach
from planners.manipulation.lift_report import not_found, out_of_hands, solved, too_heavy, too_large, too_thick
from planners.manipulation.lift_sampling import LiftSampling, jaw_of
from planners.manipulation.lift_search import Found, LiftRecord, LiftSearch, NothingFound
from planners.manipulation.lift_settings import LiftSettings
from planners.manipulation.reach.reach_memory import ReachMemory
from planners.progress import Progress
from planners.scene.lift_scene import PlateLiftScene


class PlateLiftPlanner:
    """One sampling of poses and holds of one lift, searched as often as is asked for."""

    def __init__(
        self,
        scene: PlateLiftScene,
        settings: LiftSettings,
        progress: Progress,
        memory: ReachMemory | None = None,
        proofs: Sequence[UnbalanceProof] = (),
    ) -> None:
        """Sample poses and holds; nothing is solved yet.

        Args:
            scene: what is to be lifted, and where.
            settings: budgets and choices, with the lengths of a cell of size 1.
            progress: told what is being done.
            memory: of the reach in other lifts.
            proofs: of imbalance, found with another sampling. What they rule out is no part of the graph, so that more
                poses and holds fit into memory; such a planner is for this scene's forces alone.
        """
        settings = settings.in_cell(scene.cell)
        self.scene, self.settings, self._memory = scene, settings, memory
        self.record = LiftRecord(progress)
        self.sampling = LiftSampling.of(scene, settings)
        self.balance = self.sampling.balance(settings.reserve)
        """Of the last search."""
        self.balance.learn(proofs)
        self._ruled_out = self.balance.ruled_out.copy() if proofs else None
        self.search: LiftSearch | None = None
        """The last one."""
        self._way: GraphPath | None = None

    @cached_property
    def reach(self) -> LiftReach:
        """Which hand reaches which pose in which postures; found when first asked for."""
        return LiftReach(self.sampling, self.record.rejections, self.record.progress, self._memory, self._ruled_out)

    @cached_property
    def fits(self) -> bool:
        """Whether the graph fits into memory."""
        return self.reach.edge_count <= self.settings.largest_graph

    def with_limits(self, scene: PlateLiftScene) -> PlateLiftPlanner:
        """Return a planner of the same poses, holds and reach for other forces; nothing is solved yet.

        Args:
            scene: other than this one in nothing but what the balance program takes: the cup's force and cone,
                friction, limits of the hands, the lifter's model, mass and tolerances. Where the cup sits is taken for
                the balance alone: what it meets, and which grips it is in the way of, stays as it was.
        """
        other = copy(self)
        other.scene, other.sampling = scene, self.sampling.with_limits(scene)
        other.reach = self.reach.with_limits(other.sampling)
        other.balance = other.sampling.balance(self.settings.reserve)
        other.record, other.search = LiftRecord(self.record.progress), None
        return other

    def plan(self, *, explained: bool = True) -> LiftPlan:
        """Plan the lift with the reserve of the settings.

        Args:
            explained: whether to look for the causes where nothing is found; that takes balances of its own.
        """
        proof = self.proof(explained=explained)
        if proof is not None:
            return proof
        if not self.fits:
            return too_large(self.sampling, self.record.rejections, self.reach.edge_count)
        return self.planned(self.begin(), explained=explained, thorough=explained)

    def proof(self, *, explained: bool = True) -> LiftPlan | None:
        """Return the answer where it takes no search: that there is no plan. None where a search has to tell.

        If `explained`, it is looked for what would be enough; that takes balances of its own.
        """
        sampling, rejections = self.sampling, self.record.rejections
        capacity = self.capacity()
        if not capacity.suffices:
            return too_heavy(sampling, rejections, capacity, explained=explained)
        if jaw_of(sampling.workcell).width_max < least_opening(sampling.prism, self.scene.friction.grip):
            return too_thick(sampling, rejections)
        beyond = self.out_of_reach()
        return None if beyond is None else out_of_hands(sampling, rejections, beyond)

    def capacity(self) -> LiftCapacity:
        """Bound what robot and lifter can carry together off the support, at whatever tilt, with nothing kept back."""
        return self.sampling.stated.capacity(0.5 * math.pi)

    def plan_keeping(self, reserve: float, *, low: bool = True, explained: bool = True) -> LiftPlan:
        """Search again with another share of every limit kept back; what does not depend on it stays known.

        Args:
            reserve: [1].
            low: whether a plan may end where the lift cannot go on, if there is no other.
            explained: see `plan`.
        """
        search = self._begin_keeping(reserve)
        if not low and not explained and search.any_way() is None:
            return not_found(search, NO_WAY)
        return self.planned(search, low=low, explained=explained, thorough=explained)

    def may_keep(self, reserve: float, *, low: bool) -> bool:
        """Ask whether a plan could keep a share of every limit back: False proves that `plan_keeping` finds none.

        Poses, holds and transfers of the plate have to leave a way; the motion of the arms is not asked for.

        Args:
            reserve: [1].
            low: as for `plan_keeping`.
        """
        search = self._begin_keeping(reserve, () if low else self.settings.rises[:1], full=False)
        # What was a way with another reserve often is one with this.
        if self._way is not None and search.is_way(self._way):
            return True
        found = search.any_way()
        self._way = found or self._way
        return found is not None

    def may_hold_as_stated(self) -> bool:
        """Ask whether a plan could hold the plate as stated: False proves that `plan_as_stated` finds none."""
        balance = self.balance
        search = self._begin_as_stated()
        self.balance = balance
        return search.any_way() is not None

    def plan_as_stated(self) -> LiftPlan:
        """Search for a plan that holds the plate as stated, whatever its tolerances, with nothing kept back."""
        search = self._begin_as_stated()
        if search.any_way() is None:
            return not_found(search, NO_WAY)
        return self.planned(self.begin(), explained=False, thorough=False)

    def _begin_as_stated(self) -> LiftSearch:
        self.balance = self.sampling.balance(0.0, tolerances=False)
        return self.begin((), full=False)

    def begin(self, rises: tuple[tuple[float, ...], ...] | None = None, *, full: bool | None = None) -> LiftSearch:
        """Merge the graph for the balance of now, whatever its size; nothing of it is searched yet.

        Args:
            rises: other than the settings'.
            full: whether to examine all nodes first, other than the settings say.
        """
        reach, last = self.reach, self.search
        self.search = LiftSearch(
            reach,
            self.balance,
            self.settings.rises if rises is None else rises,
            Failures(self.balance) if last is None else last.failures.of_reach(self.balance),
            self.record,
            full=self.settings.full if full is None else full,
        )
        return self.search

    def _begin_keeping(
        self, reserve: float, rises: tuple[tuple[float, ...], ...] | None = None, *, full: bool | None = None
    ) -> LiftSearch:
        self.balance = self.balance.keeping(self.sampling.keeping(reserve), reserve)
        return self.begin(rises, full=full)

    def planned(
        self, search: LiftSearch, *, low: bool = True, explained: bool = True, thorough: bool = True
    ) -> LiftPlan:
        """Search a graph that was merged, and report.

        Args:
            search: of the graph.
            low: as for `plan_keeping`.
            explained: likewise.
            thorough: see `LiftSearch.find`.
        """
        found = search.find(low=low, thorough=thorough or explained)
        if isinstance(found, Found):
            return solved(search, found)
        if found is NothingFound.NO_TRIES:
            tries = self.settings.sequences
            return not_found(search, f"No sequence could be moved along in {tries} tries.")
        if not explained:
            return not_found(search, NO_WAY)
        impasse = find_impasse(search)
        return not_found(search, impasse.summary, impasse.causes)

    def out_of_reach(self) -> OutOfReach | None:
        """Prove that neither hand reaches the plate where it lies, if it is so: nothing else could move it first."""
        plate = self.scene.plate
        spans = [ArmSpan.of(arm) for arm in self.scene.cell.arms.values()]
        radius = float(np.linalg.norm(plate.solid.surface()[0], axis=1).max())
        return out_of_reach(spans, plate.T_world_body[:3, 3], radius)
