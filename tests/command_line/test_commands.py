"""The command line: what it prints, and its exit codes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from support.service import ROOT, TASKS, task

from app.cli import main
from app.summary import contact_states, largest_hand_force, summarise
from workers.pipeline import Pipeline


def test_a_solved_task_is_0_and_its_document_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "plan.json"
    assert main(["plan", str(TASKS / "ab1.json"), "--out", str(out)]) == 0
    told = capsys.readouterr().out
    document = json.loads(out.read_text())
    assert document["certificate"]["passed"] is True
    for word in ("solved", "no contact", " N ", "certificate", f"{len(document['certificate']['checks'])} checks"):
        assert word in told


def test_help_names_both_kinds_of_tasks_and_examples_that_are_there(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["plan", "--help"])
    told = capsys.readouterr().out
    for name in ("plate_lift", "ab1", "suction_tool", "domino_pile", "tissue_pile_short_tool"):
        assert name in told
    for path in TASKS.glob("*.json"):
        assert path.stem in told


def test_a_task_without_a_plan_is_2_and_says_why(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", str(TASKS / "pb1_weak_cup.json")]) == 2
    told = capsys.readouterr().out
    assert "infeasible" in told
    assert " N" in told


@pytest.mark.parametrize(
    ("body", "pointer"),
    [(json.dumps(task(cell="moon_base")), "/cell: "), (json.dumps({}), "/kind: "), ("{", "/: ")],
)
def test_bad_input_is_3_and_is_pointed_at(
    body: str, pointer: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "task.json"
    path.write_text(body)
    assert main(["plan", str(path)]) == 3
    assert capsys.readouterr().err.startswith(pointer)


def test_a_file_that_is_not_there_is_3() -> None:
    assert main(["plan", "nowhere.json"]) == 3


@pytest.mark.parametrize("out", ["no/such/folder/plan.json", "."])
def test_an_impossible_place_for_the_document_is_told_before_planning(
    out: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Pipeline, "solve", lambda *_: pytest.fail("it planned"))
    assert main(["plan", str(TASKS / "ab1.json"), "--out", out]) == 3
    assert out in capsys.readouterr().err


def test_a_document_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "plan.json"
    out.write_text("the last plan")

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Pipeline, "solve", interrupt)
    assert main(["plan", str(TASKS / "ab1.json"), "--out", str(out)]) == 130
    assert [path.name for path in tmp_path.iterdir()] == ["plan.json"]
    assert out.read_text() == "the last plan"


def test_an_option_that_cannot_be_followed_is_3_and_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["serve", "--port", "99999"]) == 3
    assert "--port" in capsys.readouterr().err


@pytest.mark.parametrize("command", [[], ["serve"], ["api"], ["worker"], ["plan"], ["warmup"]])
def test_every_command_explains_itself(command: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "app.cli", *command, "--help"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert "usage: liftwright" in done.stdout


def _segment(state: Any, contacts: list[dict[str, Any]]) -> dict[str, Any]:
    return {"contact_state": state, "contacts": contacts, "time": [0.0, 1.0]}


def test_the_summary_counts_hand_forces_along_their_normals_only() -> None:
    grip = {"by": "right", "normal": [0, 0, 1], "wrench": [9, 0, 4, 0, 0, 0]}
    cup = {"by": "cup", "normal": [0, 0, 1], "wrench": [0, 0, 50, 0, 0, 0]}
    document = {"cell": {"arms": {"left": {}, "right": {}}}, "segments": [_segment(None, [grip, cup])]}
    assert largest_hand_force(document) == (4.0, "right")


def test_contact_states_are_told_once_in_a_row() -> None:
    edge = {"element": "edge", "index": 1, "with": "table"}
    none = {"element": "none", "index": 0, "with": None}
    document = {"segments": [_segment(state, []) for state in (edge, edge, None, none, edge)]}
    assert contact_states(document) == ["edge 1 on table", "no contact", "edge 1 on table"]


def test_a_plan_without_contact_states_tells_what_is_moved() -> None:
    document = {
        "outcome": "solved", "cell": {"arms": {"left": {}, "right": {}}}, "segments": [_segment(None, [])],
        "explanation": {"summary": "3 objects moved, nearest to its goal first (a, b, c), with 1 handover."},
        "certificate": {"passed": True, "checks": []},
        "statistics": {"total_seconds": 3.0, "stages": [{"name": "certify", "seconds": 1.0}]},
    }  # fmt: skip
    told = summarise(document)
    assert "3 objects moved" in told
    assert "contact states" not in told
    assert "2.00 s" in told


def test_an_explanation_names_what_is_needed_and_what_there_is() -> None:
    cause = {"reason": "the plate is too heavy", "needed": 62.8, "available": 54.0, "unit": "N", "where": "no contact"}
    document = {"outcome": "infeasible", "explanation": {"summary": "It cannot be lifted.", "causes": [cause]}}
    told = summarise(document)
    assert "needed 62.8 N, available 54 N" in told
    assert "(no contact)" in told
