"""The part of RESULTS.md on what a user would pick instead, on the same cases, and where we lose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.benchmarks.effort import Effort
from tests.benchmarks.markdown import cell, table
from tests.benchmarks.part import Findings, Limit
from tests.benchmarks.peers.balance_contest import balance_contest
from tests.benchmarks.peers.contest import Contest, Entry, NotMeasured
from tests.benchmarks.peers.handover_contest import handover_contest
from tests.benchmarks.peers.kinematics_contest import kinematics_contests
from tests.benchmarks.peers.motion_contest import MotionCases, motion_contests
from tests.benchmarks.peers.timing_contest import timing_contests
from tests.benchmarks.tasks import Note

PACKAGES = ("toppra", "ruckig", "eaik", "ur-analytic-ik", "hpp-python")
"""Whose versions are told beside those that every part tells."""
SHOWN = ("length", "duration")
"""Sizes whose ratio stands in the table of all; numbers of postures and efforts are alike where both are right."""
SLIGHT = 0.01
"""Relative difference that is no difference."""


def measure(effort: Effort, note: Note, folder: Path) -> Findings:
    """Give everybody the same cases: about ten minutes, of which HPP takes up to five."""
    del folder
    asked = effort.peers
    note("peers: motion, ours")
    cases = MotionCases.draw(asked.motions)
    found = [
        *motion_contests(cases, note),
        *_handovers(asked.handovers, note),
        *timing_contests(cases, note),
        *kinematics_contests(asked.poses, asked.iterated, note),
        balance_contest(asked.programs, note),
    ]
    left_out = [] if asked.handovers else [NotMeasured("HPP", "the handover is left out of this run")]
    return Findings(list(peers_limits(found)), peers_sections(found, left_out))


def _handovers(runs: int, note: Note) -> list[Contest]:
    if not runs:
        return []
    with TemporaryDirectory() as databases:
        return [handover_contest(runs, note, Path(databases))]


def peers_limits(found: Sequence[Contest]) -> Iterator[Limit]:
    """Yield that our own answers pass the check that the others' have to pass."""
    for contest in found:
        refused = contest.ours.refused
        yield Limit(f"{contest.what}: answers of ours that the check refuses", "= 0", refused, not refused)


def peers_sections(found: Sequence[Contest], left_out: Sequence[NotMeasured] = ()) -> list[str]:
    """Return the table of all, where we lose, what could not be measured, and how each fared by itself."""
    return [_summary(found), _losses(found), _not_measured(found, left_out), _details(found)]


def _summary(found: Sequence[Contest]) -> str:
    head = ("peer", "what (cases)", "its time ÷ ours", "its success", "ours", "its length or duration ÷ ours")
    rows = [
        (peer.name, contest.what, None, None, contest.ours.success, None)
        if isinstance(peer, NotMeasured)
        else (peer.name, contest.what, contest.time_ratio(peer), peer.success, contest.ours.success,
              contest.size_ratio(peer) if contest.size in SHOWN else None)
        for contest in found
        for peer in contest.peers
    ]  # fmt: skip
    text = (
        "Medians of CPU time on one core, in one run, on the same cases; success is the share of cases whose answer "
        "passes a check that is the same for all and takes nobody's word: coal on pinocchio's kinematics for paths, "
        "pinocchio for postures, differences of samples for time laws, the program as it is printed, in cvxpy, for "
        "forces. Answers that come too late or are refused are in the time, too. A dash: not measured, or "
        f"nothing to compare. {_versions()}"
    )
    return "\n\n".join(["### Ours beside each", text, table(head, rows)])


def _versions() -> str:
    return ", ".join(f"{name} {_version(name)}" for name in PACKAGES) + "."


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "(not installed)"


def _losses(found: Sequence[Contest]) -> str:
    lines = [f"- {line}" for contest in found for peer in contest.measured for line in losses(contest, peer)]
    return "### Where we lose\n\n" + ("\n".join(lines) or "Nowhere in this run.")


def losses(contest: Contest, peer: Entry) -> Iterator[str]:
    """Yield in what a peer is better, a sentence each."""
    ours, what = contest.ours, contest.what
    time, size = contest.time_ratio(peer), contest.size_ratio(peer)
    if time < 1.0 - SLIGHT:
        yield (
            f"{what}: {peer.name} is {1.0 / time:.1f} times as fast, {cell(peer.milliseconds(50))} ms where ours takes "
            f"{cell(ours.milliseconds(50))} ms."
        )
    if peer.success > ours.success:
        yield f"{what}: {peer.name} solves {100 * peer.success:.1f} % and ours {100 * ours.success:.1f} %."
    if size is not None and (size < 1.0 - SLIGHT if contest.less_is_better else size > 1.0 + SLIGHT):
        word = "less" if contest.less_is_better else "more"
        yield f"{what}: {peer.name} has {100 * abs(1.0 - size):.1f} % {word} {contest.size} in the median."


def _not_measured(found: Sequence[Contest], left_out: Sequence[NotMeasured]) -> str:
    peers = [*(peer for each in found for peer in each.peers), *left_out]
    absent = {peer.name: peer.reason for peer in peers if isinstance(peer, NotMeasured)}
    lines = [f"- {name}: {reason}." for name, reason in absent.items()]
    return "### What could not be measured\n\n" + ("\n".join(lines) or "Everything was.")


def _details(found: Sequence[Contest]) -> str:
    head = ("what (cases)", "median [ms]", "95 % below [ms]", "success", "refused by the check", "median size")
    blocks = ["### How each was used, and how it fared"]
    for contest in found:
        rows = [
            (f"{entry.name}: {contest.what}", entry.milliseconds(50), entry.milliseconds(95), entry.success,
             entry.refused, entry.median_size)
            for entry in (contest.ours, *contest.measured)
        ]  # fmt: skip
        blocks += [contest.text] if contest.text else []
        blocks.append(table(head, rows))
    return "\n\n".join(blocks)
