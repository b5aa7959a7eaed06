"""What the page tells of a plan beside its scene: segments, curves, figures, reasons; as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from app.cause_words import figures_of, reason_of
from app.viewer.considered import tell_considered
from app.viewer.curves import Chart, Span
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
OUTCOMES = {"solved": "solved", "infeasible": "infeasible", "not_found": "not found"}
KIND_STORIES: Mapping[str, type[KindStory]] = {"plate_lift": LiftStory, "suction_tool": ToolStory}


def tell_story(document: Mapping[str, Any], sources: Sources) -> dict[str, Any]:
    """Return all the page needs of a plan document but its scene."""
    kind = document["task"]["kind"]
    story = KIND_STORIES[kind](document)
    return {
        "id": document["id"],
        "title": document["task"]["external_id"] or document["id"][:8],
        "subtitle": story.subtitle(),
        "outcome": document["outcome"],
        "outcome_words": OUTCOMES[document["outcome"]],
        "summary": document["explanation"]["summary"],
        "causes": [_cause(cause) for cause in document["explanation"]["causes"]],
        "tabs": story.tabs,
        "simulation_words": story.simulation_words,
        "force_scale": 1e3 * FORCE_SCALES[kind],
        "sources": _sources(document, sources, story),
        "simulation": None if document["simulation"] is None else story.tell_simulation(),
        "considered": tell_considered(document),
        "legend": {
            "meanings": _legend({name: MEANINGS[name] for name in story.meanings}),
            "segments": _legend(SEGMENT_KINDS),
        },
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
    return {"reason": reason_of(cause), "numbers": figures_of(cause)}
