"""What a command says of input that it cannot use."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from typing import Any

BAD_INPUT = 3
"""Exit code."""


def refuse(problems: Iterable[Mapping[str, Any]]) -> int:
    """Print every problem, as `planners.contract.problems` lists them, and return the exit code."""
    for problem in problems:
        choices = problem.get("allowed")
        allowed = f" (one of: {', '.join(choices)})" if choices else ""
        sys.stderr.write(f"{problem['pointer'] or '/'}: {problem['detail']}{allowed}\n")
    return BAD_INPUT
