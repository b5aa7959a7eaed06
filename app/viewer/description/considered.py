"""What a suction-tool planner looked at, counted: places for the cup, grasps of the tool, and regrasp graphs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from app.viewer.drawing.considered_signs import asked_grasps, reason_colours, told_graph
from planners.contract.strict_model import StrictModel
from planners.contract.task_spec import SuctionToolTask
from planners.plan.considered import Considered, RegraspGraph
from planners.plan.plan import Plan

Tally = list[tuple[str | None, int]]
"""How often each reason was met; None: nothing was against it."""


class ReasonColour(StrictModel):
    """A reason why something fell, and the colour it is drawn in; None: it did not fall."""

    reason: str | None
    colour: str


class ConsideredObject(StrictModel):
    """What was considered for one object."""

    name: str
    places: Tally
    grasps: Tally
    held: bool
    """Whether the tool was in a hand already when its turn came."""
    graph: RegraspGraph | None


class ConsideredDescription(StrictModel):
    """What the page draws and counts."""

    grasps: int
    """How many the tool has."""
    colours: list[ReasonColour]
    objects: list[ConsideredObject]
    """Those that are moved first, in their order."""


def describe_considered(plan: Plan) -> ConsideredDescription | None:
    """Return what the page draws and counts; None where nothing was considered, as for a plate lift."""
    considered = plan.statistics.considered
    if considered is None:
        return None
    given = [item.name for item in plan.task.objects] if isinstance(plan.task, SuctionToolTask) else []
    return ConsideredDescription(
        grasps=len(considered.tool_grasps.widths),
        colours=[ReasonColour(reason=reason, colour=colour) for reason, colour in reason_colours(considered).items()],
        objects=[_object(considered, name) for name in dict.fromkeys([*considered.order, *given])],
    )


def _object(considered: Considered, name: str) -> ConsideredObject:
    return ConsideredObject(
        name=name,
        places=_tally(place.reason for place in considered.places.get(name, ())),
        grasps=_tally(node.reason for node in asked_grasps(considered, name)),
        held=any(step.object == name and step.by == "held" for step in considered.steps),
        graph=told_graph(considered, name),
    )


def _tally(reasons: Iterable[str | None]) -> Tally:
    """Return reasons with their numbers, what did not fall first, then the most frequent."""
    return sorted(Counter(reasons).items(), key=lambda item: (item[0] is not None, -item[1]))
