"""Where a board of square markers is: found by its corners, then laid over the picture as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array, Transform, transform
from planners.perception.camera import Camera
from planners.perception.scan_files import ScanRefused

DICTIONARIES = {
    "4x4_50": cv2.aruco.DICT_4X4_50,
    "5x5_50": cv2.aruco.DICT_5X5_50,
    "6x6_50": cv2.aruco.DICT_6X6_50,
    "apriltag_36h11": cv2.aruco.DICT_APRILTAG_36H11,
}
"""Families of markers by their names."""
LARGEST_ERROR = 2.0
"""With corners farther off, on average, it is another board [px]."""
CORNER_NOISE = 0.15
"""Uncertainty of a corner, if the corners themselves do not tell a larger one [px]."""
ALIGNED_NOISE = 0.095
"""... of a board that was laid over the picture [px]: so large that 19 of 20 errors are within twice what is told."""
AMBIGUOUS = 1.5
"""A board that looks nearly as well from its mirrored side, at so many times the error, has two poses [1]."""
CORNER_ACCURACY, CORNER_STEPS = 0.001, 100
"""Corners are refined until they move less [px], or so often [1]."""


@dataclass(frozen=True)
class MarkerBoard:
    """A flat grid of square markers; its frame is in its middle, x along rows, y up the columns, z out of the board."""

    dictionary: str
    ids: tuple[int, ...]
    """Row by row from the top, each from the left."""
    columns: int
    """Markers in a row."""
    marker: float
    """Side of a marker [m]."""
    gap: float
    """Between markers [m]."""

    @property
    def rows(self) -> int:
        """How many rows there are."""
        return len(self.ids) // self.columns

    def corners(self) -> dict[int, Array]:
        """Return the (4, 3) corners of every marker by its id, in the board's frame, in the detector's order."""
        step = self.marker + self.gap
        square = self.marker * np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])
        middle = 0.5 * np.array([self.columns - 1, self.rows - 1])
        places = {
            marker: step * np.array([i % self.columns - middle[0], middle[1] - i // self.columns, 0.0])
            for i, marker in enumerate(self.ids)
        }
        return {marker: square + place for marker, place in places.items()}


@dataclass(frozen=True, eq=False)
class SeenBoard:
    """A board as it was seen."""

    T_world_board: Transform
    position_std: float
    """Uncertainty of its origin [m]: 19 of 20 errors are within twice as much."""
    rotation_std: float
    """... of its orientation [rad]."""
    markers: tuple[int, ...]
    """Ids of the markers that were seen."""
    error: float
    """Root of the mean square of the corners' distances from where they should be, before alignment [px]."""
    corners: Array
    """(n, 2) that were seen [px]."""


@dataclass(frozen=True)
class BoardNotSeen:
    """Why a board was not found."""

    reason: str


def find_board(image: NDArray[np.uint8], camera: Camera, board: MarkerBoard) -> SeenBoard | BoardNotSeen:
    """Find a board in a picture.

    Args:
        image: (h, w) grey or (h, w, 3) blue, green, red.
        camera: that took it.
        board: what is looked for.

    Raises:
        ScanRefused: Nobody knows the board's family of markers.
    """
    if board.dictionary not in DICTIONARIES:
        raise ScanRefused("description", f"there are no markers {board.dictionary!r}; use {', '.join(DICTIONARIES)}")
    markers, pixels = _markers(image, board)
    if not markers:
        return BoardNotSeen("none of its markers is seen")
    model = np.vstack([board.corners()[marker] for marker in markers])
    poses = _poses(model, pixels, camera)
    if not poses:
        return BoardNotSeen("its markers' corners fit no pose")
    (error, turn, move), *others = poses
    if error > LARGEST_ERROR:
        return BoardNotSeen(f"its markers are {error:.1f} pixels off where they should be: another board, or camera")
    if others and others[0][0] < AMBIGUOUS * error and len(markers) == 1:
        return BoardNotSeen("it is seen too small to tell which way it leans")
    places = board.corners()
    aligned = align_board(
        image, camera, DICTIONARIES[board.dictionary], [(marker, places[marker]) for marker in markers], turn, move
    )
    noise = ALIGNED_NOISE if aligned is not None else max(error, CORNER_NOISE)
    turn, move = aligned or (turn, move)
    rotation, _ = cv2.Rodrigues(turn)
    T_camera_board = transform(np.asarray(rotation, dtype=float), move.ravel())
    if T_camera_board[:3, 2] @ move.ravel() >= 0.0:
        return BoardNotSeen("it is seen from behind, which no board can be")
    position_std, rotation_std = _deviations(model, turn, move, camera, noise)
    return SeenBoard(camera.T_world_camera @ T_camera_board, position_std, rotation_std, markers, error, pixels)


