"""How a process loads what it keeps for as long as it runs."""

from __future__ import annotations

import atexit
import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def loading() -> Iterator[None]:
    """Look for no garbage while a block imports libraries and loads files, nor ever in what it has loaded.

    All of that stays, and there is much of it: to look through it again and again takes a tenth of the time of loading
    it, and of each job a tenth of a second at a time. When the interpreter ends it is looked through once more:
    bindings tell of every class that is left then.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
        atexit.register(gc.unfreeze)
