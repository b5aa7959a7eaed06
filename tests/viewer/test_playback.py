"""What a plan's simulation says between its samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.viewer.drawing.contact_forces import by_hand
from app.viewer.playback import Playback
from planners.plan.timeline import ContactForce, Moment
from tests.support.documents import plan_of
from tests.support.lift_documents import contact, segment, set_curve, simulation

GRIP = {"arm": "right", "body": "plate", "pose": [0.0, -0.13, 0.0, 1.0, 0.0, 0.0, 0.0], "width": 0.04}
PUSH = {"arm": "left", "body": "plate", "point": [-0.1, 0.15, 0.0], "normal": [0.0, -1.0, 0.0]}
HOLD = {"grip": GRIP, "push": PUSH}


@pytest.fixture
def simulated(document: dict[str, Any]) -> dict[str, Any]:
    """Return a plan of a second in which both hands hold the plate, and its simulation of three."""
    document["segments"] = [segment(0.0, 11, hold=HOLD)]
    document["simulation"] = simulation(3.0)
    return document


def at(document: dict[str, Any], time: float) -> Moment:
    return Playback(plan_of(document)).at("simulation", time)


def force(document: dict[str, Any], by: str, time: float = 2.0) -> ContactForce:
    return next(each for each in at(document, time).contacts if each.by == by)


def turn_plate(document: dict[str, Any], position: list[float], turn: Rotation) -> None:
    motion = document["simulation"]["motion"]
    motion["plate"] = [[*position, *turn.as_quat(scalar_first=True)]] * len(motion["time"])


def test_joints_are_those_of_physics_and_move_straight_between_samples(simulated: dict[str, Any]) -> None:
    rng = np.random.default_rng(4)
    motion = simulated["simulation"]["motion"]
    motion["positions"] = rng.normal(size=(len(motion["time"]), 12)).tolist()
    for time in rng.uniform(0.0, 2.9, 20):
        expected = [np.interp(time, motion["time"], column) for column in np.array(motion["positions"]).T]
        assert at(simulated, time).positions == pytest.approx(np.array(expected), abs=1e-12)


def test_before_its_first_sample_all_is_as_planned(simulated: dict[str, Any]) -> None:
    motion = simulated["simulation"]["motion"]
    motion["time"] = [time + 0.5 for time in motion["time"]]
    motion["positions"] = np.ones((len(motion["time"]), 12)).tolist()
    assert at(simulated, 0.49).positions == pytest.approx(np.zeros(12))
    assert at(simulated, 0.51).positions == pytest.approx(np.ones(12))


def test_the_cup_rides_on_the_plate_and_the_cable_stays_upright_on_the_cup(simulated: dict[str, Any]) -> None:
    turn = Rotation.from_euler("xyz", [0.3, -0.4, 0.2])
    turn_plate(simulated, [0.2, 0.1, 1.5], turn)
    poses = at(simulated, 2.0).body_poses
    centre, first_centre = np.array([0.2, 0.1, 1.5]), np.array([0.3, 0.0, 1.114])
    cup, cable_end = (centre + turn.apply(np.array([0.4, 0.0, z]) - first_centre) for z in (1.154, 1.174))
    assert poses["cup"][:3] == pytest.approx(cup)
    assert poses["cable"] == pytest.approx([*cable_end[:2], cable_end[2] + 0.55, 1.0, 0.0, 0.0, 0.0])


def test_hands_push_up_where_they_hold_the_plate(simulated: dict[str, Any]) -> None:
    turn = Rotation.from_euler("xyz", [0.5, 0.1, 0.0])
    centre = np.array([0.3, 0.0, 1.4])
    turn_plate(simulated, centre.tolist(), turn)
    set_curve(simulated, "gripping hand", lambda time: 4.0 * time)
    set_curve(simulated, "pushing hand", 11.0)
    grips, pushes = force(simulated, "right"), force(simulated, "left")
    assert grips.force == pytest.approx([0.0, 0.0, 8.0])
    assert grips.point == pytest.approx(centre + turn.apply([0.0, -0.13, 0.0]))
    assert pushes.force == pytest.approx([0.0, 0.0, 11.0])
    assert pushes.point == pytest.approx(centre + turn.apply([-0.1, 0.15, 0.0]))


def test_a_hand_that_holds_nothing_exerts_nothing(simulated: dict[str, Any]) -> None:
    simulated["segments"][0]["hold"] = {"grip": GRIP, "push": None}
    assert [each.by for each in at(simulated, 2.0).contacts] == ["right", "cup"]


@pytest.mark.parametrize(("lifter", "along"), [("paper", [0.0, -np.sin(0.5), np.cos(0.5)]), ("cable", [0.0, 0.0, 1.0])])
def test_the_cup_pulls_along_its_axis_or_along_its_cable(
    simulated: dict[str, Any], lifter: str, along: list[float]
) -> None:
    simulated["task"]["lifter_model"] = lifter
    turn_plate(simulated, [0.3, 0.0, 1.4], Rotation.from_euler("x", 0.5))
    set_curve(simulated, "suction load", 12.0)
    assert force(simulated, "cup").force == pytest.approx(12.0 * np.array(along))


@pytest.mark.parametrize(("asked", "shown"), [(-1.0, 0.0), (9.0, 3.0)])
def test_times_outside_a_simulation_are_taken_to_the_nearer_end(
    simulated: dict[str, Any], asked: float, shown: float
) -> None:
    assert at(simulated, asked).time == shown


def test_where_there_is_no_simulation_the_plan_is_shown(document: dict[str, Any]) -> None:
    document["segments"] = [segment(0.0, 11)]
    played = Playback(plan_of(document))
    assert played.at("simulation", 0.5).positions == pytest.approx(played.at("plan", 0.5).positions)
    assert played.durations == pytest.approx({"plan": 1.0})


def test_a_simulation_that_ended_at_once_shows_the_start(document: dict[str, Any]) -> None:
    document["segments"] = [segment(0.0, 11, hold=HOLD)]
    document["simulation"] = simulation(0.0, outcome="slipped")
    moment = at(document, 1.0)
    assert moment.body_poses["plate"] == pytest.approx(document["bodies"]["plate"]["pose"])
    assert all(not each.force.any() for each in moment.contacts)


def test_a_hands_fingers_are_drawn_as_what_the_hand_bears(document: dict[str, Any]) -> None:
    """A squeeze of 60 N is in the fingers' forces and not in the arm's."""
    contacts = [
        contact(0, "right", "soft_finger", (1.0, 0.5, 64.0), finger=0, point=[0.1, 0.0, 1.10]),
        contact(0, "right", "soft_finger", (2.0, -0.5, -56.0), finger=1, point=[0.1, 0.0, 1.14]),
        contact(0, "left", "point", (0.0, 0.0, 2.0)),
    ]
    forces = plan_of({**document, "segments": [segment(0.0, 3, contacts=contacts)]}).at(0.0).contacts
    drawn = {force.by: force for force in by_hand(forces)}
    assert drawn.keys() == {"left", "right"}
    assert drawn["right"].force == pytest.approx([3.0, 0.0, 8.0])
    assert drawn["right"].point == pytest.approx([0.1, 0.0, 1.12])
    assert drawn["left"].force == pytest.approx([0.0, 0.0, 2.0])
