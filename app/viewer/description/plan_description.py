"""What the page tells of a plan beside its scene: segments, curves, figures, reasons."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import JsonValue, PlainSerializer

from app.check_words import PROOF, words_of_check
from app.summary import (
    figures_of,
    is_less_than_asked,
    least_reserve,
    least_torque,
    reason_of,
    remaining_torque,
    share_words,
)
from app.viewer.description.charts import (
    DIGITS,
    PERCENT,
    Chart,
    Spans,
    executed_charts,
    marked_spans,
    planned_charts,
    simulated_charts,
)
from app.viewer.description.considered import ConsideredDescription, describe_considered
from app.viewer.palette import FORCE_SCALES, MEANINGS, SEGMENT_KINDS
from app.viewer.playback import SourceName
from planners.contract.strict_model import StrictModel
from planners.contract.task_change import CannotBeChanged, changed
from planners.contract.task_spec import to_post_again, write_task
from planners.plan.loads import loads_of
from planners.plan.plan import Plan
from planners.plan.segment import Grip, Segment
from planners.plan.verdicts import Certificate, Remedy, Statistics
from workers.robot.execution_log import ExecutedMotion

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
Seconds = Annotated[float, PlainSerializer(lambda seconds: round(seconds, DIGITS))]
Row = tuple[str, ...]
"""A label and its value, or several columns."""


class SegmentDescription(StrictModel):
    """A stretch of time: a segment of the plan, or what follows it in the simulation."""

    kind: str
    start: Seconds
    end: Seconds
    words: str
    """What happens."""
    state: str
    """The contact state of a plate, or the object that is moved."""
    hold: str
    reserve: str = NO_FIGURE
    """The least share of all limits that is kept back [%]."""
    force: str = NO_FIGURE
    """The most that a hand bears [N]."""


class SourceDescription(StrictModel):
    """Something to be played; its curves are shown page by page."""

    duration: Seconds
    segments: list[SegmentDescription]
    charts: list[Chart]
    pages: Spans
    marked: Spans
    """When something was not as it should be."""


class FigureGroup(StrictModel):
    """A small table."""

    title: str
    rows: list[Row]


class NodeForces(StrictModel):
    """Sizes of forces at the end of one motion."""

    segment: int
    time: float
    forces: list[Row]
    """Who exerts them, planned, simulated [N]."""


class SimulationDescription(StrictModel):
    """How a simulation ended, and what was modelled."""

    outcome: str
    words: str
    good: bool
    sentence: str
    figures: list[FigureGroup]
    nodes: list[NodeForces]
    model: list[str]


class ExecutionDescription(StrictModel):
    """How an execution by two arms ended."""

    words: str
    good: bool


class CheckDescription(StrictModel):
    """One check of the certificate."""

    name: str
    sentence: str
    """What it asks, for who reads the plan."""
    passed: bool
    margin: float | None
    unit: str | None
    where: str


class CertificateDescription(StrictModel):
    """What was checked again."""

    title: str
    about: str
    """Says so where it was no motion that was checked."""
    checks: list[CheckDescription]


class CauseDescription(StrictModel):
    """A reason why there is no plan."""

    reason: str
    numbers: str | None


class RemedyDescription(StrictModel):
    """A change of the task with which there is a plan."""

    sentence: str
    figures: str
    """What came of planning the changed task."""
    task: dict[str, JsonValue] | None
    """The changed task, to be posted; None: the change does not fit the task that the plan states."""


class LeastReserveDescription(StrictModel):
    """How much is kept back where least is."""

    value: str
    asked: str
    """Says so where it is less than the task asks for."""
    of: str
    """What would give way, and what be lost."""
    where: str
    time: Seconds
    torque: str
    """What is left of a joint's largest torque where that is least, and where; empty where that is not told."""


class LegendEntry(StrictModel):
    """A colour and its meaning."""

    colour: str
    words: str


class Legend(StrictModel):
    """By name."""

    meanings: dict[str, LegendEntry]
    segments: dict[str, LegendEntry]


