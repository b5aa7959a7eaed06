"""The commit that parts of RESULTS.md name: whatever has changed since changes no figure."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.benchmarks import machine


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a repository of one commit, in which the benchmarks look."""
    monkeypatch.setattr(machine, "ROOT", tmp_path)
    _git(tmp_path, "init", "--quiet")
    _commit(tmp_path, "planners/search.py", "depth = 1")
    return tmp_path


def test_texts_and_other_tests_leave_the_commit_as_it_was(repository: Path) -> None:
    """Figures of before such a change and of after it are of one commit."""
    before = machine.commit()
    for name in ("README.md", "docs/task.md", "tests/plan/test_plan.py", "tests/benchmarks/RESULTS.md"):
        _commit(repository, name, "text")
    assert machine.commit() == before


@pytest.mark.parametrize("name", ["planners/search.py", "app/new.py", "tests/benchmarks/load.py", "constraints.txt"])
def test_what_figures_depend_on_is_named(repository: Path, name: str) -> None:
    """A change of it is told while it is not committed, and is the commit from then on."""
    before = machine.commit()
    path = _written(repository, name, "depth = 2")
    _git(repository, "add", name)
    assert machine.commit() == f"{before} with uncommitted changes"
    _commit(repository, name, path.read_text())
    assert machine.commit() not in (before, "unknown")
    assert "changes" not in machine.commit()


def test_what_is_no_repository_has_no_commit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As where the sources were unpacked from an archive."""
    monkeypatch.setattr(machine, "ROOT", tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert machine.commit() == "unknown"


def _written(repository: Path, name: str, text: str) -> Path:
    path = repository / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def _commit(repository: Path, name: str, text: str) -> None:
    _written(repository, name, text)
    _git(repository, "add", name)
    _git(repository, "-c", "user.name=n", "-c", "user.email=e@x", "commit", "--quiet", "--message", name)


def _git(repository: Path, *words: str) -> None:
    subprocess.run(["git", *words], cwd=repository, check=True, capture_output=True)
