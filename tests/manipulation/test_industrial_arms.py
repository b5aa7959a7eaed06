"""A lift and a pile by arms of another kind: industrial ones with a spherical wrist, made small for the laboratory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from planners import read_task, solve
from planners.kinematics.arm_kind import ArmKind, arm_kind
from tests.support.own_cell import load_cell_file

ROOT = Path(__file__).resolve().parents[2]
SCALE = 0.36
HOME = {"left": [-173.9, -92.0, -0.8, 154.8, 61.8, 150.2], "right": [178.4, -35.3, 66.2, 132.9, 65.9, 11.6]}
"""Clear of everything, hands about where the laboratory's arms have them [deg]."""


def read(file: str) -> dict[str, Any]:
    return yaml.safe_load((ROOT / f"assets/{file}.yaml").read_text())


def small_arm() -> dict[str, Any]:
    """Return a spherical-wrist arm with the reach of a UR3e, made of the shipped one."""
    robot = read("robots/abb_irb2600_12_165")
    for joint in robot["joints"]:
        joint["a"] *= SCALE
        joint["d"] *= SCALE
        # It bears seven times as much for its size, and is that much stronger.
        joint["torque"] *= 25.0 * SCALE**4
    for link in robot["links"]:
        for cylinder in link.get("cylinders", ()):
            cylinder["radius"] *= SCALE
            for end in ("start", "end"):
                cylinder[end] = [SCALE * x for x in cylinder[end]]
        # The fork is slimmer: margins are those of the laboratory.
        fork = 0.85 * SCALE
        for piece in link.get("pieces", ()):
            piece[:] = [[fork * x, (SCALE if y < -0.4 else fork) * y, SCALE * z] for x, y, z in piece]
    for link in robot["masses"]:
        link["mass"] *= SCALE**3
        link["com"] = [SCALE * x for x in link["com"]]
    return {**robot, "name": "small", "payload": 4.0, "reach": SCALE * robot["reach"]}


@pytest.mark.parametrize(
    ("task", "cell"),
    [("ab1", "dual_ur3e_lift"), pytest.param("tissue_pile", "dual_ur3e_tool", marks=pytest.mark.slow)],
)
@pytest.mark.slow
def test_arms_with_a_spherical_wrist_do_what_the_laboratorys_do(task, cell, tmp_path):
    mount, file = read("mounts/dual_column"), read(f"cells/{cell}")
    for arm, home in HOME.items():
        mount["arms"][arm]["home_deg"] = home
        file["arms"][arm]["robot"] = "small"
    for kind, content in (("robots", small_arm()), ("mounts", mount), ("cells", file)):
        (tmp_path / kind).mkdir()
        (tmp_path / kind / f"{content['name']}.yaml").write_text(yaml.safe_dump(content))
    industrial = load_cell_file(tmp_path / "cells" / f"{cell}.yaml")
    assert {arm_kind(arm.dh) for arm in industrial.arms.values()} == {ArmKind.SPHERICAL_WRIST}
    body = json.loads((ROOT / f"assets/tasks/{task}.json").read_text())
    plan = solve(read_task({**body, "options": {"remedies": False}}), cells={cell: industrial})
    assert plan.outcome == "solved"
    assert plan.certificate is not None
    assert plan.certificate.passed
