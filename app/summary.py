"""What a person wants to know of a plan document first."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import groupby
from typing import Any

import numpy as np

from app.cause_words import figures_of, reason_of


def summarise(document: Mapping[str, Any]) -> str:
    """Return a few lines: outcome, what happens, largest force, times, checks, physics; or why there is no plan."""
    if document["outcome"] != "solved":
        return _explain(document)
    checks = document["certificate"]["checks"]
    verdict = "passed" if document["certificate"]["passed"] else "FAILED"
    total = document["statistics"]["total_seconds"]
    seconds = {stage["name"]: stage["seconds"] for stage in document["statistics"]["stages"]}
    certifying, simulating = seconds.get("certify", 0.0), seconds.get("simulate", 0.0)
    force, where = largest_hand_force(document)
    lines = {
        "outcome": "solved",
        **_happening(document),
        "segments": f"{len(document['segments'])}, {document['segments'][-1]['time'][-1]:.1f} s of motion",
        "largest force": f"{force:.1f} N on one contact normal ({where})",
        "planning time": f"{total - certifying - simulating:.2f} s",
        "certificate": f"{verdict}, {len(checks)} checks in {certifying:.2f} s",
        "simulation": _simulated(document["simulation"], simulating),
    }
    return "\n".join(f"{name + ':':<16}{text}" for name, text in lines.items())


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
            return f"lifted, {1e3 * simulation['lift']['height']:.0f} mm, in {seconds:.1f} s"
        case "done":
            return f"done, in {seconds:.1f} s"
        case failure:
            when = simulation.get("failed_at", simulation["time"])
            return f"FAILED: {failure} at {when:.2f} s of motion: {simulation['cause']}"


def contact_states(document: Mapping[str, Any]) -> list[str]:
    """Return the contact states a plan goes through, in words, each once in a row."""
    states = (segment["contact_state"] for segment in document["segments"])
    words = (contact_word(state) for state in states if state is not None)
    return [word for word, _ in groupby(words)]


def largest_hand_force(document: Mapping[str, Any]) -> tuple[float, str]:
    """Return the largest force along the normal of one hand contact [N], and which arm it belongs to."""
    return max(_hand_forces(document), default=(0.0, "no hand"))


def contact_word(state: Mapping[str, Any]) -> str:
    """Return one contact state of a plan document in words."""
    if state["element"] == "none":
        return "no contact"
    return f"{state['element']} {state['index']} on {state['with']}"


def _hand_forces(document: Mapping[str, Any]) -> Iterator[tuple[float, str]]:
    for segment in document["segments"]:
        for contact in segment["contacts"]:
            if contact["by"] in document["cell"]["arms"]:
                yield float(np.dot(contact["wrench"][:3], contact["normal"])), contact["by"]


def _explain(document: Mapping[str, Any]) -> str:
    explanation = document["explanation"]
    lines = [f"{'outcome:':<16}{document['outcome']}", f"{'why:':<16}{explanation['summary']}"]
    lines += [f"{'':<16}- {_cause(cause)}" for cause in explanation["causes"]]
    return "\n".join(lines)


def _cause(cause: Mapping[str, Any]) -> str:
    figures = figures_of(cause)
    return reason_of(cause) + (f": {figures}" if figures else "") + (f" ({cause['where']})" if cause["where"] else "")
