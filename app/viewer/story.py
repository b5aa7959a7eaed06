"""What the page tells of a plan beside its scene: segments, curves, figures, reasons; as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from app.summary import figures_of, least_reserve, reason_of
from app.viewer.considered import tell_considered
from app.viewer.curves import PERCENT, Chart, Span
from app.viewer.kind_story import DIGITS, KindStory
from app.viewer.lift_story import LiftStory
from app.viewer.palette import FORCE_SCALES, MEANINGS, SEGMENT_KINDS
from app.viewer.sources import Sources
from app.viewer.tool_story import ToolStory
from planners.geometry.pose import Array

BY_CONTACT = "contact_states"
"""Member of a graph's figures that has the same figures for each contact state."""
AFTER_PLANNING = frozenset({"certify", "simulate"})
"""Stages of a job in which there is a plan already."""
NO_FIGURE = "\u2013"
RESERVE = "reserve"
"""Meaning of the colour of a curve that only newer documents have."""
OUTCOMES = {"solved": "solved", "infeasible": "infeasible", "not_found": "not found"}
WITHOUT_PLAN = {
    "infeasible": "it is proven that there is no plan",
    "not_found": "none among those that were tried; there may be one",
}
"""What it means that there is none."""
KIND_STORIES: Mapping[str, type[KindStory]] = {"plate_lift": LiftStory, "suction_tool": ToolStory}


def tell_story(document: Mapping[str, Any], sources: Sources) -> dict[str, Any]:
    """Return all the page needs of a plan document but its scene."""
    kind = document["task"]["kind"]
    story = KIND_STORIES[kind](document)
    played = _sources(document, sources, story)
    return {
        "id": document["id"],
        "title": document["task"]["external_id"] or document["id"][:8],
        "subtitle": story.subtitle(),
        "outcome": document["outcome"],
        "outcome_words": OUTCOMES[document["outcome"]],
        "outcome_meaning": WITHOUT_PLAN.get(document["outcome"], ""),
        "summary": document["explanation"]["summary"],
        "causes": [_cause(cause) for cause in document["explanation"].get("causes", ())],
        "tabs": story.tabs,
        "simulation_words": story.simulation_words,
        "force_scale": 1e3 * FORCE_SCALES[kind],
        "sources": played,
        "simulation": None if document["simulation"] is None else story.tell_simulation(),
        "considered": tell_considered(document),
        "legend": {
            "meanings": _legend({name: MEANINGS[name] for name in _meanings(story, played)}),
            "segments": _legend(SEGMENT_KINDS),
        },
        "colours": {name: colour for name, (colour, _) in (MEANINGS | SEGMENT_KINDS).items()},
        "least_reserve": _least_reserve(document, played["plan"]["segments"]),
        "highlights": _highlights(document, sources.plan.duration, story),
        "figures": _figures(document["statistics"]),
        "rejections": sorted(document["statistics"]["rejections"].items(), key=lambda item: -item[1]),
        "certificate": document["certificate"],
    }


def _sources(document: Mapping[str, Any], sources: Sources, story: KindStory) -> dict[str, Any]:
    """Return what can be played: the plan, and its simulation if there is one."""
    segments = story.segments()
    planned_end = sources.plan.duration
    plan = _source(planned_end, segments, story.planned_charts(sources.plan), [(0.0, planned_end)])
    if document["simulation"] is None:
        return {"plan": plan}
    end = document["simulation"]["time"]
    executed = _executed(segments, end, story.after_the_plan(segments[-1]["end"]))
    return {"plan": plan, "simulation": _source(end, executed, story.simulated_charts(), story.pages(), story.marked())}


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