class PlanDescription(StrictModel):
    """All the page needs of a plan but its scene."""

    id: str
    title: str
    subtitle: str
    outcome: str
    outcome_words: str
    outcome_meaning: str
    summary: str
    causes: list[CauseDescription]
    remedies: list[RemedyDescription] | None
    """What to change; None: there is a plan, or it was not looked for."""
    tabs: tuple[str, ...]
    """Of the panel, in order."""
    simulation_words: str
    """Of the button that plays the simulation."""
    force_scale: float
    """Length of arrows [mm/N]."""
    sources: dict[SourceName, SourceDescription]
    simulation: SimulationDescription | None
    execution: ExecutionDescription | None
    considered: ConsideredDescription | None
    legend: Legend
    colours: dict[str, str]
    least_reserve: LeastReserveDescription | None
    highlights: list[Row]
    """What a person wants to know first."""
    figures: list[FigureGroup]
    rejections: list[tuple[str, int]]
    certificate: CertificateDescription | None


class KindDescription(ABC):
    """What the page tells of a plan; in parts it differs by the kind of task."""

    tabs: ClassVar[tuple[str, ...]]
    simulation_words: ClassVar[str]
    meanings: ClassVar[tuple[str, ...]]
    """Colours that appear in scene and curves."""

    def __init__(self, plan: Plan, executed: ExecutedMotion | None = None) -> None:
        self.plan, self.executed = plan, executed

    @abstractmethod
    def subtitle(self) -> str:
        """Say what the task is about."""

    @abstractmethod
    def segments(self) -> list[SegmentDescription]:
        """Return the plan's segments."""

    @abstractmethod
    def highlights(self) -> list[Row]:
        """Return what matters most in a plan of this kind, as label and value."""

    @abstractmethod
    def after_the_plan(self) -> Sequence[tuple[str, float, float, str]]:
        """Return what follows the plan in its simulation: kind, start, end [s], words."""

    @abstractmethod
    def pages(self) -> Sequence[tuple[float, float]]:
        """Return begins and ends of the stretches of the simulation whose curves are shown page by page [s]."""

    @abstractmethod
    def simulation(self) -> SimulationDescription:
        """Return outcome, a sentence, groups of figures, and what was modelled."""

    def describe(self) -> PlanDescription:
        """Return all the page needs."""
        plan = self.plan
        sources = self._sources()
        return PlanDescription(
            id=plan.id,
            title=plan.task.external_id or plan.id[:8],
            subtitle=self.subtitle(),
            outcome=plan.outcome,
            outcome_words=OUTCOMES[plan.outcome],
            outcome_meaning=WITHOUT_PLAN.get(plan.outcome, ""),
            summary=plan.explanation.summary,
            causes=[
                CauseDescription(reason=reason_of(cause), numbers=figures_of(cause))
                for cause in plan.explanation.causes
            ],
            remedies=_remedies(plan),
            tabs=self.tabs,
            simulation_words=self.simulation_words,
            force_scale=1e3 * FORCE_SCALES[plan.task.kind],
            sources=sources,
            simulation=None if plan.simulation is None else self.simulation(),
            execution=None
            if self.executed is None
            else ExecutionDescription(words=self.executed.ending, good=self.executed.is_done),
            considered=describe_considered(plan),
            legend=Legend(
                meanings=_legend({name: MEANINGS[name] for name in self._drawn_meanings(sources)}),
                segments=_legend(SEGMENT_KINDS),
            ),
            colours={name: colour for name, (colour, _) in (MEANINGS | SEGMENT_KINDS).items()},
            least_reserve=_least_reserve(plan, sources["plan"].segments),
            highlights=self._all_highlights(),
            figures=_figures(plan.statistics),
            rejections=sorted(plan.statistics.rejections.items(), key=lambda item: -item[1]),
            certificate=None if plan.certificate is None else _certificate(plan.certificate, plan.outcome),
        )

    def _sources(self) -> dict[SourceName, SourceDescription]:
        """Return what can be played: the plan, and its simulation if there is one."""
        plan = self.plan
        segments = [
            told.model_copy(update=_figures_of_segment(segment, plan))
            for told, segment in zip(self.segments(), plan.segments, strict=True)
        ]
        sources: dict[SourceName, SourceDescription] = {
            "plan": SourceDescription(
                duration=plan.duration,
                segments=segments,
                charts=planned_charts(plan),
                pages=np.array([[0.0, plan.duration]]),
                marked=np.empty((0, 2)),
            )
        }
        if plan.simulation is not None:
            sources["simulation"] = SourceDescription(
                duration=plan.simulation.time,
                segments=self._executed(segments, plan.simulation.time),
                charts=simulated_charts(plan),
                pages=np.array(self.pages()),
                marked=marked_spans(plan.simulation),
            )
        if self.executed is not None and plan.segments:
            time = self.executed.time
            sources["execution"] = SourceDescription(
                duration=time[-1],
                segments=_done_in(segments, self.executed),
                charts=executed_charts(plan, self.executed),
                pages=np.array([[0.0, time[-1]]]),
                marked=np.empty((0, 2)),
            )
        return sources

    def _executed(self, segments: Sequence[SegmentDescription], end: float) -> list[SegmentDescription]:
        """Return the plan's segments as far as the simulation came, and what followed them."""
        done = [
            segment.model_copy(update={"end": min(segment.end, end)}) for segment in segments if segment.start < end
        ]
        return done + [
            SegmentDescription(
                kind=kind, start=start, end=stop, words=words, state=segments[-1].state, hold=segments[-1].hold
            )
            for kind, start, stop, words in self.after_the_plan()
            if start < stop
        ]

    def _drawn_meanings(self, sources: Mapping[SourceName, SourceDescription]) -> list[str]:
        """Return the meanings for the legend: those of the kind of task, and the reserve where a curve is of it."""
        drawn = {line.colour for source in sources.values() for chart in source.charts for line in chart.series}
        return [*self.meanings, *({RESERVE} & drawn)]

    def _all_highlights(self) -> list[Row]:
        certificate, statistics = self.plan.certificate, self.plan.statistics
        rows: list[Row] = []
        if self.plan.segments:
            rows += [("motion", f"{self.plan.duration:.1f} s"), *self.highlights()]
        if statistics.total_seconds is not None:
            after = sum(seconds for name, seconds in statistics.times if name in AFTER_PLANNING)
            rows.append(("planned in", f"{statistics.total_seconds - after:.2f} s"))
        if certificate is not None:
            passed = len(certificate.checks) - len(certificate.failures)
            label = "certificate" if self.plan.segments else "its proof"
            rows.append((label, f"{passed} of {len(certificate.checks)} checks"))
        return rows


