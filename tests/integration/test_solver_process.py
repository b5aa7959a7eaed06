"""One solver process, without service or engine around it."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import gc
import gzip
import hashlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Iterable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from planners.progress import Report
from tests.support.service import FAKE_SOLVER, ROOT, wait_for
from workers.settings import SOLVER_COMMAND
from workers.solver import pool as pool_module
from workers.solver.examiner_pool import ExaminerPool
from workers.solver.pool import LOADING, OnReport, SolverCommand, SolverDied, SolverFault, SolverPool, SolverProcess
from workers.solver.process import COMPILE
from workers.solver.protocol import SolverRequest, StudyRequest
from workers.solver.warm_up import CACHE_VARIABLE
from workers.stores.plan_store import PackedDocument

COMMAND = SolverCommand(FAKE_SOLVER, {})


def request(wish: str) -> SolverRequest:
    return SolverRequest("a", {"external_id": wish})


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


async def opened_pool() -> SolverPool:
    """Return a pool of one slot whose process is ready."""
    pool = SolverPool(COMMAND, slots=1)
    pool.open()
    await pool.loaded()
    return pool


async def begun_job(pool: SolverPool, wish: str) -> asyncio.Task[PackedDocument]:
    """Return a job that a process of the pool is at work on."""
    begun = asyncio.Event()
    job = asyncio.create_task(pool.solve(request(wish), lambda _: asyncio.sleep(0, begun.set())))
    await begun.wait()
    return job


@pytest.fixture(autouse=True)
def all_is_closed() -> Iterator[None]:
    """Whatever a test leaves open fails this one, and not another that runs when garbage is collected."""
    yield
    gc.collect()


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
    assert [report.done for report in seen][-1] == 100_000


BUSY = """
from planners.progress import Report
from workers.solver.process import main
from workers.solver.protocol import Answer
def solve(request, progress, certified):
    for step in range(100_000):
        progress(Report("graph", step + 1, 100_000))
    return Answer("solved", b'{"outcome": "solved"}')
main(lambda: solve)
"""

NOISY = """
import os
from workers.solver.process import main
from workers.solver.protocol import Answer
def solve(request, progress, certified):
    print("a library says hello")
    os.write(1, b"and another one")
    return Answer("solved", b'{"outcome": "solved"}')
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


def test_what_is_no_message_is_a_death() -> None:
    for said in (b"out of memory\n", b"\xff\n", b"7\n", b"[]\n"):
        with pytest.raises(SolverDied, match="no message"):
            solve("now", SolverCommand((sys.executable, "-c", f"import os; os.write(1, {said!r}); os.read(0, 1)"), {}))


def test_a_pool_whose_solvers_cannot_be_started_tells_each_job_so_and_closes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool_module, "START_PAUSES_SECONDS", (0.0,))

    async def run() -> None:
        pool = SolverPool(SolverCommand(("/no/such/solver",), {}), slots=2)
        pool.open()
        await pool.loaded()
        for _ in range(3):
            with pytest.raises(SolverDied, match="could not be started"):
                await pool.solve(request("now"), ignore)
        await pool.close()

    asyncio.run(run())


def short_of_processes(monkeypatch: pytest.MonkeyPatch, refusals: int) -> None:
    """Refuse to start the next so many processes."""
    start = asyncio.create_subprocess_exec

    async def refuse_some(*words: str, **options: Any) -> asyncio.subprocess.Process:
        nonlocal refusals
        if refusals:
            refusals -= 1
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        return await start(*words, **options)

    monkeypatch.setattr(asyncio, "create_subprocess_exec", refuse_some)


def test_a_machine_that_is_short_of_processes_for_a_moment_costs_no_job(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool_module, "START_PAUSES_SECONDS", (0.05, 0.05))

    async def run() -> PackedDocument:
        short_of_processes(monkeypatch, 3)
        pool = await opened_pool()
        try:
            return await pool.solve(request("now"), ignore)
        finally:
            await pool.close()

    assert asyncio.run(run()).outcome == "solved"


