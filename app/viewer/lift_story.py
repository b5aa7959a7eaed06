"""The story of a plate lift."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from app.summary import contact_word, largest_load
from app.viewer.curves import Chart, Span
from app.viewer.kind_story import KindStory, squeeze_words, stretch
from app.viewer.lift_curves import dips, planned_charts, simulated_charts
from app.viewer.simulation_story import tell_simulation
from app.viewer.timeline import Timeline


class LiftStory(KindStory):
    """A plate, its contact states, and the lift that follows the plan."""

    tabs = ("View", "Lift", "Figures", "Rejected", "Checks")
    simulation_words = "Simulation with lift"
    meanings = ("left", "right", "environment", "suction", "sum", "limit", "start", "goal")

    def subtitle(self) -> str:
        """Say what the plate is, and what the cup bears."""
        plate, cup = self.document["task"]["plate"], self.document["task"]["cup"]
        size = plate["shape"].get("size")
        what = "plate" if size is None else " \u00d7 ".join(f"{1000 * length:.0f}" for length in size) + " mm plate"
        return f"{plate['mass']:g} kg {what}, cup of {cup['max_force']:g} N"

    def segments(self) -> list[dict[str, Any]]:
        """Return the plan's segments with their contact states."""
        return [_segment(segment) for segment in self.document["segments"]]

    def highlights(self) -> list[list[str]]:
        """Return the most that a hand bears."""
        force, arm = largest_load(self.document)
        return [["largest force", f"{force:.1f} N ({arm} hand)"]]

    def planned_charts(self, timeline: Timeline) -> list[Chart]:
        """Return vertical forces of the hands, suction load, reserve and joint speeds."""
        return planned_charts(self.document, timeline)

    def simulated_charts(self) -> list[Chart]:
        """Return what hands, cup and lifter did."""
        return simulated_charts(self.document)

    def after_the_plan(self, planned_end: float) -> Sequence[tuple[str, float, float, str]]:
        """Return how the hands took up the load, and the lift."""
        end, lift = self.document["simulation"]["time"], self.document["simulation"]["lift"]
        after = [("settle", planned_end, end if lift is None else lift["begin"], "Hands take up the load")]
        if lift is not None:
            after.append(("lift", lift["begin"], end, "Hands follow the lifter"))
        return after

    def pages(self) -> Sequence[Span]:
        """Return the manipulation and the lift."""
        end, lift = self.document["simulation"]["time"], self.document["simulation"]["lift"]
        return [(0.0, end)] if lift is None else [(0.0, lift["begin"]), (lift["begin"], end)]

    def marked(self) -> Sequence[Span]:
        """Return when both hands together bore less than the minimum."""
        return dips(self.document)

    def tell_simulation(self) -> dict[str, Any]:
        """Return how it ended, how the lift went, and how well it kept to the plan."""
        return tell_simulation(self.document)


def _segment(segment: Mapping[str, Any]) -> dict[str, Any]:
    state = segment["contact_state"]
    words = _deed(segment["kind"], segment["movers"])
    contact = "" if state is None else contact_word(state)
    return stretch(segment["kind"], segment["time"], words, contact, _hold(segment["hold"]))


def _deed(kind: str, movers: Sequence[str]) -> str:
    arms = " and ".join(movers)
    hand = f"{arms} hand" if len(movers) == 1 else "hands" if movers else "hand"
    deeds = {
        "transit": f"{hand} travels",
        "approach": f"{hand} approaches",
        "retreat": f"{hand} retreats",
        "transfer": f"plate moved by {arms} hand" if len(movers) == 1 else "plate moved by both hands",
        "grip": "fingers close",
        "release": "fingers open",
    }
    return deeds[kind][0].upper() + deeds[kind][1:]


def _hold(hold: Mapping[str, Any] | None) -> str:
    grip, push = (None, None) if hold is None else (hold["grip"], hold["push"])
    words = [] if grip is None else [f"gripped by {grip['arm']}{squeeze_words([grip])}"]
    words += [] if push is None else [f"pushed by {push['arm']}"]
    return ", ".join(words) or "no hand on it"
