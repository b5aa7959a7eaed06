"""Curves beside the scene: lines over a common time, of the plan and of its simulation, for tasks of both kinds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from planners.contract.arrays import Rows
from planners.contract.strict_model import StrictModel
from planners.contract.task_spec import PlateLiftTask, SuctionToolTask
from planners.geometry.pose import Array
from planners.plan.contacts import BearingContact, SuctionContact
from planners.plan.plan import Plan
from planners.plan.simulation import LiftSimulation, Simulation, ToolSimulation
from planners.plan.timeline import ContactSet
from planners.regrasp.suction.suction_hold import suction_margin
from planners.scene.suction_tool import TOOL_NAME, CupData
from workers.robot.execution_log import ExecutedMotion

DIGITS = 4
"""Of times and values, behind the point: a thousandth of what can be seen."""
MILLIMETRES = 1e3
MILLIRADIANS = 1e3
PERCENT = 100.0
MINIMUM = "min. m g \u2212 f_cup"
HANDS, CUP, CUP_USE = "Hands, vertical force", "Vacuum cup", "Suction cup, used of what it bears"
Values = Annotated[Array, Rows(None, digits=DIGITS, gaps=True)]
Spans = Annotated[Array, Rows(2, digits=DIGITS)]
"""Rows [begin, end] of stretches of time [s]."""
NO_SPANS = np.empty((0, 2))


class Series(StrictModel):
    """One line of a chart."""

    name: str
    colour: str
    """A meaning of the palette."""
    values: Values
    """(n,) at the chart's times; nan where there is nothing to draw."""
    dashed: bool = False


class Chart(StrictModel):
    """Lines over a common time."""

    title: str
    unit: str
    time: Values
    """(n,) [s]; two values at one time where two segments meet."""
    series: list[Series]
    marked: Spans = NO_SPANS
    """When something is not as it should be."""


def planned_charts(plan: Plan) -> list[Chart]:
    """Return what hands and cup bear, the reserve, and joint speeds; nothing without segments."""
    if not plan.segments:
        return []
    sets = plan.timeline.contact_sets
    if isinstance(plan.task, PlateLiftTask):
        forces = [_lifting_hands(plan, plan.task, sets), _cup_load(sets)] if sets else []
    else:
        forces = [_cup_use(plan), _finger_forces(plan, plan.task, sets)] if sets else []
    return [chart for chart in (*forces, _reserve(plan), _speeds(plan)) if chart is not None]


def simulated_charts(plan: Plan) -> list[Chart]:
    """Return what hands, cup and lifter or tool did; nothing without a simulation that came to its first sample."""
    simulation = plan.simulation
    if simulation is None or not _has_curves(simulation):
        return []
    task = plan.task
    if isinstance(simulation, LiftSimulation) and isinstance(task, PlateLiftTask):
        return _simulated_lift(plan, task, simulation)
    return _simulated_tool_use(plan)


def executed_charts(plan: Plan, executed: ExecutedMotion) -> list[Chart]:
    """Return how far each arm was off the plan, and the force at its wrist; behind a lifter there is no plan."""
    planned = np.array([plan.at(time).positions for time in executed.clock])
    off = MILLIRADIANS * np.abs(executed.positions - planned)
    if isinstance(plan.task, PlateLiftTask):
        off[executed.clock >= plan.duration] = np.nan
    arms = list(plan.cell.arms)
    return [
        Chart(
            title="Farthest joint off the plan",
            unit="mrad",
            time=executed.time,
            series=[_line(arm, arm, off[:, 6 * i : 6 * i + 6].max(axis=1)) for i, arm in enumerate(arms)],
        ),
        Chart(
            title="Force at the wrist",
            unit="N",
            time=executed.time,
            series=[_line(arm, arm, executed.force[:, i]) for i, arm in enumerate(arms)],
        ),
    ]


def marked_spans(simulation: Simulation) -> Array:
    """Return when (k, 2) something was not as it should be [s].

    In a lift: both hands together bore less than the minimum; with a tool: the cup was asked for more than it bears.
    """
    if not _has_curves(simulation):
        return NO_SPANS
    time, curves = _curves(simulation)
    if isinstance(simulation, ToolSimulation):
        return spans(time, curves["suction share"] > 1.0)
    least, lift = simulation.minimum_total_force, simulation.lift
    if least is None or lift is None:
        return NO_SPANS
    return spans(time, (curves["both hands"] < least) & (time >= lift.begin))


