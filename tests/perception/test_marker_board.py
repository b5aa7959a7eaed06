"""Boards of markers, found in pictures that a simulated camera takes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest

from planners.geometry.pose import Transform, inverse, rotation_angle, rotation_x, rotation_z, transform
from planners.perception.camera import Camera
from planners.perception.marker_board import BoardNotSeen, MarkerBoard, SeenBoard, find_board
from tests.support.colour_camera import Studio, drawn, eye_camera, looking_at, studio, window_round

BOARD = MarkerBoard("4x4_50", (0, 1, 2, 3), 2, 0.030, 0.006)
T_WORLD_BOARD = transform(rotation_z(0.7) @ rotation_x(0.05), [0.3, 0.1, 1.344])


@pytest.fixture(scope="module")
def photographer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    with studio(tmp_path_factory.mktemp("textures")) as opened:
        opened.board(BOARD, T_WORLD_BOARD)
        yield opened


def picture_of(photographer: Studio, camera: Camera, seed: int = 0) -> np.ndarray:
    corners = np.vstack(list(BOARD.corners().values())) @ T_WORLD_BOARD[:3, :3].T + T_WORLD_BOARD[:3, 3]
    return photographer.picture(camera, np.random.default_rng(seed), window=window_round(camera, corners))


def camera_at(tilt: float, roll: float = 0.4) -> Camera:
    return eye_camera(looking_at(T_WORLD_BOARD[:3, 3], 0.35, tilt, 1.0, roll))


@pytest.mark.parametrize("tilt", [0.1, 0.3, 0.6])
@pytest.mark.parametrize("roll", [0.4, 0.4 + math.pi])
def test_a_board_is_found_where_it_is(photographer: Studio, tilt: float, roll: float) -> None:
    camera = camera_at(tilt, roll)
    seen = find_board(picture_of(photographer, camera), camera, BOARD)
    assert isinstance(seen, SeenBoard)
    assert seen.markers == BOARD.ids
    off = np.linalg.norm(seen.T_world_board[:3, 3] - T_WORLD_BOARD[:3, 3])
    assert off < 1.5e-3
    assert rotation_angle(seen.T_world_board[:3, :3], T_WORLD_BOARD[:3, :3]) < math.radians(1.0)


def projected(camera: Camera, T_world_board: Transform) -> np.ndarray:
    """Draw a board by a homography: another renderer, without an error of its own."""
    image = drawn(BOARD)
    height, width = image.shape
    metres = BOARD.marker / 160
    corners = np.array([[-0.5, -0.5], [width - 0.5, -0.5], [width - 0.5, height - 0.5], [-0.5, height - 0.5]])
    x, y = 0.5 * metres * width, 0.5 * metres * height
    in_board = np.array([[-x, y, 0.0], [x, y, 0.0], [x, -y, 0.0], [-x, -y, 0.0]])
    pixels = camera.pixels(in_board @ T_world_board[:3, :3].T + T_world_board[:3, 3])
    H, _ = cv2.findHomography(corners, pixels)
    return cv2.warpPerspective(image, H, (1280, 720), flags=cv2.INTER_AREA, borderValue=200)


def test_the_pose_is_right_with_another_renderer_too() -> None:
    camera = camera_at(0.4)
    seen = find_board(projected(camera, T_WORLD_BOARD), camera, BOARD)
    assert isinstance(seen, SeenBoard)
    assert np.linalg.norm(seen.T_world_board[:3, 3] - T_WORLD_BOARD[:3, 3]) < 1e-3
    assert rotation_angle(seen.T_world_board[:3, :3], T_WORLD_BOARD[:3, :3]) < math.radians(0.5)


@pytest.mark.parametrize("tilt", [0.05, 0.3, 0.6])
def test_a_board_laid_over_the_picture_is_nearer_than_its_corners_tell(photographer: Studio, tilt: float) -> None:
    camera = camera_at(tilt)
    off: dict[str, list[float]] = {"corners": [], "aligned": []}
    for seed in range(4):
        seen = find_board(picture_of(photographer, camera, seed), camera, BOARD)
        assert isinstance(seen, SeenBoard)
        model = np.vstack([BOARD.corners()[marker] for marker in seen.markers])
        _, turn, move = cv2.solvePnP(model, seen.corners, camera.matrix, camera.distortion_array)
        T_camera_board = transform(
            np.asarray(cv2.Rodrigues(turn)[0], dtype=float), np.asarray(move, dtype=float).ravel()
        )
        for name, T in (("corners", camera.T_world_camera @ T_camera_board), ("aligned", seen.T_world_board)):
            off[name].append(float(np.linalg.norm(T[:3, 3] - T_WORLD_BOARD[:3, 3])))
    assert np.mean(off["aligned"]) < 0.7 * np.mean(off["corners"])
    assert np.mean(off["aligned"]) < 0.3e-3


@pytest.mark.parametrize("light", [(0.4, 0.0), (0.25, 140.0), (1.3, -30.0)])
def test_the_pose_does_not_depend_on_the_light(photographer: Studio, light: tuple[float, float]) -> None:
    camera, (contrast, brightness) = camera_at(0.3), light
    plain = picture_of(photographer, camera)
    ramp = np.linspace(0.8, 1.0, plain.shape[1])[None, :, None]
    lit = np.clip(contrast * plain * ramp + brightness, 0, 255).astype(np.uint8)
    seen = find_board(lit, camera, BOARD)
    assert isinstance(seen, SeenBoard)
    assert np.linalg.norm(seen.T_world_board[:3, 3] - T_WORLD_BOARD[:3, 3]) < 0.6e-3


def test_a_picture_without_markers_has_no_board() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (480, 640, 3)).astype(np.uint8)
    assert isinstance(find_board(noise, camera_at(0.2), BOARD), BoardNotSeen)


def test_another_board_is_not_taken_for_it(photographer: Studio) -> None:
    camera = camera_at(0.3)
    image = picture_of(photographer, camera)
    other = replace(BOARD, ids=(10, 11, 12, 13))
    assert find_board(image, camera, other) == BoardNotSeen("none of its markers is seen")
    swapped = replace(BOARD, ids=(3, 1, 2, 0))
    assert isinstance(find_board(image, camera, swapped), BoardNotSeen)


def test_the_corners_of_a_board_are_a_grid_of_squares_round_its_middle() -> None:
    corners = BOARD.corners()
    every = np.vstack(list(corners.values()))
    np.testing.assert_allclose(every.mean(axis=0), 0.0, atol=1e-12)
    for square in corners.values():
        np.testing.assert_allclose(np.linalg.norm(np.roll(square, 1, axis=0) - square, axis=1), BOARD.marker)
    first, second, third, _ = (corners[i].mean(axis=0) for i in BOARD.ids)
    np.testing.assert_allclose(second - first, [0.036, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(third - first, [0.0, -0.036, 0.0], atol=1e-12)


def test_a_distorting_lens_is_undone() -> None:
    straight = camera_at(0.3)
    bent = replace(straight, distortion=(0.1, -0.05, 0.001, -0.001))
    rays = bent.rays(64, 48)
    points = np.dstack([rays, np.ones(rays.shape[:2])]).reshape(-1, 3)
    T = bent.T_world_camera
    pixels = bent.pixels(points @ T[:3, :3].T + T[:3, 3]).reshape(48, 64, 2)
    columns, rows = np.meshgrid(np.arange(64), np.arange(48))
    np.testing.assert_allclose(pixels, np.dstack([columns, rows]), atol=0.05)
    np.testing.assert_allclose(inverse(T) @ T, np.eye(4), atol=1e-12)
