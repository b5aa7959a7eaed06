"""Pictures of marker boards and of the suction tool, taken by PyBullet's camera."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pybullet
from numpy.typing import NDArray

from planners.geometry.pose import Array, Transform, inverse, to_pose7, transform
from planners.perception.camera import Camera
from planners.perception.marker_board import DICTIONARIES, MarkerBoard

WIDTH, HEIGHT = 1280, 720
FOCAL = 938.0
"""[px]: 42 degrees up and down."""
FINER = 2
"""Pictures are drawn so much finer and averaged: a pixel sees an area, the renderer looks at points."""
NEAR, FAR = 0.02, 10.0
Window = tuple[int, int, int, int]
"""Left, top, width, height of a part of the picture [px]."""
PIXELS_A_MARKER = 160
QUIET = 0.1
"""White rim of a drawn board, in markers."""


def eye_camera(T_world_camera: Transform) -> Camera:
    """Return the camera of `picture`."""
    return Camera(FOCAL, FOCAL, 0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1), T_world_camera)


def looking_at(target: Array, distance: float, tilt: float, azimuth: float, roll: float) -> Transform:
    """Return a camera's pose at a distance from a target, `tilt` off the vertical above it."""
    back = np.array([math.sin(tilt) * math.cos(azimuth), math.sin(tilt) * math.sin(azimuth), math.cos(tilt)])
    z = -back
    x = np.cross([math.cos(roll), math.sin(roll), 0.0], z)
    x /= np.linalg.norm(x)
    return transform(np.column_stack([x, np.cross(z, x), z]), target + distance * back)