def _done_in(segments: Sequence[SegmentDescription], executed: ExecutedMotion) -> list[SegmentDescription]:
    """Return the plan's segments at the times at which they were executed, each as often as it was, back and forth."""
    begins = [segment.start for segment in segments]
    which = np.maximum(np.searchsorted(begins, executed.clock + 1e-6, side="right") - 1, 0)
    borders = [0, *(np.flatnonzero(np.diff(which)) + 1), len(which) - 1]
    return [
        segments[int(which[a])].model_copy(update={"start": executed.time[a], "end": executed.time[b]})
        for a, b in pairwise(borders)
        if executed.time[b] > executed.time[a]
    ]


def _certificate(certificate: Certificate, outcome: str) -> CertificateDescription:
    is_proof = outcome == "infeasible"
    subject = "Proof that there is no plan" if is_proof else "Certificate of the plan"
    return CertificateDescription(
        title=f"{subject}: {'passed' if certificate.passed else 'FAILED'}",
        about=PROOF if is_proof else "",
        checks=[
            CheckDescription(
                name=plain(check.name),
                sentence=words_of_check(check.name),
                passed=check.passed,
                margin=check.margin,
                unit=check.unit,
                where=check.where if isinstance(check.where, str) else "",
            )
            for check in certificate.checks
        ],
    )


def _remedies(plan: Plan) -> list[RemedyDescription] | None:
    """Return what to change where there is no plan, or physics does not carry it out."""
    if plan.explanation.remedies is None:
        return None
    task, asked = write_task(to_post_again(plan.task)), plan.task.options.reserve
    return [
        RemedyDescription(
            sentence=remedy.sentence, figures=_figures_of_remedy(remedy, asked), task=_changed_task(task, remedy)
        )
        for remedy in plan.explanation.remedies
    ]


