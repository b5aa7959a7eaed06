"""One solver process, without service or engine around it."""

from __future__ import annotations

import asyncio
import gzip
import hashlib
import json
import os
import signal
import subprocess
import sys

import psutil
import pytest
from support.service import FAKE_SOLVER, wait_for

from workers.solver import OnReport, PackedDocument, SolverCommand, SolverDied, SolverFault, SolverPool, SolverProcess
from workers.solver_protocol import Report, Request

COMMAND = SolverCommand(FAKE_SOLVER, {})


def request(wish: str) -> Request:
    return {"id": "a", "task": {"external_id": wish}}


async def ignore(_: Report) -> None: ...


def solve(wish: str, command: SolverCommand = COMMAND, on_report: OnReport = ignore) -> PackedDocument:
    """Have one process solve one request, and leave nothing behind."""

    async def run() -> PackedDocument:
        child = await SolverProcess.start(command)
        try:
            return await child.solve(request(wish), on_report)
        finally:
            await child.kill()

    return asyncio.run(run())


def test_a_document_arrives_whole_and_is_what_its_hash_says() -> None:
    packed = solve("now")
    body = gzip.decompress(packed.gzip)
    assert json.loads(body)["id"] == "a"
    assert hashlib.sha256(body).hexdigest() == packed.sha256


def test_reports_are_few_enough_not_to_slow_the_work_and_tell_the_end_of_each_stage() -> None:
    seen: list[Report] = []

    async def keep(report: Report) -> None:
        seen.append(report)

    solve("now", SolverCommand((sys.executable, "-c", BUSY), {}), keep)
    assert len(seen) < 100
    assert [report["done"] for report in seen][-1] == 100_000


BUSY = """
from workers.solver_process import main
def solve(request, progress):
    for step in range(100_000):
        progress("graph", step + 1, 100_000)
    return {"outcome": "solved"}
main(lambda: solve)
"""

NOISY = """
import os
from workers.solver_process import main
def solve(request, progress):
    print("a library says hello")
    os.write(1, b"and another one")
    return {"outcome": "solved"}
main(lambda: solve)
"""


def test_what_libraries_print_does_not_get_into_the_answer() -> None:
    packed = solve("now", SolverCommand((sys.executable, "-c", NOISY), {}))
    assert json.loads(gzip.decompress(packed.gzip)) == {"outcome": "solved"}


@pytest.mark.parametrize(("wish", "error"), [("die", SolverDied), ("fail", SolverFault)])
def test_a_death_and_a_fault_are_told_apart(wish: str, error: type[Exception]) -> None:
    with pytest.raises(error):
        solve(wish)


def test_a_command_that_is_no_solver_is_a_death_with_its_exit_code() -> None:
    with pytest.raises(SolverDied, match="exit code 7"):
        solve("now", SolverCommand((sys.executable, "-c", "raise SystemExit(7)"), {}))


def test_every_job_of_a_pool_has_a_process_of_its_own_and_none_is_left_when_it_closes() -> None:
    async def run() -> None:
        pool = SolverPool(COMMAND, slots=1)
        await pool.open()
        pids = set()
        for _ in range(3):
            pids |= {process.pid for process in psutil.Process().children()}
            await pool.solve(request("now"), ignore)
        assert len(pids) >= 2
        await pool.close()

    asyncio.run(run())
    assert psutil.Process().children(recursive=True) == []


def test_a_solver_dies_with_the_process_that_started_it() -> None:
    """The worker is killed; the solver and what it has started see that their stdin has closed."""
    worker = (
        "import subprocess, sys, time\n"
        f"child = subprocess.Popen({list(FAKE_SOLVER)!r}, stdin=subprocess.PIPE, start_new_session=True)\n"
        'child.stdin.write(b\'{"id": "a", "task": {"external_id": "child"}}\\n\'); child.stdin.flush()\n'
        "time.sleep(600)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", worker], stdout=subprocess.DEVNULL)
    family = psutil.Process(process.pid)
    wait_for(lambda: len(family.children(recursive=True)) == 2, 20)
    below = family.children(recursive=True)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    wait_for(lambda: not any(p.is_running() and p.status() != psutil.STATUS_ZOMBIE for p in below), 2)