def test_points_of_a_study_are_examined_once_the_machine_has_room_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A start that fails is no fault of the point that would have been examined."""
    monkeypatch.setattr(pool_module, "START_PAUSES_SECONDS", (0.05, 0.05))
    points: list[object] = []

    async def keep(point: dict[str, object]) -> None:
        points.append(point)

    async def run() -> None:
        short_of_processes(monkeypatch, 2)
        pool = ExaminerPool(SolverCommand(("sh", "-c", EXAMINER), {}))
        try:
            await pool.examine(StudyRequest({}, [0]), keep)
        finally:
            await pool.close()

    asyncio.run(run())
    assert points == [{"index": 0}]


EXAMINER = """echo '{}'; read request; echo '{"point": {"index": 0}}'; echo '{"examined": true}'; exec sleep 600"""
"""What stands for a process that examines points."""

LINGERING = """setsid sh -c "echo '{}'; exec sleep 1" & exec sleep 600"""
"""What says that it is ready has the same stdout, and is in no group that is ended."""


@pytest.mark.slow
def test_a_process_is_waited_for_however_often_who_ends_it_is_cancelled() -> None:
    async def run() -> None:
        child = await SolverProcess.start(SolverCommand(("sh", "-c", LINGERING), {}))
        await child.ready()
        ending = asyncio.create_task(child.kill())
        for _ in range(3):
            await asyncio.sleep(0.1)
            ending.cancel()
        assert not (await asyncio.wait([ending], timeout=0.1))[0]
        with pytest.raises(asyncio.CancelledError):
            await ending
        assert not child.alive

    # What was left open would be told of, as a warning that is an error.
    asyncio.run(run())


@pytest.mark.slow
def test_a_slot_is_got_ready_again_however_often_its_job_is_cancelled() -> None:
    async def run() -> None:
        pool = SolverPool(SolverCommand(("sh", "-c", LINGERING), {}), slots=1)
        pool.open()
        await pool.loaded()
        job = asyncio.create_task(pool.solve(request("never"), ignore))
        for _ in range(3):
            await asyncio.sleep(0.1)
            job.cancel()
        with pytest.raises(asyncio.CancelledError):
            await job
        assert await pool.loaded() == 1
        await pool.close()

    asyncio.run(run())


def test_every_job_of_a_pool_has_a_process_of_its_own_and_none_is_left_when_it_closes() -> None:
    others = children()

    async def run() -> None:
        pool = await opened_pool()
        packed = [await pool.solve(request("now"), ignore) for _ in range(3)]
        pids = {json.loads(gzip.decompress(each.gzip))["process"] for each in packed}
        assert len(pids) == 3
        await pool.close()

    asyncio.run(run())
    assert children() == others


def test_short_jobs_one_after_the_other_do_not_heap_up_waiting_processes() -> None:
    others = children()

    async def run() -> None:
        pool = await opened_pool()
        for _ in range(6):
            await pool.solve(request("now"), ignore)
            assert len(children() - others) <= 2, "the process and its fork"
        await pool.close()

    asyncio.run(run())


def made_by(packed: PackedDocument) -> int:
    return json.loads(gzip.decompress(packed.gzip))["process"]


GATED = """
import sys, time
from pathlib import Path
gate = Path(sys.argv.pop())
sys.path.insert(0, "tests")
from tests.support.fake_solver import solve
from workers.solver.process import main
def prepare():
    while not gate.exists():
        time.sleep(0.02)
    return solve