def _changed_task(task: Mapping[str, Any], remedy: Remedy) -> dict[str, JsonValue] | None:
    try:
        return changed(task, remedy.patch)
    except CannotBeChanged:
        return None


def _figures_of_remedy(remedy: Remedy, asked: float) -> str:
    words = [OUTCOMES[remedy.outcome] + (", certified" if remedy.certified else "")]
    if remedy.reserve is not None:
        of_asked = f" of {share_words(asked)} asked for" if is_less_than_asked(remedy, asked) else ""
        words.append(f"keeps back {share_words(remedy.reserve)}{of_asked}")
    if remedy.largest_force is not None:
        words.append(f"largest force {remedy.largest_force:.1f} N")
    if remedy.simulated:
        words.append("carried out in physics")
    return "; ".join(words)


def squeeze_words(grips: Sequence[Grip]) -> str:
    """Return with what force the pads press, to follow what is held; nothing where the plan does not command it."""
    forces = {f"{grip.squeeze:.0f} N" for grip in grips if grip.squeeze is not None}
    return f", squeezed with {' and '.join(sorted(forces))}" if forces else ""


def _figures_of_segment(segment: Segment, plan: Plan) -> dict[str, str]:
    """Return the least reserve of a segment, and the most that a hand bears in it."""
    figures = {}
    reserve = None if segment.reserve is None else segment.reserve[~np.isnan(segment.reserve)]
    if reserve is not None and len(reserve):
        figures["reserve"] = f"{PERCENT * reserve.min():.1f}"
    force = max((force for force, _ in loads_of(segment, plan)), default=0.0)
    if force > 0.0:
        figures["force"] = f"{force:.1f}"
    return figures


def _least_reserve(plan: Plan, segments: Sequence[SegmentDescription]) -> LeastReserveDescription | None:
    """Return how much is kept back where least is, whether that is enough, what would give way, and where to see it."""
    found = least_reserve(plan)
    if found is None:
        return None
    (least, time), torque = found, least_torque(plan)
    options = plan.task.options
    asked = options.reserve if "reserve" in options.model_fields_set else 0.0
    return LeastReserveDescription(
        value=f"{PERCENT * least.value:.1f} %",
        asked=f"less than the {PERCENT * asked:g} % asked for" if least.value < asked else "",
        of=f"{plain(least.limited_by)}: {plain(least.body)} would be lost",
        where=f"segment {least.segment + 1}: {segments[least.segment].words}",
        time=time,
        torque="" if torque is None else f"Joint torque: {remaining_torque(torque[0])}, {plain(torque[1])}",
    )


def _legend(entries: Mapping[str, tuple[str, str]]) -> dict[str, LegendEntry]:
    return {name: LegendEntry(colour=colour, words=words) for name, (colour, words) in entries.items()}


def _figures(statistics: Statistics) -> list[FigureGroup]:
    graph = {name: value for name, value in statistics.graph.items() if name != BY_CONTACT}
    groups = {
        "Graph": _rows(graph),
        "Nodes by contact": _by_contact(statistics.graph.get(BY_CONTACT)),
        "Search": _rows(statistics.search),
        "Time": [(name, f"{seconds:.2f} s") for name, seconds in statistics.times],
    }
    return [FigureGroup(title=title, rows=rows) for title, rows in groups.items() if rows]


def _by_contact(figures: JsonValue) -> list[Row]:
    """Return one row a contact state under a row of headings; nothing without contact states."""
    if not isinstance(figures, dict):
        return []
    columns = ("nodes", "alive", "dead")
    rows = []
    for state, counts in figures.items():
        told = counts if isinstance(counts, dict) else {}
        rows.append((state, *(_figure(told.get(column)) for column in columns)))
    return [("", *columns), *rows] if rows else []


def _rows(figures: Mapping[str, JsonValue]) -> list[Row]:
    """Flatten nested figures into rows; inner names follow their group's."""
    rows: list[Row] = []
    for name, value in figures.items():
        words = plain(name)
        if isinstance(value, dict):
            rows += [(f"{words}: {inner}", text) for inner, text in _rows(value)]
        else:
            rows.append((words, _figure(value)))
    return rows


def _figure(value: JsonValue) -> str:
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


def plain(name: str) -> str:
    """Return a name with spaces."""
    return name.replace("_", " ")
