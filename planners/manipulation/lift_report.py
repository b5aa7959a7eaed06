"""Put what became of a plate lift into words and figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import groupby, pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planners.balance.capacity import LiftCapacity
from planners.graph.rejections import Rejection
from planners.graph.search import ALIVE, DEAD, UNKNOWN, GraphPath
from planners.manipulation.graph.node_examiner import hands_of
from planners.manipulation.groundwork import jaw_of
from planners.manipulation.impasse import contact_name, find_impasse
from planners.manipulation.lift_plan import LiftOutcome, LiftPlan, SequenceStep
from planners.manipulation.statics.lift_torques import LiftTorques
from planners.manipulation.statics.reserves import ReservedSegments, keeping_most
from planners.scene.arm_span import OutOfReach
from planners.segment import ContactSet, Segment

if TYPE_CHECKING:
    from planners.manipulation.planner import PlateLiftPlanner


class LiftReport:
    """Reads a planner's state; changes nothing of it but the tally of rejections."""

    def __init__(self, lift: PlateLiftPlanner) -> None:
        self._lift = lift

    def solved(self, path: GraphPath, segments: tuple[Segment, ...]) -> LiftPlan:
        """Report a sequence that was found and choreographed."""
        steps = tuple(self._step(node) for node in path.nodes)
        changes = sum(a.contact != b.contact for a, b in pairwise(steps))
        # What happens between the nodes counts too: their contacts and forces are not all there is.
        contacts = [word for word, _ in groupby(contact_name(segment.contact) for segment in segments)]
        reserved = self._reserved(segments)
        sets = (each.balance for segment in reserved.segments for each in segment.contact_sets)
        force = max(balance.f_plus_gp for balance in sets)
        summary = f"The plate is lifted over {' - '.join(contacts)}; no hand bears more than {force:.1f} N."
        return LiftPlan(
            LiftOutcome.SOLVED, reserved.segments, steps, (), summary, self._lift.rejections, self.graph_figures(),
            self.search_figures(path, changes), reserved,
        )  # fmt: skip

    def _reserved(self, segments: tuple[Segment, ...]) -> ReservedSegments:
        """Take forces that are as far from their limits as can be, unless the least effort is what was asked for."""
        lift, torques = self._lift, LiftTorques(self._lift.workcell)

        def bearable(segment: Segment, each: ContactSet) -> bool:
            where = segment.trajectory, each.sample, segment.T_world_body[each.sample]
            return lift.settings.minimise != "force" and torques.refusal(*where, each.balance) is None

        return keeping_most(segments, lift.stated, lift.reserve, bearable)

    def _step(self, node: int) -> SequenceStep:
        pose = self._lift.poses.poses[int(self._lift.graph.node_pose[node])]
        return SequenceStep(
            int(self._lift.graph.node_pose[node]),
            contact_name(pose.contact),
            hands_of(*self._lift.graph.hold_of(node)),
            self._lift.examiner.largest_force(node),
        )

    def too_heavy(self, capacity: LiftCapacity) -> LiftPlan:
        """Report that robot and lifter cannot carry the weight in any pose: a proof."""
        cause = Rejection(
            "capacity",
            f"The plate is too heavy: the cup can carry at most {capacity.cup:.1f} N, the gripper "
            f"{capacity.gripper:.1f} N and the stick {capacity.pusher:.1f} N of its weight",
            needed=capacity.needed,
            available=capacity.available,
            unit="N",
        )
        self._lift.rejections.add(cause)
        summary = (
            f"Robot and vacuum lifter together can carry at most {capacity.available:.1f} N; "
            f"the plate weighs {capacity.needed:.1f} N."
        )
        return LiftPlan(
            LiftOutcome.INFEASIBLE, (), (), (cause,), summary, self._lift.rejections, self._sampling_figures(), {}
        )

    def too_thick(self) -> LiftPlan:
        """Report that the gripper does not open for the plate in any direction: a proof, as plans end gripped."""
        width = jaw_of(self._lift.workcell).width_max
        reason = "The gripper does not open wide enough for the plate"
        thickness = self._lift.prism.height
        cause = Rejection("capacity", reason, needed=thickness, available=width, unit="m")
        self._lift.rejections.add(cause)
        summary = (
            f"The plate is {1e3 * thickness:.1f} mm thick; the gripper opens {1e3 * width:.1f} mm, "
            "and it cannot be gripped from side to side either."
        )
        return LiftPlan(
            LiftOutcome.INFEASIBLE, (), (), (cause,), summary, self._lift.rejections, self._sampling_figures(), {}
        )

    def out_of_reach(self, beyond: OutOfReach) -> LiftPlan:
        """Report that neither hand reaches the plate where it lies: a proof, as only hands can move it first."""
        reason = "Neither hand reaches the plate where it lies"
        cause = Rejection("reach", reason, "plate", beyond.needed, beyond.available, "m")
        self._lift.rejections.add(cause)
        summary = (
            f"The plate's origin is {beyond.needed:.2f} m from the nearer shoulder; arm and hand, stretched out, reach "
            f"its nearest point up to {beyond.available:.2f} m."
        )
        return LiftPlan(
            LiftOutcome.INFEASIBLE, (), (), (cause,), summary, self._lift.rejections, self._sampling_figures(), {}
        )

    def too_large(self, edges: int) -> LiftPlan:
        """Report that the graph would not fit into memory: nothing was searched."""
        limit = self._lift.settings.largest_graph
        reason = "The graph of all poses and holds is too large"
        cause = Rejection("sampling", reason, needed=edges, available=limit, unit="edges")
        self._lift.rejections.add(cause)
        summary = (
            f"The graph would have {edges} edges, and {limit} fit into memory: lower contact_density or hold_density, "
            "or simplify the plate's outline."
        )
        return LiftPlan(
            LiftOutcome.NOT_FOUND, (), (), (cause,), summary, self._lift.rejections, self._sampling_figures(), {}
        )

    def no_path(self) -> LiftPlan:
        """Say why nothing was found."""
        impasse = find_impasse(self._lift)
        return self.not_found(impasse.summary, impasse.causes)

    def not_found(self, summary: str, main: tuple[Rejection, ...] = ()) -> LiftPlan:
        """Report that nothing was found among the poses and holds that were tried.

        The main causes come first, then what failed most often on the way.
        """
        told = {cause.reason for cause in main}
        often = [
            replace(rejection, reason=f"{rejection.reason.rstrip('.')} ({count} times)")
            for rejection, count in self._lift.rejections.most_common(6)
            if rejection.reason not in told
        ]
        for cause in main:
            self._lift.rejections.add(cause)
        causes = (*main, *often)[:6]
        return LiftPlan(
            LiftOutcome.NOT_FOUND,
            (),
            (),
            causes,
            summary,
            self._lift.rejections,
            self.graph_figures(),
            self.search_figures(None, 0),
        )

    def _sampling_figures(self) -> dict[str, int]:
        return {
            "poses": len(self._lift.poses.poses),
            "pose_edges": len(self._lift.poses.edges),
            "grips": len(self._lift.grips),
            "pushes": len(self._lift.pushes),
        }

    def graph_figures(self) -> dict[str, int | Mapping[str, Mapping[str, int]]]:
        """Return the sizes of what was built, at last by contact state."""
        status = self._lift.graph.knowledge.status
        return {
            **self._sampling_figures(),
            "nodes": self._lift.graph.graph.node_count,
            "edges": self._lift.graph.graph.edge_count,
            "alive": int((status == ALIVE).sum()),
            "dead": int((status == DEAD).sum()),
            "unexamined": int((status == UNKNOWN).sum()),
            "starts": len(self._lift.graph.starts),
            "goals": int((self._lift.graph.goal & (status == ALIVE)).sum()),
            "contact_states": self._figures_by_contact(),
        }

    def _figures_by_contact(self) -> dict[str, dict[str, int]]:
        graph, status = self._lift.graph, self._lift.graph.knowledge.status
        contact_of_pose = [contact_name(pose.contact) for pose in self._lift.poses.poses]
        contacts = list(dict.fromkeys(contact_of_pose))
        number_of_pose = np.array([contacts.index(contact) for contact in contact_of_pose], dtype=np.intp)
        number_of_node = number_of_pose[graph.node_pose]

        def counts(numbers: NDArray[np.intp]) -> NDArray[np.intp]:
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

    def search_figures(self, path: GraphPath | None, contact_changes: int) -> dict[str, int | float | None]:
        """Return what the search did and found."""
        return {
            **{name: self._lift.counts[name] for name in ("searches", "sequences", "assignments", "splits")},
            "examined": self._lift.examiner.examined,
            "balances_solved": self._lift.balance.solved,
            "motion_queries": self._lift.choreographer.motion_queries,
            "length": None if path is None else len(path.nodes),
            "cost": None if path is None else path.cost,
            "contact_changes": contact_changes,
            "max_force": None if path is None else max(map(self._lift.examiner.largest_force, path.nodes)),
        }
