"""Inverse kinematics of a UR3e: ours, eaik, ur_analytic_ik and iteration on pinocchio."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from time import process_time

import numpy as np

from planners.geometry.pose import Array
from planners.kinematics.forward import flange_pose
from planners.kinematics.inverse import inverse_kinematics
from tests.benchmarks.bench_kinematics import all_branches
from tests.benchmarks.iterative_ik import iterate
from tests.benchmarks.peers.contest import Contest, Entry, answers_of, tried
from tests.benchmarks.tasks import Note
from tests.kinematics.arm_oracle import UR3E, PinocchioArm

REACHED = 1e-5
"""Most that any entry of a pose may be off, by pinocchio [m, 1]."""
STARTS = 20
"""Of an iteration, before it is given up."""
SAME = 1e-3
"""Postures that differ by less are the same [rad]."""
TEXT = (
    "Random postures of a UR3e, its table as it is published; what is asked for is their flange pose. *One by one*: a "
    "call from Python for each pose. *In one call*: all poses, ours in compiled code, *eaik* by its batch on one "
    "thread. Iteration is damped least squares on pinocchio, from up to 20 random postures until it gets to one "
    "solution. Solved: a posture is returned, and by pinocchio's forward kinematics each that is returned is on the "
    "pose. Size: how many different postures there are."
)

Solver = Callable[[Array], Sequence[Array]]


def kinematics_contests(poses: int, iterated: int, note: Note) -> list[Contest]:
    """Return two contests: called one by one, and all at once."""
    note("peers: inverse kinematics")
    rng = np.random.default_rng(0)
    targets = np.array([flange_pose(UR3E, np.eye(4), q) for q in rng.uniform(-np.pi, np.pi, (poses, 6))])
    arm = PinocchioArm(UR3E)

    def ours(T: Array) -> Sequence[Array]:
        branches = np.empty((8, 6))
        valid = inverse_kinematics(UR3E, T, 0.0, branches)
        return [branches[k] for k in range(8) if valid >> k & 1]

    def of_eaik() -> Entry:
        return _one_by_one("eaik", arm, targets, eaik_solver())

    def of_ur_analytic_ik() -> Entry:
        from ur_analytic_ik import ur3e

        return _one_by_one("ur_analytic_ik", arm, targets, ur3e.inverse_kinematics)

    def of_iteration() -> Entry:
        def solve(T: Array) -> Sequence[Array]:
            found = (iterate(arm, T, rng.uniform(-np.pi, np.pi, 6)) for _ in range(STARTS))
            return next(([q] for q in found if q is not None), [])

        return _one_by_one("pinocchio, iterated", arm, targets[:iterated], solve)

    entry = _one_by_one("ours", arm, targets, ours)
    one_by_one = Contest(
        f"inverse kinematics, one by one ({poses})",
        entry,
        [tried("eaik", of_eaik), tried("ur_analytic_ik", of_ur_analytic_ik)],
        "postures",
        less_is_better=False,
        text=TEXT,
    )
    few = Contest(
        f"inverse kinematics, one solution ({iterated})",
        replace(entry.of(range(iterated)), sizes=()),
        [of_iteration()],
    )
    return [one_by_one, few, _in_one_call(arm, targets, entry)]


def eaik_solver() -> Solver:
    """Return eaik's solver of the arm, one pose at a time; what it only comes near to is left out."""
    from eaik.IK_DH import DhRobot

    robot = DhRobot(UR3E[:, 1], UR3E[:, 0], UR3E[:, 2])

    def solve(T: Array) -> Sequence[Array]:
        answer = robot.IK(T)
        return [q for q, near in zip(answer.Q, answer.is_LS, strict=True) if not near]

    return solve


def _in_one_call(arm: PinocchioArm, targets: Array, entry: Entry) -> Contest:
    """Time is that of all poses over their number; the answers of ours are those of `entry`."""
    all_branches(UR3E, targets[:1])
    begun = process_time()
    all_branches(UR3E, targets)
    ours = (process_time() - begun) / len(targets)

    def of_eaik() -> Entry:
        from eaik.IK_DH import DhRobot

        robot = DhRobot(UR3E[:, 1], UR3E[:, 0], UR3E[:, 2])
        poses = list(targets)
        begun = process_time()
        answers = robot.IK_batched(poses, num_worker_threads=1)
        seconds = (process_time() - begun) / len(targets)
        exact = [[q for q, near in zip(each.Q, each.is_LS, strict=True) if not near] for each in answers]
        return _judged("eaik", arm, targets, exact, [seconds] * len(targets))

    return Contest(
        f"inverse kinematics, in one call ({len(targets)})",
        Entry("ours", [ours] * len(targets), entry.solved, entry.sizes, entry.claimed),
        [tried("eaik", of_eaik)],
        "postures",
        less_is_better=False,
    )


def _one_by_one(name: str, arm: PinocchioArm, targets: Array, solve: Solver) -> Entry:
    solve(targets[0])
    answers, seconds = answers_of(solve, targets)
    return _judged(name, arm, targets, answers, seconds)


def _judged(
    name: str, arm: PinocchioArm, targets: Array, answers: Sequence[Sequence[Array]], seconds: Sequence[float]
) -> Entry:
    reached = [
        [float(np.abs(arm.flange_pose(np.asarray(q, dtype=float)) - T).max()) < REACHED for q in postures]
        for T, postures in zip(targets, answers, strict=True)
    ]
    solved = [bool(each) and all(each) for each in reached]
    numbers = [float(different(postures)) if ok else np.nan for postures, ok in zip(answers, solved, strict=True)]
    return Entry(name, seconds, solved, numbers, [len(postures) > 0 for postures in answers])


def different(postures: Sequence[Array]) -> int:
    """Return how many postures there are, full turns apart being the same."""
    kept: list[Array] = []
    for q in postures:
        if all(np.abs(np.remainder(q - other + np.pi, 2 * np.pi) - np.pi).max() > SAME for other in kept):
            kept.append(np.asarray(q))
    return len(kept)