def spans(time: Array, which: NDArray[np.bool_]) -> Array:
    """Return the stretches (k, 2) in which something holds; one ends with the first sample at which it no longer does.

    Args:
        time: (n,) [s].
        which: (n,) whether it holds.
    """
    borders = np.flatnonzero(np.diff(np.concatenate([[False], which, [False]]).astype(int)))
    return time[np.minimum(borders, len(time) - 1)].reshape(-1, 2)


def _has_curves(simulation: Simulation) -> bool:
    return any(len(curve.time) for curve in simulation.force_curves)


def _curves(simulation: Simulation) -> tuple[Array, dict[str, Array]]:
    """Return the common time of a simulation's curves and their values by name; of a simulation that has curves."""
    return simulation.force_curves[0].time, {curve.name: curve.value for curve in simulation.force_curves}


def _line(name: str, colour: str, values: Array) -> Series:
    return Series(name=name, colour=colour, values=values)


def _level(name: str, value: float, time: Array) -> Series:
    """Return a limit that stays."""
    return Series(name=name, colour="limit", values=np.full(len(time), value), dashed=True)


def _by_set(sets: Sequence[ContactSet], value: Callable[[tuple[BearingContact, ...]], float | None]) -> Array:
    """Return a value of each contact set (n,), nan where there is none."""
    found = (value(each.contacts) for each in sets)
    return np.array([np.nan if number is None else number for number in found])


def _times(sets: Sequence[ContactSet]) -> Array:
    return np.array([contact_set.time for contact_set in sets])


def _speeds(plan: Plan) -> Chart:
    """Return how fast the fastest joint of each arm turns, of its limit."""
    time = np.concatenate([segment.time for segment in plan.segments])
    speeds = np.abs(np.concatenate([segment.velocities for segment in plan.segments]))
    series = []
    for index, (arm, limits) in enumerate(plan.cell.arms.items()):
        of_limit = speeds[:, 6 * index : 6 * index + 6] / limits.velocity_max
        series.append(_line(arm, arm, PERCENT * of_limit.max(axis=1)))
    series.append(_level("limit", PERCENT, time))
    return Chart(title="Fastest joint, of its limit", unit="%", time=time, series=series)


def _reserve(plan: Plan) -> Chart | None:
    """Return which share of the force limits is kept back; None where no segment tells, as in documents of 0.1.0."""
    told = [(segment.time, segment.reserve) for segment in plan.segments if segment.reserve is not None]
    if not told:
        return None
    time = np.concatenate([times for times, _ in told])
    series = [_line("kept back", "reserve", PERCENT * np.concatenate([reserve for _, reserve in told]))]
    if "reserve" in plan.task.options.model_fields_set:
        series.append(_level("requested", PERCENT * plan.task.options.reserve, time))
    return Chart(title="Force reserve", unit="%", time=time, series=series)


def _lifting_hands(plan: Plan, task: PlateLiftTask, sets: Sequence[ContactSet]) -> Chart:
    time, arms = _times(sets), tuple(plan.cell.arms)
    lifts = {arm: _by_set(sets, lambda contacts, arm=arm: _lift(contacts, arm)) for arm in arms}
    series = [_line(arm, arm, values) for arm, values in lifts.items()]
    series.append(_line("both", "sum", np.sum(list(lifts.values()), axis=0)))
    # Once nothing else touches the plate, the hands bear at least m g - f_cup.
    minimum = task.plate.mass * float(np.linalg.norm(plan.cell.gravity)) - task.cup.max_force
    series.append(_level(MINIMUM, minimum, time))
    return Chart(title=HANDS, unit="N", time=time, series=series)


def _lift(contacts: Iterable[BearingContact], arm: str) -> float:
    return float(sum(contact.wrench[2] for contact in contacts if contact.by == arm))


def _cup_load(sets: Sequence[ContactSet]) -> Chart | None:
    pads = [next((each for each in found.contacts if isinstance(each, SuctionContact)), None) for found in sets]
    if not any(pads):
        return None
    load, limit = (
        np.array([np.nan if pad is None else getattr(pad, name) for pad in pads]) for name in ("suction_force", "limit")
    )
    series = [_line("load", "suction", load), Series(name="limit", colour="limit", values=limit, dashed=True)]
    return Chart(title=CUP, unit="N", time=_times(sets), series=series)


