"""Free motion of an arm: how often a search that was exhausted is made once more, and what is told of one in vain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from planners.cell.cell import load_cell
from planners.hands import arm_motion
from planners.hands.arm_motion import NOT_HELD, PATIENCE, FreeMotion, FreeMove, Stuck
from planners.motion.query import MotionOutcome, MotionQuery, MotionResult, MotionSettings
from tests.motion.test_motion_query import no_boxes

PERSISTENCE = 4
SETTINGS = MotionSettings(max_iterations=10)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the iterations of every search; one with more than usual finds what is asked for where joint 1 is at 1."""
    iterations: list[int] = []

    def searched(query: MotionQuery, settings: MotionSettings, _rng: np.random.Generator) -> MotionResult:
        iterations.append(settings.max_iterations)
        if settings.max_iterations == SETTINGS.max_iterations or query.goals[0, 0] != 1.0:
            return MotionResult(MotionOutcome.ITERATIONS_EXHAUSTED)
        return MotionResult(MotionOutcome.FOUND, np.vstack([query.start, query.goals[0]]), 0)

    monkeypatch.setattr(arm_motion, "plan_motion", searched)
    return iterations


def ask(free: FreeMotion, goal: float) -> None:
    arm = load_cell("dual_ur3e_lift").arms["left"]
    free.find(FreeMove("hand", arm, slice(0, 6), np.zeros(12), np.full((1, 6), goal), None), no_boxes(6))  # type: ignore[arg-type]


def test_after_some_searches_in_vain_none_is_made_once_more_and_one_that_finds_begins_the_count_anew(
    asked: list[int],
) -> None:
    free = FreeMotion(SETTINGS, np.random.default_rng(0), persistence=PERSISTENCE)
    usual, patient = SETTINGS.max_iterations, PERSISTENCE * SETTINGS.max_iterations
    for _ in range(PATIENCE - 1):
        with pytest.raises(Stuck):
            ask(free, 0.5)
    ask(free, 1.0)
    for _ in range(PATIENCE + 3):
        with pytest.raises(Stuck):
            ask(free, 0.5)
    assert asked == [usual, patient] * (2 * PATIENCE) + [usual] * 3


@dataclass(frozen=True)
class TouchedAt:
    """Something touches the post where joint 1 is at a place."""

    place: float

    def first_collision(self, Q: np.ndarray) -> np.ndarray:
        return np.where(Q[:, 0] == self.place, 0, -1)

    def pair_names(self, _pair: int) -> tuple[str, str]:
        return "left_wrist", "post"


@pytest.mark.parametrize(
    ("outcome", "place", "told"),
    [
        (MotionOutcome.START_IN_COLLISION, 0.0, "The start is in collision. (left_wrist and post)"),
        (MotionOutcome.START_IN_COLLISION, 0.7, NOT_HELD[MotionOutcome.START_IN_COLLISION]),
        # The first goal is outside the limits: what touches there is in nobody's way.
        (MotionOutcome.GOALS_IN_COLLISION, 0.5, f"{MotionOutcome.GOALS_IN_COLLISION.value} (left_wrist and post)"),
        (MotionOutcome.GOALS_IN_COLLISION, 99.0, NOT_HELD[MotionOutcome.GOALS_IN_COLLISION]),
    ],
)
def test_who_is_in_the_way_is_told_and_else_that_nothing_would_be_held(
    outcome: MotionOutcome, place: float, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arm_motion, "plan_motion", lambda *_: MotionResult(outcome))
    goals, arm = np.array([[99.0] * 6, [0.5] * 6]), load_cell("dual_ur3e_lift").arms["left"]
    move = FreeMove("hand", arm, slice(0, 6), np.zeros(12), goals, TouchedAt(place))  # type: ignore[arg-type]
    with pytest.raises(Stuck) as stuck:
        FreeMotion(SETTINGS, np.random.default_rng(0)).find(move, no_boxes(6))
    assert stuck.value.rejection.reason == f"free motion of the hand: {told}"
