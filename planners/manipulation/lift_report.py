"""Put what became of a plate lift into words and figures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import cycle, groupby, islice, pairwise

import numpy as np
from numpy.typing import NDArray

from planners.balance.balanced import Balanced
from planners.balance.capacity import LiftCapacity
from planners.balance.relaxed_balance import least_force
from planners.cell.arm_span import OutOfReach
from planners.contract.task_spec import HandForceLimit
from planners.graph.rejections import CAPACITY, Rejection, Rejections
from planners.graph.search import ALIVE, DEAD, UNKNOWN, GraphPath
from planners.manipulation.graph.node_examiner import hands_of
from planners.manipulation.lift_plan import LiftPlan, SequenceStep
from planners.manipulation.lift_sampling import LiftSampling, jaw_of
from planners.manipulation.lift_search import Found, LiftSearch
from planners.manipulation.lift_segment import BalancedContacts, LiftSegment
from planners.manipulation.statics.lift_programs import payload_forces
from planners.manipulation.statics.lift_torques import LiftTorques
from planners.manipulation.statics.reserves import ReservedSegments, keeping_most
from planners.plan.verdicts import PlanningOutcome, told_apart
from planners.scene.lift_scene import PlateLiftScene

_MOST_ASKED = 100
"""Poses in the air with a grip and a push, of which it is asked whether they hold a plate that is too heavy."""
_CAUSES = 6
"""Causes that are told where nothing was found."""


def solved(search: LiftSearch, found: Found) -> LiftPlan:
    """Report a sequence that was found and choreographed."""
    steps = tuple(_step(search, node) for node in found.path.nodes)
    changes = sum(a.contact != b.contact for a, b in pairwise(steps))
    # What happens between the nodes counts too: their contacts and forces are not all there is.
    plate = search.sampling.scene.plate
    told = (segment.contact.told(plate.outline, plate.T_world_body) for segment in found.segments)
    contacts = [word for word, _ in groupby(told)]
    reserved = _reserved(search, found.segments)
    sets = (each.balance for segment in reserved.segments for each in segment.contact_sets)
    force = max(balance.f_plus_gp for balance in sets)
    return LiftPlan(
        outcome=PlanningOutcome.SOLVED,
        segments=reserved.segments,
        steps=steps,
        causes=(),
        summary=f"The plate is lifted over {' - '.join(contacts)}; no hand bears more than {force:.1f} N.",
        rejections=search.record.rejections,
        graph=_graph_figures(search),
        search=_search_figures(search, found.path, changes),
        reserves=reserved,
        rises=search.rising is not None,
    )


def not_found(search: LiftSearch, summary: str, main: tuple[Rejection, ...] = ()) -> LiftPlan:
    """Report that nothing was found among the poses and holds that were tried.

    The main causes come first, then what failed most often on the way.
    """
    rejections, told = search.record.rejections, {cause.reason for cause in main}
    # How often is in the statistics: it tells how much was tried, not how much is short.
    often = [rejection for rejection, _ in rejections.most_common(_CAUSES) if rejection.reason not in told]
    for cause in main:
        rejections.add(cause)
    return LiftPlan(
        outcome=PlanningOutcome.NOT_FOUND,
        causes=(*main, *often)[:_CAUSES],
        summary=summary,
        rejections=rejections,
        graph=_graph_figures(search),
        search=_search_figures(search, None, 0),
        rises=search.rising is not None,
    )


def too_heavy(
    sampling: LiftSampling, rejections: Rejections, capacity: LiftCapacity, *, explained: bool = True
) -> LiftPlan:
    """Report that robot and lifter cannot carry the weight in any pose: a proof.

    If `explained`, it says what would be enough; that takes balances of its own.
    """
    sloping = " (pull, and friction of its pad on a slope)" if capacity.cup > sampling.stated.cup.max_force else ""
    borne = _borne_beyond_limits(sampling.scene, capacity)
    less = "" if borne is None else f"; {_limits_told(sampling.scene, borne)}"
    cause = Rejection(
        CAPACITY,
        f"The plate is too heavy: the cup can carry at most {capacity.cup:.1f} N{sloping}, the gripper "
        f"{capacity.gripper:.1f} N and the stick {capacity.pusher:.1f} N of its weight{less}",
        needed=capacity.needed,
        available=capacity.available,
        unit="N",
    )
    most, weight = told_apart(capacity.available, capacity.needed, 1, "f")
    summary = f"Robot and vacuum lifter together can carry at most {most} N; the plate weighs {weight} N."
    if explained and borne is not None and capacity.cup + sum(borne) >= capacity.needed:
        summary += f" {_with_all_that_arms_bear(sampling, borne)}"
    return _unsearched(sampling, rejections, PlanningOutcome.INFEASIBLE, cause, summary)


def _borne_beyond_limits(scene: PlateLiftScene, capacity: LiftCapacity) -> tuple[float, float] | None:
    """Return what the arms' payloads leave gripper and stick [N]; None where the task allows no less than that."""
    gripper, pusher = payload_forces(scene.cell)
    return (gripper, pusher) if capacity.gripper < gripper or capacity.pusher < pusher else None


