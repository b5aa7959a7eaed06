"""Tells of planning plate lifts: the paper's columns beside ours."""

from __future__ import annotations

from collections.abc import Iterable
from statistics import fmean, pstdev
from typing import TYPE_CHECKING

from tests.benchmarks.bench_graph import GraphFigures, PathFigures, SearchFigures
from tests.benchmarks.bench_paper_method import PaperMethodFigures
from tests.benchmarks.bench_processes import ProcessFigures
from tests.benchmarks.bench_tasks import TaskFigures
from tests.benchmarks.lift_variants import OURS
from tests.benchmarks.markdown import Cell, cell, table
from tests.benchmarks.paper_tables import PAPER
from tests.benchmarks.part import Limit

if TYPE_CHECKING:
    from tests.benchmarks.planning_part import PlanningFigures

PLANNING_LIMIT, PLANNING_AIM = 3.0, 1.0
"""[s]"""
CERTIFICATE_LIMIT, CERTIFICATE_AIM = 5.0, 1.0
"""[s]"""
MEMORY_LIMIT = 1024.0
"""[MiB]"""


def limits(results: PlanningFigures) -> list[Limit]:
    """Return what was aimed at beside what was reached."""
    solved = [task for task in results.tasks if task.name in PAPER]
    certified = sum(task.outcome == "solved" and not task.failed_checks for task in solved)
    planning = {task.name: task.planning for task in solved}
    certificate = {task.name: task.certificate for task in solved}
    memory = {figures.name: figures.peak_mib for figures in results.processes}
    return [
        Limit.at_most("planning [s], slowest of the tasks", planning, PLANNING_LIMIT, PLANNING_AIM),
        Limit.at_most("certificate [s], slowest of the tasks", certificate, CERTIFICATE_LIMIT, CERTIFICATE_AIM),
        Limit.at_most("peak memory of a planning process [MiB]", memory, MEMORY_LIMIT),
        Limit(
            "tasks solved and certified", f"{len(solved)} of {len(solved)}", f"{certified} of {len(solved)}",
            certified == len(solved),
        ),
    ]  # fmt: skip


def sections(results: PlanningFigures, pictures: dict[str, str]) -> list[str]:
    """Return the sections of this part; pictures are file names."""
    return [
        _tasks(results, pictures["stages"]),
        _processes(results),
        _table_3(results),
        _table_4(results),
        _differences(results),
        _paper_method(results, pictures["comparison"]),
        _scaling(results, pictures["scaling"]),
    ]


def _tasks(results: PlanningFigures, picture: str) -> str:
    stages = list(dict.fromkeys(stage for task in results.tasks for stage in task.stages))
    head = ("task", "outcome", "planning", "of it CPU", "slowest run", "certificate", "of it CPU", "total")
    rows = [
        (task.name, task.outcome, task.planning, task.planning_cpu, task.slowest_planning, task.certificate,
         task.certificate_cpu, task.total) for task in results.tasks
    ]  # fmt: skip
    parts = [
        "### Tasks, spec to certified plan",
        "Seconds, medians, in one warm process with cached kernels. Planning runs from the parsed body to the finished "
        "document, motion included.",
        table(head, rows),
        "Stages of planning:",
        table(
            ("task", *stages), [(task.name, *(task.stages.get(stage) for stage in stages)) for task in results.tasks]
        ),
        f"![Stages of planning and certificate]({picture})",
        *_failures(results.tasks),
    ]
    return "\n\n".join(parts)


def _failures(tasks: Iterable[TaskFigures]) -> list[str]:
    lines = [f"- {task.name}: {task.summary}" for task in tasks if task.outcome != "solved"]
    lines += [
        f"- {task.name}: **the certificate failed** at {', '.join(task.failed_checks)}; the service does not deliver it"
        for task in tasks
        if task.failed_checks
    ]
    return ["\n".join(lines)] if lines else []


def _processes(results: PlanningFigures) -> str:
    service = results.service
    rows = []
    for figures in results.processes:
        over_http = (
            (None, None, None)
            if service is None
            else (1e3 * service.accepted[figures.name], service.done[figures.name], service.states[figures.name])
        )
        rows.append((figures.name, figures.peak_mib, *over_http))
    text = (
        f"A solver process is ready {cell(results.start)} s after its start, kernels cached; one always waits for the "
        "next job. Peak memory (resident, VmHWM) is that of a process which warms up and solves one task."
    )
    if service is not None:
        text += (
            f" `liftwright serve` is ready after {cell(service.start)} s; the first time, with an empty data "
            f"directory, after {cell(service.first_start)} s. All tasks posted at once take "
            f"{cell(service.in_a_row)} s each, the start of each job's process included."
        )
    head = ("task", "peak memory [MiB]", "POST to 202 [ms]", "202 to done [s]", "ended as")
    return "\n\n".join(["### Processes and the running service", text, table(head, rows)])


