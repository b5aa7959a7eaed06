"""Where a board of square markers is: found by its corners, then laid over the picture as a whole."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array, Transform, transform
from planners.perception.board_alignment import align_board
from planners.perception.camera import Camera
from planners.perception.refusal import ScanRefused

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
    """Return the poses of a flat model, refined, with their errors [px], the best first."""
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
