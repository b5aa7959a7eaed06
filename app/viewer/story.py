"""What the page tells of a plan beside its scene: segments, curves, figures, reasons; as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from app.summary import contact_word, largest_hand_force
from app.viewer.curves import Chart, Span, dips, planned_charts, simulated_charts
from app.viewer.palette import MEANINGS, SEGMENT_KINDS
from app.viewer.simulation_story import tell_simulation
from app.viewer.sources import Sources
from planners.geometry.pose import Array

DIGITS = 4
"""Of times and values in curves, behind the point: a thousandth of what can be seen."""
BY_CONTACT = "contact_states"
"""Member of a graph's figures that has the same figures for each contact state."""
OUTCOMES = {"solved": "solved", "infeasible": "infeasible", "not_found": "not found"}


def tell_story(document: Mapping[str, Any], sources: Sources) -> dict[str, Any]:
    """Return all the page needs of a plan document but its scene."""
    return {
        "id": document["id"],
        "title": document["task"]["external_id"] or document["id"][:8],
        "subtitle": _subtitle(document),
        "outcome": document["outcome"],
        "outcome_words": OUTCOMES[document["outcome"]],
        "summary": document["explanation"]["summary"],
        "causes": [_cause(cause) for cause in document["explanation"]["causes"]],
        "sources": _sources(document, sources),
        "simulation": None if document["simulation"] is None else tell_simulation(document),
        "legend": {
            "meanings": _legend(MEANINGS),
            "segments": _legend(SEGMENT_KINDS),
        },
        "highlights": _highlights(document, sources.plan.duration),
        "figures": _figures(document["statistics"]),
        "rejections": sorted(document["statistics"]["rejections"].items(), key=lambda item: -item[1]),
        "certificate": document["certificate"],
    }


def _sources(document: Mapping[str, Any], sources: Sources) -> dict[str, Any]:
    """Return what can be played: the plan, and its simulation if there is one."""
    body = "plate" if document["task"]["kind"] == "plate_lift" else "object"
    segments = [_segment(segment, body) for segment in document["segments"]]
    planned_end = sources.plan.duration
    plan = _source(planned_end, segments, planned_charts(document, sources.plan), [(0.0, planned_end)])
    simulation = document["simulation"]
    if simulation is None:
        return {"plan": plan}
    end, lift = simulation["time"], simulation["lift"]
    pages = [(0.0, end)] if lift is None else [(0.0, lift["begin"]), (lift["begin"], end)]
    executed = _source(end, _executed(segments, simulation), simulated_charts(document), pages, dips(document))
    return {"plan": plan, "simulation": executed}


def _source(
    duration: float,
    segments: Sequence[Mapping[str, Any]],
    charts: Sequence[Chart],
    pages: Sequence[Span],
    marked: Sequence[Span] = (),
) -> dict[str, Any]:
    """Return one thing to play; its curves are shown page by page."""
    return {
        "duration": round(duration, DIGITS),
        "segments": segments,
        "charts": [_chart(chart) for chart in charts],
        "pages": _spans(pages),
        "marked": _spans(marked),
    }


