"""Where a lift ends for want of force, force is named before reach, with what the nearest hold lacks."""

from __future__ import annotations

import pytest

from planners.contract.task_spec import read_task
from planners.manipulation.impasse import TOO_WEAK
from planners.plan.verdicts import Cause
from tests.support.plan_shelf import PlanShelf

OUTLINE = [[0.16, 0], [0.1, 0.13], [-0.09, 0.14], [-0.16, 0.02], [-0.08, -0.12], [0.07, -0.14]]
CUP_FORCE = 24.0
"""[N]"""
NO_FARTHER_THAN_FACE = "gets no farther than a tilt of 0° (face)"


def ended(shelf: PlanShelf, mass: float) -> tuple[str, Cause]:
    """Return where the lift of a plate ends that its cup is too weak for, and the first cause."""
    plan = shelf.plan(
        read_task(
            {
                "kind": "plate_lift",
                "plate": {"shape": {"type": "prism", "outline": OUTLINE, "height": 0.03}, "mass": mass},
                "plate_pose": [0.33, 0.03, 1.109, 1, 0, 0, 0],
                "cup": {"position": [0.06, 0.03], "radius": 0.02, "max_force": CUP_FORCE},
                "options": {"remedies": False, "simulate": False, "contact_density": 0.7, "hold_density": 0.7},
            }
        )
    )
    assert plan.explanation is not None
    return plan.explanation.summary, plan.explanation.causes[0]


@pytest.mark.slow
def test_want_of_force_is_named_before_the_reach_of_the_one_hold_that_would_do(shelf: PlanShelf) -> None:
    """A lighter plate gets farther in the same place, so reach is not what ends the heavy one's way."""
    lacking: list[float] = []
    for mass in (4.8, 5.2, 5.6):
        summary, cause = ended(shelf, mass)
        assert NO_FARTHER_THAN_FACE in summary
        assert (cause.reason, cause.unit) == (TOO_WEAK, "N")
        assert cause.available == CUP_FORCE
        assert cause.needed is not None
        lacking.append(cause.needed - CUP_FORCE)
        assert f"lacks {lacking[-1]:.1f} N" in summary
    assert 0.0 < lacking[0] < lacking[1] < lacking[2]
    summary, cause = ended(shelf, 3.5)
    assert NO_FARTHER_THAN_FACE not in summary
    assert cause.reason != TOO_WEAK
