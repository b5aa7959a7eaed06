"""Which compiled kernels are still believed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from workers.solver.warm_up import forget_stale_kernels


def written(path: Path, seconds: int, text: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    os.utime(path, (seconds, seconds))
    return path


@pytest.mark.parametrize("apart", [False, True])
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
