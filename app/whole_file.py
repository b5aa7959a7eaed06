"""Files of results that are written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from errno import ENOENT
from pathlib import Path
from typing import TextIO


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
