"""What the part on what others pick instead must say of any figures. No measured figure is asserted."""

from __future__ import annotations

import math
import re

import numpy as np
import pinocchio as pin
import pytest

from planners.cell.cell import load_cell
from planners.motion.timing import JointLimits
from planners.program.cell_description import CellDescription
from tests.benchmarks.peers.contest import Contest, Entry, NotMeasured, tried
from tests.benchmarks.peers.handover_contest import with_fixed_fingers
from tests.benchmarks.peers.kinematics_contest import different
from tests.benchmarks.peers.mplib_scene import INTERPRETER, REASON, BoxObstacle, NoInterpreter, ask_mplib
from tests.benchmarks.peers.timing_contest import keeps
from tests.benchmarks.peers_part import losses, peers_limits, peers_sections

OURS = Entry("ours", [0.002, 0.004, 0.002], [True, True, True], [2.0, 2.0, 4.0], [True, True, True])
WORSE = Entry("Slow", [0.2, 0.4, 0.2], [True, False, True], [3.0, math.nan, 6.0], [True, True, True])
BETTER = Entry("Quick", [0.001, 0.002, 0.001], [True, True, True], [1.8, 1.8, 3.6])
ABSENT = NotMeasured("Absent", "it has no wheel")
CONTEST = Contest("motion (3)", OURS, [WORSE, BETTER, ABSENT], "length", text="How.")


def test_every_peer_has_a_row_and_those_that_were_not_measured_have_a_reason() -> None:
    summary, lost, missing, details = peers_sections([CONTEST], [NotMeasured("Elsewhere", "it is left out")])
    assert "| Slow | motion (3) | 100 | 0.667 | 1 | 1.50 |" in summary
    assert "| Quick | motion (3) | 0.500 | 1 | 1 | 0.900 |" in summary
    assert "| Absent | motion (3) | – | – | 1 | – |" in summary
    assert "Quick is 2.0 times as fast" in lost
    assert "Quick has 10.0 % less length" in lost
    assert "Slow" not in lost
    assert missing.endswith("- Absent: it has no wheel.\n- Elsewhere: it is left out.")
    assert "| Slow: motion (3) | 200 | 380 | 0.667 | 1 | 4.50 |" in details
    for text in (summary, details):
        blocks = re.findall(r"(?:^\|.*\n)+", f"{text}\n", re.MULTILINE)
        assert blocks
        assert all(len({line.count("|") for line in block.splitlines()}) == 1 for block in blocks)


def test_where_nobody_is_better_it_is_said_so() -> None:
    _, lost, missing, _ = peers_sections([Contest("motion (3)", OURS, [WORSE], "length")])
    assert lost.endswith("Nowhere in this run.")
    assert missing.endswith("Everything was.")


def test_more_is_better_where_postures_are_counted() -> None:
    more = Entry("More", OURS.seconds, OURS.solved, [4.0, 4.0, 8.0])
    counted = Contest("postures (3)", OURS, [more], "postures", less_is_better=False)
    assert list(losses(counted, more)) == ["postures (3): More has 100.0 % more postures in the median."]
    less_solved = Contest("motion (3)", WORSE, [OURS])
    assert any("ours solves 100.0 % and ours 66.7 %" in line for line in losses(less_solved, OURS))


def test_our_answers_that_the_check_refuses_break_a_limit() -> None:
    assert [limit.kept for limit in peers_limits([CONTEST])] == [True]
    assert [limit.kept for limit in peers_limits([Contest("motion (3)", WORSE, [])])] == [False]


def test_some_of_the_cases_keep_what_became_of_them() -> None:
    some = WORSE.of([1, 2])
    assert (some.refused, some.success, some.median_size) == (1, 0.5, 6.0)
    assert BETTER.of([0]).claimed == ()


def test_what_is_not_installed_is_told() -> None:
    def run() -> Entry:
        import no_such_library_of_planners  # pyright: ignore[reportMissingImports]  # noqa: F401

        return OURS

    absent = tried("Absent", run)
    assert isinstance(absent, NotMeasured)
    assert "no_such_library_of_planners" in absent.reason


def test_without_an_interpreter_that_has_mplib_the_reason_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(INTERPRETER, raising=False)
    with pytest.raises(NoInterpreter, match="numpy"):
        ask_mplib(None, BoxObstacle("plate", (1.0, 1.0, 1.0), np.eye(4), ()), [], 1.0)
    assert INTERPRETER in REASON


def test_fingers_that_are_fixed_stand_as_far_apart_as_they_are_told_to() -> None:
    cell = load_cell("dual_ur3e_tool")
    description = CellDescription(cell, "cell")
    places = []
    for width in (0.02, 0.05):
        model = pin.buildModelFromXML(with_fixed_fingers(description, cell, {"left": width, "right": 0.03}))
        assert model.nq == 12
        data = model.createData()
        pin.framesForwardKinematics(model, data, pin.neutral(model))
        places.append([data.oMf[model.getFrameId(f"left_pad_{i}")].translation for i in (0, 1)])
    narrow, wide = (float(np.linalg.norm(a - b)) for a, b in places)
    assert wide - narrow == pytest.approx(0.03, abs=1e-6)


def test_postures_that_full_turns_part_are_the_same() -> None:
    q = np.linspace(-3.0, 3.0, 6)
    assert different([q, q + 2.0 * math.pi, q - 2.0 * math.pi]) == 1
    assert different([q, q + 0.1]) == 2
    assert different([]) == 0


def test_motion_that_exceeds_a_limit_or_ends_elsewhere_is_refused() -> None:
    t = np.linspace(0.0, 2.0, 101)[:, None]
    # A quarter of a rad/s² up to half the way, and down again.
    q = np.where(t < 1.0, 0.125 * t**2, 0.25 - 0.125 * (2.0 - t) ** 2)
    v, a = np.where(t < 1.0, 0.25 * t, 0.25 * (2.0 - t)), np.where(t < 1.0, 0.25, -0.25)
    samples, ends = (t[:, 0], q, v, a), np.array([[0.0], [0.25]])
    limits = JointLimits(np.array([0.25]), np.array([0.25]))
    assert keeps(samples, ends, limits)
    assert not keeps(samples, ends + 0.01, limits)
    assert not keeps(samples, ends, JointLimits(np.array([0.2]), np.array([0.25])))
    assert not keeps(samples, ends, JointLimits(np.array([0.25]), np.array([0.2])))
    lied = (t[:, 0], q, v, np.zeros_like(a))
    assert not keeps(lied, ends, JointLimits(np.array([0.25]), np.array([0.2])))
