"""The command line: what it prints, and its exit codes."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from app.access.caller import Scope
from app.cli.keys_command import issue_key
from app.cli.main import main
from app.cli.service_client import KEY_VARIABLE, ServiceClient
from app.settings import ServiceSettings
from app.summary import contact_states, is_certified, outcome_line, summarise
from planners.cell.cell import load_cell
from planners.contract.scene_document import SceneDocument
from planners.plan.loads import largest_load
from planners.plan.plan import Plan
from tests.support.documents import plan_of
from tests.support.lift_documents import contact, lift, lift_document, segment, simulation
from tests.support.scan_frames import SHIPPED
from tests.support.service import FAKE_SOLVER, ROOT, TASKS, task, unsolved_task
from tests.support.serving import served
from tests.support.tool_documents import tool_simulation
from workers.solver.pipeline import Pipeline


@pytest.mark.slow
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


def test_a_task_without_a_plan_is_2_and_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "task.json"
    path.write_text(json.dumps(unsolved_task("pb1_weak_cup")))
    assert main(["plan", str(path)]) == 2
    told = capsys.readouterr().out
    assert "infeasible" in told
    assert " N" in told


@pytest.mark.parametrize(
    ("body", "pointer"),
    [(json.dumps(task(cell="moon_base")), "/cell: "), (json.dumps({}), "/kind: ")],
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


@pytest.mark.parametrize(
    ("command", "option", "given"),
    [
        (["plan", str(TASKS / "ab1.json")], "--apply", "0"),
        (["plan", str(TASKS / "ab1.json")], "--apply", "one"),
        (["study", str(TASKS / "ab1.json"), "--axis", "/cup/mu=0.4,0.5"], "--processes", "-1"),
        (["study", str(TASKS / "ab1.json"), "--axis", "/cup/mu=0.4,0.5"], "--processes", "1.5"),
        (["execute", "plan.json"], "--speed", "fast"),
        (["keys", "issue", "--owner", "mes"], "--days", "-1"),
        (["keys", "issue", "--owner", "mes"], "--days", "nan"),
        (["keys", "issue", "--owner", "mes"], "--days", "1e12"),
    ],
)
def test_a_number_that_an_option_cannot_have_is_3_and_told_with_those_that_it_can(
    command: list[str], option: str, given: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as exit_:
        main([*command, option, given])
    told = capsys.readouterr().err
    assert exit_.value.code == 3
    assert re.search(rf"argument {option}: must be a .*number.* not {re.escape(given)}$", told.strip())


@pytest.mark.parametrize("command", [[], ["serve"], ["api"], ["worker"], ["plan"], ["scene"], ["warmup"]])
def test_every_command_explains_itself(command: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "app.cli.main", *command, "--help"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert "usage: liftwright" in done.stdout


def _plan(**members: Any) -> Plan:
    """Return a solved plan of one segment, with other members instead of its own."""
    document = {**lift_document(load_cell("dual_ur3e_lift")), "outcome": "solved", "segments": [segment(0.0, 2)]}
    return plan_of({**document, **members})


def _statistics(total: float, stages: dict[str, float], **members: Any) -> dict[str, Any]:
    told = [{"name": name, "seconds": seconds} for name, seconds in stages.items()]
    return {"total_seconds": total, "stages": told, "graph": {}, "search": {}, "rejections": {}, **members}


def _finger(normal: list[float], force: list[float], number: int, sample: int = 0) -> dict[str, Any]:
    return contact(
        *(sample, "right", "soft_finger", (0.0, 0.0, 0.0)),
        finger=number, normal=normal, wrench=[*force, 1.0, 2.0, 3.0],
    )  # fmt: skip


def test_the_largest_load_is_what_the_plate_weighs_on_a_hand_not_what_its_fingers_squeeze() -> None:
    up, down, aside = [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]
    contacts = [
        _finger(up, [0.0, 0.0, 62.0], 0),
        _finger(down, [3.0, 0.0, -58.0], 1),
        _finger(up, [0.0, 0.0, 60.0], 0, sample=7),
        _finger(down, [0.0, 0.0, -60.0], 1, sample=7),
        contact(0, "left", "point", (4.5, 2.0, 2.0), normal=aside),
        contact(0, "cup", "suction", (0.0, 0.0, 50.0), normal=down),
    ]

    def load(contacts: list[dict[str, Any]]) -> tuple[float, str]:
        return largest_load(_plan(segments=[segment(0.0, 8, contacts=contacts)]))

    assert load(contacts) == (5.0, "right")
    contacts[1]["wrench"][0] = 0.0
    assert load(contacts) == (4.5, "left")
    assert load(contacts[5:]) == (0.0, "")


def test_contact_states_are_told_once_in_a_row() -> None:
    edge = {"element": "edge", "index": 1, "with": "table", "vertices": [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]}
    none = {"element": "none", "index": 0, "with": None, "vertices": []}
    states = enumerate((edge, edge, None, none, edge))
    plan = _plan(segments=[segment(0.1 * i, 2, contact_state=state) for i, state in states])
    assert contact_states(plan) == ["edge 1 on table", "no contact", "edge 1 on table"]


def test_a_plan_without_contact_states_tells_what_is_moved() -> None:
    plan = _plan(
        explanation={"summary": "3 objects moved, nearest to its goal first (a, b, c), with 1 handover."},
        statistics=_statistics(3.0, {"certify": 1.0}),
    )
    told = summarise(plan)
    assert "3 objects moved" in told
    assert "contact states" not in told
    assert "2.00 s" in told


def test_a_plan_tells_where_the_cup_was_put_where_the_task_left_that_open() -> None:
    chosen = {"position": [0.1, 0.0], "tried": 40, "reserve": 0.15, "sentence": "The cup sits best there."}
    explanation = {"summary": "The plate is lifted."}
    assert not any(line.startswith("cup:") for line in summarise(_plan(explanation=explanation)).splitlines())
    told = summarise(_plan(explanation={**explanation, "cup_place": chosen})).splitlines()
    assert "cup:            The cup sits best there." in told


@pytest.mark.parametrize(
    ("executed", "line"),
    [
        (None, "simulation:     not yet"),
        (simulation(9.0, lift=lift(4.0, height=0.188)), "simulation:     lifted, 188 mm, in 17.7 s"),
        (tool_simulation(9.0), "simulation:     done, in 17.7 s"),
        (
            simulation(9.5, outcome="cup_lost", cause="the pad peels off"),
            "simulation:     FAILED: cup_lost at 9.50 s of motion: the pad peels off",
        ),
        (
            tool_simulation(7.0, outcome="object_dropped", failed_at=6.25, cause="the cup lets go"),
            "simulation:     FAILED: object_dropped at 6.25 s of motion: the cup lets go",
        ),
    ],
)
def test_a_solved_plan_tells_how_it_fared_in_physics(executed: dict[str, Any] | None, line: str) -> None:
    plan = _plan(simulation=executed, statistics=_statistics(20.0, {"simulate": 17.7}))
    assert line in summarise(plan).splitlines()
    # In one line, too, as it is told of several tasks: a plan that failed is not told as one that did not.
    _, failed, how = line.partition("FAILED: ")
    assert outcome_line(plan).partition("; in physics it FAILED: ")[2] == how
    assert ("FAILED" in outcome_line(plan)) == bool(failed)


def test_a_plan_that_nobody_wants_simulated_says_so() -> None:
    document = lift_document(load_cell("dual_ur3e_lift"))
    plan = _plan(task={**document["task"], "options": {**document["task"]["options"], "simulate": False}})
    assert "simulation:     none, options.simulate is false" in summarise(plan).splitlines()


@pytest.mark.parametrize("certificate", [None, {"passed": False, "checks": []}, {"passed": True, "checks": []}])
def test_a_solved_plan_tells_its_smallest_reserve_and_whether_it_is_certified(
    certificate: dict[str, Any] | None,
) -> None:
    least = {"value": 0.1234, "limited_by": "cup", "body": "plate", "segment": 1, "sample": 2}
    if certificate is not None:
        torque = {
            "name": "joint torque",
            "passed": True,
            "margin": 3.0,
            "unit": "Nm",
            "where": "an elbow",
            "share_left": 0.3,
        }
        certificate = {**certificate, "checks": [torque]}
    plan = _plan(
        segments=[segment(begin, 3, time=[begin, begin + 3.3, begin + 3.55]) for begin in (0.0, 3.7)],
        certificate=certificate,
        statistics=_statistics(20.0, {}, reserve=least),
    )
    lines = summarise(plan).splitlines()
    assert "reserve:        12.3 % (cup, 7.2 s)" in lines
    options = plan.task.options.model_copy(update={"reserve": 0.2})
    wanting = plan.model_copy(update={"task": plan.task.model_copy(update={"options": options})})
    assert (
        "reserve:        12.3 % (cup, 7.2 s); the most that was found, 20 % was asked for"
        in summarise(wanting).splitlines()
    )
    assert ("joint torque:   30 % of the limit remains (an elbow)" in lines) == (certificate is not None)
    (told,) = (line for line in lines if line.startswith("certificate:"))
    passed = certificate is not None and certificate["passed"]
    assert ("passed" in told, is_certified(plan)) == (passed, passed)
    without = _plan(statistics=_statistics(20.0, {}, reserve=None))
    assert not any(line.startswith("reserve:") for line in summarise(without).splitlines())


def _unsolved(outcome: str, cause: dict[str, Any]) -> Plan:
    return _plan(outcome=outcome, segments=[], explanation={"summary": "There is none.", "causes": [cause]})


@pytest.mark.parametrize("passed", [True, False])
def test_without_a_plan_checks_are_said_to_be_of_the_proof_and_not_of_a_plan(passed: bool) -> None:
    certificate = {"passed": passed, "checks": []}
    statistics = _statistics(1.0, {"certify": 0.25})
    plan = _plan(outcome="infeasible", segments=[], certificate=certificate, statistics=statistics)
    verdict = "passed" if passed else "FAILED"
    assert f"certificate:    {verdict}, 0 checks of the proof that no plan exists in 0.25 s" in summarise(plan)
    assert not is_certified(plan)


def test_an_explanation_names_what_is_needed_and_what_there_is() -> None:
    cause = {"reason": "the plate is too heavy", "needed": 62.8, "available": 54.0, "unit": "N", "where": "no contact"}
    told = summarise(_unsolved("infeasible", cause))
    assert "needed 62.8 N, available 54 N" in told
    assert "(no contact)" in told


@pytest.mark.parametrize(
    ("reason", "needed", "available", "unit", "told"),
    [
        ("No hold bears it.", 0.2117, 0.0, "N", "- No hold bears it: short by 0.2117 N (face)"),
        # Documents of 0.1.0 count some lengths downwards, and leave the unit of a share out.
        ("The pad is bent", -0.0005, -0.0012, "m", "- The pad is bent: short by 0.7 mm (face)"),
        ("It is too thick.", 0.09, 0.085, "m", "- It is too thick: needed 90 mm, available 85 mm (face)"),
        ("The cup is weak.", 0.0, -0.25, None, "- The cup is weak: short by 0.25 (face)"),
        ("It is blocked.", None, None, None, "- It is blocked (face)"),
    ],
)
def test_a_cause_tells_how_much_is_missing(
    reason: str, needed: float | None, available: float | None, unit: str | None, told: str
) -> None:
    cause = {"reason": reason, "needed": needed, "available": available, "unit": unit, "where": "face"}
    assert told in map(str.strip, summarise(_unsolved("not_found", cause)).splitlines())


SCAN = SHIPPED / "tissue_boxes"


def test_a_scan_is_perceived_without_a_server_and_a_task_takes_its_objects_from_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, preview = tmp_path / "scene.json", tmp_path / "seen.png"
    assert main(["scene", str(SCAN), "--out", str(out), "--preview", str(preview)]) == 0
    told = capsys.readouterr().out
    document = SceneDocument.model_validate_json(out.read_text())
    assert len(document.objects) == 3
    assert all(part.name in told for part in document.objects)
    assert preview.read_bytes().startswith(b"\x89PNG")
    goal = {
        **json.loads((SCAN / "task.json").read_text()),
        "objects": [{"name": "x", "mass": 0.3, "goal_pose": [0] * 7}],
    }
    task_file = tmp_path / "task.json"
    task_file.write_text(json.dumps(goal))
    # The scene is read; what the task says of its object is wrong.
    assert main(["plan", str(task_file), "--scene", str(out)]) == 3
    assert "/objects/0/name" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("files", "said"),
    [
        (["scan=nowhere.json"], "nowhere.json"),
        ([str(SHIPPED)], "no scan.json"),
        (["film.png"], "no such file"),
        ([__file__], "is called like its part"),
        ([str(SCAN), f"depth={SCAN / 'colour.png'}"], "given twice"),
        ([str(SCAN / "scan.json"), str(SCAN / "colour.png")], "depth"),
        ([f"scan={SCAN / 'task.json'}"], "/kind"),
        ([f"scan={SCAN / 'colour.png'}"], "UTF-8"),
    ],
)
def test_files_that_are_no_scan_are_3_and_told(files: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scene", *files]) == 3
    assert said in capsys.readouterr().err


def test_a_scene_that_only_a_service_keeps_is_3_and_says_how_to_plan_with_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "task.json"
    file.write_text(json.dumps({**json.loads((SCAN / "task.json").read_text()), "scene_id": "5f0c"}))
    assert main(["plan", str(file)]) == 3
    told = capsys.readouterr().err
    assert all(words in told for words in ("/scene_id", "5f0c", "--service", "--scene"))


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    settings = ServiceSettings(
        data_dir=tmp_path_factory.mktemp("data"), solver_command=FAKE_SOLVER, worker_slots=1, authentication="required"
    )
    key = issue_key(settings, "mes", Scope.WRITE, None)
    with served(settings) as address, pytest.MonkeyPatch.context() as patch:
        patch.setenv(KEY_VARIABLE, key)
        yield address


@pytest.mark.slow
def test_a_scan_is_perceived_by_a_service_whose_scene_a_task_then_names(
    service: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["scene", str(SCAN), "--service", service]) == 0
    told = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    client = ServiceClient(service)
    assert len(json.loads(client.read(f"/v1/scenes/{told['scene_id']}"))["scene"]["objects"]) == 3
    assert told["viewer"].startswith(service)
    task = {**json.loads((SCAN / "task.json").read_text()), "external_id": "fail", "scene_id": told["scene_id"]}
    file = tmp_path / "task.json"
    file.write_text(json.dumps(task))
    assert main(["plan", str(file), "--service", service]) == 1
    assert "failed" in capsys.readouterr().err
    file.write_text(json.dumps({**task, "scene_id": "unknown"}))
    assert main(["plan", str(file), "--service", service]) == 3
    assert "/scene_id" in capsys.readouterr().err


@pytest.mark.slow
def test_a_service_has_all_of_several_tasks_before_the_first_is_waited_for(
    service: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    for name in ("post", "follow"):
        method = getattr(ServiceClient, name)

        def noted(*arguments: Any, name: str = name, method: Any = method) -> Any:
            done.append(name)
            return method(*arguments)

        monkeypatch.setattr(ServiceClient, name, noted)
    for name in ("a", "b"):
        (tmp_path / f"{name}.json").write_text(json.dumps(task(external_id="fail")))
    (tmp_path / "c.json").write_text(json.dumps(task(cell="moon_base")))
    files = [str(tmp_path / f"{name}.json") for name in ("a", "b", "c")]
    assert main(["plan", *files, "--service", service]) == 1
    assert done == ["post", "post", "post", "follow", "follow"]
    told = capsys.readouterr()
    outcomes = dict(zip(files, ("failed", "failed", "refused, 1 problem"), strict=True))
    # The service logs to the same screen here.
    lines = [line for line in told.out.splitlines() if line.startswith(str(tmp_path))]
    assert lines == [f"{file}  {outcome}" for file, outcome in outcomes.items()]
    assert "/cell: there is no cell moon_base" in told.err


def test_a_service_that_refuses_the_key_or_is_away_is_1(
    service: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(KEY_VARIABLE, "wrong")
    assert main(["scene", str(SCAN), "--service", service]) == 1
    assert "401" in capsys.readouterr().err
    assert main(["scene", str(SCAN), "--service", "http://127.0.0.1:1"]) == 1
    assert "no service answers" in capsys.readouterr().err
    assert main(["scene", str(SCAN), "--service", "127.0.0.1"]) == 1


def test_a_service_that_asks_for_a_key_is_told_where_a_key_goes(
    service: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(KEY_VARIABLE)
    assert main(["plan", str(TASKS / "ab1.json"), "--service", service]) == 1
    assert f"set the environment variable {KEY_VARIABLE}" in capsys.readouterr().err
    monkeypatch.setenv(KEY_VARIABLE, "")
    assert main(["plan", str(TASKS / "ab1.json"), "--service", service]) == 1
    assert f"set the environment variable {KEY_VARIABLE}" in capsys.readouterr().err