def _with_all_that_arms_bear(sampling: LiftSampling, borne: tuple[float, float]) -> str:
    """Say whether forces hold the plate in the air once the task allows what the arms bear, and what else it takes.

    It may be that no way leads there all the same: that is not looked at.
    """
    scene, told = sampling.scene, _limits_told(sampling.scene, borne)
    asked, most = scene.hand_force_limit, float(math.ceil(max(borne)))
    limit = asked.model_copy(update={"normal": max(asked.normal, most), "net": max(asked.net, most)})
    granted = replace(scene, hand_force_limit=limit)
    lacking = _least_cup_force(sampling.with_limits(granted))
    if lacking == 0.0:
        enough = "with all of that, forces hold the plate as stated, if the arms get it there"
        return f"The task's limit is short: {told}; {enough}."
    if lacking is not None:
        force = math.ceil(10.0 * (scene.cup.max_force + lacking)) / 10.0
        stronger = replace(granted, cup=replace(scene.cup, max_force=force))
        if _least_cup_force(sampling.with_limits(stronger)) == 0.0:
            cup = f"the cup pulls with {force:g} N as well, instead of {scene.cup.max_force:g} N"
            enough = f"with all of that, forces hold it as stated if {cup}"
            return f"The task's limit is short, and not alone: {told}; {enough}."
    return f"The task's limit is short, and not alone: {told}; with all of that, no forces were found that hold it."