def drawn(board: MarkerBoard) -> NDArray[np.uint8]:
    """Return a board as a picture, with a white rim."""
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[board.dictionary])
    gap, rim = round(PIXELS_A_MARKER * board.gap / board.marker), round(QUIET * PIXELS_A_MARKER)
    step = PIXELS_A_MARKER + gap
    size = (board.rows * step - gap + 2 * rim, board.columns * step - gap + 2 * rim)
    image = np.full(size, 255, np.uint8)
    for i, marker in enumerate(board.ids):
        r, c = rim + step * (i // board.columns), rim + step * (i % board.columns)
        image[r : r + PIXELS_A_MARKER, c : c + PIXELS_A_MARKER] = cv2.aruco.generateImageMarker(
            dictionary, marker, PIXELS_A_MARKER
        )
    return image


class Studio:
    """A PyBullet world with a table in which pictures are taken."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._client = pybullet.connect(pybullet.DIRECT)

    def close(self) -> None:
        pybullet.disconnect(self._client)

    def box(self, size: tuple[float, float, float], T_world_box: Transform, colour: tuple[float, float, float]) -> int:
        shape = pybullet.createVisualShape(
            pybullet.GEOM_BOX,
            halfExtents=[0.5 * length for length in size],
            rgbaColor=[*colour, 1.0],
            physicsClientId=self._client,
        )
        return self._body(shape, T_world_box)

    def cylinder(
        self, radius: float, height: float, T_world_cylinder: Transform, colour: tuple[float, float, float]
    ) -> int:
        shape = pybullet.createVisualShape(
            pybullet.GEOM_CYLINDER,
            radius=radius,
            length=height,
            rgbaColor=[*colour, 1.0],
            physicsClientId=self._client,
        )
        return self._body(shape, T_world_cylinder)

    def board(self, board: MarkerBoard, T_world_board: Transform) -> int:
        image = drawn(board)
        metres = board.marker / PIXELS_A_MARKER
        x, y = 0.5 * metres * image.shape[1], 0.5 * metres * image.shape[0]
        mesh = self._folder / "board.obj"
        mesh.write_text(
            f"v {-x} {-y} 0\nv {x} {-y} 0\nv {x} {y} 0\nv {-x} {y} 0\n"
            "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\nf 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1\n"
        )
        texture = self._folder / f"board_{'_'.join(map(str, board.ids))}.png"
        cv2.imwrite(str(texture), image)
        shape = pybullet.createVisualShape(
            pybullet.GEOM_MESH, fileName=str(mesh), rgbaColor=[1, 1, 1, 1], physicsClientId=self._client
        )
        body = self._body(shape, T_world_board)
        loaded = pybullet.loadTexture(str(texture), physicsClientId=self._client)
        pybullet.changeVisualShape(body, -1, textureUniqueId=loaded, physicsClientId=self._client)
        return body

    def move(self, body: int, T_world_body: Transform) -> None:
        position, orientation = _bullet_pose(T_world_body)
        pybullet.resetBasePositionAndOrientation(body, position, orientation, physicsClientId=self._client)

    def picture(
        self, camera: Camera, rng: np.random.Generator, noise: float = 3.0, window: Window = (0, 0, WIDTH, HEIGHT)
    ) -> NDArray[np.uint8]:
        """Return (h, w, 3) blue, green, red, with normal noise of a standard deviation [grey levels].

        Outside of the window there is only noise.
        """
        left, top, width, height = window
        to_gl = np.diag([1.0, -1.0, -1.0, 1.0]) @ inverse(camera.T_world_camera)
        fine = (FINER * width, FINER * height)
        _, _, rgba, _, _ = pybullet.getCameraImage(
            *fine,
            to_gl.T.ravel().tolist(),
            _frustum(camera, window),
            lightDirection=[0.3, 0.2, 1.0],
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        drawn_finer = np.asarray(rgba, dtype=np.uint8).reshape(fine[1], fine[0], 4)[..., 2::-1]
        image = np.full((HEIGHT, WIDTH, 3), 128.0, np.float32)
        image[top : top + height, left : left + width] = cv2.resize(
            drawn_finer, (width, height), interpolation=cv2.INTER_AREA
        )
        image += noise * rng.standard_normal(image.shape, dtype=np.float32)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def _body(self, shape: int, T_world_body: Transform) -> int:
        position, orientation = _bullet_pose(T_world_body)
        return pybullet.createMultiBody(
            baseVisualShapeIndex=shape, basePosition=position, baseOrientation=orientation, physicsClientId=self._client
        )


def window_round(camera: Camera, points: Array, rim: int = 30) -> Window:
    """Return the part of a picture that shows (n, 3) points in the world."""
    pixels = camera.pixels(points)
    low = np.clip(np.floor(pixels.min(axis=0)).astype(int) - rim, 0, [WIDTH - 16, HEIGHT - 16])
    high = np.clip(np.ceil(pixels.max(axis=0)).astype(int) + rim, low + 16, [WIDTH, HEIGHT])
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


def _frustum(camera: Camera, window: Window) -> list[float]:
    """Return the projection of a part of a picture. The renderer samples the corners of its pixels: as OpenCV counts,
    the middle of its image is at (width / 2, height / 2 - 1)."""
    left, top, width, height = window
    columns = left + (np.array([0.0, FINER * width]) - 0.5 * (FINER - 1)) / FINER
    rows = top + (np.array([-1.0, FINER * height - 1.0]) - 0.5 * (FINER - 1)) / FINER
    x = NEAR * (columns - camera.cx) / camera.fx
    y = NEAR * (camera.cy - rows) / camera.fy
    return list(pybullet.computeProjectionMatrix(x[0], x[1], y[1], y[0], NEAR, FAR))


@contextmanager
def studio(folder: Path) -> Iterator[Studio]:
    """Open a studio that keeps its textures in a folder."""
    opened = Studio(folder)
    try:
        yield opened
    finally:
        opened.close()


def _bullet_pose(T: Transform) -> tuple[list[float], list[float]]:
    x, y, z, qw, qx, qy, qz = to_pose7(T)
    return [x, y, z], [qx, qy, qz, qw]
