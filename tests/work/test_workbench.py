"""Work is done in a process of its own, which keeps to its memory and ends with whoever waits for it."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import psutil
import pytest

from app.errors import WorkDied, WorkTooLarge
from app.work.wanted import NobodyWaits, StillWanted
from app.work.workbench import Workbench, WorkError
from planners.errors import SceneError
from tests.support import works
from tests.support.service import ROOT, wait_for

MEMORY_BYTES = 1 << 30
LARGE = 50_000_000
SECOND = 1.0
WAITING = """
import sys
from pathlib import Path
from app.work.wanted import StillWanted
from app.work.workbench import Workbench
from tests.support import works
with StillWanted() as wanted:
    Workbench(1 << 30).do(wanted, works.work_on, Path(sys.argv[1]))
"""


@pytest.fixture
def bench() -> Iterator[Workbench]:
    made = Workbench(MEMORY_BYTES)
    yield made
    made.close()


def done(bench: Workbench, work: Callable[..., Any], *given: Any) -> Any:
    with StillWanted() as wanted:
        return bench.do(wanted, work, *given)


def told_in(file: Path) -> psutil.Process:
    """Return the process that has told itself in a file."""
    return psutil.Process(int(wait_for(lambda: file.exists() and file.read_text(), 60.0)))


def is_gone(process: psutil.Process) -> bool:
    try:
        return process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def test_each_work_has_a_process_of_its_own_that_is_gone_after_it(bench: Workbench) -> None:
    processes = [done(bench, works.process_of) for _ in range(3)]
    assert len({*processes, os.getpid()}) == 4
    wait_for(lambda: not any(map(psutil.pid_exists, processes)), SECOND)


def test_another_process_costs_less_than_reading_its_modules_again(bench: Workbench) -> None:
    done(bench, works.process_of)
    begun = time.perf_counter()
    for _ in range(10):
        done(bench, works.process_of)
    assert time.perf_counter() - begun < 10 * 0.2


def test_what_a_module_prepares_is_prepared_once_for_all_works_after_the_first(bench: Workbench) -> None:
    assert done(bench, works.preparers)[0] == []
    for _ in range(3):
        prepared, forker = done(bench, works.preparers)
        assert prepared == [forker]


def test_what_is_large_comes_and_goes_whole_also_of_several_at_once(bench: Workbench) -> None:
    sent = [os.urandom(LARGE), b"", b"few"]
    with ThreadPoolExecutor(3) as pool:
        assert list(pool.map(lambda content: done(bench, works.echo, content), sent)) == sent


def test_what_is_wrong_with_what_was_given_is_said_as_it_was_raised(bench: Workbench) -> None:
    with pytest.raises(SceneError) as refused:
        done(bench, works.refuse)
    assert str(refused.value) == "/plate: is too heavy"
    assert (refused.value.pointers, refused.value.allowed) == (("/plate", "/cup"), ["light"])
    with pytest.raises(WorkError, match="out of order"):
        done(bench, works.fail)


@pytest.mark.slow
def test_what_takes_too_much_memory_is_refused_and_what_dies_is_told_and_the_next_is_done(bench: Workbench) -> None:
    with pytest.raises(WorkTooLarge, match="1024 MiB"):
        done(bench, works.grow)
    with pytest.raises(WorkDied):
        done(bench, works.die)
    assert done(bench, works.echo, b"next") == b"next"


def test_the_process_that_forks_may_die(bench: Workbench) -> None:
    done(bench, works.process_of)
    (forks,) = (each for each in psutil.Process().children() if "app.work.process" in each.cmdline())
    forks.kill()
    wait_for(lambda: is_gone(forks), SECOND)
    assert done(bench, works.echo, b"next") == b"next"


def test_a_process_is_gone_as_soon_as_nobody_waits(bench: Workbench, tmp_path: Path) -> None:
    outcome: list[BaseException] = []

    def wait() -> None:
        try:
            bench.do(wanted, works.work_on, tmp_path / "told")
        except NobodyWaits as nobody:
            outcome.append(nobody)

    with StillWanted() as wanted:
        waiting = threading.Thread(target=wait)
        waiting.start()
        process = told_in(tmp_path / "told")
        wanted.no_longer()
        waiting.join(SECOND)
        assert outcome
        wait_for(lambda: is_gone(process), SECOND)


def test_what_nobody_waits_for_is_not_begun(bench: Workbench, tmp_path: Path) -> None:
    with StillWanted() as wanted:
        wanted.no_longer()
        with pytest.raises(NobodyWaits):
            bench.do(wanted, works.work_on, tmp_path / "told")
    assert done(bench, works.echo, b"next") == b"next"
    assert not (tmp_path / "told").exists()


@pytest.mark.slow
def test_no_process_outlives_one_that_is_killed(tmp_path: Path) -> None:
    service = subprocess.Popen([sys.executable, "-c", WAITING, str(tmp_path / "told")], cwd=ROOT)
    try:
        work = told_in(tmp_path / "told")
        forks = work.parent()
        assert forks is not None
        assert forks.ppid() == service.pid
        service.kill()
        service.wait()
        wait_for(lambda: is_gone(work) and is_gone(forks), SECOND)
    finally:
        service.kill()
        service.wait()
