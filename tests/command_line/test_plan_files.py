"""What `liftwright plan` says of files that are no task, and of what it keeps beside plans."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from app.cli.main import main
from app.cli.output import stage_words
from app.cli.service_client import NotUnderstood, ServiceClient
from app.cli.task_file import TaskFile
from planners.cell.cell import load_cell
from planners.errors import LiftwrightError
from planners.plan.plan import Plan
from planners.progress import Progress
from planners.regrasp.graph.object_progress import ObjectStage
from planners.remedies.kinds import KINDS
from planners.scene.suction_tool import load_tool
from tests.support.documents import plan_of
from tests.support.lift_documents import lift_document, segment, simulation
from tests.support.own_cell import station
from tests.support.scan_frames import SHIPPED
from tests.support.service import ROOT, task
from tests.support.tool_plans import FEW
from workers.solver.pipeline import Pipeline
from workers.solver.progress import STAGE_SHARES
from workers.solver.protocol import SolverRequest

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


# The program ends with the files of the cell; here it goes on.
@pytest.mark.filterwarnings("ignore:Implicitly cleaning up:ResourceWarning")
def test_a_scene_that_a_service_perceived_in_ones_own_cell_is_in_the_cell_that_is_given(
    tmp_path: Path, refusal: Said
) -> None:
    scene = _written(tmp_path / "seen.json", {**SCENE, "cell": "0" * 32})
    cell = _written(tmp_path / "cell.json", station())
    told = refusal(SCANS_TASK, "--scene", scene, "--cell", cell)
    assert told == "/scene_id: the scene was perceived without depth or cloud: it has no objects"
    assert "in the cell 0000" in refusal(SCANS_TASK, "--scene", scene)


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
    assert told.startswith("liftwright: /proc/x.json: ")


UNPLANNED = {"numba", "trimesh", "scipy", "pinocchio", "pybullet", "cvxpy", "rich", "httpx", "fastapi", "sqlalchemy"}
"""What takes long to load, and only planning has a use for."""


MISSPELT = {**json.loads((ROOT / "assets/tasks/ab1.json").read_text()), "cell": "dual_ur3e_lfit"}


@pytest.mark.parametrize("body", [{}, {"kind": "plate_lift"}, {"kind": "suction_tool", "objects": []}, MISSPELT])
def test_what_is_no_task_is_refused_before_anything_is_loaded_that_plans(tmp_path: Path, body: Any) -> None:
    path = _written(tmp_path / "task.json", body)
    code = (
        "import sys; from app.cli.main import main; code = main(['plan', sys.argv[1]]);"
        "print(code, *sorted({name.partition('.')[0] for name in sys.modules}))"
    )
    done = subprocess.run([sys.executable, "-c", code, path], cwd=ROOT, capture_output=True, text=True, check=True)
    code, *loaded = done.stdout.split()
    assert code == "3"
    assert UNPLANNED.isdisjoint(loaded)
    assert done.stderr.startswith("/")


def test_a_task_may_be_written_in_yaml_and_faults_name_its_lines(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "task.yaml"
    path.write_text("kind: plate_lift\nplate:\n  mass: heavy\n  colour: red\n")
    assert main(["plan", str(path)]) == 3
    told = capsys.readouterr().err.splitlines()
    assert any(line.startswith("/plate/mass (line 3): must be a number") for line in told)
    assert any(line.startswith("/plate/colour (line 4): is not known here") for line in told)
    assert any(line.startswith("/plate/shape (line 2): is required") for line in told)
    assert any(line.startswith("/cup (line 1): is required") for line in told)


@pytest.mark.parametrize("ending", [".yaml", ".yml", ""])
def test_a_task_is_the_same_in_yaml_from_a_file_or_from_standard_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str
) -> None:
    body = task()
    for text in (yaml.safe_dump(body), json.dumps(body), json.dumps(body, indent=1)):
        path = tmp_path / f"task{ending}"
        path.write_text(text)
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
        assert TaskFile.read(str(path) if ending else "-").task == body


def _ending(outcomes: dict[str, str]) -> Callable[..., Plan]:
    """Return what plans tasks by their names, with these outcomes."""

    def solve(_: Pipeline, request: SolverRequest, __: Progress) -> Plan:
        outcome = outcomes[request.id]
        if outcome == "fault":
            raise LiftwrightError("it does not stand its check")
        segments = [segment(0.0, 2)] if outcome == "solved" else []
        explanation = {"summary": f"why {request.id} is so"}
        stated = {"outcome": outcome, "segments": segments, "explanation": explanation}
        return plan_of({**lift_document(load_cell("dual_ur3e_lift")), **stated})

    return solve


@pytest.mark.parametrize(
    ("outcomes", "code"),
    [
        ({"a": "solved", "b": "solved"}, 0),
        ({"a": "solved", "b": "not_found"}, 2),
        ({"a": "infeasible", "refused": "", "b": "solved"}, 3),
        ({"refused": "", "a": "fault", "b": "solved"}, 1),
    ],
)
def test_several_tasks_have_a_line_and_a_document_each_and_end_with_the_worst(
    outcomes: dict[str, str],
    code: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Pipeline, "solve", _ending(outcomes))
    files = [_written(tmp_path / f"{name}.json", {} if name == "refused" else task()) for name in outcomes]
    out = tmp_path / "plans"
    assert main(["plan", *map(str, files), "--out", str(out)]) == code
    told = capsys.readouterr().out.splitlines()
    assert sorted(line.split()[0] for line in told) == sorted(map(str, files))
    for line in told:
        name, words = Path(line.split()[0]).stem, " ".join(line.split()[1:])
        expected = {"solved": "solved: ", "": "refused, 1 problem", "fault": "failed"}
        assert words.startswith(expected.get(outcomes[name], f"{outcomes[name]}: why {name} is so"))
    planned = {f"{name}.json" for name, outcome in outcomes.items() if outcome not in ("", "fault")}
    assert {path.name for path in out.iterdir()} == planned


def test_tasks_are_checked_as_they_are_for_planning_and_none_is_planned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Pipeline, "solve", lambda *_: pytest.fail("a task was planned"))
    good = str(_written(tmp_path / "good.json", task()))
    bad = str(_written(tmp_path / "bad.json", {**task(), "plate_pose": [0.3, 0.0, 1.0, 1, 0, 0, 0]}))
    assert main(["plan", "--check", good]) == 0
    assert capsys.readouterr().out == f"{good}: a task that can be planned\n"
    assert main(["plan", "--check", good, bad]) == 3
    out, refused = capsys.readouterr()
    assert [line.split()[0] for line in out.splitlines()] == [good, bad]
    assert "/plate_pose: " in refused
    for more in ("--apply=1", "--service=http://127.0.0.1:1", f"--out={tmp_path / 'plan.json'}"):
        with pytest.raises(SystemExit, match="3"):
            main(["plan", "--check", good, more])


REMEDIES = [
    {
        "kind": "cup_force", "sentence": f"Pull with {force} N.", "outcome": "solved", "certified": True,
        "patch": [{"op": "add", "path": "/cup/max_force", "value": force}], "reserve": reserve, "largest_force": 12.0,
    }
    for force, reserve in ((31.0, 0.1), (32.0, 0.075))
]  # fmt: skip


def _without_a_plan(*_: Any) -> Plan:
    explanation = {"summary": "why it is so", "remedies": REMEDIES}
    stated = {"outcome": "not_found", "segments": [], "explanation": explanation}
    return plan_of({**lift_document(load_cell("dual_ur3e_lift")), **stated})


def test_remedies_are_told_with_their_numbers_and_one_is_applied(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Pipeline, "solve", _without_a_plan)
    file = _written(tmp_path / "mine.json", task())
    assert main(["plan", str(file), "--apply", "2"]) == 2
    told = capsys.readouterr().out
    assert "1. Pull with 31.0 N. Then: solved and certified, 10 % of every limit kept back, at most" in told
    assert "7.5 % of every limit kept back, where 10 % is asked for, at most" in told
    changed = tmp_path / "mine.remedy-2.json"
    assert str(changed) in told
    assert json.loads(changed.read_bytes()) == {**task(), "cup": {**task()["cup"], "max_force": 32.0}}
    assert json.loads(file.read_bytes()) == task()


def test_what_physics_carries_out_is_told_beside_a_plan_that_failed_there_and_is_applied(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    document = lift_document(load_cell("dual_ur3e_lift"))
    remedies = [{**remedy, "simulated": True} for remedy in REMEDIES]
    failed = {**simulation(0.1), "outcome": "slipped", "cause": "the stick slid"}
    explanation = {"summary": "how it is lifted", "remedies": remedies}
    plan = plan_of(
        {
            **document,
            "outcome": "solved",
            "simulation": failed,
            "explanation": explanation,
            "segments": [segment(0.0, 3)],
        }
    )
    monkeypatch.setattr(Pipeline, "solve", lambda *_: plan)
    file = _written(tmp_path / "mine.json", task())
    assert main(["plan", str(file), "--apply", "1"]) == 0
    told = capsys.readouterr().out.splitlines()
    assert "simulation:     FAILED: slipped" in told[-4]
    assert told[-3].startswith("what helps:     1. Pull with 31.0 N.")
    assert told[-2].endswith("carried out in physics.")
    assert json.loads((tmp_path / "mine.remedy-1.json").read_bytes())["cup"]["max_force"] == 31.0


def test_a_remedy_that_is_not_there_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Pipeline, "solve", _without_a_plan)
    file = str(_written(tmp_path / "mine.json", task()))
    assert main(["plan", file, "--apply", "3"]) == 3
    assert "choose from 1 to 2" in capsys.readouterr().err.splitlines()[-1]
    with pytest.raises(SystemExit, match="3"):
        main(["plan", file, "--apply", "0"])


def test_a_task_without_plan_and_remedy_is_no_bad_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    stated = {"outcome": "not_found", "segments": [], "explanation": {"summary": "why it is so", "remedies": []}}
    plan = plan_of({**lift_document(load_cell("dual_ur3e_lift")), **stated})
    monkeypatch.setattr(Pipeline, "solve", lambda *_: plan)
    assert main(["plan", str(_written(tmp_path / "mine.json", task())), "--apply", "1"]) == 2
    assert "changed task:   none" in capsys.readouterr().out


@pytest.mark.parametrize("line", [["plan"], ["plan", "a.json", "--aply", "1"], ["plan", "a.json", "--apply", "one"]])
def test_a_line_that_is_no_command_is_bad_input_and_shows_how_that_command_is_used(
    line: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="3"):
        main(line)
    assert capsys.readouterr().err.startswith("usage: liftwright plan")


def test_nothing_is_applied_to_a_task_that_has_a_plan_or_to_several(
    tmp_path: Path, refusal: Said, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Pipeline, "solve", _ending({"a": "solved"}))
    one = _written(tmp_path / "a.json", task())
    assert main(["plan", str(one), "--apply", "1"]) == 0
    assert "none, the task has a plan" in capsys.readouterr().out
    assert "one task" in refusal(one, _written(tmp_path / "b.json", task()), "--apply", "1")


def test_no_document_takes_the_place_of_its_task_or_of_another_document(tmp_path: Path, refusal: Said) -> None:
    one = _written(tmp_path / "one.json", task())
    other = tmp_path / "other"
    other.mkdir()
    same = _written(other / "one.json", task())
    assert f"{one} is a task" in refusal(one, "--out", one)
    assert "one.json is a task" in refusal(one, _written(tmp_path / "two.json", task()), "--out", tmp_path)
    assert "two tasks would be written to" in refusal(one, same, "--out", tmp_path / "plans")
    assert f"{one} is given twice" in refusal(one, one)
    assert "go to a folder" in refusal(one, _written(tmp_path / "two.json", task()), "--out", one)
    assert json.loads(one.read_text()) == task()


def test_a_quaternion_with_w_last_is_warned_of_and_planned_as_it_stands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Pipeline, "solve", _ending({"task": "solved"}))
    body = task()
    meant = body["plate_pose"][:3]
    for quaternion, warned in (([0, 0, 0, 1], True), ([1, 0, 0, 0], False), ([0.8, 0, 0, 0.6], False)):
        path = _written(tmp_path / "task.json", {**body, "plate_pose": [*meant, *quaternion]})
        code = main(["plan", str(path)])
        told = capsys.readouterr().err
        assert ("warning: /plate_pose: 0, 0, 0, 1 is half a turn about z" in told) == warned
        assert code == 0 or "/plate_pose" in told


def test_stages_are_told_in_words_with_the_object_they_are_about() -> None:
    for stage in {name for shares in STAGE_SHARES.values() for name in shares} | {each.value for each in ObjectStage}:
        words = stage_words(stage)
        assert words != stage
        assert stage_words(f"{stage} box_1") == f"{words} (box_1)"
    for kind, about in KINDS.items():
        assert stage_words(f"remedies {kind}") == f"{stage_words('remedies')} ({about})"
    assert stage_words("polish") == "polish"


def test_a_plan_that_only_another_version_can_read_is_said_to_be_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ServiceClient, "read", lambda *_: b'{"schema_version": "1.1"}')
    with pytest.raises(NotUnderstood, match="/schema_version"):
        ServiceClient("http://127.0.0.1:8040").plan("/v1/plans/some/document")


@pytest.fixture
def needs_handovers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have planning ask for handovers, few of them, and find no plan."""

    def solve(pipeline: Pipeline, _: object, progress: Progress) -> Plan:
        pipeline.solver.handovers(pipeline.solver.cells["dual_ur3e_tool"], load_tool("long_symmetric"), FEW, progress)
        return plan_of({**lift_document(load_cell("dual_ur3e_lift")), "outcome": "not_found", "segments": []})

    monkeypatch.setattr(Pipeline, "solve", solve)


@pytest.mark.usefixtures("needs_handovers")
@pytest.mark.slow
def test_handovers_are_computed_aloud_and_once_for_a_data_directory(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file, kept = str(ROOT / "assets/tasks/domino_pile.json"), tmp_path / "kept"
    assert main(["plan", file]) == 2
    told = capsys.readouterr().err
    # On a slow machine progress tells of it as well.
    assert told.count("liftwright: computing handovers") == 1
    assert "not kept" in told
    assert "--data-dir" in told
    assert list(tmp_path.iterdir()) == []
    assert main(["plan", file, "--data-dir", str(kept)]) == 2
    assert str(kept) in capsys.readouterr().err
    monkeypatch.setenv("LIFTWRIGHT_DATA_DIR", str(kept))
    assert main(["plan", file]) == 2
    assert "computing handovers" not in capsys.readouterr().err
