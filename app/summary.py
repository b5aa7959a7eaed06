"""What a person wants to know of a plan first: what happens, or why there is no plan, and by how much."""

from __future__ import annotations

import math
from itertools import groupby

import numpy as np

from planners.contract.task_spec import PlateLiftTask
from planners.geometry import polygon
from planners.geometry.pose import from_pose7
from planners.geometry.sides import told_side
from planners.graph.rejections import CAPACITY
from planners.plan.loads import largest_load
from planners.plan.plan import Plan
from planners.plan.segment import ContactState
from planners.plan.simulation import LiftSimulation, ToolSimulation, failure_of
from planners.plan.verdicts import Cause, LeastReserve, Remedy, shortage_words

PLANNING_STEPS = frozenset({"balance", CAPACITY, "clearance", "grasp", "reach", "transfer", "transit", "torque"})
"""Steps of planning, which a cause has as its place where it has no other: they tell nobody much."""
_ROUNDING = 1e-6
"""A share that is less than a tenth of a per cent by less counts as that tenth, in tenths [1]."""
MILLIMETRES = 1e3
"""In a metre: lengths are told as on drawings."""


def share_words(share: float) -> str:
    """Return a share of limits in per cent, to tenths and no more than there is, as in "7.5 %"."""
    return f"{math.floor(1e3 * share + _ROUNDING) / 10.0:g} %"


def reason_of(cause: Cause) -> str:
    """Return the reason, without a full stop: figures may follow."""
    return cause.reason.rstrip(".")


def figures_of(cause: Cause) -> str | None:
    """Return what was needed and what there was, or how much was missing; None without figures."""
    if cause.needed is None or cause.available is None:
        return None
    return shortage_words(cause.needed, cause.available, cause.unit)


def least_reserve(plan: Plan) -> tuple[LeastReserve, float] | None:
    """Return what a plan states of it, and the time [s] of that sample.

    None: nothing is held, or the plan is of before there was any.
    """
    least = plan.statistics.reserve
    return None if least is None else (least, float(plan.segments[least.segment].time[least.sample]))


def summarise(plan: Plan) -> str:
    """Return a few lines: outcome, what happens, largest force, times, checks, physics; or why there is no plan."""
    if plan.outcome != "solved":
        return _explain(plan)
    total, seconds = plan.statistics.total_seconds, dict(plan.statistics.times)
    certifying, simulating, changing = (seconds.get(stage, 0.0) for stage in ("certify", "simulate", "remedies"))
    force, arm = largest_load(plan)
    lines = {
        "outcome": "solved",
        **_happening(plan),
        **_cup_place(plan),
        "segments": f"{len(plan.segments)}, {plan.duration:.1f} s of motion",
        "largest force": f"{force:.1f} N ({arm} hand)" if arm else "no hand bears anything",
        **_reserve(plan),
        **_joint_torque(plan),
        "planning time": "not told" if total is None else f"{total - certifying - simulating - changing:.2f} s",
        "certificate": _certificate(plan, certifying),
        "simulation": _simulated(plan, simulating),
    }
    return "\n".join([*(f"{name + ':':<16}{text}" for name, text in lines.items()), *_remedies(plan)])


def outcome_line(plan: Plan) -> str:
    """Return the outcome in one line: what comes of it, or why there is no plan."""
    if plan.outcome != "solved":
        return f"{plan.outcome}: {plan.explanation.summary}"
    force, arm = largest_load(plan)
    bears = f", at most {force:.1f} N on the {arm} hand" if arm else ""
    certified = "certified" if is_certified(plan) else "not certified"
    failure, remedies = failure_of(plan.simulation), plan.explanation.remedies
    physics = "" if failure is None else f"; in physics it FAILED: {failure.words()}"
    helps = f". What helps: {remedies[0].sentence}" if failure is not None and remedies else ""
    return f"solved: {len(plan.segments)} segments, {plan.duration:.1f} s of motion{bears}, {certified}{physics}{helps}"


def is_certified(plan: Plan) -> bool:
    """Tell whether something was planned, and a certificate of it passed."""
    return plan.outcome == "solved" and plan.certificate is not None and plan.certificate.passed


def _certificate(plan: Plan, seconds: float) -> str:
    """Return what the second opinion was asked, how it went, and how long it took."""
    if plan.certificate is None:
        return "none, not certified" if plan.outcome == "solved" else "none, nothing to certify: no plan"
    verdict = "passed" if plan.certificate.passed else "FAILED"
    # Without a plan nothing is approved but the proof that there is none.
    asked = "" if plan.outcome == "solved" else " of the proof that no plan exists"
    return f"{verdict}, {len(plan.certificate.checks)} checks{asked} in {seconds:.2f} s"


def _reserve(plan: Plan) -> dict[str, str]:
    """Return how much of the force limits is kept back where least is, of what, and when; nothing without a figure."""
    found = least_reserve(plan)
    if found is None:
        return {}
    least, time = found
    asked = plan.task.options.reserve
    less = f"; the most that was found, {share_words(asked)} was asked for" if least.value < asked else ""
    return {"reserve": f"{share_words(least.value)} ({least.limited_by}, {time:.1f} s){less}"}


