"""What a person wants to know of a plan document first: what happens, or why there is no plan, and by how much."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import groupby
from typing import Any

import numpy as np

from planners.plan.verdicts import LeastReserve

MILLIMETRES = 1e3
"""In a metre: lengths are told as on drawings."""


def reason_of(cause: Mapping[str, Any]) -> str:
    """Return the reason, without a full stop: figures may follow."""
    return str(cause["reason"]).rstrip(".")


def figures_of(cause: Mapping[str, Any]) -> str | None:
    """Return what was needed and what there was, or how much was missing; None without figures.

    Where nothing, or less than nothing, is said to be available, the figures are a shortfall: how far the nearest try
    was from a limit.
    """
    needed, available = cause["needed"], cause["available"]
    if needed is None or available is None:
        return None
    if available > 0.0:
        return f"needed {_measure(needed, cause['unit'])}, available {_measure(available, cause['unit'])}"
    return f"short by {_measure(needed - available, cause['unit'])}"


def _measure(value: float, unit: str | None) -> str:
    if unit == "m":
        value, unit = MILLIMETRES * value, "mm"
    return f"{value:.4g} {unit}" if unit else f"{value:.4g}"


def least_reserve(document: Mapping[str, Any]) -> tuple[LeastReserve, float] | None:
    """Return what a plan document states of it, and the time [s] of that sample.

    None: nothing is held, or the document is of before there was any.
    """
    stated = document["statistics"].get("reserve")
    if stated is None:
        return None
    least = LeastReserve.model_validate(stated)
    return least, document["segments"][least.segment]["time"][least.sample]


def summarise(document: Mapping[str, Any]) -> str:
    """Return a few lines: outcome, what happens, largest force, times, checks, physics; or why there is no plan."""
    if document["outcome"] != "solved":
        return _explain(document)
    total = document["statistics"]["total_seconds"]
    seconds = {stage["name"]: stage["seconds"] for stage in document["statistics"]["stages"]}
    certifying, simulating = seconds.get("certify", 0.0), seconds.get("simulate", 0.0)
    force, arm = largest_load(document)
    lines = {
        "outcome": "solved",
        **_happening(document),
        "segments": f"{len(document['segments'])}, {document['segments'][-1]['time'][-1]:.1f} s of motion",
        "largest force": f"{force:.1f} N ({arm} hand)" if arm else "no hand bears anything",
        **_reserve(document),
        "planning time": "not told" if total is None else f"{total - certifying - simulating:.2f} s",
        "certificate": _certificate(document, certifying),
        "simulation": _simulated(document["simulation"], simulating),
    }
    return "\n".join(f"{name + ':':<16}{text}" for name, text in lines.items())


def is_certified(document: Mapping[str, Any]) -> bool:
    """Tell whether a document has a plan, and a certificate that it passed."""
    certificate = document["certificate"]
    return document["outcome"] == "solved" and certificate is not None and certificate["passed"]


def _certificate(document: Mapping[str, Any], seconds: float) -> str:
    """Return how the second opinion went, and how long it took."""
    certificate = document["certificate"]
    if certificate is None:
        return "none, not certified" if document["outcome"] == "solved" else "none, nothing to certify: no plan"
    verdict = "passed" if certificate["passed"] else "FAILED"
    return f"{verdict}, {len(certificate['checks'])} checks in {seconds:.2f} s"


def _reserve(document: Mapping[str, Any]) -> dict[str, str]:
    """Return how much of the force limits is kept back where least is, of what, and when; nothing without a figure."""
    found = least_reserve(document)
    if found is None:
        return {}
    least, time = found
    return {"reserve": f"{least.value:.2f} ({least.limited_by}, {time:.1f} s)"}


def _happening(document: Mapping[str, Any]) -> dict[str, str]:
    """Return what the plan does: the contact states of a plate, or which objects are moved how."""
    states = contact_states(document)
    return {"contact states": " > ".join(states)} if states else {"moved": str(document["explanation"]["summary"])}


def _simulated(simulation: Mapping[str, Any] | None, seconds: float) -> str:
    """Return how the plan fared in physics, and how long that took to find out."""
    if simulation is None:
        return "none, options.simulate is false"
    match simulation["outcome"]:
        case "lifted":
            lift = simulation["lift"]
            height = "" if lift is None else f", {1e3 * lift['height']:.0f} mm"
            return f"lifted{height}, in {seconds:.1f} s"
        case "done":
            return f"done, in {seconds:.1f} s"
        case failure:
            when, cause = failure_of(simulation)
            return f"FAILED: {failure} at {when:.2f} s of motion: {cause}"


def failure_of(simulation: Mapping[str, Any]) -> tuple[float, str]:
    """Return when a simulation failed [s], and what gave way, without a full stop."""
    failed_at = simulation.get("failed_at")
    cause = simulation["cause"] or "it is not told what gave way"
    return simulation["time"] if failed_at is None else failed_at, cause.rstrip(".")


def contact_states(document: Mapping[str, Any]) -> list[str]:
    """Return the contact states a plan goes through, in words, each once in a row."""
    states = (segment["contact_state"] for segment in document["segments"])
    words = (contact_word(state) for state in states if state is not None)
    return [word for word, _ in groupby(words)]


def largest_load(document: Mapping[str, Any]) -> tuple[float, str]:
    """Return the most that a hand bears [N], and which arm's it is; without any, 0 N and no arm.

    Of a gripper it is the net force of both fingers, which its squeeze cancels in; of a stick its normal force.
    """
    return max(_loads(document), default=(0.0, ""))


def contact_word(state: Mapping[str, Any]) -> str:
    """Return one contact state of a plan document in words."""
    if state["element"] == "none":
        return "no contact"
    index, body = state["index"], state["with"]
    return state["element"] + ("" if index is None else f" {index}") + ("" if body is None else f" on {body}")


def _loads(document: Mapping[str, Any]) -> Iterator[tuple[float, str]]:
    for segment in document["segments"]:
        nets: dict[tuple[str, str, int], np.ndarray] = {}
        for contact in segment["contacts"]:
            arm, force = contact.get("by"), np.array(contact["wrench"][:3])
            if arm not in document["cell"]["arms"]:
                continue
            if contact["kind"] == "point":
                yield float(force @ contact["normal"]), arm
            else:
                key = arm, contact["body"], contact["sample"]
                nets[key] = nets.get(key, 0.0) + force
        for (arm, _, _), net in nets.items():
            yield float(np.linalg.norm(net)), arm


def _explain(document: Mapping[str, Any]) -> str:
    explanation = document["explanation"]
    lines = [f"{'outcome:':<16}{document['outcome']}", f"{'why:':<16}{explanation['summary']}"]
    lines += [f"{'':<16}- {_cause(cause)}" for cause in explanation.get("causes", ())]
    if document["certificate"] is None:
        lines.append(f"{'certificate:':<16}{_certificate(document, 0.0)}")
    return "\n".join(lines)


def _cause(cause: Mapping[str, Any]) -> str:
    figures, where = figures_of(cause), cause.get("where")
    return reason_of(cause) + (f": {figures}" if figures else "") + (f" ({where})" if where else "")
