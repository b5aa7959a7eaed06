"""The balance program (5) three ways, on the same random lifts: ours, Clarabel, and the statement in cvxpy."""

# clarabel is a native module without stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import process_time
from typing import TypeVar

import clarabel
import numpy as np
from scipy import sparse

from planners.balance.balanced import Unbalanced
from planners.balance.cone_program import K_HAND, K_SUCTION
from planners.balance.contacts import Cup, Friction, GripContacts, HandLimits, PushContact
from planners.balance.proofs import TwistTable
from planners.balance.solver import Balance
from planners.geometry.pose import rotation_x, rotation_y, rotation_z
from tests.support.balance_statement import Plate, state_balance

Item = TypeVar("Item")
BalanceNode = tuple[np.ndarray, np.ndarray, GripContacts, PushContact]

HALF = np.array([0.15, 0.15, 0.02])
CORNERS = HALF * np.array([[-1, -1, -1], [-1, 1, -1], [1, 1, -1], [1, -1, -1]])
PLATE = Plate(4.0, np.zeros(3), Cup.on_top((0.1, 0.0, 0.02), 0.0175, 20.0), Friction(), HandLimits(), "paper")
POSES, GRIPS, PUSHES = 151, 30, 64
PROBLEMS, STATED = 400, 10


def measure() -> dict[str, float]:
    """Return CPU microseconds per problem, and how much faster ours is than each other way."""
    rng = np.random.default_rng(0)
    rotations, points = _poses(rng)
    grips = [_grip(rng) for _ in range(GRIPS)]
    pushes = [_push(rng) for _ in range(PUSHES)]
    nodes = [
        (rotations[pose], points[pose], grips[rng.integers(GRIPS)], pushes[rng.integers(PUSHES)])
        for pose in rng.integers(POSES, size=PROBLEMS)
    ]
    balance = new_balance()
    answers = [balance.solve(*node) for node in nodes]
    ours = _microseconds(lambda node: balance.solve(*node), nodes)
    theirs = _microseconds(lambda node: clarabel_effort(balance, node), nodes)
    stated = _microseconds(lambda node: state_balance(PLATE, *node).problem.solve(solver="CLARABEL"), nodes[:STATED])
    table = TwistTable(balance, rotations, points, grips, pushes)
    proofs = [answer.proof for answer in answers if isinstance(answer, Unbalanced) and answer.proof is not None]
    fixed = _microseconds(table.infeasible, proofs[:20])
    return {
        "ours_us": ours,
        "clarabel_us": theirs,
        "cvxpy_us": stated,
        "clarabel_over_ours": theirs / ours,
        "cvxpy_over_ours": stated / ours,
        "feasible_share": 1.0 - len(proofs) / PROBLEMS,
        "twist_table_nodes": float(POSES * (1 + GRIPS) * (1 + PUSHES)),
        "twist_table_us": fixed,
    }


def balance_nodes(problems: int) -> list[BalanceNode]:
    """Draw rotations of the plate, points it stands on, grips and pushes."""
    rng = np.random.default_rng(0)
    rotations, points = _poses(rng)
    return [(rotations[pose], points[pose], _grip(rng), _push(rng)) for pose in rng.integers(POSES, size=problems)]


def clarabel_effort(balance: Balance, node: BalanceNode) -> float:
    """Return the least effort that Clarabel finds for the same matrices; infinite if it finds none."""
    program = balance.program(*node)
    linear, *orders = program.sizes
    kinds = [clarabel.ZeroConeT(6), clarabel.NonnegativeConeT(linear), *map(clarabel.SecondOrderConeT, orders)]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    size = program.balance.shape[1]
    # The hands' effort is the last variable.
    cost = np.zeros(size)
    cost[program.pull], cost[-1] = K_SUCTION, K_HAND
    nothing, rows = sparse.csc_matrix((size, size)), sparse.csc_matrix(np.vstack([program.balance, -program.rows]))
    right = np.concatenate([program.load, program.offsets])
    solution = clarabel.DefaultSolver(nothing, cost, rows, right, kinds, settings).solve()
    return solution.obj_val if solution.status == clarabel.SolverStatus.Solved else np.inf


def new_balance() -> Balance:
    """Return a solver of the plate's program."""
    return Balance(PLATE.mass, PLATE.com, PLATE.cup, PLATE.friction, PLATE.limits, PLATE.lifter_model)


def _microseconds(run: Callable[[Item], object], items: Sequence[Item]) -> float:
    start = process_time()
    for item in items:
        run(item)
    return (process_time() - start) / len(items) * 1e6


def _poses(rng: np.random.Generator) -> tuple[np.ndarray, list[np.ndarray]]:
    """Level, tilted about an edge, on a vertex, and in the air: as many of each as a dense graph has."""
    counts = [4] + [2] * 40 + [1] * 60 + [0] * 50
    tilts = np.deg2rad(rng.uniform(4.0, 30.0, POSES))
    rotations = [
        rotation_z(0.3) @ (np.eye(3) if count == 4 else rotation_y(tilt) @ rotation_x(tilt * (count < 2)))
        for count, tilt in zip(counts, tilts, strict=True)
    ]
    return np.array(rotations), [CORNERS[4 - count :] for count in counts]


def _grip(rng: np.random.Generator) -> GripContacts:
    x, side = rng.uniform(-0.13, 0.13), rng.choice([-0.132, 0.132])
    return GripContacts(np.array([[x, side, -0.02], [x, side, 0.02]]), np.array([[0, 0, 1.0], [0, 0, -1.0]]))


def _push(rng: np.random.Generator) -> PushContact:
    x, y = rng.uniform(-0.14, 0.14, 2)
    return PushContact(np.array([x, y, -0.02]), np.array([0.0, 0.0, 1.0]))