def _table_3(results: PlanningFigures) -> str:
    lazy = {task.name: task for task in results.tasks}
    graphs = [figures for figures in results.graphs if figures.variant == OURS.name]
    sizes = [row for figures in graphs for row in _sizes(figures)]
    times = [row for figures in graphs for row in _times(figures)]
    examined = [_examined(figures, lazy[figures.name]) for figures in graphs]
    return "\n\n".join(
        [
            "### Table III: building the graph",
            "The whole graph of the planner that people run, every node examined, as the paper builds it "
            "(`search: full`), with the reserve that its plan keeps. MSG nodes can be held, and MSG edges are those "
            "between them.",
            table(
                ("task", "grips", "pushes", "holds", "DCSG nodes", "DCSG edges", "MSG nodes", "MSG edges"),
                sizes,
            ),
            "Seconds. RV1 is reach and collisions, RV2 the balance of each hold: least, most, mean, standard deviation "
            "and total. Ours counts the holds of which a node was left to examine; proofs of imbalance found at one "
            "hold rule out nodes of others, and poses that differ by height alone share an answer. Whether hands can "
            "rise from a goal the paper does not ask; it is in the sum.",
            table(
                ("task", "DCSG", "RV1", "RV2 min", "max", "mean", "std", "RV2 total", "rise", "merge", "all"),
                times,
            ),
            "What the default, lazy search examines instead, the path being the same. Candidates are the nodes that "
            "each hand reaches by itself.",
            table(
                ("task", "poses × holds", "candidates", "examined, full", "examined, lazy", "programs solved, lazy"),
                examined,
            ),
        ]
    )


def _sizes(figures: GraphFigures) -> list[list[Cell]]:
    paper = PAPER[figures.name]
    holds = paper.grips + paper.pushes + paper.grips * paper.pushes
    return [
        [f"{figures.name}, paper", paper.grips, paper.pushes, holds, paper.dcsg_nodes, paper.dcsg_edges, paper.nodes,
         paper.edges],
        [f"{figures.name}, ours", figures.grips, figures.pushes, figures.holds, figures.dcsg_nodes, figures.dcsg_edges,
         figures.nodes, figures.edges],
    ]  # fmt: skip


def _times(figures: GraphFigures) -> list[list[Cell]]:
    paper, spent = PAPER[figures.name], figures.balance_seconds
    own = (min(spent), max(spent), fmean(spent), pstdev(spent), sum(spent))
    total = figures.dcsg_seconds + figures.reach_seconds + own[4] + figures.rise_seconds + figures.merge_seconds
    return [
        [f"{figures.name}, paper", paper.dcsg_seconds, paper.reach_seconds, *paper.balance_seconds, None,
         paper.merge_seconds, paper.total_seconds - paper.search_seconds],
        [f"{figures.name}, ours", figures.dcsg_seconds, figures.reach_seconds, *own, figures.rise_seconds,
         figures.merge_seconds, total],
    ]  # fmt: skip


def _examined(figures: GraphFigures, lazy: TaskFigures) -> list[Cell]:
    everything = figures.dcsg_nodes * figures.holds
    return [
        figures.name, everything, figures.candidates, figures.examined, lazy.search.get("examined"),
        lazy.search.get("balances_solved"),
    ]  # fmt: skip


def _table_4(results: PlanningFigures) -> str:
    ours = [figures for figures in results.searches if figures.variant == OURS.name]
    rows = [row for figures in ours for row in _searches(figures)]
    return "\n\n".join(
        [
            "### Table IV: searching the graph",
            "The same graph. The search runs from every start to all goals, every node being known. Its path is what "
            "the paper reports: the cheapest of each start, and of these the one of least force. Ours is checked along "
            "its edges too, and replaced until its whole motion is found: the checked path, with the seconds of all "
            "searches, checks and motions. Length counts nodes, force is the largest contact normal of a hand in "
            "newtons.",
            table(
                ("task", "reserve", "starts", "goals", "search [s]", "length", "contact changes", "force",
                 "checked length", "contact changes", "force", "paths tried", "checked [s]"),
                rows,
            ),
        ]
    )  # fmt: skip


def _searches(figures: SearchFigures) -> list[list[Cell]]:
    rows: list[list[Cell]] = []
    if figures.minimise == "cost":
        paper = PAPER[figures.name]
        rows.append(
            [f"{figures.name}, paper", 0, paper.starts, paper.goals, paper.search_seconds, paper.length,
             paper.contact_changes, f"{paper.largest_force:.2f}", None, None, None, None, None]
        )  # fmt: skip
    rows.append(
        [f"{figures.name}, least {figures.minimise}", figures.reserve, figures.starts, figures.goals,
         figures.search_seconds, *_path(figures.first), *_path(figures.checked), figures.sequences,
         figures.checked_seconds]
    )  # fmt: skip
    return rows