def _executed(segments: Sequence[Mapping[str, Any]], simulation: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the plan's segments as far as the simulation came, and what followed them."""
    end, lift = simulation["time"], simulation["lift"]
    done = [{**segment, "end": min(segment["end"], end)} for segment in segments if segment["start"] < end]
    planned_end = segments[-1]["end"]
    common = {"state": "no contact", "element": "none", "hold": segments[-1]["hold"]}
    after = [("settle", planned_end, end if lift is None else lift["begin"], "Hands take up the load")]
    if lift is not None:
        after.append(("lift", lift["begin"], end, "Hands follow the lifter"))
    stretches = [(kind, start, stop, words) for kind, start, stop, words in after if start < stop]
    return done + [
        {"kind": kind, "start": round(start, DIGITS), "end": round(stop, DIGITS), "words": words, **common}
        for kind, start, stop, words in stretches
    ]


def _spans(spans: Sequence[Span]) -> list[list[float]]:
    return [[round(begin, DIGITS), round(end, DIGITS)] for begin, end in spans]


def _subtitle(document: Mapping[str, Any]) -> str:
    task = document["task"]
    if task["kind"] != "plate_lift":
        return task["kind"].replace("_", " ")
    plate, cup = task["plate"], task["cup"]
    size = plate["shape"].get("size")
    what = "plate" if size is None else " \u00d7 ".join(f"{1000 * length:.0f}" for length in size) + " mm plate"
    return f"{plate['mass']:g} kg {what}, cup of {cup['max_force']:g} N"


def _segment(segment: Mapping[str, Any], body: str) -> dict[str, Any]:
    state = segment["contact_state"]
    return {
        "kind": segment["kind"],
        "start": round(segment["time"][0], DIGITS),
        "end": round(segment["time"][-1], DIGITS),
        "words": _deed(segment["kind"], segment["movers"], body),
        "state": "" if state is None else contact_word(state),
        "element": "" if state is None else state["element"],
        "hold": _hold(segment["hold"]),
    }


def _deed(kind: str, movers: Sequence[str], body: str) -> str:
    arms = " and ".join(movers)
    hand = f"{arms} hand" if len(movers) == 1 else "hands" if movers else "hand"
    deeds = {
        "transit": f"{hand} travels",
        "approach": f"{hand} approaches",
        "retreat": f"{hand} retreats",
        "transfer": f"{body} moved by {arms} hand" if len(movers) == 1 else f"{body} moved by both hands",
        "handover": f"{body} goes from hand to hand",
        "grip": "fingers close",
        "release": "fingers open",
        "attach": "vacuum on",
        "detach": "vacuum off",
    }
    return deeds[kind][0].upper() + deeds[kind][1:]


def _hold(hold: Mapping[str, Any] | None) -> str:
    if hold is None:
        return "no hand on it"
    words = [f"{deed} by {hold[key]['arm']}" for key, deed in (("grip", "gripped"), ("push", "pushed")) if hold[key]]
    return ", ".join(words) or "no hand on it"


def _chart(chart: Chart) -> dict[str, Any]:
    return {
        "title": chart.title,
        "unit": chart.unit,
        "time": _numbers(chart.time),
        "series": [
            {"name": line.name, "colour": line.colour, "dashed": line.dashed, "values": _numbers(line.values)}
            for line in chart.series
        ],
        "marked": _spans(chart.marked),
    }


def _numbers(values: Array) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in np.round(values, DIGITS)]


def _legend(entries: Mapping[str, tuple[str, str]]) -> dict[str, dict[str, str]]:
    return {name: {"colour": colour, "words": words} for name, (colour, words) in entries.items()}


def _highlights(document: Mapping[str, Any], duration: float) -> list[list[str]]:
    """Return what a person wants to know first, as label and value."""
    certificate, statistics = document["certificate"], document["statistics"]
    rows = []
    if document["segments"]:
        force, arm = largest_hand_force(document)
        rows += [["motion", f"{duration:.1f} s"], ["largest force", f"{force:.1f} N ({arm})"]]
    if statistics["total_seconds"] is not None:
        rows.append(["planned in", f"{statistics['total_seconds']:.2f} s"])
    if certificate is not None:
        passed = sum(check["passed"] for check in certificate["checks"])
        rows.append(["certificate", f"{passed} of {len(certificate['checks'])} checks"])
    return rows


def _figures(statistics: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return groups of figures, each with a title and rows of label and value."""
    stages = [[stage["name"], f"{stage['seconds']:.2f} s"] for stage in statistics["stages"]]
    graph = {name: value for name, value in statistics["graph"].items() if name != BY_CONTACT}
    by_contact = _by_contact(statistics["graph"].get(BY_CONTACT, {}))
    search = _rows(statistics["search"])
    groups = [("Graph", _rows(graph)), ("Nodes by contact", by_contact), ("Search", search), ("Time", stages)]
    return [{"title": title, "rows": rows} for title, rows in groups if rows]


def _by_contact(figures: Mapping[str, Mapping[str, int]]) -> list[list[str]]:
    """Return one row a contact state under a row of headings; nothing without contact states."""
    columns = ("nodes", "alive", "dead")
    rows = [[contact, *(f"{counts[column]:,}" for column in columns)] for contact, counts in figures.items()]
    return [["", *columns], *rows] if rows else []


def _rows(figures: Mapping[str, Any]) -> list[list[str]]:
    """Flatten nested figures into rows; inner names follow their group's."""
    rows: list[list[str]] = []
    for name, value in figures.items():
        words = name.replace("_", " ")
        if isinstance(value, Mapping):
            rows += [[f"{words}: {inner}", text] for inner, text in _rows(value)]
        elif isinstance(value, list):
            rows.append([words, ", ".join(map(str, value))])
        else:
            rows.append([words, f"{value:,.2f}" if isinstance(value, float) else f"{value:,}"])
    return rows


def _cause(cause: Mapping[str, Any]) -> dict[str, Any]:
    numbers = None
    if cause["needed"] is not None and cause["available"] is not None:
        numbers = f"needed {cause['needed']:.4g} {cause['unit']}, available {cause['available']:.4g} {cause['unit']}"
    return {"reason": cause["reason"], "numbers": numbers}
