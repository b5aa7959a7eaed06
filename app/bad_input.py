"""What a command says of input that it cannot use."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from typing import Any

from planners.errors import LiftwrightError

BAD_INPUT = 3
"""Exit code."""


class BadInput(LiftwrightError):
    """A file is not what a command takes; the message names it."""


def refuse(problems: Iterable[Mapping[str, Any]], file: str) -> int:
    """Print every problem of a file, as `planners.contract.problems` lists them, and return the exit code."""
    for problem in problems:
        choices = problem.get("allowed")
        allowed = f" (one of: {', '.join(choices)})" if choices else ""
        sys.stderr.write(f"{problem['pointer'] or file}: {problem['detail']}{allowed}\n")
    return BAD_INPUT
