"""Put what became of a plate lift into words and figures."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from planners.balance.capacity import LiftCapacity
from planners.graph.rejections import Rejection
from planners.graph.search import ALIVE, DEAD, UNKNOWN, GraphPath
from planners.manipulation.contacts import PrincipalContact
from planners.manipulation.examiner import hands_of
from planners.manipulation.groundwork import jaw_of
from planners.manipulation.lift_plan import LiftOutcome, LiftPlan, SequenceStep
from planners.segment import Segment

if TYPE_CHECKING:
    from planners.manipulation.planner import PlateLiftPlanner


class LiftReport:
    """Reads a planner's state; changes nothing of it but the tally of rejections."""

    def __init__(self, lift: PlateLiftPlanner) -> None:
        self._lift = lift

    def solved(self, path: GraphPath, segments: tuple[Segment, ...]) -> LiftPlan:
        """Report a sequence that was found and choreographed."""
        steps = tuple(self._step(node) for node in path.nodes)
        contacts = [steps[0].contact]
        contacts += [b.contact for a, b in pairwise(steps) if a.contact != b.contact]
        force = max(step.force for step in steps)
        summary = f"The plate is lifted over {' - '.join(contacts)}; the hands bear at most {force:.2f} N on a contact."
        return LiftPlan(
            LiftOutcome.SOLVED, segments, steps, (), summary, self._lift.rejections, self.graph_figures(),
            self.search_figures(path, len(contacts) - 1),
        )  # fmt: skip

    def _step(self, node: int) -> SequenceStep:
        pose = self._lift.poses.poses[int(self._lift.graph.node_pose[node])]
        return SequenceStep(
            int(self._lift.graph.node_pose[node]),
            _contact_name(pose.contact),
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
            "and the plate is no narrower from side to side."
        )
        return LiftPlan(
            LiftOutcome.INFEASIBLE, (), (), (cause,), summary, self._lift.rejections, self._sampling_figures(), {}
        )

    def too_large(self, edges: int) -> LiftPlan:
        """Report that the graph would not fit into memory: nothing was searched."""
        limit = self._lift.settings.largest_graph
        cause = Rejection("sampling", "The graph of all poses and holds is too large", needed=edges, available=limit)
        self._lift.rejections.add(cause)
        summary = (
            f"The graph would have {edges} edges, and {limit} fit into memory: lower contact_density or hold_density, "
            "or simplify the plate's outline."
        )
        return LiftPlan(
            LiftOutcome.NOT_FOUND, (), (), (cause,), summary, self._lift.rejections, self._sampling_figures(), {}
        )

    def no_path(self) -> LiftPlan:
        """Say why nothing was found: which layer of the graph is empty, or what fell most."""
        alive = self._lift.graph.knowledge.status != DEAD
        starts = [n for n in self._lift.graph.starts if alive[n] and n not in self._lift.graph.lost_starts]
        if not self._lift.grips:
            summary = "The gripper finds no place to hold the plate: it is too small, or the cup is in the way."
        elif not starts:
            summary = "No hand can come to the plate where it rests."
            self._explain_starts()
        elif not (self._lift.graph.goal & alive).any():
            summary = "No grip and push together can hold the plate off its support."
        else:
            summary = f"No sequence of holds leads from the support into the air: {self._farthest()}."
        return self.not_found(summary)

    def _farthest(self) -> str:
        """Say how far the plate can be raised from rest, by the edges that are left."""
        reached = self._lift.graph.reachable()
        tilts = np.array([float(np.linalg.norm(pose.tilt)) for pose in self._lift.poses.poses])
        pose = self._lift.poses.poses[max(self._lift.graph.node_pose[reached], key=tilts.__getitem__)]
        tilt = math.degrees(float(np.linalg.norm(pose.tilt)))
        return f"it gets no farther than a tilt of {tilt:.0f}° ({_contact_name(pose.contact)})"

    def _explain_starts(self) -> None:
        """Count what keeps each hand off the plate at rest."""
        T_world_plate = self._lift.poses.poses[self._lift.poses.flat].T_world_plate
        for hand in (self._lift.pair.first, self._lift.pair.second):
            for reason, count in hand.hindrances(T_world_plate).items():
                self._lift.rejections.add(Rejection("reach", reason, where="the plate at rest"), count)

    def not_found(self, summary: str) -> LiftPlan:
        """Report that nothing was found among the poses and holds that were tried, with the most frequent reasons."""
        causes = tuple(
            replace(rejection, reason=f"{rejection.reason} ({count} times)")
            for rejection, count in self._lift.rejections.most_common(6)
        )
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

    def graph_figures(self) -> dict[str, int]:
        """Return the sizes of what was built."""
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


def _contact_name(contact: PrincipalContact) -> str:
    """Name a contact as reports do: "face", "edge 3", "vertex 0", "no contact"."""
    if contact.index is None:
        return "no contact"
    return "face" if contact.element == "face" else f"{contact.element} {contact.index}"