def _markers(image: NDArray[np.uint8], board: MarkerBoard) -> tuple[tuple[int, ...], Array]:
    """Return the ids of the board's markers in a picture, and their corners (4 n, 2) [px]."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementMinAccuracy = CORNER_ACCURACY
    parameters.cornerRefinementMaxIterations = CORNER_STEPS
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[board.dictionary])
    found, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
    if ids is None:
        return (), np.empty((0, 2))
    seen: dict[int, Array] = {}
    for marker, corners in zip((int(each) for each in ids.ravel()), found, strict=True):
        if marker in board.ids and marker not in seen:
            seen[marker] = corners.reshape(4, 2).astype(float)
    kept = tuple(sorted(seen))
    return kept, np.vstack([seen[marker] for marker in kept]) if kept else np.empty((0, 2))


def _poses(model: Array, pixels: Array, camera: Camera) -> list[tuple[float, Array, Array]]:
    """Return the poses of a flat model (n, 3) seen at pixels (n, 2), refined, with errors [px], the best first."""
    K, distortion = camera.matrix, camera.distortion_array
    count, turns, moves, _ = cv2.solvePnPGeneric(model, pixels, K, distortion, flags=cv2.SOLVEPNP_IPPE)
    poses = []
    for turn, move in zip(turns[:count], moves[:count], strict=True):
        turn, move = cv2.solvePnPRefineLM(model, pixels, K, distortion, turn, move)
        projected, _ = cv2.projectPoints(model, turn, move, K, distortion)
        error = float(np.sqrt(np.mean(np.sum((projected.reshape(-1, 2) - pixels) ** 2, axis=1))))
        if np.isfinite(error) and float(move.ravel()[2]) > 0.0:
            poses.append((error, turn, move))
    return sorted(poses, key=lambda pose: pose[0])


def _deviations(model: Array, turn: Array, move: Array, camera: Camera, noise: float) -> tuple[float, float]:
    """Return the worst uncertainties of position [m] and orientation [rad] for corners with `noise` [px]."""
    _, jacobian = cv2.projectPoints(model, turn, move, camera.matrix, camera.distortion_array)
    covariance = noise**2 * np.linalg.pinv(jacobian[:, :6].T @ jacobian[:, :6])
    worst = [float(np.sqrt(np.linalg.eigvalsh(covariance[k : k + 3, k : k + 3])[-1])) for k in (3, 0)]
    return worst[0], worst[1]


CELLS_AROUND = 0.5
"""So much of the white round a marker is looked at, in cells of its print [1]."""
SAMPLES = 6
"""In each direction of a cell [1]: closer together than pixels are, with a marker of up to 36 pixels."""
BLUR = 0.5
"""Standard deviation of how far a pixel smears the print [px]."""
FINE = 16
"""Pixels of a cell in the drawing of the print [1]."""
MOST_STEPS = 12
SMALLEST_STEP = 1e-7
"""A step that moves the board less is the last one [m]."""
FARTHEST = 1.5
"""An alignment that moves corners farther from where they were seen has lost its way [px]."""
LEAST_CONTRAST = 8.0
"""Between black and white of a marker [grey levels]."""


@dataclass(frozen=True, eq=False)
class _Print:
    """Places of a board's print, with what is printed there."""

    points: Array
    """(n, 3) in the board's frame [m]."""
    values: Array
    """(n,) 0: black, 1: white, between them at edges."""
    marker: NDArray[np.intp]
    """(n,) to which marker they belong, from 0."""


