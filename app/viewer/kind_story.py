"""What the page tells differently of the two kinds of tasks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from app.viewer.curves import Chart, Span
from app.viewer.timeline import Timeline

DIGITS = 4
"""Of times and values in curves, behind the point: a thousandth of what can be seen."""


class KindStory(ABC):
    """Words and curves for the plan document of one kind of task."""

    tabs: ClassVar[tuple[str, ...]]
    """Of the panel, in order."""
    simulation_words: ClassVar[str]
    """Of the button that plays the simulation."""
    meanings: ClassVar[tuple[str, ...]]
    """Colours that appear in scene and curves."""

    def __init__(self, document: Mapping[str, Any]) -> None:
        """Take a plan document."""
        self.document = document

    @abstractmethod
    def subtitle(self) -> str:
        """Say what the task is about."""

    @abstractmethod
    def segments(self) -> list[dict[str, Any]]:
        """Return the plan's segments: kind, start, end, words, state, hold."""

    @abstractmethod
    def highlights(self) -> list[list[str]]:
        """Return what matters most in a plan of this kind, as label and value."""

    @abstractmethod
    def planned_charts(self, timeline: Timeline) -> list[Chart]:
        """Return the curves of the plan; none for a plan without segments."""

    @abstractmethod
    def simulated_charts(self) -> list[Chart]:
        """Return the curves of the simulation; none for a plan without one."""

    @abstractmethod
    def after_the_plan(self, planned_end: float) -> Sequence[tuple[str, float, float, str]]:
        """Return what follows the plan in its simulation: kind, start, end [s], words."""

    @abstractmethod
    def pages(self) -> Sequence[Span]:
        """Return the stretches of the simulation whose curves are shown page by page."""

    @abstractmethod
    def marked(self) -> Sequence[Span]:
        """Return when in the simulation something was not as it should be."""

    @abstractmethod
    def tell_simulation(self) -> dict[str, Any]:
        """Return outcome, a sentence, groups of figures, and what was modelled."""


def squeeze_words(grips: Sequence[Mapping[str, Any]]) -> str:
    """Return with what force the pads press, to follow what is held; nothing where the plan does not command it."""
    forces = {f"{grip['squeeze']:.0f} N" for grip in grips if grip.get("squeeze") is not None}
    return f", squeezed with {' and '.join(sorted(forces))}" if forces else ""


def stretch(kind: str, time: Sequence[float], words: str, state: str, hold: str) -> dict[str, Any]:
    """Return one segment of the timeline."""
    return {
        "kind": kind,
        "start": round(time[0], DIGITS),
        "end": round(time[-1], DIGITS),
        "words": words,
        "state": state,
        "hold": hold,
    }
