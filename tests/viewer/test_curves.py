"""The curves say what the document says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from viewer.conftest import contact, segment

from app.viewer.curves import Chart, Series, planned_charts, simulated_charts
from app.viewer.timeline import Timeline


def charts(document: dict[str, Any]) -> list[Chart]:
    return planned_charts(document, Timeline(document, np.zeros(12)))


def line(chart: Chart, name: str) -> Series:
    return next(series for series in chart.series if series.name == name)


def test_hands_bear_the_sum_of_their_contacts_and_together_that_of_both(document: dict[str, Any]) -> None:
    contacts = [
        contact(0, "right", "soft_finger", (0.0, 0.0, 3.0), finger=0),
        contact(0, "right", "soft_finger", (0.0, 9.0, 4.0), finger=1),
        contact(0, "left", "point", (1.0, 0.0, 5.0)),
        contact(0, "table", "environment", (0.0, 0.0, 8.0)),
    ]
    document["segments"] = [segment(0.0, 2, contacts=contacts)]
    forces = charts(document)[0]
    assert line(forces, "right").values == pytest.approx([7.0])
    assert line(forces, "left").values == pytest.approx([5.0])
    assert line(forces, "both").values == pytest.approx([12.0])


def test_the_minimum_is_the_weight_less_what_the_cup_can_carry(document: dict[str, Any]) -> None:
    document["segments"] = [segment(0.0, 2, contacts=[contact(0, "left", "point", (0.0, 0.0, 5.0))])]
    minimum = next(series for series in charts(document)[0].series if series.dashed)
    assert minimum.values == pytest.approx([4.0 * 9.81 - 20.0])


def test_the_fastest_joint_is_shown_in_percent_of_its_own_limit(document: dict[str, Any]) -> None:
    velocities = np.zeros((2, 12))
    velocities[1, 6:] = 0.5 * np.array(document["cell"]["arms"]["right"]["velocity_max"]) * [1, -1, 0.2, 1, 0.4, -0.9]
    document["segments"] = [segment(0.0, 2, velocities=velocities.tolist())]
    speeds = charts(document)[-1]
    assert line(speeds, "right").values == pytest.approx([0.0, 50.0])
    assert line(speeds, "left").values == pytest.approx([0.0, 0.0])


def test_where_there_is_no_cup_the_load_has_a_gap(document: dict[str, Any]) -> None:
    pull = contact(1, "cup", "suction", (0.0, 0.0, 6.0), suction_force=11.0)
    document["segments"] = [segment(0.0, 2, contacts=[contact(0, "left", "point", (0.0, 0.0, 5.0)), pull])]
    load = line(charts(document)[1], "load").values
    assert np.isnan(load[0])
    assert load[1] == pytest.approx(11.0)


def test_times_never_fall(document: dict[str, Any]) -> None:
    press = [contact(sample, "left", "point", (0.0, 0.0, 5.0)) for sample in (0, 2)]
    document["segments"] = [segment(0.0, 3, contacts=press), segment(0.2, 3, contacts=press)]
    for chart in charts(document):
        assert (np.diff(chart.time) >= 0.0).all()


def test_a_plan_without_segments_has_no_curves(document: dict[str, Any]) -> None:
    assert charts(document) == []
    assert simulated_charts(document) == []


def test_simulated_curves_are_grouped_by_unit_with_the_minimum_among_the_forces(document: dict[str, Any]) -> None:
    curve = {"time": [0.0, 1.0], "value": [1.0, 3.0]}
    document["simulation"] = {
        "outcome": "lifted",
        "minimum_total_force": 19.24,
        "force_curves": [
            {"name": "left_force", "unit": "N", **curve},
            {"name": "commanded_velocity", "unit": "m/s", "time": [0.5, 1.5], "value": [0.0, 0.1]},
            {"name": "right_force", "unit": "N", **curve},
        ],
    }
    forces, speeds = simulated_charts(document)
    assert [series.colour for series in forces.series] == ["left", "right", "limit"]
    assert forces.series[-1].values == pytest.approx([19.24, 19.24])
    assert (forces.unit, speeds.unit) == ("N", "m/s")
