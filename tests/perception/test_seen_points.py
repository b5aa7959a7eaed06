"""Points that are kept to be drawn: few enough, all of them measured, each with the object it speaks for."""

from __future__ import annotations

import numpy as np
import pytest

from planners.perception.depth_view import DepthView
from planners.perception.object_finder import KnownPlace, SeenTable, perceive_objects
from planners.perception.perception_settings import PerceptionSettings
from planners.perception.seen_points import NOBODY, SeenPoints
from tests.support.depth_camera import TABLE_TOP
from tests.support.table_frames import frame


@pytest.fixture(scope="module")
def seen() -> SeenTable:
    looked = frame(np.random.default_rng([11, 0]))
    view = DepthView.from_depth(looked.depth, looked.camera)
    return perceive_objects(view, KnownPlace(TABLE_TOP), PerceptionSettings(), np.random.default_rng(0))


@pytest.mark.parametrize("most", [50, 3_000, 50_000, 10**6])
def test_no_more_points_are_kept_than_asked_for_and_each_was_measured(seen: SeenTable, most: int) -> None:
    kept = SeenPoints.of(seen.view, seen.findings.owners, most)
    assert 0 < len(kept.points) <= most
    measured = {tuple(point) for point in seen.view.points()[np.isfinite(seen.view.depth)].tolist()}
    assert {tuple(point) for point in kept.points.tolist()} <= measured
    assert len(kept.points) == min(len(measured), len(kept.points))
    if most >= len(measured):
        assert len(kept.points) == len(measured)


def test_every_object_keeps_points_and_they_lie_on_its_top(seen: SeenTable) -> None:
    kept = SeenPoints.of(seen.view, seen.findings.owners)
    for index, each in enumerate(seen.findings.objects):
        mine = kept.points[kept.owners == index]
        assert len(mine) >= 0.3 * each.top_points
        top = each.T_world_object[2, 3] + 0.5 * each.height
        assert float(np.median(np.abs(mine[:, 2] - top))) < 0.003
        T = each.T_world_object
        local = (mine - T[:3, 3]) @ T[:3, :3]
        reach = np.ptp(each.outline(0.01) - T[:2, 3], axis=0).max()
        assert np.all(np.linalg.norm(local[:, :2], axis=1) < reach)
    assert (kept.owners == NOBODY).any()


def test_points_are_read_as_they_were_written(seen: SeenTable) -> None:
    kept = SeenPoints.of(seen.view, seen.findings.owners, 1_000)
    again = SeenPoints.from_bytes(kept.to_bytes())
    np.testing.assert_allclose(again.points, kept.points, atol=1e-6)
    np.testing.assert_array_equal(again.owners, kept.owners)
