"""Attempts at layouts on disk: a run that was stopped goes on where it was, as long as the code is the same."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Self

from tests.benchmarks.machine import ROOT
from tests.benchmarks.pile_attempt import PileAttempt

FOLDER = ROOT / "build" / "benchmarks"
"""Where a full run keeps what it has done."""
_MEASURED = ("assets", "planners", "workers")
_MEASURING = ("random_piles.py", "pile_attempt.py")


class AttemptFile:
    """Attempts that were made with one state of the code, one on each line."""

    def __init__(self, path: Path) -> None:
        """Open a file; a last line that was cut off is dropped."""
        self._path = path
        if path.exists():
            whole = path.read_bytes()
            path.write_bytes(whole[: whole.rfind(b"\n") + 1])

    @classmethod
    def of_this_code(cls, folder: Path) -> Self:
        """Return the file of the code as it is, changes that are not committed included."""
        folder.mkdir(parents=True, exist_ok=True)
        return cls(folder / f"piles_{_digest(_sources())}.jsonl")

    def read(self) -> dict[tuple[str, int], PileAttempt]:
        """Return the attempts by pile and seed."""
        if not self._path.exists():
            return {}
        attempts = [PileAttempt(**json.loads(line)) for line in self._path.read_text().splitlines()]
        return {(attempt.pile, attempt.seed): attempt for attempt in attempts}

    def add(self, attempt: PileAttempt) -> None:
        """Write an attempt down."""
        with self._path.open("a") as file:
            file.write(json.dumps(asdict(attempt)) + "\n")


def _sources() -> list[Path]:
    files = [path for folder in _MEASURED for path in (ROOT / folder).rglob("*") if path.is_file()]
    measuring = [Path(__file__).parent / name for name in _MEASURING]
    return sorted(path for path in (*files, *measuring) if "__pycache__" not in path.parts)


def _digest(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(str(file.relative_to(ROOT)).encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:12]
