"""Processes that keep graphs: one for each editor, as long as there are not too many, and none that is left behind."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Awaitable, Callable
from typing import TypeVar

import psutil

from planners.plan.verdicts import Feasibility
from workers.solver.feasibility_pool import FeasibilityPool
from workers.solver.pool import SolverCommand
from workers.solver.protocol import FeasibilityRequest

COMMAND = SolverCommand((sys.executable, "-m", "tests.support.fake_feasibility"), {})
Result = TypeVar("Result")


def wish(words: str) -> FeasibilityRequest:
    return FeasibilityRequest({"external_id": words})


def with_pool(most: int, use: Callable[[FeasibilityPool], Awaitable[Result]]) -> Result:
    """Use a pool, and see that nothing of it is left."""

    async def used() -> Result:
        pool = FeasibilityPool(COMMAND, most)
        try:
            return await use(pool)
        finally:
            await pool.close()

    found = asyncio.run(used())
    assert not [each for each in psutil.Process().children() if "fake_feasibility" in " ".join(each.cmdline())]
    return found


def process_of(answer: Feasibility | None) -> int:
    assert answer is not None
    assert answer.why is not None
    return int(answer.why)


def test_an_editor_has_its_process_and_another_one_its_own() -> None:
    async def use(pool: FeasibilityPool) -> None:
        one, other = await asyncio.gather(pool.ask("one", wish("")), pool.ask("other", wish("")))
        again = await pool.ask("one", wish(""))
        assert process_of(one) == process_of(again) != process_of(other)
        assert again is not None
        assert again.kept == 2.0, "it was asked twice"

    with_pool(2, use)


def test_who_asked_longest_ago_makes_room_and_who_is_being_answered_does_not() -> None:
    async def use(pool: FeasibilityPool) -> None:
        first = process_of(await pool.ask("one", wish("")))
        second = process_of(await pool.ask("two", wish("")))
        assert process_of(await pool.ask("three", wish(""))) not in (first, second)
        assert not psutil.pid_exists(first)
        assert psutil.pid_exists(second)
        busy = [asyncio.create_task(pool.ask(name, wish("slow"))) for name in ("two", "three")]
        while not all(keeper.turn.locked() for keeper in pool._keepers.values()):
            await asyncio.sleep(0.01)
        assert await pool.ask("one", wish("")) is None
        assert process_of((await asyncio.gather(*busy))[0]) == second

    with_pool(2, use)


def test_a_process_that_dies_says_nothing_and_the_next_question_is_answered() -> None:
    async def use(pool: FeasibilityPool) -> None:
        before = process_of(await pool.ask("one", wish("")))
        assert await pool.ask("one", wish("die")) is None
        assert process_of(await pool.ask("one", wish(""))) != before
        assert await pool.ask("one", wish("unknown")) is None

    with_pool(1, use)


def test_a_process_that_died_between_two_questions_is_replaced() -> None:
    async def use(pool: FeasibilityPool) -> None:
        before = process_of(await pool.ask("one", wish("")))
        psutil.Process(before).kill()
        while pool._keepers["one"].process.alive:
            await asyncio.sleep(0.01)
        assert process_of(await pool.ask("one", wish(""))) != before

    with_pool(1, use)


def test_with_an_editor_that_leaves_or_gives_up_its_process_ends() -> None:
    async def use(pool: FeasibilityPool) -> None:
        first = process_of(await pool.ask("one", wish("")))
        await pool.leave("one")
        assert not psutil.pid_exists(first)
        second = process_of(await pool.ask("one", wish("")))
        asking = asyncio.create_task(pool.ask("one", wish("slow")))
        await asyncio.sleep(0.1)
        asking.cancel()
        await asyncio.wait([asking])
        assert not psutil.pid_exists(second), "its answer would be taken for that to another question"
        await pool.leave("one")

    with_pool(1, use)


def test_there_may_be_none() -> None:
    async def use(pool: FeasibilityPool) -> None:
        assert await pool.ask("one", wish("")) is None

    with_pool(0, use)


def test_where_there_is_no_such_program_nothing_is_known() -> None:
    async def asked() -> None:
        pool = FeasibilityPool(SolverCommand(("/no/such/program",), {}), 1)
        assert await pool.ask("one", wish("")) is None
        await pool.close()

    asyncio.run(asked())
