"""What the page tells of a simulation: how it ended and why, how the lift went, how well it kept to the plan."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from app.summary import failure_of

SIMULATED_OUTCOMES = {"lifted": "lifted", "slipped": "slipped", "cup_lost": "cup lost", "overload": "overload"}
BEARERS = {"left": "left hand", "right": "right hand", "cup": "cup", "support": "support"}
"""Words for what bears the plate."""


def tell_simulation(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return outcome, a sentence, groups of figures, the comparison with the plan, and what was modelled."""
    simulation = document["simulation"]
    return {
        "outcome": simulation["outcome"],
        "words": SIMULATED_OUTCOMES[simulation["outcome"]],
        "good": simulation["outcome"] == "lifted",
        "sentence": _sentence(simulation),
        "figures": _figures(simulation),
        "nodes": [_node(node) for node in simulation["manipulation"]["nodes"]],
        "model": simulation["model"],
    }


def _sentence(simulation: Mapping[str, Any]) -> str:
    lift = simulation["lift"]
    if simulation["outcome"] == "lifted" and lift is not None:
        return f"The plate was lifted by {1e3 * lift['height']:.0f} mm."
    time, cause = failure_of(simulation)
    when = f"{time:.2f} s" if lift is None else f"{time:.2f} s, {time - lift['begin']:.2f} s into the lift"
    return f"At {when}: {cause}."


def _figures(simulation: Mapping[str, Any]) -> list[dict[str, Any]]:
    lift, dips, manipulation = simulation["lift"], simulation["dips"], simulation["manipulation"]
    groups = []
    if lift is not None:
        groups.append({"title": "Lift", "rows": _lift_rows(lift)})
        rows = [["dips", f"{dips['count']}"], ["together", f"{dips['seconds']:.2f} s"]]
        if dips["lowest"] is not None:
            rows.append(["lowest sum", f"{dips['lowest']:.1f} N"])
        if simulation["minimum_total_force"] is not None:
            rows.append(["minimum", f"{simulation['minimum_total_force']:.1f} N"])
        groups.append({"title": "Both hands below the minimum", "rows": rows})
    rows = [
        ["largest force difference", f"{manipulation['largest_difference']:.1f} N"],
        ["of the plate's weight", f"{100.0 * manipulation['largest_difference_of_weight']:.1f} %"],
        ["cup off its place, most", f"{1e3 * manipulation['largest_distance']:.1f} mm"],
        ["plate turned, most", f"{np.degrees(manipulation['largest_angle']):.1f}\u00b0"],
    ]
    return [*groups, {"title": "Manipulation against its plan", "rows": rows}]


def _lift_rows(lift: Mapping[str, Any]) -> list[list[str]]:
    return [
        ["height", f"{1e3 * lift['height']:.0f} mm"],
        ["reachable", f"{1e3 * lift['reachable_height']:.0f} mm"],
        ["F_goal, pushing hand", f"{lift['goal_force']:.1f} N"],
        ["reserve kept on the cup", f"{100.0 * lift['cup_reserve']:.0f} %"],
        ["lifter's way", f"{1e3 * lift['lifter_travel']:.0f} mm"],
        ["lifter's time", f"{lift['lifter_seconds']:.1f} s"],
        ["hands follow by force", "yes" if lift["controlled"] else "no"],
    ]


def _node(node: Mapping[str, Any]) -> dict[str, Any]:
    """Return the sizes of forces at the end of one motion, planned and simulated, by who exerts them."""
    forces = [
        [BEARERS[name], *(f"{np.linalg.norm(node[source][name]):.1f}" for source in ("planned", "simulated"))]
        for name in node["planned"]
    ]
    return {"segment": node["segment"], "time": node["time"], "forces": forces}
