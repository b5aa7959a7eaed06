"""`make bench`: measures everything and writes RESULTS.md and its pictures."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from tests.benchmarks.plots import draw
from tests.benchmarks.report import report
from tests.benchmarks.run import FULL, QUICK, run


def main() -> None:
    """Run the benchmarks."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one small case of each, to see that everything works")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, metavar="DIR", help="where RESULTS.md goes")
    given = parser.parse_args()
    begun = time.monotonic()

    def note(what: str) -> None:
        print(f"{time.monotonic() - begun:6.0f} s  {what}", file=sys.stderr, flush=True)

    results = run(QUICK if given.quick else FULL, note)
    given.out.mkdir(parents=True, exist_ok=True)
    pictures = draw(results, given.out)
    target = given.out / "RESULTS.md"
    target.write_text(report(results, pictures, quick=given.quick, seconds=time.monotonic() - begun))
    note(f"wrote {target.name}")


if __name__ == "__main__":
    main()
