"""Liftwright's planners: a pure library that turns a task into a certified plan.

>>> from pathlib import Path
>>> from planners import Plan, read_task, solve
>>> plan = solve(read_task(Path("assets/tasks/pb1_weak_cup.json")))
>>> print(plan.outcome, plan.explanation.remedies[0].sentence, sep=": ")
infeasible: Use a cup, or a vacuum, that pulls with 44.5 N instead of 20 N.
>>> Plan.read(plan.write()).outcome
'infeasible'
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from planners.contract.task_spec import read_task
    from planners.plan.plan import Plan
    from planners.planning import solve

__all__ = ["Plan", "read_task", "solve"]

_HOMES = {"Plan": "planners.plan.plan", "read_task": "planners.contract.task_spec", "solve": "planners.planning"}


def __getattr__(name: str) -> object:
    # When they are asked for: whoever needs one part of the library does not load all of it.
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
