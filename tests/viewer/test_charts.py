"""The curves say what the document says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from app.viewer.description.charts import Chart, Series, marked_spans, planned_charts, simulated_charts
from planners.geometry.pose import Array
from tests.support.documents import plan_of
from tests.support.lift_documents import contact, lift, segment, set_curve, simulation


def charts(document: dict[str, Any]) -> list[Chart]:
    return planned_charts(plan_of(document))


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
    assert simulated_charts(plan_of(document)) == []


@pytest.fixture
def simulated(document: dict[str, Any]) -> dict[str, Any]:
    """Return a plan whose simulation lasts six seconds, with a lift from two on."""
    document["segments"] = [segment(0.0, 11)]
    document["simulation"] = simulation(6.0, lift=lift(2.0))
    return document


def dips(document: dict[str, Any]) -> Array:
    simulation = plan_of(document).simulation
    assert simulation is not None
    return marked_spans(simulation)


def simulated_chart(document: dict[str, Any], title: str) -> Chart:
    return next(chart for chart in simulated_charts(plan_of(document)) if chart.title == title)


def test_simulated_hands_are_shown_in_the_colours_of_their_arms_above_the_minimum(simulated: dict[str, Any]) -> None:
    set_curve(simulated, "pushing hand", 14.0)
    set_curve(simulated, "gripping hand", 8.0)
    forces = simulated_chart(simulated, "Hands, vertical force")
    by_colour = {series.colour: series.values for series in forces.series}
    # The stick is on the left arm, the gripper on the right one.
    assert by_colour["left"] == pytest.approx(14.0)
    assert by_colour["right"] == pytest.approx(8.0)
    assert by_colour["limit"] == pytest.approx(19.24)


def test_speeds_are_in_millimetres_a_second(simulated: dict[str, Any]) -> None:
    set_curve(simulated, "commanded velocity", 0.02)
    set_curve(simulated, "lifter velocity", 0.05)
    speeds = simulated_chart(simulated, "Lift, speed upward")
    assert [series.values[0] for series in speeds.series] == pytest.approx([20.0, 50.0])


def test_dips_are_the_times_in_the_lift_when_both_hands_bear_less_than_the_minimum(simulated: dict[str, Any]) -> None:
    set_curve(simulated, "both hands", lambda time: 15.0 if time < 2.5 or 3.0 <= time < 3.4 or time >= 5.0 else 22.0)
    assert dips(simulated) == pytest.approx(np.array([[2.0, 2.5], [3.0, 3.4], [5.0, 5.98]]), abs=0.021)
    assert simulated_chart(simulated, "Hands, vertical force").marked == pytest.approx(dips(simulated))


def test_before_a_lift_there_are_no_dips(simulated: dict[str, Any]) -> None:
    simulated["simulation"]["lift"] = None
    assert dips(simulated).shape == (0, 2)
