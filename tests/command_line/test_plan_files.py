"""What `liftwright plan` says of files that are no task, and of what it keeps beside plans."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.service import ROOT, task

from app.cli.main import main
from app.cli.service_client import NotUnderstood, ServiceClient
from planners.plan.plan import Plan
from planners.plan.verdicts import Explanation
from planners.progress import Progress
from planners.scene.suction_tool import load_tool
from tests.support.scan_frames import SHIPPED
from tests.support.tool_plans import FEW
from workers.solver.pipeline import Pipeline

Said = Callable[..., str]
SCANS_TASK = SHIPPED / "tissue_boxes" / "task.json"
SCENE = {"schema_version": "1.0", "cell": "dual_ur3e_tool", "external_id": None, "tool": None, "table": None,
         "objects": [], "unrecognised": [], "notes": []}  # fmt: skip
UPLOAD = "0" * 64


@pytest.fixture
def refusal(capsys: pytest.CaptureFixture[str]) -> Said:
    """Return what is said of bad input, one line."""

    def run(*arguments: object) -> str:
        assert main(["plan", *map(str, arguments)]) == 3
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1
        return lines[0]

    return run


def _written(path: Path, body: Any) -> Path:
    path.write_text(json.dumps(body))
    return path


@pytest.mark.parametrize(
    ("content", "said"), [(b"{", "the file is not JSON"), (b"\x89PNG", "the file is not UTF-8"), (b"[]", "")]
)
def test_a_file_that_cannot_be_a_task_is_named(content: bytes, said: str, tmp_path: Path, refusal: Said) -> None:
    path = tmp_path / "viewer.png"
    path.write_bytes(content)
    told = refusal(path)
    assert f"{path}: {said}" in told
    assert "body" not in told


def test_a_task_given_as_a_scene_is_told_how_to_get_one(tmp_path: Path, refusal: Said) -> None:
    path = _written(tmp_path / "lid.json", task("domino_pile.json"))
    told = refusal(path, "--scene", path)
    assert told.startswith(f"liftwright: {path} is not a scene")
    assert "liftwright scene --out FILE" in told


def test_a_file_given_as_a_scene_that_is_not_json_is_named(tmp_path: Path, refusal: Said) -> None:
    path = tmp_path / "scene.json"
    path.write_text("{")
    assert f"{path}: the file is not JSON" in refusal(SCANS_TASK, "--scene", path)


def test_a_scene_given_as_a_task_is_told_apart(tmp_path: Path, refusal: Said) -> None:
    path = _written(tmp_path / "seen.json", SCENE)
    assert f"{path} is a scene, not a task; give it as --scene" in refusal(path)


def test_a_plan_document_given_as_a_task_is_told_apart(tmp_path: Path, refusal: Said) -> None:
    document = {"schema_version": "1.0", "task": task(), "segments": [], "certificate": None}
    path = _written(tmp_path / "plan.json", document)
    assert f"{path} is a plan document, not a task" in refusal(path)


def test_a_task_of_perceived_objects_without_a_scene_is_told_how_to_give_one(refusal: Said) -> None:
    told = refusal(SCANS_TASK)
    assert told == '/scene_id: the task needs a scene: give --scene FILE, or "scene_id" in the task'


def test_a_task_with_an_upload_is_told_that_a_service_keeps_it(tmp_path: Path, refusal: Said) -> None:
    body = task("domino_pile.json")
    body["objects"][0]["shape"] = {"type": "mesh", "upload": UPLOAD}
    told = refusal(_written(tmp_path / "task.json", body))
    assert f"the upload {UPLOAD} is kept by a service, not here" in told
    assert "--service" in told


def test_a_place_that_cannot_be_written_is_called_as_it_was_given(refusal: Said) -> None:
    told = refusal(ROOT / "assets/tasks/ab1.json", "--out", "/proc/x.json")
    assert told.endswith("'/proc/x.json'")


def test_a_plan_that_only_another_version_can_read_is_said_to_be_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ServiceClient, "read", lambda *_: b'{"schema_version": "1.1"}')
    with pytest.raises(NotUnderstood, match="/schema_version"):
        ServiceClient("http://127.0.0.1:8040").plan("/v1/plans/some/document")


@pytest.fixture
def needs_handovers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have planning ask for handovers, few of them, and find no plan."""

    def solve(pipeline: Pipeline, _: object, progress: Progress) -> Plan:
        pipeline.solver.handovers(pipeline.solver.cells["dual_ur3e_tool"], load_tool("long_symmetric"), FEW, progress)
        explanation = Explanation(summary="none", causes=[])
        return Plan.model_construct(outcome="not_found", explanation=explanation, certificate=None)

    monkeypatch.setattr(Pipeline, "solve", solve)


@pytest.mark.usefixtures("needs_handovers")
def test_handovers_are_computed_aloud_and_once_for_a_data_directory(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file, kept = str(ROOT / "assets/tasks/domino_pile.json"), tmp_path / "kept"
    assert main(["plan", file]) == 2
    told = capsys.readouterr().err
    assert told.count("computing handovers") == 1
    assert "not kept" in told
    assert "--data-dir" in told
    assert list(tmp_path.iterdir()) == []
    assert main(["plan", file, "--data-dir", str(kept)]) == 2
    assert str(kept) in capsys.readouterr().err
    monkeypatch.setenv("LIFTWRIGHT_DATA_DIR", str(kept))
    assert main(["plan", file]) == 2
    assert "computing handovers" not in capsys.readouterr().err
