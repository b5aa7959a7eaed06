"""What the parts on a service at scale must ask for and must not leave out. No figure is asserted."""

from __future__ import annotations

import math
import re

from tests.benchmarks.bench_days import DaysEffort, DaysFigures, DaysLook
from tests.benchmarks.bench_fairness import (
    ALONE,
    ALONE_TOGETHER,
    FEW,
    MANY,
    ONE,
    TOGETHER,
    URGENT,
    BegunJob,
    FairnessFigures,
    Waited,
    inverted,
    overtaken,
)
from tests.benchmarks.bench_many_workers import KINDS, ManyWorkersCase, ManyWorkersFigures, Spell, kind_of
from tests.benchmarks.scale_part import (
    days_limits,
    days_section,
    fairness_limits,
    fairness_section,
    many_workers_limits,
    many_workers_sections,
    reckoned_cores,
    statements_of_a_job,
)


def has_even_tables(text: str) -> bool:
    blocks = re.findall(r"(?:^\|.*\n)+", f"{text}\n", re.MULTILINE)
    return bool(blocks) and all(len({line.count("|") for line in block.splitlines()}) == 1 for block in blocks)


def begun(*jobs: tuple[str, int, float, float]) -> list[BegunJob]:
    return [BegunJob(f"job {n}", *job) for n, job in enumerate(jobs)]


def fairness(behind: float, by: int, order: list[BegunJob]) -> FairnessFigures:
    waits = {case: [Waited(0.2, 0)] * 3 for case in (ALONE, ALONE_TOGETHER, TOGETHER)}
    waits |= {case: [Waited(0.2, 0), Waited(behind, by), Waited(behind, 0)] for case in (ONE, URGENT)}
    return FairnessFigures(1000, 5, waits, order)


def test_a_job_that_is_begun_before_a_more_urgent_one_of_its_owner_is_found() -> None:
    late, waiting = 5_000.0, math.inf
    kept = begun((MANY, 3, 0.0, 1000.0), (FEW, 0, 0.0, 1100.0), (MANY, 2, 0.0, 1200.0), (MANY, 9, late, late))
    assert inverted(kept) == []
    broken = begun((MANY, 3, 0.0, 1000.0), (MANY, 4, 0.0, 1100.0), (MANY, 5, 0.0, waiting))
    assert [job.id for job in inverted(broken)] == ["job 0", "job 1"]


def test_others_overtake_only_between_the_answer_and_the_last_begin() -> None:
    order = begun((MANY, 0, 0, 90), (MANY, 0, 0, 110), (FEW, 0, 0, 120), (MANY, 0, 0, 130), (FEW, 0, 0, 140))
    assert overtaken(order, {"job 2"}, 100.0) == 1
    assert overtaken(order, {"job 2", "job 4"}, 100.0) == 2


def test_fairness_asks_for_one_job_of_others_at_most_and_for_priorities() -> None:
    order = begun((MANY, 9, 0.0, 1000.0), (MANY, 3, 0.0, 2000.0), (MANY, 2, 0.0, math.inf))
    kept = {"SQLite": fairness(0.35, 1, order)}
    assert [limit.kept for limit in fairness_limits(kept)] == [True, True, True]
    wrong = begun((MANY, 3, 0.0, 1000.0), (MANY, 9, 0.0, 2000.0))
    broken = {**kept, "PostgreSQL": fairness(0.45, 2, wrong)}
    assert [limit.kept for limit in fairness_limits(broken)] == [True, True, True, False, False, False]
    text = fairness_section(broken)
    assert has_even_tables(text)
    assert f"| PostgreSQL: {URGENT} | 0.450 | 0.450 | 2 |" in text


def test_every_statement_of_a_worker_has_a_kind() -> None:
    found = {
        "BEGIN": "begin and end of transactions",
        "SELECT $1": "locks and proof of life",
        "SELECT pg_try_advisory_lock($1::BIGINT) AS pg_try_advisory_lock_1": "locks and proof of life",
        "INSERT INTO liftwright_plan_events (plan_id) VALUES ($1)": "events",
        "SELECT dbos.queues.name FROM dbos.queues WHERE name = $1": "queues: what the engine reads before a claim",
        "SELECT workflow_uuid FROM dbos.workflow_status FOR UPDATE SKIP LOCKED LIMIT $1": "queues: claims",
        "UPDATE dbos.workflow_status SET status = $1": "jobs of the engine",
        "SELECT liftwright_plans.id FROM liftwright_plans": "plans and the rest",
    }
    assert {statement: kind_of(statement) for statement in found} == found
    assert set(found.values()) <= set(KINDS)


def spell(seconds: float, looks: int, more: int, cpu: float, connections: int) -> Spell:
    kinds = dict.fromkeys(KINDS, 0) | {"queues: claims": looks, "events": more}
    return Spell(seconds, kinds, cpu, 1.0, 0.5, connections)


def test_a_thousand_workers_follow_by_arithmetic_from_those_that_were_measured() -> None:
    often = ManyWorkersFigures(
        ManyWorkersCase(10, 0.1, 100), spell(10.0, 10_000, 0, 2.0, 50), spell(20.0, 20_000, 1_500, 5.0, 50)
    )
    seldom = ManyWorkersFigures(
        ManyWorkersCase(10, 1.0, 100), spell(10.0, 1_000, 0, 0.2, 50), spell(20.0, 2_000, 1_500, 0.5, 61)
    )
    assert statements_of_a_job(often) == 15.0
    assert "100.0 statements/s = 100,000 statements/s; × 0.200 ms = 20.0 cores" in reckoned_cores(often)
    assert "and 5,000 connections" in reckoned_cores(often)
    assert [limit.kept for limit in many_workers_limits([often, seldom])] == [True, False]
    text = "\n\n".join(many_workers_sections([often, seldom]))
    assert has_even_tables(text)
    assert "| 10 workers, 0.1 s → 1 s | 1,000 | 100 |" in text


def days(last: float, size: float, left: int) -> DaysFigures:
    looks = [
        DaysLook(ended, {"API": 100.0 if ended < 900 else last, "w0": 50.0}, 10.0 if ended < 900 else size, 200)
        for ended in range(0, 1001, 20)
    ]
    return DaysFigures(1000, 60.0, looks=looks, left={"liftwright_plans": left})


def test_days_ask_that_memory_and_database_stay_level_and_nothing_is_left() -> None:
    kept, broken = days(104.0, 10.4, 0), days(106.0, 12.0, 1)
    assert [limit.kept for limit in days_limits({"SQLite": kept})] == [True, True, True]
    assert [limit.kept for limit in days_limits({"SQLite": broken})] == [False, False, False]
    text = days_section({"SQLite": kept, "PostgreSQL": broken}, DaysEffort())
    assert has_even_tables(text)
    assert "| PostgreSQL, after 100 % | 200 | 12 | API 106, w0 50 |" in text
