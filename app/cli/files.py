"""Files of commands: those they refuse, and results that are written whole or not at all."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from errno import ENOENT
from pathlib import Path
from typing import Any, TextIO

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


@contextmanager
def written_whole(out: Path | None) -> Iterator[TextIO | None]:
    """Open a file beside `out` that takes its place at the end: an impossible place is told before the work.

    Raises:
        OSError: Nothing can be written there.
    """
    if out is None:
        yield None
        return
    if out.exists() and not out.is_file():
        # A pipe or a terminal; of a directory the system says so itself.
        with out.open("w", encoding="utf-8") as stream:
            yield stream
        return
    if not out.parent.is_dir():
        raise FileNotFoundError(ENOENT, "no such folder", str(out))
    partial = out.with_name(f".{out.name}.{os.getpid()}")
    try:
        file = partial.open("x", encoding="utf-8")
    except OSError as error:
        # Whoever reads this has named another file.
        error.filename = str(out)
        raise
    try:
        with file:
            yield file
        partial.replace(out)
    finally:
        partial.unlink(missing_ok=True)
