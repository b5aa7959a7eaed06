"""Compiled kernels on disk that no longer match their sources."""

from __future__ import annotations

import ast
import os
from collections.abc import Iterator
from pathlib import Path

PACKAGES = tuple(Path(__file__).resolve().parents[1] / name for name in ("planners", "workers"))
CACHE_VARIABLE = "NUMBA_CACHE_DIR"
"""Tells the compiler where to keep compiled kernels."""
COMPILER = "numba"
_SUFFIXES = (".nbi", ".nbc")


def forget_stale_kernels(packages: tuple[Path, ...] = PACKAGES, cache_dir: str | None = None) -> int:
    """Remove compiled kernels that are older than any source of kernels, and return how many files that were.

    The compiler compares a kernel with its own file only. What it inlines from other files may have changed since: a
    kernel of old parts gives wrong answers, or writes where it should not. Sources of kernels are the files that use
    the compiler, and those that they import: functions and constants are taken from there.

    Args:
        packages: folders of sources.
        cache_dir: where compiled kernels are kept; None: where the compiler is told to, else beside the sources.
    """
    newest = max((path.stat().st_mtime_ns for path in _sources_of_kernels(packages)), default=0)
    kept_apart = os.environ.get(CACHE_VARIABLE) if cache_dir is None else cache_dir
    folders = (Path(kept_apart),) if kept_apart else packages
    stale = [path for folder in folders for path in _compiled(folder) if path.stat().st_mtime_ns < newest]
    for path in stale:
        path.unlink(missing_ok=True)
    return len(stale)


def _sources_of_kernels(packages: tuple[Path, ...]) -> set[Path]:
    roots = {package.parent for package in packages}
    sources: set[Path] = set()
    for path in (path for package in packages for path in package.rglob("*.py")):
        modules = _imported(path)
        if COMPILER in modules:
            files = (root.joinpath(*module.split(".")).with_suffix(".py") for root in roots for module in modules)
            sources |= {path, *(file for file in files if file.is_file())}
    return sources


def _imported(path: Path) -> set[str]:
    """Return the modules that a file imports by name."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            found.add(node.module)
        elif isinstance(node, ast.Import):
            found |= {each.name for each in node.names}
    return found


def _compiled(folder: Path) -> Iterator[Path]:
    return (path for path in folder.rglob("*.nb[ic]") if path.suffix in _SUFFIXES)
