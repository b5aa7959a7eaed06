"""The part of RESULTS.md on compiled kernels, each beside well-known libraries."""

from __future__ import annotations

from pathlib import Path

from tests.benchmarks.effort import KERNELS, Effort
from tests.benchmarks.markdown import table
from tests.benchmarks.part import Findings, Limit
from tests.benchmarks.tasks import Note

RATE_LIMIT = 100_000.0
"""Free configurations of the full cell on one core [1/s]."""
COMPARISONS = (
    ("a free configuration of the full cell", "collision", 1.0, "free_us",
     (("coal, broad phase", "coal_broadphase_free_us"), ("coal, all pairs", "coal_pairs_free_us"),
      ("python-fcl, all pairs", "fcl_pairs_free_us"))),
    ("inverse kinematics, all branches", "kinematics", 1.0, "closed_form_us",
     (("pinocchio, iterated, one solution", "iteration_us"),)),
    ("a cone program", "balance", 1.0, "ours_us",
     (("Clarabel, same matrices", "clarabel_us"), ("cvxpy, stated anew", "cvxpy_us"))),
    ("cheapest paths from one start, 300,000 edges", "search", 1e3, "ours_ms",
     (("scipy dijkstra", "scipy_ms"), ("networkx dijkstra", "networkx_ms"))),
)  # fmt: skip
"""What, its kernel, microseconds in the unit of its figures, our figure, and others with theirs."""


def measure(effort: Effort, note: Note, folder: Path) -> Findings:
    """Measure each kernel beside others that do the same."""
    del folder
    kernels: dict[str, dict[str, float]] = {}
    for name in effort.kernels:
        note(f"kernels: {name}")
        kernels[name] = KERNELS[name]()
    beside = [
        (what, ours * scale, other, theirs * scale, theirs / ours)
        for what, kernel, scale, own_member, others in COMPARISONS
        for other, member in others
        if (figures := kernels.get(kernel)) and (ours := figures[own_member]) and (theirs := figures[member])
    ]
    comparison = [
        "### Beside other libraries",
        "CPU time on one core; the others' figures come from the same run.",
        table(("", "ours [µs]", "beside", "its [µs]", "its ÷ ours"), beside),
    ]
    details = [
        f"### {name.capitalize()}\n\n" + table(("", ""), [(_spelt(member), value) for member, value in figures.items()])
        for name, figures in kernels.items()
    ]
    return Findings(list(_limits(kernels)), ["\n\n".join(comparison), *details])


def _limits(kernels: dict[str, dict[str, float]]) -> list[Limit]:
    if "collision" not in kernels:
        return []
    rate = kernels["collision"]["free_per_second"]
    what = "free configurations of the full cell per CPU second"
    return [Limit(what, f"≥ {RATE_LIMIT:,.0f}", rate, rate >= RATE_LIMIT)]


def _spelt(member: str) -> str:
    """Write the name of a figure out, with its unit in brackets."""
    words = member.split("_")
    units = {"us": "[µs]", "ms": "[ms]"}
    return " ".join([*(word for word in words if word not in units), *(units[word] for word in words if word in units)])
