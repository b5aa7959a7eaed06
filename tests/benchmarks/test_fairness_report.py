"""What is made of the order in which jobs were begun. No figure is asserted."""

from __future__ import annotations

from tests.benchmarks.bench_fairness import FEW, MANY, SLOTS, BegunJob, inverted, overtaken


def begun(*jobs: tuple[str, int, int]) -> list[BegunJob]:
    """Return jobs of owners, with priorities and when they were accepted, begun one after the other from 100 on."""
    return [BegunJob(str(place), *job, 100 + place) for place, job in enumerate(jobs)]


def test_what_was_accepted_before_and_is_more_urgent_is_begun_first_but_among_those_begun_together() -> None:
    late, together = [(MANY, 1, 0)] * (SLOTS + 1), [(MANY, 1, 0)] * (SLOTS - 1)
    assert [each.id for each in inverted(begun(*late, (MANY, 5, 0)))] == ["0", "1"]
    assert inverted(begun(*together, (MANY, 5, 0))) == []


def test_what_comes_later_or_is_another_owners_overtakes_nobody() -> None:
    before = [(MANY, 1, 0)] * (SLOTS + 2)
    assert inverted(begun(*before, (FEW, 9, 0))) == []
    assert inverted(begun(*before, (MANY, 9, 150))) == []


def test_jobs_of_others_count_from_the_answer_to_the_last_that_was_posted() -> None:
    jobs = begun(*[(MANY, 0, 0)] * 3, (FEW, 0, 0), (MANY, 0, 0), (FEW, 0, 0), (MANY, 0, 0))
    assert overtaken(jobs, {"3", "5"}, answered_us=100.5) == 3
    assert overtaken(jobs, {"3"}, answered_us=102.5) == 0
