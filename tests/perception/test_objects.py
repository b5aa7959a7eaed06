"""Objects on a table, found in simulated depth images: the truth is known, the noise is a camera's."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from planners.geometry.pose import rotation_x, rotation_z, transform
from planners.perception.camera import Camera
from planners.perception.depth_view import LARGEST_IMAGE, DepthView
from planners.perception.object_finder import KnownPlace, SeenTable, perceive_objects
from planners.perception.perception_settings import PerceptionSettings
from planners.perception.scan_files import ScanRefused
from tests.support.depth_camera import (
    NOISELESS,
    TABLE_TOP,
    Thing,
    Turned,
    cylinder,
    depth_image,
    floor,
    overhead_camera,
    table,
)
from tests.support.table_frames import (
    CAN,
    DOMINO,
    TISSUE_BOX,
    Frame,
    TrueObject,
    errors,
    frames,
    matched,
    on_table,
    seen,
)

TABLE = np.array([[0.05, -0.915], [0.85, -0.915], [0.85, 0.915], [0.05, 0.915]])
MILLIMETRE = 1e-3
FRAMES = 14
"""That uncertainties are tried on."""


def perceived(frame: Frame, view: DepthView | None = None) -> SeenTable:
    view = view or DepthView.from_depth(frame.depth, frame.camera)
    return perceive_objects(view, KnownPlace(TABLE_TOP, TABLE), PerceptionSettings(), np.random.default_rng(0))


def box(size: tuple[float, float, float], x: float, y: float, yaw: float = 0.0, above: float = 0.0) -> TrueObject:
    return TrueObject("box", size, on_table(x, y, size[2], yaw, above))


def can(x: float, y: float) -> TrueObject:
    return TrueObject("cylinder", CAN, on_table(x, y, CAN[2]), is_can=True)


def photographed(*objects: TrueObject, others: tuple[Thing, ...] = (), roll: float = 0.0, seed: int = 0) -> Frame:
    return seen(objects, overhead_camera(roll=roll), np.random.default_rng(seed), others=others)


def test_all_objects_of_seeded_frames_are_found_and_none_is_invented() -> None:
    for frame in frames(4, seed=11):
        found = perceived(frame)
        pairs, invented, missed = matched(found.findings.objects, frame.objects)
        assert (invented, missed) == ([], [])
        for each, true in pairs:
            assert each.shape.type == true.kind
            off = errors(each, true)
            assert off.center < 4 * MILLIMETRE
            assert off.height < 4 * MILLIMETRE


def test_without_noise_a_box_is_as_large_as_it_is_to_a_third_of_a_pixel() -> None:
    true = box(TISSUE_BOX, 0.5, 0.1, yaw=0.4)
    frame = seen([true], overhead_camera(), np.random.default_rng(0), noise=NOISELESS)
    (one,) = perceived(frame).findings.objects
    off = errors(one, true)
    assert off.center < MILLIMETRE
    assert off.yaw is not None
    assert off.yaw < math.radians(0.3)
    assert off.height < 0.2 * MILLIMETRE
    # What pixels that mix both sides of an edge cost is added, here for nothing.
    assert off.sides < 2 * MILLIMETRE


def test_an_empty_table_has_no_objects() -> None:
    found = perceived(photographed())
    assert (found.findings.objects, found.findings.unrecognised) == ((), ())
    assert found.plane.height_at(0.45, 0.0) == pytest.approx(TABLE_TOP, abs=2 * MILLIMETRE)


def test_an_image_that_is_upside_down_shows_the_same_objects() -> None:
    objects = (box(TISSUE_BOX, 0.3, 0.2, 0.3), box(DOMINO, 0.6, -0.1, 1.0), can(0.5, 0.3))
    for roll in (0.0, math.pi):
        found = perceived(photographed(*objects, roll=roll))
        pairs, invented, missed = matched(found.findings.objects, objects)
        assert (len(pairs), invented, missed) == (3, [], [])


def test_a_camera_whose_pose_is_upside_down_is_refused() -> None:
    frame = photographed(can(0.5, 0.0))
    turned = replace(frame.camera, T_world_camera=frame.camera.T_world_camera @ transform(rotation_x(math.pi)))
    with pytest.raises(ScanRefused, match="pose"):
        perceived(frame, DepthView.from_depth(frame.depth, turned))


@pytest.mark.parametrize("gap", [0.006, 0.012])
def test_boxes_side_by_side_are_told_apart_by_a_gap_of_two_pixels(gap: float) -> None:
    objects = [box(TISSUE_BOX, 0.45, y) for y in (0.0, TISSUE_BOX[1] + gap)]
    pairs, invented, missed = matched(perceived(photographed(*objects)).findings.objects, objects)
    assert (len(pairs), invented, missed) == (2, [], [])


def test_boxes_that_touch_and_are_of_different_heights_are_told_apart() -> None:
    objects = [box(TISSUE_BOX, 0.45, 0.0), box((0.24, 0.115, 0.09), 0.45, 0.115)]
    pairs, invented, missed = matched(perceived(photographed(*objects)).findings.objects, objects)
    assert (len(pairs), invented, missed) == (2, [], [])


def test_boxes_of_one_height_that_touch_out_of_line_are_not_one_box() -> None:
    objects = [box(TISSUE_BOX, 0.45, 0.0), box(TISSUE_BOX, 0.50, 0.115)]
    found = perceived(photographed(*objects)).findings
    pairs, invented, _ = matched(found.objects, objects)
    assert invented == []
    assert len(pairs) == 2 or found.unrecognised


def test_a_box_on_a_box_stands_on_it() -> None:
    low, high = box(TISSUE_BOX, 0.5, 0.0, 0.2), box(DOMINO, 0.5, 0.0, 1.2, above=TISSUE_BOX[2])
    pairs, invented, missed = matched(perceived(photographed(low, high)).findings.objects, [low, high])
    assert (invented, missed) == ([], [])
    by_truth = {id(true): each for each, true in pairs}
    assert by_truth[id(high)].supported_by == by_truth[id(low)].name
    assert by_truth[id(low)].supported_by == "table"
    assert by_truth[id(high)].height == pytest.approx(DOMINO[2], abs=4 * MILLIMETRE)


def test_a_can_is_as_wide_as_its_body_not_as_its_rim() -> None:
    for x, y in ((0.45, 0.0), (0.6, 0.3)):
        (one,) = perceived(photographed(can(x, y))).findings.objects
        assert one.shape.type == "cylinder"
        assert 2.0 * one.shape.radius == pytest.approx(CAN[0], abs=5 * MILLIMETRE)


@pytest.mark.parametrize(
    "thing",
    [
        Turned(((-0.06, 0.06), (0.06, 0.001)), on_table(0.5, 0.0, 0.12)),
        cylinder(0.04, 0.15, transform(rotation_x(0.5 * math.pi), [0.5, 0.0, TABLE_TOP + 0.04])),
        Turned(((0.0, 0.07), (0.02, 0.06), (0.04, 0.045), (0.055, 0.02), (0.06, 0.001)), on_table(0.5, 0.0, 0.0)),
    ],
    ids=["cone", "lying cylinder", "dome"],
)
def test_what_is_neither_box_nor_upright_cylinder_is_told_and_not_invented(thing: Thing) -> None:
    found = perceived(photographed(others=(thing,))).findings
    assert found.objects == ()
    assert len(found.unrecognised) >= 1
    assert all(np.linalg.norm(piece.outline.mean(axis=0) - [0.5, 0.0]) < 0.05 for piece in found.unrecognised)


def test_an_object_that_the_image_cuts_is_told_and_not_measured() -> None:
    frame = photographed(box(TISSUE_BOX, 0.45, 0.0, 0.3), box(TISSUE_BOX, 0.45, 0.5))
    width = 200
    cut = replace(frame, depth=frame.depth[:, 56:])
    moved = replace(frame.camera, cx=frame.camera.cx - 56)
    column = round(moved.cx - 0.5 / 1.15 * moved.fx)
    cut = replace(frame, depth=cut.depth[:, max(0, column) :], camera=replace(moved, cx=moved.cx - max(0, column)))
    assert cut.depth.shape[1] > width
    found = perceived(cut).findings
    pairs, invented, _ = matched(found.objects, frame.objects)
    assert ([true.T_world_object[1, 3] for _, true in pairs], invented) == ([0.0], [])
    assert any("border" in piece.reason for piece in found.unrecognised)


def test_clutter_gives_no_object_that_is_not_there() -> None:
    rng = np.random.default_rng(5)
    heap = [
        TrueObject("box", tuple(rng.uniform(0.02, 0.12, 3)), transform(
            rotation_z(rng.uniform(0, 3)) @ rotation_x(rng.uniform(-1.2, 1.2)),
            [0.45 + rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1), TABLE_TOP + rng.uniform(0.02, 0.08)],
        ))
        for _ in range(25)
    ]  # fmt: skip
    found = perceived(photographed(box(TISSUE_BOX, 0.45, 0.4), others=tuple(one.thing() for one in heap))).findings
    sizes = [each for each in found.objects if each.T_world_object[1, 3] < 0.25]
    tops = [one for one in heap if abs(one.T_world_object[2, 2]) > 0.99]
    assert len(sizes) <= len(tops)
    assert found.unrecognised


def test_an_object_off_the_table_is_none() -> None:
    outside = TrueObject("box", TISSUE_BOX, transform(position=[1.1, 0.0, TABLE_TOP + 0.03]))
    assert perceived(photographed(outside)).findings.objects == ()


@pytest.mark.parametrize("organised", [True, False])
def test_a_cloud_shows_what_its_depth_image_shows(organised: bool) -> None:
    frame = photographed(box(TISSUE_BOX, 0.4, 0.2, 0.5), can(0.6, -0.2))
    view = DepthView.from_depth(frame.depth, frame.camera)
    points = np.dstack([view.rays * view.depth[..., None], view.depth])
    if organised:
        view = DepthView.from_organised(points, frame.camera.T_world_camera)
    else:
        flat = points.reshape(-1, 3)
        shuffled = flat[np.random.default_rng(1).permutation(len(flat))]
        view = DepthView.from_points(shuffled, frame.camera.T_world_camera)
    pairs, invented, missed = matched(perceived(frame, view).findings.objects, frame.objects)
    assert (len(pairs), invented, missed) == (2, [], [])
    for each, true in pairs:
        assert errors(each, true).sides < 10 * MILLIMETRE


@pytest.mark.parametrize("depth", [np.full((100, 100), np.nan), np.zeros((100, 100)), np.full((100, 100), -1.0)])
def test_an_image_without_measurements_is_refused(depth: np.ndarray) -> None:
    with pytest.raises(ScanRefused, match="points between"):
        DepthView.from_depth(depth, overhead_camera())


def test_points_that_are_all_one_are_refused() -> None:
    points = np.tile([0.0, 0.0, 1.15], (5000, 1))
    with pytest.raises(ScanRefused, match="points between"):
        DepthView.from_points(points, overhead_camera().T_world_camera)


@pytest.mark.slow
def test_19_of_20_errors_are_within_twice_what_is_told() -> None:
    told: dict[str, list[float]] = {}
    for seen_frame in frames(FRAMES, 31):
        view = DepthView.from_depth(seen_frame.depth, seen_frame.camera)
        found = perceive_objects(view, KnownPlace(TABLE_TOP), PerceptionSettings(), np.random.default_rng(0)).findings
        for each, true in matched(found.objects, seen_frame.objects)[0]:
            for name, values in errors(each, true).told.items():
                told.setdefault(name, []).extend(values)
    # The errors of one frame go together, since its depths drift together: frames count, not errors.
    slack = 3.0 * math.sqrt(0.95 * 0.05 / FRAMES)
    for name, values in told.items():
        assert np.mean(np.array(values) < 2.0) > 0.95 - slack, name
        assert np.mean(np.array(values) < 1.0) < 0.95, name


@pytest.mark.slow
def test_a_heap_of_points_with_shadows_is_perceived_as_the_image_it_comes_from() -> None:
    things = [TrueObject("box", (0.2, 0.12, 0.12), on_table(0.45, y, 0.12)) for y in (-0.3, 0.3)]
    camera = overhead_camera(focal=730.0, shape=(848, 1024))
    shape = (848, 1024)
    depth = depth_image(
        [table(), floor(), *(one.thing() for one in things)], camera, np.random.default_rng(5), shape=shape
    )
    rays = camera.rays(shape[1], shape[0])
    points = np.dstack([rays * depth[..., None], depth]).reshape(-1, 3)
    view = DepthView.from_points(points[np.isfinite(points).all(axis=1)], camera.T_world_camera)
    found = perceive_objects(view, KnownPlace(TABLE_TOP), PerceptionSettings(), np.random.default_rng(0)).findings
    assert len(matched(found.objects, things)[0]) == len(things)


def test_an_image_that_is_too_large_is_thinned_with_its_camera() -> None:
    camera = overhead_camera()
    whole = Camera(4 * camera.fx, 4 * camera.fy, 4 * camera.cx, 4 * camera.cy, camera.T_world_camera)
    depth = np.full((1696, 2048), 1.2)
    view = DepthView.from_depth(depth, whole)
    assert view.depth.size <= LARGEST_IMAGE
    step = round(2048 / view.shape[1])
    np.testing.assert_allclose(view.rays, whole.rays(2048, 1696)[::step, ::step], atol=1e-12)
