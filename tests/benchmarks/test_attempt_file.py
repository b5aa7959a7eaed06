"""Attempts in several processes: each is made once, and comes back under its case and seed."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import pytest

from tests.benchmarks.attempt_file import AttemptFile, Unfinished, repeated

CASES = [("b", 2.0), ("a", 2.0), ("a", 1.0)]


@dataclass(frozen=True)
class Product:
    """What a task, a variant and a seed came to."""

    task: str
    factor: float
    seed: int
    words: str

    @classmethod
    def broken(cls, key: tuple[str, float, int], error: BaseException) -> Self:
        return cls(*key, str(error))

    @property
    def key(self) -> Hashable:
        return self.task, self.factor, self.seed

    def told(self) -> str:
        return self.words


def made(task: str, factor: float, seed: int) -> Product:
    if (task, seed) == ("b", 1):
        raise ValueError("seed 1 of b")
    return Product(task, factor, seed, f"{task} {factor * seed:g}")


@pytest.mark.slow
def test_attempts_come_back_by_case_and_seed_and_are_made_once(tmp_path: Path) -> None:
    file, notes = AttemptFile(tmp_path / "products.jsonl", Product), list[str]()
    with pytest.raises(Unfinished):
        repeated(file, made, CASES, 3, 2, notes.append, most=4)
    assert len(notes) == 4
    results = repeated(file, made, CASES, 3, 2, notes.append)
    assert len(notes) == 9
    assert [[each.words for each in case] for case in results] == [
        ["b 0", "seed 1 of b", "b 4"],
        ["a 0", "a 2", "a 4"],
        ["a 0", "a 1", "a 2"],
    ]
