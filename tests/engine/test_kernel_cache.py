"""Which compiled kernels are still believed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.samples import among
from workers.solver.warm_up import forget_stale_kernels, keep_kernels


def written(path: Path, seconds: int, text: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    os.utime(path, (seconds, seconds))
    return path


@pytest.mark.parametrize("apart", among([False, True], [True]))
@pytest.mark.parametrize("changed", ["unchanged.py", "deep/inlined.py", "deep/constants.py"])
def test_a_kernel_older_than_any_source_of_kernels_is_forgotten_even_if_its_own_has_not_changed(
    tmp_path: Path, apart: bool, changed: str
) -> None:
    package, cache = tmp_path / "package", tmp_path / "cache"
    compiled = cache / "package" if apart else package / "__pycache__"
    kernel = "from numba import njit\nfrom package.deep.inlined import g\nfrom package.deep.constants import C\n"
    texts = {"unchanged.py": kernel, "deep/inlined.py": "import numba\n", "deep/constants.py": "C = 1\n"}
    for name, text in texts.items():
        written(package / name, 300 if name == changed else 100, text)
    written(package / "elsewhere.py", 400, "from package.unchanged import f\n")
    stale = [written(compiled / name, 200) for name in ("unchanged.f.nbi", "unchanged.f.1.nbc")]
    fresh = written(compiled / "changed.g.nbi", 301)
    other = written(compiled / "unchanged.pyc", 200)
    assert forget_stale_kernels((package,), str(cache) if apart else "") == len(stale)
    assert not any(path.exists() for path in stale)
    assert fresh.exists()
    assert other.exists()
    assert forget_stale_kernels((package,), str(cache) if apart else "") == 0


def test_a_folder_without_sources_or_kernels_is_left_alone(tmp_path: Path) -> None:
    assert forget_stale_kernels((tmp_path / "nowhere",), "") == 0


COMPILE = """
import sys, numpy as np
from package.deep.math import f, g
for name in sys.argv[1:]:
    f(np.ones((2, 2)).astype(name))
    g(np.ones((2, 2))[:, :1] if name == "int32" else np.ones((2, 2)))
    print(sum(f.stats.cache_misses.values()), sum(g.stats.cache_misses.values()))
"""
SOURCE = """
from numba import njit
@njit(cache=True)
def f(rows):
    return rows.sum()
@njit(cache=True)
def g(rows):
    return rows[0, 0]
"""


def compiled(package: Path, cache: Path | None, *types: str) -> list[str]:
    """Return what a process that calls kernels with arrays of these types had to compile after each, `f` and `g`."""
    kept = {} if cache is None else {"NUMBA_CACHE_DIR": str(cache)}
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    command = (sys.executable, "-c", COMPILE, *types)
    told = subprocess.run(
        command, cwd=package.parent, env={**environment, **kept}, check=True, capture_output=True, text=True
    )
    return told.stdout.splitlines()


@pytest.mark.parametrize("apart", among([False, True], [True]))
@pytest.mark.slow
def test_of_two_processes_kernels_all_signatures_are_kept_and_nothing_is_compiled_again(
    tmp_path: Path, apart: bool
) -> None:
    package, kept = tmp_path / "package", tmp_path / "kept" if apart else None
    written(package / "deep" / "math.py", 100, SOURCE)
    one, two = tmp_path / "one", tmp_path / "two"
    assert compiled(package, one, "float64", "int32") == ["1 1", "2 2"]
    assert compiled(package, two, "float32", "int32") == ["1 1", "2 2"]
    keep_kernels([one, two], (package,), str(kept or ""))
    types = ("float64", "float32", "int32")
    assert compiled(package, kept, *types) == ["0 0"] * len(types)
    assert compiled(package, kept, "int64") == ["1 0"]


USED = """
from dataclasses import replace
from planners.regrasp.grasps import arm_sweeps, handovers
from workers.solver.pipeline import Pipeline

Pipeline.solve = lambda *_: None
pipeline = Pipeline.load()
kept = Pipeline(replace(pipeline.solver, handovers=lambda *_: None))
kept.compile("suction_tool")
print(all(kernel.signatures for kernel in (handovers._comes_free, arm_sweeps.first_branches)))
"""


@pytest.mark.slow
def test_kernels_that_find_handovers_are_compiled_although_those_of_the_shipped_tools_are_kept() -> None:
    """They may be kept from before the kernels changed."""
    told = subprocess.run((sys.executable, "-c", USED), check=True, capture_output=True, text=True)
    assert told.stdout.strip() == "True"
