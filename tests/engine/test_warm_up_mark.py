"""A start compiles once, and again after whatever could have changed what is compiled."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.service import ROOT
from workers.processor import FEATURES_VARIABLE, NAME_VARIABLE
from workers.settings import WorkerSettings
from workers.solver import warm_up
from workers.solver.warm_up import MARK, is_warm, mark_warm

EMPTY = """
import contextlib, sys
from app.cli.main import main
assert "numba" not in sys.modules
with contextlib.suppress(SystemExit):
    main(["--version"])
import numba
assert (numba.config.CPU_NAME, numba.config.CPU_FEATURES) == (None, None)
"""


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "sources"
    (folder / "deep").mkdir(parents=True)
    monkeypatch.setattr(warm_up, "SOURCES", (folder,))
    source = folder / "deep" / "kernel.py"
    source.write_text("a = 1")
    return source


@pytest.fixture
def settings(tmp_path: Path, source: Path) -> WorkerSettings:
    settings = WorkerSettings(data_dir=tmp_path / "data")
    assert not is_warm(settings)
    mark_warm(settings)
    return settings


def test_a_mark_stands_while_nothing_changes(settings: WorkerSettings, source: Path) -> None:
    (source.parent / "__pycache__").mkdir()
    (source.parent / "__pycache__" / "kernel.nbi").write_text("compiled")
    assert is_warm(settings)


def test_kernels_of_another_container_are_not_those_that_were_compiled_beside_the_same_handovers(
    settings: WorkerSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernels, older = tmp_path / "kernels", tmp_path / "older"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(kernels))
    mark_warm(settings)
    assert is_warm(settings)
    kernels.rename(older)
    assert not is_warm(settings)
    older.rename(kernels)
    assert is_warm(settings)


def test_a_source_that_is_changed_added_or_removed_makes_it_void(settings: WorkerSettings, source: Path) -> None:
    facts = source.stat()
    source.write_text("a = 2")
    os.utime(source, ns=(facts.st_atime_ns, facts.st_mtime_ns + 1))
    assert not is_warm(settings)
    mark_warm(settings)
    other = source.with_name("other.py")
    other.write_text("")
    assert not is_warm(settings)
    mark_warm(settings)
    other.unlink()
    assert not is_warm(settings)


def test_another_solver_another_place_of_kernels_or_another_data_directory_makes_it_void(
    settings: WorkerSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not is_warm(settings.model_copy(update={"solver_command": ("other",)}))
    assert not is_warm(settings.model_copy(update={"data_dir": tmp_path / "elsewhere"}))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert not is_warm(settings)


def test_a_mark_holds_on_another_processor_only_if_kernels_are_compiled_for_one_that_is_named(
    tmp_path: Path, source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = WorkerSettings(data_dir=tmp_path / "data")
    for given in ({}, {NAME_VARIABLE: "x86-64-v3"}, {NAME_VARIABLE: "x86-64-v3", FEATURES_VARIABLE: "+avx2"}):
        with monkeypatch.context() as here:
            # An image that was built without has them empty.
            for variable in (NAME_VARIABLE, FEATURES_VARIABLE):
                here.setenv(variable, given.get(variable, ""))
            mark_warm(settings)
            assert is_warm(settings)
            here.setattr(warm_up.codegen, "get_host_cpu_features", lambda: "+sse2,-avx2")
            assert is_warm(settings) == (len(given) == 2)
            mark_warm(settings)
            here.setattr(warm_up.binding, "get_host_cpu_name", lambda: "another")
            assert is_warm(settings) == (len(given) >= 1)
            here.setenv(NAME_VARIABLE, "x86-64-v2")
            assert not is_warm(settings)


@pytest.mark.slow
def test_an_empty_name_of_a_processor_is_none_to_the_compiler() -> None:
    """As in an image that was built without one: the compiler would take it for a name."""
    environment = {**os.environ, NAME_VARIABLE: "", FEATURES_VARIABLE: ""}
    subprocess.run([sys.executable, "-c", EMPTY], cwd=ROOT, env=environment, check=True, stdout=subprocess.DEVNULL)


def test_the_sources_that_count_are_there() -> None:
    assert all((folder / "__init__.py").is_file() for folder in warm_up.SOURCES)


@pytest.mark.parametrize("content", [b"\xff\xfe no UTF-8 \x80", b"", b"warm"])
def test_a_mark_that_was_spoiled_is_made_again(settings: WorkerSettings, content: bytes) -> None:
    (settings.handovers_dir / MARK).write_bytes(content)
    assert not is_warm(settings)
    mark_warm(settings)
    assert is_warm(settings)


def test_a_mark_that_cannot_be_read_or_kept_stops_nothing(settings: WorkerSettings) -> None:
    (settings.handovers_dir / MARK).unlink()
    (settings.handovers_dir / MARK).mkdir()
    assert not is_warm(settings)
    mark_warm(settings)
    assert not is_warm(settings)
