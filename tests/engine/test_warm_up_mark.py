"""A start compiles once, and again after whatever could have changed what is compiled."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from workers.settings import WorkerSettings
from workers.solver import warm_up
from workers.solver.warm_up import MARK, is_warm, mark_warm


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
