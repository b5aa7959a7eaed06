"""Budgets and choices of a plate lift's planning."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from planners.cell.cell import Cell
from planners.cell.cell_size import resized
from planners.manipulation.contacts.dense_contact_states import ContactSampling
from planners.manipulation.graph.manipulation_graph import TransitionCost
from planners.manipulation.graph.node_examiner import Objective
from planners.manipulation.holds.grips import GripSampling
from planners.manipulation.holds.pushes import PushSampling


@dataclass(frozen=True)
class LiftSettings:
    """Budgets and choices of a plate lift's planning. Budgets count tries, never seconds."""

    minimise: Objective = "cost"
    """Eqs. (6), (9), (10), or the largest effort of a hand."""
    reserve: float = 0.1
    """Share of every limit that is kept back [1]."""
    most_reserve: bool = False
    """Look for the plan that keeps most back, whatever is asked for."""
    denser: tuple[tuple[float, float], ...] = ((1.0, 2.0), (2.0, 2.0), (3.0, 3.0))
    """What is tried where nothing is found: factors of the numbers of plate poses in contact, and of holds, rising [1].
    Of those, as many as fit into memory."""
    reserve_searches: int = 2
    """Searches for how much can be kept back."""
    reserve_step: float = 0.01
    """How finely that is looked for [1]."""
    largest_reserve: float = 0.6
    """No plan is looked for that keeps back more [1]."""
    full: bool = False
    """Examine the whole graph before the search, as the paper does; the sequence found is the same."""
    sampling: ContactSampling = field(default_factory=ContactSampling)
    grips: GripSampling = field(default_factory=GripSampling)
    pushes: PushSampling = field(default_factory=PushSampling)
    costs: TransitionCost = field(default_factory=TransitionCost)
    rises: tuple[tuple[float, ...], ...] = ((0.09, 0.18), (0.05,))
    """Over its end both hands must be able to carry the plate straight up: how high, as heights at which that is
    looked at [m], what is best first. Where no plan ends so, the next is asked for, and at last none. The cooperative
    lift goes on where the plan ends."""
    cup_reserve: float = 0.15
    """Part of the cup's largest force that the end of a plan does without, likewise [1]: while the plate is lifted,
    the lifter jerks."""
    assignments: int = 6
    """Choices of postures whose motion is tried before a sequence is given up."""
    sequences: int = 400
    """Sequences that are checked before the planner gives up."""
    stuck_pairs: int = 16
    """Holds of the other hand with which a hand may get stuck on its way to or from a hold, at one pose of the plate,
    before that is given up whatever the other hand does."""
    largest_graph: int = 2_400_000
    """Edges of the graph that fit into 1 GiB of memory: larger samplings are not searched, but thinned."""
    least_thinning: float = 0.25
    """Share of poses and holds that is left then at least [1]: with fewer, nothing can be said of a lift."""
    largest_split: int = 400_000
    """Nodes above which no hold is split by its postures: then an edge of the sequence is given up instead."""

    def in_cell(self, cell: Cell) -> LiftSettings:
        """Return settings for a cell of any size; here they are those of size 1.

        With lengths s times as long and masses s² times as large torques are s³ times as large, and weigh as much as
        before beside costs that have no unit.
        """
        size = cell.size
        grips = resized(
            self.grips, size, "depth", "palm_clearance", "rim_tolerance", "opening_clearance", "cup_clearance"
        )
        sampling = resized(self.sampling, size, "first_layer", "lifted_step")
        return replace(
            resized(self, size, "rises"), grips=grips, sampling=sampling, costs=resized(self.costs, size**-3.0, "load")
        )

    def scaled(self, contacts: float, holds: float) -> LiftSettings:
        """Return settings with so many times as many plate poses in contact, and grips and pushes."""
        return replace(
            self,
            sampling=self.sampling.scaled(contacts),
            grips=replace(self.grips, count=max(1, round(self.grips.count * holds))),
            pushes=replace(self.pushes, count=max(1, round(self.pushes.count * holds))),
        )
