"""`make bench`: measures everything, or the parts that are named, into RESULTS.md and its pictures."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

from tests.benchmarks import (
    cell_part,
    fleet_part,
    kernel_part,
    lift_part,
    lifter_part,
    peers_part,
    perception_part,
    planning_part,
    random_lift_part,
    reserve_part,
    scale_part,
    service_part,
    study_part,
    suction_part,
)
from tests.benchmarks.attempt_file import Unfinished
from tests.benchmarks.effort import FULL, QUICK
from tests.benchmarks.machine import Circumstances
from tests.benchmarks.part import Part, write_part
from tests.benchmarks.results_file import NAME, replace_part

PARTS = {
    part.name: part
    for part in (
        Part("planning", "Plate lifts: planning", planning_part.measure),
        Part("lifts_random", "Plate lifts: random", random_lift_part.measure),
        Part("lifts", "Plate lifts: simulated", lift_part.measure),
        Part("lifters", "Plate lifts: lifters of all speeds", lifter_part.measure),
        Part("reserve", "Plate lifts: what a reserve is worth", reserve_part.measure),
        Part("studies", "Plate lifts: studies", study_part.measure),
        Part("suction", "The suction tool", suction_part.measure),
        Part("cells", "The shipped cells", cell_part.measure),
        Part("perception", "Perception", perception_part.measure),
        Part("kernels", "Kernels", kernel_part.measure),
        Part("peers", "Beside what a user would pick instead", peers_part.measure),
        Part("load", "The service: under load", service_part.measure_load),
        Part("fuzz", "The service: bad input", service_part.measure_bad_input),
        Part("faults", "The service: killed at random", service_part.measure_faults),
        Part("fairness", "The service: one owner's many jobs and another's one", scale_part.measure_fairness),
        Part("many_workers", "The service: many workers on one database", scale_part.measure_many_workers),
        Part("days", "The service: days of jobs", scale_part.measure_days),
        Part("fleet", "The service: a fleet in containers", fleet_part.measure),
    )
}
"""In the order in which they stand in the report."""


def main() -> None:
    """Run the benchmarks."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; all unless told")
    parser.add_argument("--quick", action="store_true", help="one small case of each, to see that everything works")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, metavar="DIR", help="where RESULTS.md goes")
    parser.add_argument("--most", type=int, metavar="N", help="attempts to make before a resumable part stops")
    parser.add_argument("--runs", type=int, metavar="N", help="of each task and reserve, in the part reserve")
    parser.add_argument("--jobs", type=int, metavar="N", help="in each place, in the part days")
    parser.add_argument("--processes", type=int, metavar="N", help="that make attempts at a time")
    given = parser.parse_args()
    unknown = [name for name in given.parts if name not in PARTS]
    if unknown:
        parser.error(f"there is no part {', '.join(unknown)}; choose from {', '.join(PARTS)}")
    begun = time.monotonic()

    def note(what: str) -> None:
        print(f"{time.monotonic() - begun:6.0f} s  {what}", file=sys.stderr, flush=True)

    told = {"most_attempts": given.most, "processes": given.processes, "reserve_runs": given.runs,
            "days_jobs": given.jobs}  # fmt: skip
    effort = replace(QUICK if given.quick else FULL, **{name: n for name, n in told.items() if n is not None})
    given.out.mkdir(parents=True, exist_ok=True)
    for name in given.parts or PARTS:
        circumstances = Circumstances.now()
        try:
            findings = PARTS[name].measure(effort, note, given.out)
        except Unfinished as unfinished:
            note(f"{name}: {unfinished}; the same command goes on with them")
            continue
        text = write_part(PARTS[name], findings, circumstances.told())
        replace_part(given.out / NAME, name, text, list(PARTS), quick=given.quick)
        note(f"{name}: written into {NAME}")


if __name__ == "__main__":
    main()
