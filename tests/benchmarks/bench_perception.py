"""Errors of perception on seeded frames: boards of markers in pictures, objects in depth images."""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from planners.geometry.pose import Array, rotation_angle, rotation_x, rotation_z, transform
from planners.perception.depth_view import DepthView
from planners.perception.marker_board import BoardNotSeen, MarkerBoard, find_board
from planners.perception.object_finder import KnownPlace, perceive_objects
from planners.perception.perception_settings import PerceptionSettings
from tests.benchmarks.tasks import Note
from tests.support.colour_camera import eye_camera, looking_at, studio, window_round
from tests.support.depth_camera import TABLE_CENTER, TABLE_SIZE, TABLE_TOP
from tests.support.scan_frames import tool_board
from tests.support.table_frames import errors as object_errors
from tests.support.table_frames import frames, matched

BOARD = MarkerBoard("4x4_50", (0, 1, 2, 3), 2, 0.030, 0.006)
BOARD_DISTANCE = 0.35
"""From the camera [m]."""
STEEPEST = 0.6
"""Largest angle between the board's normal and the way to the camera [rad]."""
SEED = 2026


@dataclass
class BoardFigures:
    """Of one board."""

    seen: int = 0
    missed: int = 0
    position: list[float] = field(default_factory=list)
    """[mm]"""
    rotation: list[float] = field(default_factory=list)
    """[deg]"""
    told: dict[str, list[float]] = field(default_factory=lambda: {"position": [], "rotation": []})
    """Errors in uncertainties that were told [1]."""


@dataclass
class ObjectFigures:
    """Of all objects of all frames."""

    frames: int = 0
    objects: int = 0
    found: int = 0
    invented: int = 0
    wrong_kind: int = 0
    unrecognised: int = 0
    milliseconds: list[float] = field(default_factory=list)
    """CPU time of each frame."""
    center: list[float] = field(default_factory=list)
    """[mm]"""
    yaw: list[float] = field(default_factory=list)
    """[deg]"""
    sides: list[float] = field(default_factory=list)
    """The worse one [mm]."""
    height: list[float] = field(default_factory=list)
    """[mm]"""
    told: dict[str, list[float]] = field(default_factory=dict)
    """Errors in uncertainties that were told [1], by what they are errors of."""


def measure_boards(count: int, note: Note) -> dict[str, BoardFigures]:
    """Look for boards at random places of the table, from random directions at one distance."""
    own, _ = tool_board()
    boards = {"2 x 2 of 30 mm": BOARD, f"the tool's, 2 x 2 of {1e3 * own.marker:.0f} mm": own}
    return {name: _measure_board(board, count, note) for name, board in boards.items()}


def _measure_board(board: MarkerBoard, count: int, note: Note) -> BoardFigures:
    figures = BoardFigures()
    corners = np.vstack(list(board.corners().values()))
    with tempfile.TemporaryDirectory() as folder, studio(Path(folder)) as opened:
        opened.box(TABLE_SIZE, transform(position=TABLE_CENTER), (0.6, 0.5, 0.4))
        body = opened.board(board, np.eye(4))
        for index in range(count):
            if index % 50 == 0:
                note(f"perception: board {index} of {count}")
            rng = np.random.default_rng([SEED, index])
            R = rotation_z(rng.uniform(-math.pi, math.pi)) @ rotation_x(rng.uniform(-0.1, 0.1))
            T_world_board = transform(R, [rng.uniform(0.2, 0.5), rng.uniform(-0.3, 0.3), TABLE_TOP + 0.25])
            opened.move(body, T_world_board)
            target = T_world_board[:3, 3] + rng.uniform(-0.03, 0.03, 3)
            tilt, azimuth, roll = rng.uniform(0, STEEPEST), *rng.uniform(-math.pi, math.pi, 2)
            camera = eye_camera(looking_at(target, BOARD_DISTANCE, tilt, azimuth, roll))
            in_world: Array = corners @ R.T + T_world_board[:3, 3]
            picture = opened.picture(camera, rng, window=window_round(camera, in_world))
            found = find_board(picture, camera, board)
            if isinstance(found, BoardNotSeen):
                figures.missed += 1
                continue
            figures.seen += 1
            off = float(np.linalg.norm(found.T_world_board[:3, 3] - T_world_board[:3, 3]))
            angle = rotation_angle(found.T_world_board[:3, :3], R)
            figures.position.append(1e3 * off)
            figures.rotation.append(math.degrees(angle))
            figures.told["position"].append(off / found.position_std)
            figures.told["rotation"].append(angle / found.rotation_std)
    return figures


def measure_objects(count: int, note: Note) -> ObjectFigures:
    """Look for objects in frames of tables."""
    figures = ObjectFigures()
    surroundings, settings = KnownPlace(TABLE_TOP), PerceptionSettings()
    for index, frame in enumerate(frames(count, SEED)):
        if index % 20 == 0:
            note(f"perception: frame {index} of {count}")
        begun = time.process_time()
        view = DepthView.from_depth(frame.depth, frame.camera)
        found = perceive_objects(view, surroundings, settings, np.random.default_rng(0)).findings
        figures.milliseconds.append(1e3 * (time.process_time() - begun))
        pairs, invented, _ = matched(found.objects, frame.objects)
        figures.frames += 1
        figures.objects += len(frame.objects)
        figures.found += len(pairs)
        figures.invented += len(invented)
        figures.unrecognised += len(found.unrecognised)
        for each, true in pairs:
            if each.shape.type != true.kind:
                figures.wrong_kind += 1
                continue
            off = object_errors(each, true)
            figures.center.append(1e3 * off.center)
            figures.sides.append(1e3 * off.sides)
            figures.height.append(1e3 * off.height)
            if off.yaw is not None:
                figures.yaw.append(math.degrees(off.yaw))
            for name, values in off.told.items():
                figures.told.setdefault(name, []).extend(values)
    return figures
