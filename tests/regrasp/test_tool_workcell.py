"""Which pairs of bodies are looked at."""

from __future__ import annotations

import numpy as np
import pytest

from planners.collision.model import Fixed, PairChoice, Riding
from planners.regrasp.grasps.grasp_reach import GraspReach, GraspSurroundings
from planners.regrasp.grasps.tool_grasps import ToolGrasps
from planners.regrasp.tool_workcell import ToolWorkcell
from tests.regrasp.tool_tasks import box, scene_of


def _choices(reach: GraspReach) -> dict[str, PairChoice]:
    workcell = reach.workcell
    return {
        "hand": reach._hand_pairs,
        "links": reach._link_pairs,
        "carried": reach._carried_pairs,
        "between arms": workcell.between_arms,
        "one arm": workcell.with_arm(reach.arm),
    }


@pytest.mark.parametrize("arm", ["left", "right"])
@pytest.mark.parametrize("idle", [True, False])
def test_one_pair_of_each_kind_answers_for_all(arm: str, idle: bool, long_grasps: ToolGrasps) -> None:
    objects = box("one", [0.35, 0.28], [0.4, -0.25]), box("other", [0.35, 0.1], [0.4, -0.1])
    workcell = ToolWorkcell.of(scene_of(*objects))
    placements = {"one": Riding("tool", np.eye(4)), "other": Fixed(np.eye(4))}
    around = GraspSurroundings(placements, np.zeros(6) if idle else None, 0.05)
    model = workcell.model({each: 0.05 for each in workcell.cell.arms})
    for name, choice in _choices(GraspReach(workcell, arm, long_grasps, around)).items():
        chosen = workcell.pairs((name, arm, idle), choice)
        assert np.array_equal(chosen, model.pair_mask(choice))
        assert 0 < chosen.sum() < len(chosen)
