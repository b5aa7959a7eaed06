"""What was compiled and computed for a data directory: while nothing has changed, a start need not do it again."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

from llvmlite import binding

from workers.kernel_cache import CACHE_VARIABLE
from workers.settings import WorkerSettings

MARK = "warm"
"""File beside the handovers: whoever removes these has them computed again."""
SOURCES = tuple(Path(__file__).resolve().parents[1] / name for name in ("assets", "planners", "workers"))
COMPILERS = ("llvmlite", "numba", "numpy")
VARIABLES = (CACHE_VARIABLE, "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")
"""Where compiled kernels are kept, and what processor they are for."""


class WarmUpMark:
    """A file that holds a hash of all that compiled kernels and handovers depend on.

    It is a shortcut and no promise: a kernel that is missing all the same is compiled by the solver that needs it.
    """

    def __init__(self, settings: WorkerSettings) -> None:
        self._file = settings.handovers_dir / MARK
        self._command = settings.solver_command

    def stands(self) -> bool:
        """Whether nothing has changed since the mark was set."""
        try:
            return self._file.read_text() == self._digest()
        except FileNotFoundError:
            return False

    def set(self) -> None:
        """Keep that everything has been compiled and computed."""
        self._file.parent.mkdir(parents=True, exist_ok=True)
        self._file.write_text(self._digest())

    def _digest(self) -> str:
        """Return the hash as things are now."""
        facts = [*self._command, platform.python_version(), binding.get_host_cpu_name()]
        facts += [version(name) for name in COMPILERS] + [os.environ.get(name, "") for name in VARIABLES]
        return hashlib.sha256("\n".join([*facts, *_files()]).encode()).hexdigest()


def _files() -> Iterator[str]:
    """Yield name, size and time of each source and asset, as the kernels' own cache looks at them."""
    for folder in SOURCES:
        for path in sorted(folder.rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                facts = path.stat()
                yield f"{path} {facts.st_size} {facts.st_mtime_ns}"