main(prepare)
"""


@contextlib.asynccontextmanager
async def pool_without_successors(gate: Path) -> AsyncIterator[SolverPool]:
    """Open a pool of one slot whose next process gets ready only when the file `gate` is there again."""
    gate.touch()
    pool = SolverPool(SolverCommand((sys.executable, "-c", GATED, str(gate)), {}), slots=1)
    pool.open()
    await pool.loaded()
    gate.unlink()
    try:
        yield pool
    finally:
        await pool.close()


def test_a_burst_of_jobs_has_a_process_each_and_waits_for_no_start(tmp_path: Path) -> None:
    """A start takes far longer than a short job; a fork of what is loaded is as good as new."""
    others, gate = children(), tmp_path / "gate"

    async def run() -> None:
        async with pool_without_successors(gate) as pool:
            burst = [await pool.solve(request(wish), ignore) for wish in ("infeasible", "now") * 5]
            assert len({made_by(each) for each in burst}) == 10
            with pytest.raises(SolverFault):
                await pool.solve(request("fail"), ignore)
            await pool.solve(request("now"), ignore)

    asyncio.run(asyncio.wait_for(run(), 60.0))
    assert children() == others


def test_a_job_that_waits_for_a_solver_to_load_says_so(tmp_path: Path) -> None:
    gate, told = tmp_path / "gate", list[str]()

    async def keep(report: Report) -> None:
        told.append(report.name)
        gate.touch()

    async def run() -> None:
        pool = SolverPool(SolverCommand((sys.executable, "-c", GATED, str(gate)), {}), slots=1)
        pool.open()
        try:
            await pool.solve(request("now"), keep)
            assert told[0] == LOADING.name
            told.clear()
            await pool.loaded()
            await pool.solve(request("now"), keep)
            assert LOADING.name not in told
        finally:
            await pool.close()

    asyncio.run(asyncio.wait_for(run(), 60.0))


REMEMBERING = """
from workers.solver.process import main
from workers.solver.protocol import Answer
asked = []
def solve(request, progress, certified):
    asked.append(request.id)
    return Answer("solved", b"%d" % len(asked))
main(lambda: solve)
"""


def test_nothing_of_a_job_is_there_when_the_next_one_is_begun() -> None:
    async def run() -> list[bytes]:
        pool = SolverPool(SolverCommand((sys.executable, "-c", REMEMBERING), {}), slots=1)
        pool.open()
        await pool.loaded()
        try:
            return [gzip.decompress((await pool.solve(request("now"), ignore)).gzip) for _ in range(3)]
        finally:
            await pool.close()

    assert asyncio.run(run()) == [b"1"] * 3


def test_a_pool_that_was_opened_while_the_service_loads_is_not_opened_again() -> None:
    async def run() -> int:
        pool = SolverPool(COMMAND, slots=2)
        pool.open()
        pool.open()
        try:
            return await pool.loaded()
        finally:
            await pool.close()

    assert asyncio.run(run()) == 2


LEAVING = """
import subprocess, sys
from workers.solver.process import main
from workers.solver.protocol import Answer
def solve(request, progress, certified):
    left = "import os, time; os.setpgid(0, 0); time.sleep(600)"
    subprocess.Popen([sys.executable, "-c", left])
    return Answer("solved", b"left")