def _differences(results: PlanningFigures) -> str:
    searches = {(each.name, each.variant): each for each in results.searches if each.minimise == "cost"}
    rows: list[list[Cell]] = []
    for name in dict.fromkeys(figures.name for figures in results.graphs):
        paper = PAPER[name]
        rows.append(
            [f"{name}, paper", 0, paper.dcsg_edges, paper.nodes, paper.edges, paper.starts, paper.goals, paper.length,
             paper.contact_changes, f"{paper.largest_force:.2f}", None, None, None, None]
        )  # fmt: skip
        for figures in (each for each in results.graphs if each.name == name):
            search = searches[name, figures.variant]
            rows.append(
                [f"{name}, {figures.variant}", figures.reserve, figures.dcsg_edges, figures.nodes, figures.edges,
                 search.starts, search.goals, *_path(search.first), *_path(search.checked), search.sequences]
            )  # fmt: skip
    return "\n\n".join(
        [
            "### What is ours, and what it changes",
            "The same tables, least cost, with one thing of ours left out at a time; "
            "[docs/differences.md](../../docs/differences.md) says why it is there. *The reserve* is the share of "
            "every limit that is kept back: what the delivered plan keeps, where not all that is asked for can be. "
            "*The rise*: a goal is a node from which both hands can go on upwards with the plate, with some of the "
            "cup's force to spare. *Limits of hands*: what the arm's payload leaves beside a hand, and what a task "
            "allows. *Free fingers* press as they like, as the paper's do, where a gripper squeezes. *Tolerances* are "
            "of mass and centre of mass: every state is balanced at all corners of both. *The rotation rule*: poses "
            "are joined only below an angle, too. The paper's number of DCSG edges "
            "is met by a threshold of the centre of mass alone.",
            table(
                ("task", "reserve", "DCSG edges", "MSG nodes", "MSG edges", "starts", "goals", "length",
                 "contact changes", "force", "checked length", "contact changes", "force", "paths tried"),
                rows,
            ),
        ]
    )  # fmt: skip


def _path(path: PathFigures | None) -> tuple[Cell, Cell, Cell]:
    return (None, None, None) if path is None else (path.length, path.contact_changes, f"{path.largest_force:.2f}")


def _paper_method(results: PlanningFigures, picture: str) -> str:
    ours = {task.name: task.planning_cpu for task in results.tasks}
    return "\n\n".join(
        [
            "### The paper's own method on this machine (extrapolated)",
            "Each pose with each hold examined by itself. RV1: inverse kinematics by iteration (pinocchio, damped "
            "least squares, from the start positions) for the poses of each hand, collisions of every solution and "
            "pair of solutions. RV2: the cone program stated anew in cvxpy and solved, where RV1 leaves a node. "
            "**Timed on a seeded random sample and extrapolated** to all poses × holds, in CPU seconds; ± is the "
            "standard error. "
            "Collisions are asked of our compiled kernel, the first hand that cannot reach ends a node, and merging, "
            "searching and motion are left out, all in favour of the paper's method. Ours is planning as above, "
            "motion included, in CPU seconds too; the ratios are of this run: first with RV2 alone, then with both.",
            table(
                ("task", "poses × holds", "RV1 sampled", "RV1 [s]", "left by RV1", "RV2 sampled", "RV2 [s]",
                 "both [s]", "paper printed, all [s]", "ours [s]", "RV2 ÷ ours", "both ÷ ours"),
                [_extrapolated(figures, ours[figures.name]) for figures in results.paper_method],
            ),
            f"![The paper, its method here, and ours]({picture})",
        ]
    )  # fmt: skip


def _extrapolated(figures: PaperMethodFigures, ours: float) -> list[Cell]:
    return [
        figures.name, figures.nodes, figures.sampled,
        f"{figures.reach_seconds:,.0f} ± {figures.reach_error:,.0f}", figures.reached, figures.programs,
        f"{figures.cone_seconds:,.0f} ± {figures.cone_error:,.0f}", figures.total, PAPER[figures.name].total_seconds,
        ours, figures.cone_seconds / ours, figures.total / ours,
    ]  # fmt: skip


def _scaling(results: PlanningFigures, picture: str) -> str:
    head = (
        "task",
        "contacts",
        "holds",
        "poses",
        "nodes",
        "edges",
        "planning [s]",
        "of it CPU",
        "memory [MiB]",
        "outcome",
    )
    return "\n\n".join(
        [
            "### How cost grows",
            "Denser contacts cut every step of tilt and azimuth; denser holds put more grips and pushes on the rim. "
            "Each row is a process of its own, one run, lazy search.",
            table(head, [_scaled(figures) for figures in results.scaling]),
            f"![Planning time over the size of the graph]({picture})",
        ]
    )


def _scaled(figures: ProcessFigures) -> list[Cell]:
    return [
        figures.name, f"×{figures.contact_density:g}", f"×{figures.hold_density:g}", figures.poses, figures.nodes,
        figures.edges, figures.planning, figures.planning_cpu, figures.peak_mib, figures.outcome,
    ]  # fmt: skip
