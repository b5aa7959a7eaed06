"""The balance program (5) three ways, on the same random lifts: reused template, new solver, the cvxpy statement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import process_time
from typing import TypeVar

import numpy as np

from planners.balance.balanced import Unbalanced
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
    """Return CPU microseconds per problem, and how much faster the template is than each other way."""
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
    template = _microseconds(lambda node: balance.solve(*node), nodes)
    rebuilt = _microseconds(lambda node: new_balance().solve(*node), nodes[:100])
    stated = _microseconds(lambda node: state_balance(PLATE, *node).problem.solve(solver="CLARABEL"), nodes[:STATED])
    table = TwistTable(balance, rotations, points, grips, pushes)
    proofs = [answer.proof for answer in answers if isinstance(answer, Unbalanced) and answer.proof is not None]
    fixed = _microseconds(table.infeasible, proofs[:20])
    return {
        "template_us": template,
        "new_solver_us": rebuilt,
        "cvxpy_us": stated,
        "new_solver_over_template": rebuilt / template,
        "cvxpy_over_template": stated / template,
        "feasible_share": 1.0 - len(proofs) / PROBLEMS,
        "twist_table_nodes": float(POSES * (1 + GRIPS) * (1 + PUSHES)),
        "twist_table_us": fixed,
    }


def balance_nodes(problems: int) -> list[BalanceNode]:
    """Draw rotations of the plate, points it stands on, grips and pushes."""
    rng = np.random.default_rng(0)
    rotations, points = _poses(rng)
    return [(rotations[pose], points[pose], _grip(rng), _push(rng)) for pose in rng.integers(POSES, size=problems)]


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
