"""The part of RESULTS.md on perception."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.benchmarks.bench_perception import BoardFigures, ObjectFigures, measure_boards, measure_objects
from tests.benchmarks.bench_perception_bounds import Bound, measure_bounds
from tests.benchmarks.effort import Effort
from tests.benchmarks.markdown import table
from tests.benchmarks.part import Findings, Limit
from tests.benchmarks.tasks import Note

POSITION, ROTATION = 0.7, 0.2
"""Median errors of a board of markers [mm, deg]."""
CENTER, YAW, SIDES, HEIGHT = 2.0, 1.0, 3.0, 3.0
"""Median errors of objects [mm, deg, mm, mm]."""
SECONDS, MEGABYTES = 20.0, 900.0
"""Of CPU time, and of memory beyond what the process has anyway, for any scan that is let in [s, MB]."""
COVERED = 0.95
"""Share of errors that are within twice the uncertainty that is told [1]."""
FOUND = 0.98
"""Share of the objects [1]."""


def measure(effort: Effort, note: Note, folder: Path) -> Findings:
    """Measure the errors on seeded frames."""
    del folder
    bounds = measure_bounds(note, effort.scan_share)
    boards = measure_boards(effort.frames, note)
    objects = measure_objects(effort.frames, note)
    return Findings(
        [*_limits(boards, objects), *_bound_limits(bounds)],
        [_boards_told(boards), _objects_told(objects), _coverage_told(boards, objects), _bounds_told(bounds)],
    )


def _limits(boards: dict[str, BoardFigures], objects: ObjectFigures) -> list[Limit]:
    medians = [
        *(
            (f"board of markers, {name}, at 0.35 m: position, median [mm]", board.position, POSITION)
            for name, board in boards.items()
        ),
        *(
            (f"board of markers, {name}, at 0.35 m: rotation, median [deg]", board.rotation, ROTATION)
            for name, board in boards.items()
        ),
        ("objects: centre, median [mm]", objects.center, CENTER),
        ("objects: yaw, median [deg]", objects.yaw, YAW),
        ("objects: worse side, median [mm]", objects.sides, SIDES),
        ("objects: height, median [mm]", objects.height, HEIGHT),
    ]
    limits = [Limit(what, f"≤ {limit:g}", _median(values), _median(values) <= limit) for what, values, limit in medians]
    share = objects.found / objects.objects
    counts = [
        Limit("objects found", f"≥ {FOUND:.0%}", f"{objects.found} of {objects.objects}", share >= FOUND),
        Limit("objects invented", "none", objects.invented, objects.invented == 0),
        Limit("objects taken for the other kind", "none", objects.wrong_kind, objects.wrong_kind == 0),
    ]
    told = [(f"objects: {name}", values) for name, values in objects.told.items()]
    told += [(f"{name}: {what}", values) for name, board in boards.items() for what, values in board.told.items()]
    shares = [
        Limit(
            f"{what}, errors within twice what is told",
            f"≥ {COVERED:.0%}",
            f"{_covered(values):.1%}",
            _covered(values) >= COVERED,
        )
        for what, values in told
    ]
    return [*limits, *counts, *shares]


def _covered(values: Sequence[float], within: float = 2.0) -> float:
    """Return the share of errors, in uncertainties that were told, that are within so many of them."""
    return float(np.mean(np.array(values) <= within))


def _median(values: Sequence[float]) -> float:
    return float(np.median(values))


def _row(what: str, values: Sequence[float]) -> tuple[str, int, float, float, float]:
    return what, len(values), _median(values), float(np.quantile(values, 0.9)), float(np.max(values))


HEAD = ("", "number", "median", "nine of ten below", "largest")


def _boards_told(boards: dict[str, BoardFigures]) -> str:
    rows = []
    for name, board in boards.items():
        rows.append(_row(f"{name}: position [mm]", board.position))
        rows.append(_row(f"{name}: rotation [deg]", board.rotation))
    missed = ", ".join(f"{name}: {board.missed} of {board.missed + board.seen}" for name, board in boards.items())
    text = (
        "Pictures of 1280 x 720 pixels from a simulated camera (938 px focal length) 0.35 m away, up to 34° off the "
        f"board's normal, with noise of 3 grey levels. Not seen: {missed}."
    )
    return f"### Boards of markers\n\n{text}\n\n" + table(HEAD, rows)


def _objects_told(objects: ObjectFigures) -> str:
    rows = [
        _row("centre [mm]", objects.center),
        _row("yaw [deg]", objects.yaw),
        _row("worse side, or diameter [mm]", objects.sides),
        _row("height [mm]", objects.height),
        _row("CPU time of a frame [ms]", objects.milliseconds),
    ]
    text = (
        f"{objects.frames} depth images of 512 x 424 pixels, cast by rays from about 1.15 m above the table, of three "
        "to six tissue boxes, dominoes, cans, other boxes and cylinders, at times a domino on a box. Noise: 1.5 mm "
        "along the ray and more with distance and slant, 0.4 px across, three of ten pixels on edges mixed, 0.5 % "
        "lost, a slow drift of 1.5 mm. Yaw is that of boxes whose sides differ by more than 15 %. "
        f"Pieces told as not recognised: {objects.unrecognised}."
    )
    return f"### Objects on the table\n\n{text}\n\n" + table(HEAD, rows)


def _coverage_told(boards: dict[str, BoardFigures], objects: ObjectFigures) -> str:
    told = {f"objects: {name}": values for name, values in objects.told.items()}
    told |= {f"{name}: {what}": values for name, board in boards.items() for what, values in board.told.items()}
    rows = [
        (what, len(values), f"{_covered(values, 1.0):.0%}", f"{_covered(values):.1%}", float(np.quantile(values, 0.95)))
        for what, values in told.items()
    ]
    text = (
        "An uncertainty u is told so that 95 % of the errors are within 2 u. Its floors were fitted on frames of "
        "another seed than those here."
    )
    head = ("", "number", "within u", "within 2 u", "95 % are within, in u")
    return f"### Uncertainties\n\n{text}\n\n" + table(head, rows)


def _bound_limits(bounds: dict[str, Bound]) -> list[Limit]:
    return [
        Limit.at_most("any scan: CPU time [s]", {name: each.seconds for name, each in bounds.items()}, SECONDS),
        Limit.at_most(
            "any scan: memory [MB]", {name: each.peak - each.base for name, each in bounds.items()}, MEGABYTES
        ),
    ]


def _bounds_told(bounds: dict[str, Bound]) -> str:
    rows = [(name, each.sent, each.seconds, each.peak - each.base, each.outcome) for name, each in bounds.items()]
    text = (
        "Scans as large as is let in, and one larger, each in a process of its own. Memory is what the process had at "
        "most, files included, beyond what it has after a small scan."
    )
    return f"### The largest scans\n\n{text}\n\n" + table(("", "files [MB]", "CPU time [s]", "memory [MB]", ""), rows)
