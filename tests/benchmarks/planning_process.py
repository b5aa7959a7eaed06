"""One planning process: warms up, plans the task on stdin, and tells its time and peak memory on stdout as JSON.

`ru_maxrss` of a child counts what its parent held when it forked, so the peak is read as VmHWM, which begins anew.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from tests.benchmarks.bench_tasks import measure_body
from workers.solver.pipeline import Pipeline


def main() -> None:
    """Plan one task."""
    body = json.load(sys.stdin)
    pipeline = Pipeline.load()
    figures = measure_body(pipeline, body)
    json.dump({**figures, "peak_mib": _peak_mib()}, sys.stdout)


def _peak_mib() -> float:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return float(line.split()[1]) / 1024
    raise OSError("the system does not tell the peak memory of a process")


if __name__ == "__main__":
    main()
