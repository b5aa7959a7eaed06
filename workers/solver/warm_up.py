"""What is compiled and computed once, before the first job: kernels, and the handovers of the shipped tools.

Compiled kernels that no longer match their sources are removed; while nothing has changed, a start compiles nothing.
"""

from __future__ import annotations

import ast
import hashlib
import os
import pickle
import platform
import shutil
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory

import numba
import structlog
from llvmlite import binding
from numba.core import codegen, serialize
from numba.core.caching import UserProvidedCacheLocator

from planners.contract.strict_model import parsed
from planners.errors import LiftwrightError
from workers.processor import FEATURES_VARIABLE, NAME_VARIABLE
from workers.settings import WorkerSettings
from workers.solver.process import COMPILE, PARTS
from workers.solver.protocol import HANDOVERS_VARIABLE

ROOT = Path(__file__).resolve().parents[2]
KERNEL_FOLDERS = (ROOT / "planners", ROOT / "workers")
SOURCES = (ROOT / "assets", *KERNEL_FOLDERS)
CACHE_VARIABLE = "NUMBA_CACHE_DIR"
"""Tells the compiler where to keep compiled kernels."""
COMPILER = "numba"
COMPILERS = ("llvmlite", "numba", "numpy")
MARK = "warm"
"""File beside the handovers, with a hash of all that they and compiled kernels depend on. Whoever removes the handovers
has them computed again."""
_SUFFIXES = (".nbc", ".nbi")
"""Of code, and of an index that names it."""

log = structlog.get_logger(__name__)


class WarmUpFailed(LiftwrightError):
    """The solver cannot solve its reference task, so it would solve nothing else."""

    def __init__(self, return_code: int) -> None:
        super().__init__(f"the solver cannot start (exit code {return_code}); what it wrote stands above")


def warm_up(settings: WorkerSettings) -> None:
    """Compile and compute what is not there yet, with a message, so that no job has to wait for it.

    Raises:
        WarmUpFailed: The solver does not work.
    """
    forget_stale_kernels()
    log.info(
        "loading kernels and handovers of the shipped tools; the first start compiles and computes them, "
        "which takes some minutes",
        handovers=str(settings.handovers_dir),
    )
    if any(path for folder in _cache_folders() for path in _compiled(folder)):
        _compile(settings, {PARTS: os.environ.get(CACHE_VARIABLE, "")})
    else:
        # Two processes never compile into one cache: its index has no lock, and could name a kernel's code by another.
        with TemporaryDirectory() as scratch:
            apart = {(part,): f"{scratch}/{part}" for part in PARTS}
            _compile(settings, apart)
            keep_kernels([Path(cache) for cache in apart.values()])
    mark_warm(settings)


def _compile(settings: WorkerSettings, caches: Mapping[tuple[str, ...], str]) -> None:
    """Have a process for each of these parts compile at the same time; `caches` are where its kernels go.

    Raises:
        WarmUpFailed: one of them does not work.
    """
    with ExitStack() as stack:
        compilers = [
            stack.enter_context(
                subprocess.Popen(
                    (*settings.solver_command, COMPILE, *parts),
                    env={**os.environ, HANDOVERS_VARIABLE: str(settings.handovers_dir), CACHE_VARIABLE: cache},
                    # It ends when its stdin does: with this process, however that ends.
                    stdin=subprocess.PIPE,
                    stdout=subprocess.DEVNULL,
                )
            )
            for parts, cache in caches.items()
        ]
        codes = [compiler.wait() for compiler in compilers]
    failed = next((code for code in codes if code != 0), 0)
    if failed:
        raise WarmUpFailed(failed)


def keep_kernels(
    caches: Sequence[Path], packages: tuple[Path, ...] = KERNEL_FOLDERS, cache_dir: str | None = None
) -> None:
    """Copy kernels that several processes compiled to where the compiler looks for them: all signatures of each.

    Args:
        caches: where each process kept its own.
        packages: folders of sources.
        cache_dir: as in `forget_stale_kernels`.
    """
    kept_apart = os.environ.get(CACHE_VARIABLE) if cache_dir is None else cache_dir
    for source in {path.parent for package in packages for path in package.rglob("*.py")}:
        name = UserProvidedCacheLocator.get_suitable_cache_subpath(str(source / "any.py"))
        target = Path(kept_apart) / name if kept_apart else source / "__pycache__"
        for index in chain.from_iterable(sorted((cache / name).glob("*.nbi")) for cache in caches):
            _keep_signatures(index, target)


def _keep_signatures(index: Path, target: Path) -> None:
    """Copy the code of each signature in an index of the compiler's to a folder, if that has none of it yet."""
    stamp, compiled = _read_index(index)
    kept_index = target / index.name
    kept_stamp, kept = _read_index(kept_index) if kept_index.exists() else (stamp, {})
    if kept_stamp != stamp:
        kept = {}
    target.mkdir(parents=True, exist_ok=True)
    # Both processes number theirs from one.
    for signature in [each for each in compiled if each not in kept]:
        kept[signature] = f"{index.stem}.{len(kept) + 1}.nbc"
        shutil.copy2(index.with_name(compiled[signature]), target / kept[signature])
    # An index comes after all code that it names.
    kept_index.write_bytes(pickle.dumps(numba.__version__, protocol=-1) + serialize.dumps((stamp, kept)))