main(lambda: solve)
"""


def test_what_a_job_has_started_is_gone_before_the_next_one_is_begun() -> None:
    others = children()

    async def run() -> None:
        pool = SolverPool(SolverCommand((sys.executable, "-c", LEAVING), {}), slots=1)
        pool.open()
        await pool.loaded()
        for _ in range(3):
            await pool.solve(request("now"), ignore)
        assert len(children() - others) <= 3, "the process, and what the last job has left, for a moment"
        await asyncio.wait_for(pool.close(), 60.0)

    asyncio.run(run())


THREADED = """
import threading
from workers.solver.process import main
threading.Thread(target=threading.Event().wait, name="idle", daemon=True).start()
main(lambda: None)
"""


@pytest.mark.slow
def test_a_process_with_threads_forks_none() -> None:
    with pytest.raises(SolverFault, match="idle"):
        solve("now", SolverCommand((sys.executable, "-c", THREADED), {}))


@pytest.mark.slow
def test_the_real_solver_is_one_thread_when_it_is_ready() -> None:
    """Compiled kernels and libraries of linear algebra keep none either: as every job shows, which is a fork."""

    async def run() -> None:
        child = await SolverProcess.start(SolverCommand(SOLVER_COMMAND, {}))
        try:
            await child.ready()
            # One that was joined may take a moment to be gone from the kernel's list.
            wait_for(lambda: psutil.Process(child.pid).num_threads() == 1, 5)
        finally:
            await child.kill()

    asyncio.run(run())


@pytest.mark.parametrize("ending", ["die", "hang"])
def test_a_process_whose_job_dies_or_is_cancelled_is_gone_and_another_one_takes_the_next(ending: str) -> None:
    others = children()

    async def run() -> None:
        pool = await opened_pool()
        job = await begun_job(pool, ending)
        at_work = children() - others
        if ending == "hang":
            job.cancel()
        with pytest.raises((asyncio.CancelledError, SolverDied)):
            await job
        wait_for(lambda: not alive(at_work), 5)
        await pool.solve(request("now"), ignore)
        await pool.close()

    asyncio.run(run())
    assert children() == others


def test_a_fork_dies_with_the_process_that_forked_it() -> None:
    async def run() -> None:
        child = await SolverProcess.start(COMMAND)
        job = asyncio.create_task(child.solve(request("hang"), ignore))
        while not (forks := psutil.Process(child.pid).children()):
            await asyncio.sleep(0.02)
        os.kill(child.pid, signal.SIGKILL)
        with pytest.raises(SolverDied):
            await job
        wait_for(lambda: not alive(forks), 5)
        await child.kill()

    asyncio.run(asyncio.wait_for(run(), 60.0))


def test_a_job_that_is_cancelled_while_it_waits_for_its_process_leaves_none() -> None:
    others = children()

    async def run() -> None:
        pool = await opened_pool()
        await pool.solve(request("now"), ignore)
        job = asyncio.create_task(pool.solve(request("now"), ignore))
        await asyncio.sleep(0)
        job.cancel()
        with pytest.raises(asyncio.CancelledError):
            await job
        await pool.close()

    asyncio.run(run())
    assert children() == others


def test_a_pool_that_is_closed_while_the_process_of_a_job_is_ended_starts_no_other_one() -> None:
    others = children()

    async def run() -> None:
        pool = await opened_pool()
        job = await begun_job(pool, "hang")
        job.cancel()
        # One turn of the loop, in which the process is begun to be ended.
        await asyncio.sleep(0)
        await pool.close()
        with pytest.raises(asyncio.CancelledError):
            await job
        await asyncio.sleep(0.2)
        assert children() == others

    asyncio.run(run())


def alive(processes: Iterable[psutil.Process]) -> bool:
    """Tell whether some of these have not ended."""
    for each in processes:
        with contextlib.suppress(psutil.NoSuchProcess):
            if each.is_running() and each.status() not in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD):
                return True
    return False


def children() -> set[psutil.Process]:
    """The processes below this one; other tests keep a service."""
    return set(psutil.Process().children(recursive=True))


def test_a_line_without_end_is_a_fault_and_not_a_full_memory() -> None:
    endless = "import os\nfor _ in range(40): os.write(1, b'x' * 2**20)\nos.read(0, 1)\nos.read(0, 10**6)"
    with pytest.raises(SolverFault, match="a line of more than"):
        solve("now", SolverCommand((sys.executable, "-c", endless), {}))


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
    wait_for(lambda: len(family.children(recursive=True)) == 3)
    below = family.children(recursive=True)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    wait_for(lambda: not alive(below), 2)


@pytest.mark.slow
def test_the_compiler_dies_with_the_process_that_waits_for_it(tmp_path: Path) -> None:
    environment = {**os.environ, CACHE_VARIABLE: str(tmp_path)}  # where nothing is compiled yet: there is much to do
    command = [sys.executable, "-m", "app.cli.main", "warmup"]
    process = subprocess.Popen(command, cwd=ROOT, env=environment, stderr=subprocess.DEVNULL)
    try:
        started = wait_for(lambda: compilers(process.pid))
    finally:
        process.kill()
        process.wait()
    wait_for(lambda: not alive(started), 5)


def compilers(pid: int) -> list[psutil.Process]:
    """Return the children of a process that compile; libraries start others for a moment while they load."""
    found: list[psutil.Process] = []
    for child in psutil.Process(pid).children():
        with contextlib.suppress(psutil.NoSuchProcess):
            found += [child] if COMPILE in child.cmdline() else []
    return found
