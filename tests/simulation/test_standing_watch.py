"""What nothing holds, looked at all at once, against one body after the other."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from planners.geometry.pose import rotation_from_vector, transform
from planners.scene.suction_tool import TOOL_NAME
from workers.simulation.settings import WatchSettings
from workers.simulation.tool_execution import StandingWatch

SETTINGS = WatchSettings()


def motion(R: np.ndarray, center: np.ndarray) -> np.ndarray:
    return np.vstack([R, center, np.zeros((2, 3))])


def expected(name: str, was: np.ndarray, now: np.ndarray, R_center_body: np.ndarray) -> str | None:
    way, verticals = now[3] - was[3], [(each[:3] @ R_center_body)[2] for each in (was, now)]
    if -way[2] > SETTINGS.fall:
        return "tool_slipped" if name == TOOL_NAME else "object_dropped"
    if np.arccos(np.clip(verticals[0] @ verticals[1], -1.0, 1.0)) > SETTINGS.tilt:
        return "toppled"
    return "off_goal" if np.hypot(*way[:2]) > SETTINGS.shift else None


@pytest.mark.parametrize("seed", range(60))
def test_the_first_that_did_not_stand_is_told(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bodies: dict[str, Any] = {
        name: SimpleNamespace(
            motion=motion(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)),
            T_center_body=transform(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)),
        )
        for name in ("box", TOOL_NAME, "can")
    }
    watch = StandingWatch(bodies, SETTINGS)
    left = {name: body.motion for name, body in bodies.items()}
    for held in (["can"], [], ["box", TOOL_NAME], []):
        for body in bodies.values():
            turn, way = rotation_from_vector(0.1 * rng.normal(size=3)), 0.006 * rng.normal(size=3)
            body.motion = motion(turn @ body.motion[:3], body.motion[3] + way)
        left |= {name: bodies[name].motion for name in held}
        each = [
            expected(name, left[name], body.motion, body.T_center_body[:3, :3])
            for name, body in bodies.items()
            if name not in held
        ]
        found = watch.look(held, 1.0)
        assert (None if found is None else found.outcome) == next((one for one in each if one is not None), None)
