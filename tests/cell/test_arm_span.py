"""What bounds an arm's reach holds for every posture; asked of the kinematics, posture by posture."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from planners.cell.arm import Arm
from planners.cell.arm_span import SLACK, ArmSpan, out_of_reach
from planners.cell.cell import known_cells, load_cell
from planners.cell.hand import Gripper
from planners.certify.common.infeasibility import reach_bound
from planners.certify.motion.kinematics import ArmKinematics
from planners.contract.arrays import ArmName
from planners.plan.scenery import ARMS
from tests.support.documents import bodies_of, cell_of, evidence_of

TASKS = Path(__file__).parents[2] / "assets/tasks"


def touching_points(arm: Arm) -> np.ndarray:
    """Corners of the pads' inner faces at many openings, or the tip's ball from all sides: (n, 3), flange frame."""
    hand = arm.hand
    if not isinstance(hand, Gripper):
        directions = np.random.default_rng(0).normal(size=(200, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return hand.T_flange_tcp[:3, 3] + hand.tip_radius * directions
    x, _, z = 0.5 * hand.pad_size
    return np.array(
        [
            [side_x * x, 0.5 * side_y * width, hand.T_flange_tcp(width)[2, 3] + side_z * z]
            for width in np.linspace(0.0, hand.width_max, 9)
            for side_x in (-1, 1)
            for side_y in (-1, 1)
            for side_z in (-1, 1)
        ]
    )


@pytest.mark.parametrize("side", ARMS)
@pytest.mark.parametrize("cell", known_cells())
def test_no_posture_touches_anything_beyond_what_an_arm_spans(cell: str, side: ArmName) -> None:
    arm = load_cell(cell).arms[side]
    span, rng = ArmSpan.of(arm), np.random.default_rng(1)
    postures = rng.uniform(arm.position_min, arm.position_max, (4000, 6))
    # Stretched out, with the wrist turned in every way.
    postures[:2000, 2] = rng.normal(size=2000) * 0.05
    T = ArmKinematics(arm.dh, arm.T_world_base).frames(postures)[:, 6]
    points = touching_points(arm) @ T[:, :3, :3].swapaxes(1, 2) + T[:, None, :3, 3]
    farthest = float(np.linalg.norm(points - span.center, axis=2).max())
    assert farthest <= span.radius - SLACK + 1e-9
    assert farthest >= 0.8 * span.radius


def test_a_point_is_out_of_reach_only_if_it_is_for_every_arm() -> None:
    spans = [ArmSpan.of(arm) for arm in load_cell("dual_ur3e_tool").arms.values()]
    for span in spans:
        up = span.center + np.array([0.0, 0.0, 0.999 * span.radius])
        assert out_of_reach(spans, up, 0.0) is None
        assert out_of_reach([span], span.center + np.array([0.0, 0.0, 1.001 * span.radius]), 0.0) is not None
        assert out_of_reach([span], span.center + np.array([0.0, 0.0, 1.001 * span.radius]), 0.01) is None
    between = np.array([0.0, 0.0, spans[0].center[2] + 0.9])
    assert out_of_reach(spans, between, 0.0) is None


@pytest.mark.parametrize("cell", ["dual_ur3e_lift", "dual_ur3e_tool"])
def test_the_certificate_finds_the_same_numbers_with_a_little_less_slack(cell: str, bare_document) -> None:
    """Less, so that it never calls understated what the planner states."""
    evidence = evidence_of(bare_document(cell))
    spans = [ArmSpan.of(arm) for arm in load_cell(cell).arms.values()]
    for point in np.random.default_rng(2).uniform([-3, -3, 0], [3, 3, 3], (50, 3)):
        bound = reach_bound(evidence, point, 0.2)
        told = out_of_reach(spans, point, 0.2)
        if told is not None:
            assert told.needed == pytest.approx(bound.needed, rel=1e-9)
            assert 0.0 <= told.available - bound.available <= SLACK
        else:
            assert bound.needed <= bound.available + SLACK


@pytest.fixture
def bare_document():
    def document(name: str):
        cell = load_cell(name)
        task = "ab1" if cell.pusher_arms else "domino_pile"
        return {
            "schema_version": "1.0", "id": "probe", "task": json.loads((TASKS / f"{task}.json").read_text()),
            "seed": 0, "outcome": "not_found",
            "software": {"name": "liftwright", "version": "0", "commit": None},
            "explanation": {"summary": "none", "causes": []}, "cell": cell_of(cell),
            "joint_names": list(cell.joint_names), "bodies": bodies_of(cell), "segments": [],
            "certificate": None, "simulation": None,
            "statistics": {"total_seconds": None, "stages": [], "graph": {}, "search": {}, "rejections": {}},
        }  # fmt: skip

    return document
