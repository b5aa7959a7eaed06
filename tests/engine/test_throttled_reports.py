"""Reports of progress: enough of them to follow a job, not so many that they slow it down."""

from __future__ import annotations

from planners.progress import Report
from workers.solver.process import REPORT_SECONDS, Channel, ThrottledReports
from workers.solver.protocol import Message


class Sent(Channel):
    """A channel that keeps the stages it was told of."""

    def __init__(self) -> None:
        self.stages: list[str] = []

    def send(self, message: Message, block: bytes = b"") -> None:
        assert message.progress is not None
        self.stages.append(message.progress.stage)


def test_two_stages_in_turns_are_reported_once_each_until_time_has_passed() -> None:
    now, channel = [0.0], Sent()
    report = ThrottledReports(channel, lambda: now[0])
    for _ in range(5):
        report(Report("regrasp", 1, 9))
        report(Report("motion", 1, 9))
    assert channel.stages == ["regrasp", "motion"]
    now[0] += REPORT_SECONDS
    report(Report("regrasp", 2, 9))
    report(Report("motion", 2, 9))
    assert channel.stages == ["regrasp", "motion", "regrasp"]


def test_the_end_of_a_stage_is_always_reported() -> None:
    channel = Sent()
    report = ThrottledReports(channel, lambda: 0.0)
    report(Report("regrasp", 0, 2))
    report(Report("regrasp", 2, 2))
    assert channel.stages == ["regrasp", "regrasp"]