def _simulated_lift(plan: Plan, task: PlateLiftTask, simulation: LiftSimulation) -> list[Chart]:
    time, curves = _curves(simulation)
    gripping, pushing = (
        next(arm for arm, hand in plan.cell.hands.items() if hand.kind == kind) for kind in ("gripper", "stick")
    )
    hands = [
        _line(f"{pushing}, pushes", pushing, curves["pushing hand"]),
        _line(f"{gripping}, grips", gripping, curves["gripping hand"]),
        _line("both", "sum", curves["both hands"]),
    ]
    if simulation.minimum_total_force is not None:
        hands.append(_level(MINIMUM, simulation.minimum_total_force, time))
    cup = [_line("load", "suction", curves["suction load"]), _level("limit", task.cup.max_force, time)]
    rates = [
        _line("hands, commanded", "sum", MILLIMETRES * curves["commanded velocity"]),
        _line("lifter", "suction", MILLIMETRES * curves["lifter velocity"]),
    ]
    tilt = [_line("tilt", "environment", curves["plate tilt"])]
    return [
        Chart(title=HANDS, unit="N", time=time, series=hands, marked=marked_spans(simulation)),
        Chart(title=CUP, unit="N", time=time, series=cup),
        Chart(title="Lift, speed upward", unit="mm/s", time=time, series=rates),
        Chart(title="Plate, tilt", unit="\u00b0", time=time, series=tilt),
    ]


def cup_shares(plan: Plan) -> list[tuple[float, float]]:
    """Return time [s] and use of the cup [1], of what it bears, at every sample at which the tool holds an object."""
    return [
        (contact_set.time, _share(contact))
        for contact_set in plan.timeline.contact_sets
        for contact in contact_set.contacts
        if isinstance(contact, SuctionContact) and contact.by == TOOL_NAME
    ]


def _share(contact: SuctionContact) -> float:
    """Return how much a contact uses of what its cup bears, by the limit that is nearest [1]."""
    outward, x = -contact.normal, contact.x_axis
    axes = np.column_stack([x, np.cross(outward, x), outward])
    wrench = contact.wrench.reshape(2, 3) @ axes
    cup = CupData(contact.radius, contact.limit, contact.mu, contact.kappa)
    return 1.0 - float(suction_margin(wrench.reshape(6), cup))


def _cup_use(plan: Plan) -> Chart | None:
    shares = cup_shares(plan)
    if not shares:
        return None
    time = np.array([time for time, _ in shares])
    # A line breaks where nothing is on the cup: between two objects.
    values = PERCENT * np.array([share for _, share in shares])
    gap = np.flatnonzero(np.diff(time) > 1.0)
    time = np.insert(time, gap + 1, time[gap] + 1e-3)
    values = np.insert(values, gap + 1, np.nan)
    series = [_line("used", "suction", values), _level("limit", PERCENT, time)]
    return Chart(title=CUP_USE, unit="%", time=time, series=series)


def _finger_forces(plan: Plan, task: SuctionToolTask, sets: Sequence[ContactSet]) -> Chart:
    time = _times(sets)
    series = [
        _line(arm, arm, _by_set(sets, lambda contacts, arm=arm: _hardest(contacts, arm))) for arm in plan.cell.arms
    ]
    series.append(_level("limit", task.grip_force_limit, time))
    return Chart(title="Finger force", unit="N", time=time, series=series)


def _hardest(contacts: Iterable[BearingContact], arm: str) -> float | None:
    """Return the greater normal force of a hand's fingers; None where it holds nothing."""
    return max((float(each.wrench[:3] @ each.normal) for each in contacts if each.by == arm), default=None)


def _simulated_tool_use(plan: Plan) -> list[Chart]:
    assert plan.simulation is not None
    time, curves = _curves(plan.simulation)
    share = PERCENT * _while_held(curves["suction share"])
    cup = [_line("used", "suction", share), _level("limit", PERCENT, time)]
    squeezes = [_line(arm, arm, _while_held(curves[f"{arm} squeeze"])) for arm in plan.cell.arms]
    squeezes.append(_level("commanded", _commanded(plan), time))
    off = [
        _line("tool", "sum", MILLIMETRES * curves["tool off plan"]),
        _line("object", "suction", MILLIMETRES * curves["object off plan"]),
    ]
    return [
        Chart(title=CUP_USE, unit="%", time=time, series=cup, marked=marked_spans(plan.simulation)),
        Chart(title="Finger squeeze needed", unit="N", time=time, series=squeezes),
        Chart(title="Distance from the plan", unit="mm", time=time, series=off),
    ]


def _commanded(plan: Plan) -> float:
    """Return the squeeze of the plan's grips; of a document of before it was stated, the limit of a finger [N]."""
    assert isinstance(plan.task, SuctionToolTask)
    stated = (grip.squeeze for segment in plan.segments for grip in segment.grips[:1])
    return next((squeeze for squeeze in stated if squeeze is not None), plan.task.grip_force_limit)


def _while_held(values: Array) -> Array:
    """Return a curve with gaps where it is zero: nothing is held there."""
    return np.where(values == 0.0, np.nan, values)