def _least_cup_force(sampling: LiftSampling) -> float | None:
    """Return how much more a cup has to pull for some grip and push to hold the plate as stated off its support [N].

    0: they do. None: no force was found to be enough.
    """
    balance, least = sampling.balance(0.0, tolerances=False), None
    # One of each pose after the other: what one answer proves rules out many others.
    for pose in islice(cycle(sampling.poses.goals), _MOST_ASKED):
        left = np.argwhere(~balance.ruled_out[pose, 1:, 1:])
        if not len(left):
            continue
        grip, push = (int(number) for number in left[len(left) // 2])
        if isinstance(balance.at(pose, (grip, push)), Balanced):
            return 0.0
        balance.ruled_out[pose, 1 + grip, 1 + push] = True
        where = sampling.poses.poses[pose]
        more = least_force(balance.program(where.T_world_plate, where.contact_points, (grip, push)))
        if more is not None:
            least = more if least is None else min(least, more)
    return least


def _limits_told(scene: PlateLiftScene, borne: tuple[float, float]) -> str:
    """Say which limits of the task, stated or not, are less than what the arms bear beside gripper and stick [N]."""
    asked, default = scene.hand_force_limit, HandForceLimit()
    members = {"normal": (asked.normal, default.normal), "net": (asked.net, default.net)}
    short = {name: values for name, values in members.items() if values[0] < max(borne)}
    allowed = " and ".join(f"{value:g} N ({name})" for name, (value, _) in short.items())
    unstated = ", the default," if all(value == usual for value, usual in short.values()) else ""
    return (
        f"hand_force_limit allows {allowed}{unstated} where the arms bear {borne[0]:.1f} N beside the gripper and "
        f"{borne[1]:.1f} N beside the stick"
    )


def too_thick(sampling: LiftSampling, rejections: Rejections) -> LiftPlan:
    """Report that the gripper does not open for the plate in any direction: a proof, as plans end gripped."""
    width, thickness = jaw_of(sampling.workcell).width_max, sampling.prism.height
    reason = "The gripper does not open wide enough for the plate"
    cause = Rejection(CAPACITY, reason, needed=thickness, available=width, unit="m")
    summary = (
        f"The plate is {1e3 * thickness:.1f} mm thick; the gripper opens {1e3 * width:.1f} mm, "
        "and it cannot be gripped from side to side either."
    )
    return _unsearched(sampling, rejections, PlanningOutcome.INFEASIBLE, cause, summary)


def out_of_hands(sampling: LiftSampling, rejections: Rejections, beyond: OutOfReach) -> LiftPlan:
    """Report that neither hand reaches the plate where it lies: a proof, as only hands can move it first."""
    reason = "Neither hand reaches the plate where it lies"
    cause = Rejection("reach", reason, "plate", beyond.needed, beyond.available, "m")
    summary = (
        f"The plate's origin is {beyond.needed:.2f} m from the nearer shoulder; arm and hand, stretched out, reach "
        f"its nearest point up to {beyond.available:.2f} m."
    )
    return _unsearched(sampling, rejections, PlanningOutcome.INFEASIBLE, cause, summary)


def too_large(sampling: LiftSampling, rejections: Rejections, edges: int) -> LiftPlan:
    """Report that the graph would not fit into memory: nothing was searched."""
    limit = sampling.settings.largest_graph
    reason = "The graph of all poses and holds is too large"
    cause = Rejection("sampling", reason, needed=edges, available=limit, unit="edges")
    summary = (
        f"The graph would have {edges} edges, and {limit} fit into memory, which leaves too few poses and holds: "
        "simplify the plate's outline."
    )
    return _unsearched(sampling, rejections, PlanningOutcome.NOT_FOUND, cause, summary)


def _unsearched(
    sampling: LiftSampling, rejections: Rejections, outcome: PlanningOutcome, cause: Rejection, summary: str
) -> LiftPlan:
    """Report what is told before anything is searched."""
    rejections.add(cause)
    return LiftPlan(outcome, summary, (cause,), rejections, sampling.figures())


def _reserved(search: LiftSearch, segments: tuple[LiftSegment, ...]) -> ReservedSegments:
    """Take forces that are as far from their limits as can be, unless the least effort is what was asked for."""
    torques = LiftTorques(search.sampling.workcell)

    def bearable(segment: LiftSegment, each: BalancedContacts) -> bool:
        where = segment.trajectory, each.sample, segment.T_world_body[each.sample]
        return search.settings.minimise != "force" and torques.refusal(*where, each.balance) is None

    return keeping_most(segments, search.sampling.stated, search.balance.reserve, bearable)


def _step(search: LiftSearch, node: int) -> SequenceStep:
    pose = int(search.graph.node_pose[node])
    return SequenceStep(
        pose,
        search.sampling.poses.poses[pose].contact.name,
        hands_of(*search.graph.hold_of(node)),
        search.examiner.largest_force(node),
    )


def _graph_figures(search: LiftSearch) -> dict[str, int | Mapping[str, Mapping[str, int]]]:
    """Return the sizes of what was built, at last by contact state."""
    graph, status = search.graph, search.graph.knowledge.status
    return {
        **search.sampling.figures(),
        "nodes": graph.graph.node_count,
        "edges": graph.graph.edge_count,
        "alive": int((status == ALIVE).sum()),
        "dead": int((status == DEAD).sum()),
        "unexamined": int((status == UNKNOWN).sum()),
        "starts": len(graph.starts),
        "goals": int((graph.goal & (status == ALIVE)).sum()),
        "contact_states": _figures_by_contact(search),
    }


def _figures_by_contact(search: LiftSearch) -> dict[str, dict[str, int]]:
    graph, status = search.graph, search.graph.knowledge.status
    contact_of_pose = [pose.contact.name for pose in search.sampling.poses.poses]
    contacts = list(dict.fromkeys(contact_of_pose))
    number_of_pose = np.array([contacts.index(contact) for contact in contact_of_pose], dtype=np.intp)
    number_of_node = number_of_pose[graph.node_pose]

    def counts(numbers: NDArray[np.intp]) -> NDArray[np.intp]:
        """How often (contacts,) each contact is among numbers (n,)."""
        return np.bincount(numbers, minlength=len(contacts))

    columns = {
        "poses": counts(number_of_pose),
        "nodes": counts(number_of_node),
        "alive": counts(number_of_node[status == ALIVE]),
        "dead": counts(number_of_node[status == DEAD]),
    }
    return {
        contact: {name: int(column[number]) for name, column in columns.items()}
        for number, contact in enumerate(contacts)
    }


def _search_figures(search: LiftSearch, path: GraphPath | None, contact_changes: int) -> dict[str, int | float | None]:
    """Return what the search did and found."""
    force = search.examiner.largest_force
    return {
        **{name: search.record.counts[name] for name in ("searches", "sequences", "assignments", "splits")},
        "examined": search.examiner.examined,
        "balances_solved": search.balance.solved,
        "motion_queries": search.choreographer.free.searches,
        "length": None if path is None else len(path.nodes),
        "cost": None if path is None else path.cost,
        "contact_changes": contact_changes,
        "max_force": None if path is None else max(map(force, path.nodes)),
    }