def _read_index(path: Path) -> tuple[object, dict[object, str]]:
    """Return an index of the compiler's: what it knows the source by, and the file of each signature's code."""
    with path.open("rb") as file:
        # Processes of ours have just written it.
        pickle.load(file)  # noqa: S301
        return pickle.loads(file.read())  # noqa: S301


def is_warm(settings: WorkerSettings) -> bool:
    """Whether nothing has changed since everything was compiled and computed for a data directory.

    It is a shortcut and no promise: a kernel that is missing all the same is compiled by the solver that needs it.
    """
    try:
        return {mark.read_bytes() for mark in _marks(settings)} == {_digest(settings).encode()}
    except OSError:
        return False


def mark_warm(settings: WorkerSettings) -> None:
    """Keep that everything has been compiled and computed; where that cannot be, the next start finds out anew."""
    try:
        digest = _digest(settings)
        for mark in _marks(settings):
            mark.parent.mkdir(parents=True, exist_ok=True)
            mark.write_text(digest)
    except OSError as error:
        log.warning("not kept that all is warm", folder=str(settings.handovers_dir), error=str(error))


def _marks(settings: WorkerSettings) -> list[Path]:
    """Return where it is kept that all is warm: beside handovers, and beside kernels where those are elsewhere.

    Workers in containers may share their handovers and have each their own kernels.
    """
    cache = os.environ.get(CACHE_VARIABLE)
    return [folder / MARK for folder in (settings.handovers_dir, *([Path(cache)] if cache else []))]


def _digest(settings: WorkerSettings) -> str:
    """Return the hash of compiler, processor, sources and assets as they are now.

    Of the processor as far as the compiler asks for it: where name and features are given, whatever runs is as good.
    """
    facts = [*settings.solver_command, platform.python_version(), os.environ.get(CACHE_VARIABLE, "")]
    facts += [version(name) for name in COMPILERS]
    facts += [os.environ.get(NAME_VARIABLE) or binding.get_host_cpu_name()]
    facts += [os.environ.get(FEATURES_VARIABLE) or codegen.get_host_cpu_features()]
    return hashlib.sha256("\n".join([*facts, *_files()]).encode()).hexdigest()


def _files() -> Iterator[str]:
    """Yield name, size and time of each source and asset, as the kernels' own cache looks at them."""
    for folder in SOURCES:
        for path in sorted(folder.rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                facts = path.stat()
                yield f"{path} {facts.st_size} {facts.st_mtime_ns}"


def forget_stale_kernels(packages: tuple[Path, ...] = KERNEL_FOLDERS, cache_dir: str | None = None) -> int:
    """Remove compiled kernels that are older than any source of kernels, and return how many files that were.

    The compiler compares a kernel with its own file only. What it inlines from other files may have changed since: a
    kernel of old parts gives wrong answers, or writes where it should not. Sources of kernels are the files that use
    the compiler, and those that they import: functions and constants are taken from there.

    Args:
        packages: folders of sources.
        cache_dir: where compiled kernels are kept; None: where the compiler is told to, else beside the sources.
    """
    newest = max((path.stat().st_mtime_ns for path in _sources_of_kernels(packages)), default=0)
    folders = _cache_folders(packages, cache_dir)
    stale = [path for folder in folders for path in _compiled(folder) if path.stat().st_mtime_ns < newest]
    for path in stale:
        path.unlink(missing_ok=True)
    return len(stale)


def _cache_folders(packages: tuple[Path, ...] = KERNEL_FOLDERS, cache_dir: str | None = None) -> tuple[Path, ...]:
    """Return the folders in which compiled kernels are kept."""
    kept_apart = os.environ.get(CACHE_VARIABLE) if cache_dir is None else cache_dir
    return (Path(kept_apart),) if kept_apart else packages


def _sources_of_kernels(packages: tuple[Path, ...]) -> set[Path]:
    roots = {package.parent for package in packages}
    sources: set[Path] = set()
    for path in (path for package in packages for path in package.rglob("*.py")):
        content = path.read_bytes()
        # Few do, and each start of a worker waits for this.
        if COMPILER.encode() not in content:
            continue
        modules = _imported(content)
        if COMPILER in modules:
            files = (root.joinpath(*module.split(".")).with_suffix(".py") for root in roots for module in modules)
            sources |= {path, *(file for file in files if file.is_file())}
    return sources


def _imported(content: bytes) -> set[str]:
    """Return the modules that a file of this content imports by name."""
    found: set[str] = set()
    for node in ast.walk(parsed(lambda: ast.parse(content))):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            found.add(node.module)
        elif isinstance(node, ast.Import):
            found |= {each.name for each in node.names}
    return found


def _compiled(folder: Path) -> Iterator[Path]:
    return (path for path in folder.rglob("*.nb[ic]") if path.suffix in _SUFFIXES)
