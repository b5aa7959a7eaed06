"""Plan a plate lift as a person would who does not give up at once: more densely, then with less kept back.

One sampling of poses and holds, searched with one reserve, is `PlateLiftPlanner`. That it finds nothing says little
about the lift: another sampling may, and so may a smaller share of the limits kept back. So before "not found" is
said, denser samplings are tried; and where nothing but the reserve is too much, how much there can be.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from planners.balance.balanced import UnbalanceProof
from planners.graph.rejections import Rejection
from planners.manipulation.lift_plan import LiftPlan
from planners.manipulation.lift_settings import LiftSettings
from planners.manipulation.planner import PlateLiftPlanner
from planners.manipulation.reach.reach_memory import ReachMemory
from planners.manipulation.statics.reserves import STEPS
from planners.plan.verdicts import PlanningOutcome
from planners.progress import Progress, Report
from planners.scene.lift_scene import PlateLiftScene

_ROOM = 0.95
"""How much smaller still the numbers of poses and holds are made than would just fit, if edges grew as expected [1]."""
_WORTHWHILE = 1.2
"""So many times as many pairs of a pose and a hold are tried next at least [1]."""
NOT_WITHIN_TOLERANCES = "not every plate within its tolerances"
"""Words of the cause that it is what is not known of the plate that stands in the way."""
_ROUNDING = 1e-6
"""Part of a step by which a reserve may miss it."""


def plan_lift(
    scene: PlateLiftScene,
    settings: LiftSettings,
    progress: Progress,
    memory: ReachMemory | None = None,
    *,
    persistent: bool = True,
    explained: bool = True,
) -> LiftPlan:
    """Plan a plate lift; that there is no plan is an answer, with its reasons.

    Args:
        scene: what is to be lifted, and where.
        settings: budgets and choices.
        progress: told what is being done; may raise `PlanningCancelled`.
        memory: of the reach in other lifts, to which this one's is added; the plan is the same without it.
        persistent: whether to try denser samplings where nothing is found. What is found without is found with them.
        explained: whether to look for the causes where nothing is found; that takes balances of its own.
    """
    planner = PlateLiftPlanner(scene, settings, progress, memory)
    plan = planner.proof(explained=explained) or planner.plan(explained=explained and settings.reserve == 0.0)
    if plan.outcome is PlanningOutcome.NOT_FOUND and not planner.fits and _thinning(planner) >= settings.least_thinning:
        return _thinned(planner, settings, progress, memory, persistent=persistent, explained=explained)
    if plan.outcome is PlanningOutcome.SOLVED and settings.most_reserve:
        return _keeping_most(planner, plan, settings, progress, below=settings.largest_reserve)
    if plan.outcome is not PlanningOutcome.NOT_FOUND or not planner.fits:
        return plan
    below = settings.reserve
    if settings.reserve > 0.0:
        plan, below = _keeping_less(planner, settings, progress, explained=explained)
    if plan.outcome is not PlanningOutcome.SOLVED:
        if not persistent:
            return plan
        denser = _Denser(planner, settings, progress, memory)
        found = denser.plan()
        if found is None:
            return _blaming_tolerances(denser, plan, progress) if denser.may_hold_as_stated else plan
        # More may be kept back than was asked for before.
        planner, plan, below = denser.planner, found, settings.largest_reserve
    return _keeping_most(planner, plan, settings, progress, below=below)


class _Denser:
    """Tries the denser samplings of one lift, each only as far as there is hope.

    Most of what a search takes is wasted where no sequence of held poses is left, whatever the arms do; so that is
    asked first. And where none is left for the plate exactly as stated either, more of the same poses and holds were
    not found to help: then no more are tried.
    """

    def __init__(
        self, first: PlateLiftPlanner, settings: LiftSettings, progress: Progress, memory: ReachMemory | None
    ) -> None:
        self.first, self._settings, self._progress, self._memory = first, settings, progress, memory
        self.planner = first
        """The last one whose graph fits into memory."""
        self.whole = first
        """The last one whose graph has all poses and holds."""
        self.may_hold_as_stated = True
        """False: with twice as many poses not even the plate as stated could be held all the way."""
        self._proofs = [*first.balance.telling_proofs]

    def plan(self) -> LiftPlan | None:
        """Return the first plan that is found, with nothing kept back, or None."""
        known = (1.0, 1.0)
        for number, wanted in enumerate(self._settings.denser, start=1):
            fitting = self._fitting(wanted, known)
            if fitting is None or not self.may_hold_as_stated:
                break
            known, proofs = fitting
            self._progress(Report("denser", number, len(self._settings.denser)))
            scaled = replace(self._settings.scaled(*known), reserve=0.0)
            denser = PlateLiftPlanner(self.first.scene, scaled, self._progress, self._memory, proofs)
            if not denser.fits:
                break
            self.planner = denser
            way = denser.may_keep(0.0, low=True)
            if way:
                plan = denser.plan_keeping(0.0, explained=False)
                if plan.outcome is PlanningOutcome.SOLVED:
                    return plan
            self._proofs += [proof for proof in denser.balance.telling_proofs if not _is_among(proof, proofs)]
            if not proofs:
                self.whole = denser
                self.may_hold_as_stated = way or known[0] <= 1.0 or denser.may_hold_as_stated()
        return None

    def _fitting(
        self, wanted: tuple[float, float], known: tuple[float, float]
    ) -> tuple[tuple[float, float], Sequence[UnbalanceProof]] | None:
        """Choose poses and holds whose graph likely fits into memory.

        Args:
            wanted: factors of their numbers that would be best [1].
            known: those of the last graph that did fit [1].

        Returns:
            Factors, and proofs of imbalance that have to make the graph smaller; None where there would hardly be more
            than there are.
        """
        last, more = self.planner, math.prod(wanted) / math.prod(known)
        # Transfers are nearly all edges: as many as pairs of poses times pairs of holds.
        room = last.settings.largest_graph / more**2
        if last.reach.edge_count <= room:
            # A graph that lacks what proofs rule out says nothing of one that has it.
            return wanted, () if last is self.whole else (*self._proofs,)
        left = max(1, last.reach.edges_left(last.balance.ruled_out))
        share = min(1.0, _ROOM * (room / left) ** 0.25)
        worthwhile = share**2 * more >= _WORTHWHILE
        return ((share * wanted[0], share * wanted[1]), (*self._proofs,)) if worthwhile else None


def _is_among(proof: UnbalanceProof, proofs: Sequence[UnbalanceProof]) -> bool:
    return any(proof is each for each in proofs)


def _thinning(planner: PlateLiftPlanner) -> float:
    """Return which share of poses and holds likely fits into memory: edges grow with poses and with pairs of holds."""
    return _ROOM * (planner.settings.largest_graph / planner.reach.edge_count) ** (1.0 / 3.0)


def _thinned(
    planner: PlateLiftPlanner,
    settings: LiftSettings,
    progress: Progress,
    memory: ReachMemory | None,
    *,
    persistent: bool,
    explained: bool,
) -> LiftPlan:
    """Plan with fewer poses and holds, where the graph of all does not fit into memory, and say so."""
    edges, share = planner.reach.edge_count, _thinning(planner)
    fewer = replace(settings.scaled(share, share), least_thinning=settings.least_thinning / share, denser=())
    plan = plan_lift(planner.scene, fewer, progress, memory, persistent=persistent, explained=explained)
    told = f"Of poses and holds {100 * share:.0f} % were tried: the graph of all would have {edges} edges"
    return replace(plan, summary=f"{plan.summary} {told}, and {settings.largest_graph} fit into memory.")


def _keeping_less(
    planner: PlateLiftPlanner, settings: LiftSettings, progress: Progress, *, explained: bool
) -> tuple[LiftPlan, float]:
    """Plan where what is asked for cannot be kept back.

    What speaks against a reserve is found out faster than a plan that keeps it, so that one search is mostly enough:
    for the plan that keeps most back.

    Returns:
        The plan, and a reserve that no plan of its kind is found with [1].
    """
    progress(Report("reserve", 0, settings.reserve_searches))
    most = most_passable(planner, 0.0, settings.reserve - 1.0 / STEPS, low=False)
    if most is not None:
        plan = planner.plan_keeping(most, low=False, explained=False)
        if plan.outcome is PlanningOutcome.SOLVED:
            return plan, most + 1.0 / STEPS
    plan = planner.plan_keeping(0.0, explained=explained)
    if not plan.rises:
        return plan, settings.reserve
    return plan, 1.0 / STEPS if most is None else most


def most_passable(planner: PlateLiftPlanner, kept: float, top: float, *, low: bool) -> float | None:
    """Return the largest reserve that nothing speaks against, a whole multiple of 1 / STEPS, or None if there is none.

    Args:
        planner: whose reach and merged graph are kept.
        kept: a smaller one; the one returned is larger [1].
        top: none larger is asked for [1].
        low: whether the plan may end where the lift cannot go on.
    """
    known, beyond = math.floor(kept * STEPS + _ROUNDING), math.floor(top * STEPS + _ROUNDING) + 1
    best = None
    if beyond - known > 2:
        # What speaks against the least speaks against all.
        if not planner.may_keep((known + 1) / STEPS, low=low):
            return None
        known, best = known + 1, (known + 1) / STEPS
    while beyond - known > 1:
        middle = (known + beyond) // 2
        if planner.may_keep(middle / STEPS, low=low):
            known, best = middle, middle / STEPS
        else:
            beyond = middle
    return best


def _blaming_tolerances(denser: _Denser, plan: LiftPlan, progress: Progress) -> LiftPlan:
    """Say so where the plate as stated could be lifted, and only what is not known of it stands in the way."""
    scene = denser.first.scene
    if scene.mass_tolerance == scene.com_tolerance == 0.0:
        return plan
    progress(Report("tolerances", 0, 1))
    # The first sampling is the smallest, and mostly enough.
    planners = dict.fromkeys((denser.first, denser.whole))
    if all(each.plan_as_stated().outcome is not PlanningOutcome.SOLVED for each in planners):
        return plan
    reason = (
        f"The plate as stated can be lifted, but {NOT_WITHIN_TOLERANCES} of "
        f"{100 * scene.mass_tolerance:.3g} % of the mass (plate.mass_tolerance) and {1e3 * scene.com_tolerance:.3g} mm "
        "of the centre of mass (plate.com_tolerance)"
    )
    cause = Rejection("balance", reason, "the plate")
    return replace(plan, summary=f"{reason}: state smaller ones if you know it better.", causes=(cause, *plan.causes))


def _keeping_most(
    planner: PlateLiftPlanner, plan: LiftPlan, settings: LiftSettings, progress: Progress, *, below: float
) -> LiftPlan:
    """Search for a plan that keeps as much back as is asked for, or else the most there can be.

    Args:
        planner: whose reach and merged graph are kept.
        plan: the best so far.
        settings: how often is searched.
        progress: told of the searches.
        below: no plan is looked for with this much kept back, or none was found [1].
    """
    low, high = _kept(plan), below
    enough = settings.largest_reserve if settings.most_reserve else settings.reserve
    ends_low = not plan.rises
    top = min(high - 1.0 / STEPS, enough)
    for number in range(settings.reserve_searches):
        if low >= enough or high - low < settings.reserve_step:
            break
        progress(Report("reserve", number, settings.reserve_searches))
        tried = most_passable(planner, low, top, low=ends_low)
        if tried is None:
            break
        found = planner.plan_keeping(tried, low=ends_low, explained=False)
        if found.outcome is PlanningOutcome.SOLVED:
            plan, low = found, max(tried, _kept(found))
            break
        high, top = tried, 0.5 * (low + tried)
    return plan if low >= settings.reserve else replace(plan, summary=f"{plan.summary} {_told(plan, settings)}")


def _kept(plan: LiftPlan) -> float:
    return 0.0 if plan.reserve is None else plan.reserve.value


def _told(plan: LiftPlan, settings: LiftSettings) -> str:
    """Say how much is kept back where that is not what was asked for."""
    assert plan.reserve is not None
    kept, limit = plan.reserve.value, plan.reserve.limited_by
    return (
        f"With {100 * settings.reserve:.3g} % of every limit kept back there is no plan among those tried; this one "
        f"keeps back {100 * kept:.1f} %. What limits it: {limit}."
    )
