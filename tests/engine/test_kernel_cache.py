"""Which compiled kernels are still believed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from numba.core.caching import UserProvidedCacheLocator

from workers.solver.warm_up import forget_stale_kernels, keep_kernels


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


@pytest.mark.parametrize("apart", [False, True])
def test_of_two_processes_kernels_that_of_most_signatures_is_kept_whole(tmp_path: Path, apart: bool) -> None:
    package, kept = tmp_path / "package", tmp_path / "kept"
    written(package / "deep" / "math.py", 100)
    place = UserProvidedCacheLocator.get_suitable_cache_subpath(str(package / "deep" / "math.py"))
    compiled = {
        "one": ["math.f.nbi", "math.f.1.nbc", "math.g.nbi", "math.g.1.nbc", "math.g.2.nbc"],
        "two": [
            "math.f.nbi",
            "math.f.1.nbc",
            "math.f.2.nbc",
            "math.g.nbi",
            "math.g.1.nbc",
            "math.h.nbi",
            "math.h.1.nbc",
        ],
    }
    for cache, names in compiled.items():
        for name in names:
            written(tmp_path / cache / place / name, 200, cache)
    keep_kernels([tmp_path / cache for cache in compiled], (package,), str(kept) if apart else "")
    found = {
        path.name: path.read_text() for path in (kept / place if apart else package / "deep/__pycache__").iterdir()
    }
    most = {"math.f": "two", "math.g": "one", "math.h": "two"}
    assert found == {
        name: most[name[:6]] for cache, names in compiled.items() for name in names if most[name[:6]] == cache
    }
