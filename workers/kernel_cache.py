"""Compiled kernels on disk that no longer match their sources."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

PACKAGES = tuple(Path(__file__).resolve().parents[1] / name for name in ("planners", "workers"))
CACHE_VARIABLE = "NUMBA_CACHE_DIR"
"""Tells the compiler where to keep compiled kernels."""
_SUFFIXES = (".nbi", ".nbc")


def forget_stale_kernels(packages: tuple[Path, ...] = PACKAGES, cache_dir: str | None = None) -> int:
    """Remove compiled kernels that are older than any source, and return how many files that were.

    The compiler compares a kernel with its own file only. What it inlines from other files may have changed since: a
    kernel of old parts gives wrong answers, or writes where it should not.

    Args:
        packages: folders of sources with kernels.
        cache_dir: where compiled kernels are kept; None: where the compiler is told to, else beside the sources.
    """
    newest = max((path.stat().st_mtime_ns for package in packages for path in package.rglob("*.py")), default=0)
    kept_apart = os.environ.get(CACHE_VARIABLE) if cache_dir is None else cache_dir
    folders = (Path(kept_apart),) if kept_apart else packages
    stale = [path for folder in folders for path in _compiled(folder) if path.stat().st_mtime_ns < newest]
    for path in stale:
        path.unlink(missing_ok=True)
    return len(stale)


def _compiled(folder: Path) -> Iterator[Path]:
    return (path for path in folder.rglob("*.nb[ic]") if path.suffix in _SUFFIXES)
