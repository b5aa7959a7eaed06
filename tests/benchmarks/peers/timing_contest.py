"""Time along the paths that were found: ours, toppra on the same blended paths, Ruckig on their legs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from planners.geometry.pose import Array
from planners.motion.blended_path import BlendedPath
from planners.motion.timing import JointLimits, TimingSettings, time_path
from tests.benchmarks.peers.contest import Contest, Entry, Samples, answers_of, tried
from tests.benchmarks.peers.motion_contest import MotionCases
from tests.benchmarks.tasks import Note

TOLERANCE = 0.01
"""Share by which a limit may be exceeded."""
OFF_LINE = 1e-4
"""That a motion may be off the path that was found free [rad]."""
TEXT = (
    "The paths of the same run, corners rounded as far as they are free, from rest to rest. Ours ramps accelerations "
    "within 0.08 s. *toppra* gets the same blended paths as a geometric path of its own kind, piece by piece between "
    "stops, with our grid points, by which it takes a fifth of the time that those it proposes take it; Seidel's "
    "solver, constant acceleration between grid points. It has no limit of jerk, and so less to obey. *Ruckig* obeys "
    "the jerk that is as steep as our ramps, from rest to rest on each leg, in step (phase synchronisation): its free "
    "edition passes through no waypoint, so that it stops at corners, which the others round. Samples every 20 ms are "
    "in the time of all. Solved: by the samples and the differences between them no joint exceeds velocity or "
    "acceleration by more than 1 %, and the motion begins and ends where the path does. Size: duration [s]. *One leg*: "
    "a straight line; *corners*: more."
)


def timing_contests(cases: MotionCases, note: Note) -> list[Contest]:
    """Return two contests: paths of one leg, and paths with corners."""
    limits = JointLimits(cases.cell.arms["left"].velocity_max, cases.cell.arms["left"].acceleration_max)
    paths = [
        BlendedPath.through(answer.result.path, answer.query.edge_checker)
        for answer in cases.answers
        if answer.result.path is not None
    ]
    settings = TimingSettings()
    jerk = 2.0 * limits.acceleration / settings.smoothing_time

    def ours(path: BlendedPath) -> Samples:
        timed = time_path(path, limits)
        return timed.time, timed.positions, timed.velocities, timed.accelerations

    def of_toppra() -> Entry:
        from tests.benchmarks.peers.toppra_timing import time_with_toppra

        return _timed(
            "toppra", paths, limits, lambda path: time_with_toppra(path, _pieces(path), limits, settings.sample_step)
        )

    def of_ruckig() -> Entry:
        from tests.benchmarks.peers.ruckig_timing import time_with_ruckig

        return _timed(
            "Ruckig", paths, limits, lambda path: time_with_ruckig(path.waypoints, limits, jerk, settings.sample_step)
        )

    note("peers: time laws")
    entry = _timed("ours", paths, limits, ours)
    peers = [tried("toppra", of_toppra), tried("Ruckig", of_ruckig)]
    one_leg = [i for i, path in enumerate(paths) if len(path.waypoints) == 2]
    corners = [i for i, path in enumerate(paths) if len(path.waypoints) > 2]
    return [
        Contest(
            f"time along a path, {kind} ({len(chosen)})",
            entry.of(chosen),
            [peer.of(chosen) if isinstance(peer, Entry) else peer for peer in peers],
            "duration",
            text=TEXT if number == 0 else "",
        )
        for number, (kind, chosen) in enumerate((("one leg", one_leg), ("corners", corners)))
        if chosen
    ]


def _pieces(path: BlendedPath) -> list[tuple[float, float]]:
    marks = [0.0, *path.stops, path.length]
    return list(pairwise(marks))


def _timed(
    name: str, paths: Sequence[BlendedPath], limits: JointLimits, run: Callable[[BlendedPath], Samples]
) -> Entry:
    def samples_of(path: BlendedPath) -> Samples | None:
        try:
            return run(path)
        except ArithmeticError:
            return None

    run(paths[0])
    answers, seconds = answers_of(samples_of, paths)
    solved = [
        samples is not None and keeps(samples, path.waypoints, limits)
        for samples, path in zip(answers, paths, strict=True)
    ]
    durations = [
        float(samples[0][-1]) if samples is not None and good else np.nan
        for samples, good in zip(answers, solved, strict=True)
    ]
    claimed = [samples is not None for samples in answers]
    return Entry(name, seconds, solved, durations, claimed)


def keeps(samples: Samples, waypoints: Array, limits: JointLimits) -> bool:
    """Whether samples keep the limits, also as differences between them say, and begin and end on the path's ends."""
    t, q, v, a = samples
    apart = np.diff(t) > 1e-6
    step = np.diff(t)[apart, None]
    speeds = np.vstack([v, np.diff(q, axis=0)[apart] / step])
    rates = np.vstack([a, np.diff(v, axis=0)[apart] / step])
    ends = np.abs(q[[0, -1]] - waypoints[[0, -1]]).max() < OFF_LINE
    slow = (np.abs(speeds) <= (1.0 + TOLERANCE) * limits.velocity).all()
    smooth = (np.abs(rates) <= (1.0 + TOLERANCE) * limits.acceleration).all()
    return bool(ends and slow and smooth)