def align_board(
    image: NDArray[np.uint8],
    camera: Camera,
    dictionary: int,
    corners: Sequence[tuple[int, Array]],
    turn: Array,
    move: Array,
) -> tuple[Array, Array] | None:
    """Return a better pose of a board, its rotation vector and position in the camera's frame; None if there is none.

    Args:
        image: (h, w) grey or (h, w, 3) blue, green, red.
        camera: that took it.
        dictionary: OpenCV's number of the family of markers.
        corners: id and (4, 3) corners, in the board's frame, of each marker that is seen whole [m].
        turn: (3, 1) rotation vector, from the corners [rad].
        move: (3, 1) position, from the corners [m].
    """
    grey = (cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image).astype(np.float32)
    flat = np.vstack([places for _, places in corners])
    begin = _projected(flat, turn, move, camera)
    printed = _print_of(dictionary, corners, _side(begin))
    slopes = [np.asarray(cv2.Sobel(grey, cv2.CV_32F, *axis, ksize=3, scale=0.125)) for axis in ((1, 0), (0, 1))]
    for _ in range(MOST_STEPS):
        step, contrast = _step(printed, grey, slopes, camera, turn, move, len(corners))
        if contrast < LEAST_CONTRAST:
            return None
        turn, move = turn + step[:3, None], move + step[3:, None]
        if float(np.abs(_projected(flat, turn, move, camera) - begin).max()) > FARTHEST:
            return None
        if float(np.abs(step[3:]).max()) < SMALLEST_STEP:
            break
    return turn, move


def _step(
    printed: _Print,
    grey: NDArray[np.float32],
    slopes: Sequence[NDArray[Any]],
    camera: Camera,
    turn: Array,
    move: Array,
    markers: int,
) -> tuple[Array, float]:
    """Return the change (6,) of rotation vector and position that fits best, and the least contrast of a marker.

    Each marker has a brightness and a contrast of its own: light falls unevenly.
    """
    projected, jacobian = cv2.projectPoints(printed.points, turn, move, camera.matrix, camera.distortion_array)
    x, y = (projected.reshape(-1, 2)[:, axis].astype(np.float32) for axis in (0, 1))
    seen, along_x, along_y = (
        cv2.remap(each, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).ravel().astype(float)
        for each in (grey, *slopes)
    )
    by_pose = along_x[:, None] * jacobian[0::2, :6] + along_y[:, None] * jacobian[1::2, :6]
    own = (printed.marker[:, None] == np.arange(markers)).astype(float)
    unknowns = np.hstack([by_pose, -own * printed.values[:, None], -own])
    # Radians and metres differ little in what they move; the least-squares problem is well conditioned.
    solved: Array = np.asarray(np.linalg.lstsq(unknowns.T @ unknowns, -unknowns.T @ seen, rcond=None)[0], dtype=float)
    return solved[:6], float(solved[6 : 6 + markers].min())


def _print_of(dictionary: int, corners: Sequence[tuple[int, Array]], side: float) -> _Print:
    """Return the print of markers whose sides are so long in the picture [px]."""
    family = cv2.aruco.getPredefinedDictionary(dictionary)
    cells = family.markerSize + 2
    pixels_a_cell = max(1.0, side / cells)
    rim = 2
    places = np.arange(-CELLS_AROUND + 0.5 / SAMPLES, cells + CELLS_AROUND, 1.0 / SAMPLES)
    columns, rows = np.meshgrid(places, places)
    on_drawing = [((each + rim) * FINE - 0.5).astype(np.float32) for each in (columns, rows)]
    points, values = [], []
    for marker, (top_left, top_right, _, bottom_left) in corners:
        bits = cv2.aruco.generateImageMarker(family, marker, cells).astype(float) / 255.0
        drawing = np.kron(np.pad(bits, rim, constant_values=1.0), np.ones((FINE, FINE)))
        smeared = cv2.GaussianBlur(drawing, (0, 0), BLUR * FINE / pixels_a_cell)
        values.append(cv2.remap(smeared, on_drawing[0], on_drawing[1], cv2.INTER_LINEAR).ravel())
        right, down = (top_right - top_left) / cells, (bottom_left - top_left) / cells
        points.append((top_left + columns[..., None] * right + rows[..., None] * down).reshape(-1, 3))
    marker_of = np.repeat(np.arange(len(corners)), columns.size)
    return _Print(np.vstack(points), np.concatenate(values).astype(float), marker_of)


def _side(pixels: Array) -> float:
    """Return how long a marker's side is in the picture, from the (4 n, 2) corners of all of them [px]."""
    return float(np.linalg.norm(np.diff(pixels.reshape(-1, 4, 2), axis=1), axis=2).mean())


def _projected(points: Array, turn: Array, move: Array, camera: Camera) -> Array:
    projected, _ = cv2.projectPoints(points, turn, move, camera.matrix, camera.distortion_array)
    return np.asarray(projected, dtype=float).reshape(-1, 2)
