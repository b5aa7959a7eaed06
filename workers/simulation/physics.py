"""PyBullet, which greets on stdout when it is imported and when a server starts; here it does not."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from collections.abc import Iterator

__all__ = ["bullet", "quiet"]


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep the greeting of PyBullet's C code to itself: stdout may carry a protocol, stderr a progress bar."""
    sys.stdout.flush()
    sys.stderr.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    kept = [(stream, os.dup(stream)) for stream in (1, 2)]
    for stream, _ in kept:
        os.dup2(nowhere, stream)
    os.close(nowhere)
    try:
        yield
    finally:
        # C keeps a buffer of its own.
        ctypes.CDLL(None).fflush(None)
        for stream, copy in kept:
            os.dup2(copy, stream)
            os.close(copy)


with quiet():
    import pybullet as bullet
