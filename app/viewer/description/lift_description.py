"""What the page tells of a plate lift: the plate, its contact states, and the lift that follows the plan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.summary import contact_word
from app.viewer.description.charts import MILLIMETRES, PERCENT
from app.viewer.description.plan_description import (
    FigureGroup,
    KindDescription,
    NodeForces,
    Row,
    SegmentDescription,
    SimulationDescription,
    squeeze_words,
)
from planners.contract.task_spec import PlateLiftTask
from planners.plan.loads import largest_load
from planners.plan.segment import Segment, SegmentKind
from planners.plan.simulation import LiftSimulation, NodeComparison, SimulatedLift, failure_of

OUTCOMES = {"lifted": "lifted", "slipped": "slipped", "cup_lost": "cup lost", "overload": "overload"}
BEARERS = {"left": "left hand", "right": "right hand", "cup": "cup", "support": "support"}
"""Words for what bears the plate."""


class LiftDescription(KindDescription):
    """Of a plan that lifts a plate."""

    tabs = ("View", "Segments", "Lift", "Figures", "Rejected", "Checks")
    simulation_words = "Simulation with lift"
    meanings = ("left", "right", "environment", "suction", "sum", "limit", "start", "goal")

    @property
    def _simulation(self) -> LiftSimulation:
        assert isinstance(self.plan.simulation, LiftSimulation)
        return self.plan.simulation

    def subtitle(self) -> str:
        """Say what the plate is, and what the cup bears."""
        task = self.plan.task
        assert isinstance(task, PlateLiftTask)
        shape, what = task.plate.shape, "plate"
        if shape.type == "box":
            what = " \u00d7 ".join(f"{MILLIMETRES * length:.0f}" for length in shape.size) + " mm plate"
        return f"{task.plate.mass:g} kg {what}, cup of {task.cup.max_force:g} N"

    def segments(self) -> list[SegmentDescription]:
        """Return the plan's segments with their contact states."""
        return [
            SegmentDescription(
                kind=segment.kind,
                start=float(segment.time[0]),
                end=segment.end,
                words=_action(segment),
                state="" if segment.contact_state is None else contact_word(segment.contact_state),
                hold=_hold(segment),
            )
            for segment in self.plan.segments
        ]

    def highlights(self) -> list[Row]:
        """Return the most that a hand bears, and where the cup was put if the task left that open."""
        force, arm = largest_load(self.plan)
        rows = [("largest force", f"{force:.1f} N ({arm} hand)")]
        chosen = self.plan.explanation.cup_place
        if chosen is not None:
            x, y = (f"{1e3 * each:.0f}" for each in chosen.position)
            rows.append(("cup", f"at ({x}, {y}) mm, found"))
        return rows

    def after_the_plan(self) -> Sequence[tuple[str, float, float, str]]:
        """Return how the hands took up the load, and the lift."""
        end, lift = self._simulation.time, self._simulation.lift
        after = [("settle", self.plan.duration, end if lift is None else lift.begin, "Hands take up the load")]
        if lift is not None:
            after.append(("lift", lift.begin, end, "Hands follow the lifter"))
        return after

    def pages(self) -> Sequence[tuple[float, float]]:
        """Return the manipulation and the lift."""
        end, lift = self._simulation.time, self._simulation.lift
        return [(0.0, end)] if lift is None else [(0.0, lift.begin), (lift.begin, end)]

    def simulation(self) -> SimulationDescription:
        """Return how it ended, how the lift went, and how well it kept to the plan."""
        simulation = self._simulation
        return SimulationDescription(
            outcome=simulation.outcome,
            words=OUTCOMES[simulation.outcome],
            good=simulation.outcome == "lifted",
            sentence=_sentence(simulation),
            figures=_figures(simulation),
            nodes=[_node(node) for node in simulation.manipulation.nodes],
            model=simulation.model,
        )


def _action(segment: Segment) -> str:
    arms, one = " and ".join(segment.movers), len(segment.movers) == 1
    hand = f"{arms} hand" if one else "hands" if segment.movers else "hand"
    actions = {
        SegmentKind.TRANSIT: f"{hand} travels",
        SegmentKind.APPROACH: f"{hand} approaches",
        SegmentKind.RETREAT: f"{hand} retreats",
        SegmentKind.TRANSFER: f"plate moved by {arms} hand" if one else "plate moved by both hands",
        SegmentKind.GRIP: "fingers close",
        SegmentKind.RELEASE: "fingers open",
    }
    words = actions[segment.kind]
    return words[0].upper() + words[1:]


def _hold(segment: Segment) -> str:
    words = [f"gripped by {grip.arm}{squeeze_words([grip])}" for grip in segment.grips]
    words += [] if segment.push is None else [f"pushed by {segment.push.arm}"]
    return ", ".join(words) or "no hand on it"


def _sentence(simulation: LiftSimulation) -> str:
    lift, failure = simulation.lift, failure_of(simulation)
    if failure is None:
        return (
            "The plate was lifted." if lift is None else f"The plate was lifted by {MILLIMETRES * lift.height:.0f} mm."
        )
    time = failure.time
    when = f"{time:.2f} s" if lift is None else f"{time:.2f} s, {time - lift.begin:.2f} s into the lift"
    return f"At {when}: {failure.cause}."


def _figures(simulation: LiftSimulation) -> list[FigureGroup]:
    dips, kept = simulation.dips, simulation.manipulation
    groups = []
    if simulation.lift is not None:
        groups.append(FigureGroup(title="Lift", rows=_lift_rows(simulation.lift)))
        rows: list[Row] = [("dips", f"{dips.count}"), ("together", f"{dips.seconds:.2f} s")]
        if dips.lowest is not None:
            rows.append(("lowest sum", f"{dips.lowest:.1f} N"))
        if simulation.minimum_total_force is not None:
            rows.append(("minimum", f"{simulation.minimum_total_force:.1f} N"))
        groups.append(FigureGroup(title="Both hands below the minimum", rows=rows))
    rows = [
        ("largest force difference", f"{kept.largest_difference:.1f} N"),
        ("of the plate's weight", f"{PERCENT * kept.largest_difference_of_weight:.1f} %"),
        ("cup off its place, most", f"{MILLIMETRES * kept.largest_distance:.1f} mm"),
        ("plate turned, most", f"{np.degrees(kept.largest_angle):.1f}\u00b0"),
    ]
    return [*groups, FigureGroup(title="Manipulation against its plan", rows=rows)]


def _lift_rows(lift: SimulatedLift) -> list[Row]:
    return [
        ("height", f"{MILLIMETRES * lift.height:.0f} mm"),
        ("reachable", f"{MILLIMETRES * lift.reachable_height:.0f} mm"),
        ("F_goal, pushing hand", f"{lift.goal_force:.1f} N"),
        ("reserve kept on the cup", f"{PERCENT * lift.cup_reserve:.0f} %"),
        ("lifter's way", f"{MILLIMETRES * lift.lifter_travel:.0f} mm"),
        ("lifter's time", f"{lift.lifter_seconds:.1f} s"),
        ("hands follow by force", "yes" if lift.controlled else "no"),
    ]


def _node(node: NodeComparison) -> NodeForces:
    """Return the sizes of forces at the end of one motion, planned and simulated, by who exerts them."""
    forces = [
        (BEARERS[name], *(f"{np.linalg.norm(told[name]):.1f}" for told in (node.planned, node.simulated)))
        for name in node.planned
    ]
    return NodeForces(segment=node.segment, time=node.time, forces=forces)
