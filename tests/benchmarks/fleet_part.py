"""The part of RESULTS.md on the fleet in containers."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from tests.benchmarks.effort import Effort
from tests.benchmarks.markdown import table
from tests.benchmarks.part import Findings, Limit
from tests.benchmarks.tasks import Note
from tests.deployment import fleet

LARGEST_IMAGE = 1.5e9
"""[bytes]"""
SLOWEST_START = 10.0
"""[s]"""


def measure(effort: Effort, note: Note, folder: Path) -> Findings:
    """Build and run the fleet as `make fleet` does: about half an hour, as root."""
    del folder
    if not effort.fleet:
        return Findings([], [])
    fleet.FOLDER.mkdir(parents=True, exist_ok=True)
    figures = fleet.measure(fleet.FOLDER, note)
    outcomes = Counter(figures.outcomes.values())
    limits = [
        Limit("size of the image [GB]", "≤ 1.5", figures.image_bytes / 1e9, figures.image_bytes <= LARGEST_IMAGE),
        Limit(
            "API and workers ready after their start [s]", "≤ 10", figures.starting, figures.starting <= SLOWEST_START
        ),
        Limit("kernels compiled after the start", "= 0", figures.compiled, figures.compiled == 0),
    ]
    rows = [
        ("the image is built; layers that an earlier run has made are there [s]", figures.building),
        ("it is built again for another commit that changes none of its files [s]", figures.rebuilding),
        ("shipped tasks planned, certified and simulated", sum(outcomes.values())),
        *((f"… of which {outcome.replace('_', ' ')}", number) for outcome, number in sorted(outcomes.items())),
        ("until a third worker is healthy, too [s]", figures.scaling),
        ("jobs of a killed worker that others did", figures.taken_over),
        ("until API and workers of a rebuilt image are ready [s]", figures.upgrading),
        ("jobs that were accepted before the upgrade, and planned by the rebuilt image", figures.waited),
        ("containers killed at random while tasks were posted and planned", sum(figures.kills.values())),
        *((f"… of which {service}", number) for service, number in sorted(figures.kills.items())),
        ("jobs accepted meanwhile, each of which ended once, with the document that its hash says", figures.outlived),
        ("how often one of these was begun again", figures.begun_anew),
        ("documents that are the same after the database was lost and restored", figures.restored),
    ]
    text = (
        "The fleet of docker-compose.yml, by podman: PostgreSQL, one API, two workers and later three, not as root, "
        "on read-only root file systems, without capabilities, which was asked within each. "
        "Debian's packages stand in for the bases of a registry."
    )
    return Findings(limits, ["\n\n".join(["### Built, run and broken", text, table(("", ""), rows)])])
