"""The map of a study on the plate: every tile lies where the cup of its point would sit."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import viser

from app.viewer.drawing.cup_map import LIFTED, MOST_PIXELS, CupMap, cup_places, is_of_study, picture_of_tiles
from planners.geometry.pose import from_pose7
from planners.plan.plan import Plan
from planners.study.study import Study
from planners.study.study_map import StudyMap, StudyPoint
from tests.support.service import task

X = {"pointer": "/cup/position/0", "min": -0.1, "max": 0.1, "count": 3}
Y = {"pointer": "/cup/position/1", "values": [-0.05, 0.0, 0.1, 0.12]}
TOP = 0.004


def studied(*axes: dict[str, Any], known: int | None = None) -> tuple[Study, StudyMap]:
    study = Study.read({"task": task(), "axes": list(axes)})
    points = [
        StudyPoint.without_plan(study, index, "refused", "", 0.0)
        for index in range(study.count if known is None else known)
    ]
    return study, StudyMap.of(study, points)


@pytest.mark.parametrize("axes", [(X, Y), (Y, X), (X,), (Y,)])
def test_every_tile_is_centred_where_its_point_has_the_cup(axes: tuple[dict[str, Any], ...]) -> None:
    study, known = studied(*axes)
    places = cup_places(known)
    assert places is not None
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        drawn = CupMap(server.scene, "/plate/map", TOP, lambda _: None)
        drawn.paint(known, places, 0, visible=True)
        tiles = next(handle for handle in drawn._handles if isinstance(handle, viser.BatchedMeshHandle))
        for index in range(study.count):
            cup = study.document_at(index)["cup"]["position"]
            assert np.allclose(tiles.batched_positions[index], [*cup, TOP + LIFTED])
            assert places.at(np.array(cup)) == index
    finally:
        server.stop()


@pytest.mark.parametrize("axes", [(X, Y), (Y, X), (X,), ({**X, "count": 300}, Y)])
def test_the_picture_has_the_colour_of_a_point_on_its_tile_and_nothing_between_tiles(
    axes: tuple[dict[str, Any], ...],
) -> None:
    places = cup_places(studied(*axes)[1])
    assert places is not None
    numbers = np.arange(len(places.centers))
    light = np.column_stack([numbers % 251, numbers // 251, np.full(len(numbers), 7)]).astype(np.uint8)
    pixels, corner, size = picture_of_tiles(places.centers, places.step, light)

    def at(spots: np.ndarray) -> np.ndarray:
        column, row = ((spots - corner) / size * pixels.shape[1::-1]).astype(int).T
        return pixels[row, column]

    for inside in (0.0, 0.42, -0.42):
        assert np.array_equal(at(places.centers + inside * places.step)[:, :3], light)
        assert (at(places.centers + inside * places.step)[:, 3] == 255).all()
    # Of so many that their pixels have to be coarser, gaps may be too small to be seen.
    if max(pixels.shape) < MOST_PIXELS:
        assert (at(places.centers + 0.48 * places.step)[:, 3] == 0).all()


def test_a_ray_onto_a_tile_chooses_its_point_wherever_the_plate_is() -> None:
    study, known = studied(X, Y, known=5)
    places, told = cup_places(known), list[int]()
    assert places is not None
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        drawn = CupMap(server.scene, "/plate/map", TOP, told.append)
        drawn.paint(known, places, None, visible=True)
        drawn.T_world_plate = T = from_pose7([0.5, -0.2, 0.3, 0.8, 0.1, 0.2, np.sqrt(1 - 0.64 - 0.05)])
        eye = np.array([1.5, -1.0, 1.4])
        for index in range(study.count):
            cup = (T @ np.array([*study.document_at(index)["cup"]["position"], TOP + LIFTED, 1.0]))[:3]
            event: Any = viser.SceneNodePointerEvent(
                client=None, client_id=0, event="click", target=None, ray_origin=tuple(eye),
                ray_direction=tuple(cup - eye), screen_pos=(0, 0), instance_index=None, modifier=None,
            )  # fmt: skip
            drawn._clicked(event)
    finally:
        server.stop()
    # Points that are not known have no tile.
    assert told == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    "axes",
    [
        ({"pointer": "/cup/max_force", "values": [15, 20]},),
        (X, {"pointer": "/cup/max_force", "values": [15, 20]}),
        ({"pointer": "/plate_pose", "part": "yaw", "values": [0.0, 0.1]},),
    ],
)
def test_what_varies_anything_else_is_not_painted(axes: tuple[dict[str, Any], ...]) -> None:
    assert cup_places(studied(*axes)[1]) is None


@pytest.mark.parametrize(
    ("other", "same"),
    [
        ({}, True),
        ({"cup": {"position": [0.01, 0.02], "radius": 0.02, "max_force": 30}}, True),
        ({"plate_pose": [0.31, 0.0, 1.1, 1, 0, 0, 0]}, False),
        ({"cell": "dual_ur10e_lift"}, False),
        ({"plate": {"mass": 1.5}}, False),
        ({"plate": {"com": [0.01, 0.0, 0.0]}}, False),
    ],
)
def test_a_map_is_of_the_plans_that_lift_its_plate_from_its_pose(
    document: dict[str, Any], other: dict[str, Any], same: bool
) -> None:
    """Wherever the cup is, and whether or not the study says where the plate's centre of mass is: plans always do."""
    stated = {**document["task"], "plate": {**document["task"]["plate"], "com": [0.0, 0.0, 0.0]}}
    plan = Plan.read(json.dumps({**document, "task": stated}).encode())
    plate = {"com": None, **other.get("plate", {})}
    body = {**document["task"], **other, "plate": {**document["task"]["plate"], **plate}}
    study = Study.read({"task": body, "axes": [X]})
    assert is_of_study(plan, StudyMap.of(study, [])) is same