def _meanings(story: KindStory, played: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the meanings for the legend: those of the kind of task, and the reserve where there is a curve of it."""
    drawn = {line["colour"] for source in played.values() for chart in source["charts"] for line in chart["series"]}
    return [*story.meanings, *({RESERVE} & drawn)]


def _least_reserve(document: Mapping[str, Any], segments: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Return how much is kept back where least is, whether that is enough, what would give way, and where to see it."""
    found = least_reserve(document)
    if found is None:
        return None
    least, time = found
    asked = document["task"].get("options", {}).get("reserve", 0.0)
    return {
        "value": f"{PERCENT * least.value:.1f} %",
        "asked": f"less than the {PERCENT * asked:g} % asked for" if least.value < asked else "",
        "of": f"{least.limited_by.replace('_', ' ')}: {least.body.replace('_', ' ')} would be lost",
        "where": f"segment {least.segment + 1}: {segments[least.segment]['words']}",
        "time": round(time, DIGITS),
    }


def _executed(
    segments: Sequence[Mapping[str, Any]], end: float, after: Sequence[tuple[str, float, float, str]]
) -> list[dict[str, Any]]:
    """Return the plan's segments as far as the simulation came, and what followed them."""
    done = [{**segment, "end": min(segment["end"], end)} for segment in segments if segment["start"] < end]
    common = {"state": segments[-1]["state"], "hold": segments[-1]["hold"]}
    return done + [
        {"kind": kind, "start": round(start, DIGITS), "end": round(stop, DIGITS), "words": words, **common}
        for kind, start, stop, words in after
        if start < stop
    ]


def _spans(spans: Sequence[Span]) -> list[list[float]]:
    return [[round(begin, DIGITS), round(end, DIGITS)] for begin, end in spans]


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


def _highlights(document: Mapping[str, Any], duration: float, story: KindStory) -> list[list[str]]:
    """Return what a person wants to know first, as label and value."""
    certificate, statistics = document["certificate"], document["statistics"]
    rows = []
    if document["segments"]:
        rows += [["motion", f"{duration:.1f} s"], *story.highlights()]
    if statistics["total_seconds"] is not None:
        after = sum(stage["seconds"] for stage in statistics["stages"] if stage["name"] in AFTER_PLANNING)
        rows.append(["planned in", f"{statistics['total_seconds'] - after:.2f} s"])
    if certificate is not None:
        passed = sum(check["passed"] for check in certificate["checks"])
        rows.append(["certificate", f"{passed} of {len(certificate['checks'])} checks"])
    return rows


def _figures(statistics: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return groups of figures, each with a title and rows of label and value."""
    stages = [[stage["name"], f"{stage['seconds']:.2f} s"] for stage in statistics["stages"]]
    graph = {name: value for name, value in statistics["graph"].items() if name != BY_CONTACT}
    by_contact = _by_contact(statistics["graph"].get(BY_CONTACT) or {})
    search = _rows(statistics["search"])
    groups = [("Graph", _rows(graph)), ("Nodes by contact", by_contact), ("Search", search), ("Time", stages)]
    return [{"title": title, "rows": rows} for title, rows in groups if rows]


def _by_contact(figures: Mapping[str, Mapping[str, Any] | None]) -> list[list[str]]:
    """Return one row a contact state under a row of headings; nothing without contact states."""
    columns = ("nodes", "alive", "dead")
    rows = [[state, *(_figure((counts or {}).get(column)) for column in columns)] for state, counts in figures.items()]
    return [["", *columns], *rows] if rows else []


def _rows(figures: Mapping[str, Any]) -> list[list[str]]:
    """Flatten nested figures into rows; inner names follow their group's."""
    rows: list[list[str]] = []
    for name, value in figures.items():
        words = name.replace("_", " ")
        if isinstance(value, Mapping):
            rows += [[f"{words}: {inner}", text] for inner, text in _rows(value)]
        else:
            rows.append([words, _figure(value)])
    return rows


def _figure(value: Any) -> str:
    """Return any JSON value in words; a dash for a figure that there is none of, as where nothing was found."""
    match value:
        case None:
            return NO_FIGURE
        case bool():
            return "yes" if value else "no"
        case int():
            return f"{value:,}"
        case float():
            return f"{value:,.2f}"
        case list():
            return ", ".join(map(_figure, value))
        case _:
            return str(value)


def _cause(cause: Mapping[str, Any]) -> dict[str, Any]:
    return {"reason": reason_of(cause), "numbers": figures_of(cause)}