def least_torque(plan: Plan) -> tuple[float, str] | None:
    """Return what is left of a joint's largest torque where that is least, as a share of it [1], and where.

    None: the certificate does not tell, or there is none.
    """
    checks = () if plan.certificate is None else plan.certificate.checks
    told = ((check.share_left, str(check.where)) for check in checks if check.share_left is not None)
    return next(told, None)


def _joint_torque(plan: Plan) -> dict[str, str]:
    found = least_torque(plan)
    return {} if found is None else {"joint torque": f"{remaining_torque(found[0])} ({found[1]})"}


def remaining_torque(share: float) -> str:
    """Say what share of a joint's largest torque remains [1]; the word "left" is one for arms."""
    return f"{share_words(share)} of the limit remains"


def _cup_place(plan: Plan) -> dict[str, str]:
    """Return where the cup sits, and why there, where the task left that open."""
    chosen = plan.explanation.cup_place
    return {} if chosen is None else {"cup": chosen.sentence}


def _happening(plan: Plan) -> dict[str, str]:
    """Return what the plan does: the contact states of a plate, or which objects are moved how."""
    states = contact_states(plan)
    return {"contact states": " > ".join(states), **_sides(plan)} if states else {"moved": plan.explanation.summary}


def _simulated(plan: Plan, seconds: float) -> str:
    """Return how the plan fared in physics, and how long that took to find out."""
    simulation = plan.simulation
    match simulation:
        case None:
            return "not yet" if plan.task.options.simulate else "none, options.simulate is false"
        case LiftSimulation(outcome="lifted", lift=lift):
            height = "" if lift is None else f", {MILLIMETRES * lift.height:.0f} mm"
            return f"lifted{height}, in {seconds:.1f} s"
        case ToolSimulation(outcome="done"):
            return f"done, in {seconds:.1f} s"
        case _:
            failure = failure_of(simulation)
            return "lifted" if failure is None else f"FAILED: {failure.words()}"


def contact_states(plan: Plan) -> list[str]:
    """Return the contact states a plan goes through, in words, each once in a row."""
    states = (segment.contact_state for segment in plan.segments)
    words = (contact_word(state) for state in states if state is not None)
    return [word for word, _ in groupby(words)]


def _sides(plan: Plan) -> dict[str, str]:
    """Return where the edges and vertices are that a plate is turned over, as it lies at the start."""
    task = plan.task
    if not isinstance(task, PlateLiftTask):
        return {}
    shape, R_world_plate = task.plate.shape, from_pose7(task.plate_pose)[:3, :3]
    outline = polygon.rectangle(*shape.size[:2]) if shape.type == "box" else np.array(shape.outline)
    touching = {
        (state.element, state.index): None for segment in plan.segments if (state := segment.contact_state) is not None
    }
    told = [
        f"{element} {index} is {told_side(outline, R_world_plate, element, index)}"
        for element, index in touching
        if index is not None and (element == "edge" or element == "vertex")
    ]
    return {"sides": "; ".join(told)} if told else {}


def contact_word(state: ContactState) -> str:
    """Return one contact state of a plan in words."""
    if state.element == "none":
        return "no contact"
    index, body = state.index, state.with_
    return state.element + ("" if index is None else f" {index}") + ("" if body is None else f" on {body}")


def _explain(plan: Plan) -> str:
    lines = [f"{'outcome:':<16}{plan.outcome}", f"{'why:':<16}{plan.explanation.summary}"]
    lines += [f"{'':<16}- {_cause(cause)}" for cause in plan.explanation.causes]
    lines += _remedies(plan)
    seconds = dict(plan.statistics.times).get("certify", 0.0)
    lines.append(f"{'certificate:':<16}{_certificate(plan, seconds)}")
    return "\n".join(lines)


def _remedies(plan: Plan) -> list[str]:
    """Return what helps where there is no plan or physics fails, a line each, numbered as `--apply` takes them."""
    remedies = plan.explanation.remedies
    if remedies is None:
        return []
    if not remedies:
        return [f"{'what helps:':<16}none of the changes that were tried"]
    heads = ("what helps:", *[""] * len(remedies))
    return [
        f"{head:<16}{number}. {remedy.sentence} Then: {_came_of(remedy, plan.task.options.reserve)}."
        for number, (head, remedy) in enumerate(zip(heads, remedies, strict=False), start=1)
    ]


def _came_of(remedy: Remedy, asked: float) -> str:
    """Return what came of planning the changed task, of which such a share of every limit is asked for [1]."""
    force = "" if remedy.largest_force is None else f", at most {remedy.largest_force:.1f} N on a hand"
    kept = "" if remedy.reserve is None else f", {share_words(remedy.reserve)} of every limit kept back"
    if is_less_than_asked(remedy, asked):
        kept += f", where {share_words(asked)} is asked for"
    done = ", carried out in physics" if remedy.simulated else ""
    return f"{remedy.outcome}{' and certified' if remedy.certified else ''}{kept}{force}{done}"


def is_less_than_asked(remedy: Remedy, asked: float) -> bool:
    """Tell whether less is kept back than such a share [1]; a remedy that changes what is asked for says so itself."""
    return remedy.reserve is not None and remedy.reserve < asked and remedy.kind != "reserve"


def _cause(cause: Cause) -> str:
    figures, where = figures_of(cause), "" if cause.where in PLANNING_STEPS else cause.where
    return reason_of(cause) + (f": {figures}" if figures else "") + (f" ({where})" if where else "")
