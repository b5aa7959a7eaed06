"""What a plan says between its samples."""

from __future__ import annotations

import doctest
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from planners.cell.cell import Cell, load_cell
from planners.plan.plan import Plan
from tests.support.documents import plan_of
from tests.support.lift_documents import contact, lift_document, segment


def wavy_segment(start: float, n: int, rng: np.random.Generator) -> dict[str, Any]:
    return segment(start, n, positions=rng.normal(size=(n, 12)).tolist(), velocities=rng.normal(size=(n, 12)).tolist())


@pytest.fixture(scope="module")
def cell() -> Cell:
    return load_cell("dual_ur3e_lift")


@pytest.fixture
def document(cell: Cell) -> dict[str, Any]:
    return lift_document(cell)


def planned(document: dict[str, Any], *segments: dict[str, Any]) -> Plan:
    return plan_of({**document, "segments": list(segments)})


def test_joints_follow_the_cubic_hermite_curve_that_scipy_draws(document: dict[str, Any]) -> None:
    rng = np.random.default_rng(5)
    samples = wavy_segment(0.0, 7, rng)
    spline = CubicHermiteSpline(samples["time"], samples["positions"], samples["velocities"])
    plan = planned(document, samples)
    for time in rng.uniform(0.0, 0.6, 50):
        assert plan.at(time).positions == pytest.approx(spline(time), abs=1e-12)


def test_samples_are_met_exactly(document: dict[str, Any]) -> None:
    samples = wavy_segment(0.0, 5, np.random.default_rng(6))
    plan = planned(document, samples)
    for time, positions in zip(samples["time"], samples["positions"], strict=True):
        assert plan.at(time).positions == pytest.approx(np.array(positions), abs=1e-12)


def test_a_body_turns_evenly_along_the_shortest_way(document: dict[str, Any]) -> None:
    quaternions = [[1.0, 0.0, 0.0, 0.0], [-np.cos(0.6), -np.sin(0.6), 0.0, 0.0]]
    poses = [[*position, *q] for position, q in zip([[0.0, 0.0, 1.0], [0.0, 0.2, 1.4]], quaternions, strict=True)]
    plan = planned(document, segment(0.0, 2, body_poses={"plate": poses}))
    slerp = Slerp([0.0, 0.1], Rotation.from_quat(quaternions, scalar_first=True))
    for time in np.linspace(0.0, 0.1, 9):
        pose = plan.at(time).body_poses["plate"]
        assert pose[:3] == pytest.approx([0.0, 2.0 * time, 1.0 + 4.0 * time])
        turned = Rotation.from_quat(pose[3:], scalar_first=True)
        assert (turned.inv() * slerp(time)).magnitude() == pytest.approx(0.0, abs=1e-9)


def test_a_body_stays_where_the_last_segment_that_moved_it_left_it(document: dict[str, Any]) -> None:
    moved = [[0.0, 0.0, z, 1.0, 0.0, 0.0, 0.0] for z in (1.0, 2.0)]
    plan = planned(
        document, segment(0.0, 2), segment(0.1, 2, body_poses={"plate": moved}), segment(0.2, 2), segment(0.3, 2)
    )
    assert plan.at(0.05).body_poses["plate"][2] == pytest.approx(1.114)
    assert plan.at(0.15).body_poses["plate"][2] == pytest.approx(1.5)
    assert plan.at(0.35).body_poses["plate"][2] == pytest.approx(2.0)
    assert plan.at(0.35).body_poses["table"] == pytest.approx(document["bodies"]["table"]["pose"])


def test_widths_run_straight_between_samples(document: dict[str, Any]) -> None:
    plan = planned(document, segment(0.0, 2, gripper_width={"right": [0.08, 0.04]}))
    assert plan.at(0.025).widths == pytest.approx({"right": 0.07})


def test_a_contact_that_both_sets_list_is_drawn_between_them(document: dict[str, Any]) -> None:
    contacts = [
        contact(0, "left", "point", (0.0, 0.0, 2.0)),
        contact(2, "left", "point", (0.0, 4.0, 6.0), point=[0.2, 0.0, 1.1]),
    ]
    (touch,) = planned(document, segment(0.0, 3, contacts=contacts)).at(0.05).contacts
    assert touch.force == pytest.approx([0.0, 1.0, 3.0])
    assert touch.point == pytest.approx([0.05, 0.0, 1.1])


def test_between_sets_of_different_contacts_the_earlier_one_counts(document: dict[str, Any]) -> None:
    contacts = [contact(0, "left", "point", (0.0, 0.0, 2.0)), contact(2, "table", "environment", (0.0, 0.0, 9.0))]
    plan = planned(document, segment(0.0, 3, contacts=contacts))
    assert [touch.by for touch in plan.at(0.19).contacts] == ["left"]
    assert [touch.by for touch in plan.at(0.2).contacts] == ["table"]


def test_inertia_is_no_contact(document: dict[str, Any]) -> None:
    inertia = {"kind": "inertia", "sample": 0, "body": "plate", "point": [0, 0, 1], "wrench": [1, 1, 1, 0, 0, 0]}
    assert planned(document, segment(0.0, 2, contacts=[inertia])).at(0.0).contacts == ()


def test_where_two_segments_meet_the_later_one_runs(document: dict[str, Any]) -> None:
    plan = planned(document, segment(0.0, 2), segment(0.1, 2))
    assert [plan.at(time).segment for time in (0.0, 0.0999, 0.1, 0.2)] == [0, 0, 1, 1]


@pytest.mark.parametrize(("asked", "shown"), [(-1.0, 0.0), (7.0, 0.2)])
def test_times_outside_are_taken_to_the_nearer_end(document: dict[str, Any], asked: float, shown: float) -> None:
    plan = planned(document, segment(0.0, 2), segment(0.1, 2))
    assert plan.at(asked).time == pytest.approx(shown)


@pytest.mark.parametrize("start", [[0.1 * joint for joint in range(12)], None])
def test_a_plan_without_segments_rests_where_its_task_has_it_start(
    document: dict[str, Any], start: list[float] | None
) -> None:
    document["task"]["start_positions"] = start
    moment = planned(document).at(3.0)
    assert moment.segment is None
    assert moment.time == 0.0
    assert moment.positions == pytest.approx(np.full(12, np.nan) if start is None else np.array(start), nan_ok=True)
    assert moment.body_poses["plate"] == pytest.approx(document["bodies"]["plate"]["pose"])


def test_a_copy_with_other_segments_has_a_timeline_of_its_own(document: dict[str, Any]) -> None:
    plan = planned(document, segment(0.0, 2), segment(0.1, 2))
    assert plan.duration == pytest.approx(0.2)
    assert plan.timeline is plan.timeline
    shorter = plan.model_copy(update={"segments": plan.segments[:1]})
    assert shorter.duration == pytest.approx(0.1)


def test_usage_is_as_told(document: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("plan.json").write_bytes(planned(document, wavy_segment(0.0, 5, np.random.default_rng(7))).write())
    told = doctest.DocTestFinder().find(Plan.at, "Plan.at", globs={"Plan": Plan})
    assert [doctest.DocTestRunner().run(each).failed for each in told if each.examples] == [0]
