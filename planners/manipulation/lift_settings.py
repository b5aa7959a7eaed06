"""Budgets and choices of a plate lift's planning."""

from __future__ import annotations

from dataclasses import dataclass, field

from planners.manipulation.costs import TransitionCost
from planners.manipulation.dense_contacts import ContactSampling
from planners.manipulation.examiner import Objective
from planners.manipulation.grips import GripSampling
from planners.manipulation.pushes import PushSampling


@dataclass(frozen=True)
class LiftSettings:
    """Budgets and choices of a plate lift's planning. Budgets count tries, never seconds."""

    minimise: Objective = "cost"
    """Eqs. (6), (9), (10), or the largest contact normal."""
    full: bool = False
    """Examine the whole graph before the search, as the paper does; the sequence found is the same."""
    sampling: ContactSampling = field(default_factory=ContactSampling)
    grips: GripSampling = field(default_factory=GripSampling)
    pushes: PushSampling = field(default_factory=PushSampling)
    costs: TransitionCost = field(default_factory=TransitionCost)
    rise_heights: tuple[float, ...] = (0.09, 0.18)
    """Over its end both hands must be able to carry the plate straight up, if that is possible at all; looked at
    there [m]. The cooperative lift goes on where the plan ends."""
    cup_reserve: float = 0.15
    """Part of the cup's largest force that the end of a plan does without, likewise [1]: while the plate is lifted,
    the lifter jerks."""
    assignments: int = 6
    """Choices of postures whose motion is tried before a sequence is given up."""
    sequences: int = 400
    """Sequences that are checked before the planner gives up."""
    largest_graph: int = 2_400_000
    """Edges of the graph that fit into 1 GiB of memory: denser samplings are not searched."""
    largest_split: int = 400_000
    """Nodes above which no hold is split by its postures: then an edge of the sequence is given up instead."""
