"""What a command loads: nobody waits for what the command has no use for."""

from __future__ import annotations

import json
import subprocess
import sys
from itertools import chain
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PLANNING = ("numba", "scipy", "pinocchio", "ompl")
SERVICE = ("fastapi", "uvicorn", "sqlalchemy", "dbos", "alembic", "viser")
SECOND_OPINIONS = ("cvxpy", "trimesh", "networkx")
"""Asked where a plan is certified, or where there is none."""

LIST_LOADED = "import json, sys; print(json.dumps([*sys.modules]), file=sys.__stdout__)"


def loaded_by(statements: str) -> set[str]:
    """Return the top-level packages that a process has loaded at its end."""
    done = subprocess.run(
        [sys.executable, "-c", f"{statements}\n{LIST_LOADED}"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return {name.partition(".")[0] for name in json.loads(done.stdout.splitlines()[-1])}


def refused(task: Path) -> str:
    return f"from app.cli.main import main\nassert main(['plan', {str(task)!r}]) == 3"


@pytest.mark.parametrize("body", ['{"kind": "plate_lift"', '{"kind": "plate_lift", "plate": 3}', "[]"])
def test_a_task_with_faults_of_text_or_form_is_refused_before_any_planner_is_loaded(tmp_path: Path, body: str) -> None:
    task = tmp_path / "task.json"
    task.write_text(body)
    assert not loaded_by(refused(task)) & {*PLANNING, *SERVICE, *SECOND_OPINIONS}


@pytest.mark.slow
def test_a_plan_is_begun_with_nothing_of_the_service_and_no_second_opinion() -> None:
    loaded = loaded_by("import app.cli.plan_command, app.cli.local_planner, workers.solver.pipeline")
    assert loaded >= set(PLANNING)
    assert not loaded & {*chain(SERVICE, SECOND_OPINIONS)}


@pytest.mark.slow
def test_only_the_cell_that_is_asked_for_is_loaded() -> None:
    asked = "from planners.cell import cell\nassert len(cell.ShippedCells()) > 1\ncell.ShippedCells()['dual_ur3e_lift']"
    loaded_by(f"{asked}\nassert cell.load_cell.cache_info().currsize == 1")


def test_a_process_that_has_loaded_libraries_for_good_ends_without_a_word() -> None:
    """Bindings complain of whatever of theirs is left when the interpreter ends."""
    program = "from workers.loading import loading\nwith loading():\n    import planners.motion.rrt_connect\n"
    ended = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert (ended.stdout, ended.stderr) == ("", "")
