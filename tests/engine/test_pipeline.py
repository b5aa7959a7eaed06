"""The order of things, with a planner and a certifier that are told what to answer."""

from __future__ import annotations

import base64
import gzip
import itertools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from planners.cell.cell import load_cell
from planners.certify import Certificate, Check
from planners.contract.task_spec import read_task
from planners.errors import SceneError
from planners.geometry.solid_mesh import take_mesh
from planners.plan.plan import Plan
from planners.plan.simulation import LiftSimulation
from planners.plan.verdicts import Explanation, StageTime, Statistics
from planners.planning import CertificateFailed, TaskSolver
from planners.progress import Report, silent
from planners.scene.suction_tool import load_tools
from tests.support.lift_documents import lift_document, simulation
from tests.support.service import task
from workers.solver.pipeline import Pipeline
from workers.solver.protocol import REJECTED_VARIABLE, Answer, SolverRequest

CELLS = {"dual_ur3e_lift": load_cell("dual_ur3e_lift")}
REQUEST = SolverRequest("p1", task())


def a_plan(planned: Any = None, *_: Any) -> Plan:
    statistics = Statistics(
        total_seconds=0.0, stages=[StageTime(name="search", seconds=1.0)], graph={}, search={}, rejections={}
    )
    cell = CELLS["dual_ur3e_lift"].document()
    return Plan.model_construct(
        outcome="solved",
        task=planned or read_task(task()),
        cell=cell,
        segments=[],
        explanation=Explanation(summary="The plate is lifted.", causes=[], remedies=None),
        statistics=statistics,
    )


NO_REMEDIES = SolverRequest("p1", task(options={"remedies": False}))


def nothing(planned: Any, *_: Any) -> Plan:
    return a_plan(planned).model_copy(update={"outcome": "not_found"})


def certificate_with(**check: Any) -> Certificate:
    return Certificate(passed=check["passed"], checks=[Check(**check)])


def verdict(*, passed: bool) -> Any:
    where = "segment 3, sample 2"
    return lambda *_: certificate_with(name="friction_cones", passed=passed, margin=-0.5, unit="N", where=where)


def a_slip(_plan: Any, _scene: Any, progress: Any, seed: int) -> LiftSimulation:
    progress(Report("simulate", 1, 1))
    return LiftSimulation.model_validate(simulation(1.0, outcome="slipped", seed=seed))


def a_lift(_plan: Any, _scene: Any, progress: Any, seed: int) -> LiftSimulation:
    progress(Report("simulate", 1, 1))
    return LiftSimulation.model_validate(simulation(1.0, seed=seed))


def pipeline(*, passed: bool, **given: Any) -> Pipeline:
    ticks = itertools.count()
    steps: dict[str, Any] = {"plan": a_plan, "certify": verdict(passed=passed), "simulate": a_lift, **given}
    return Pipeline(TaskSolver(CELLS, {}, clock=lambda: float(next(ticks)), **steps))


def test_a_document_says_whose_it_is_and_how_long_each_stage_took() -> None:
    plan = pipeline(passed=True).solve(REQUEST, silent)
    assert plan.id == "p1"
    assert plan.certificate is not None
    assert plan.certificate.passed
    assert plan.software.name == "liftwright"
    assert [name for name, _ in plan.statistics.times] == ["scene", "search", "certify", "simulate"]
    assert plan.statistics.total_seconds == 4.0


def test_a_task_names_its_cell_by_the_id_under_which_it_is_kept_and_not_by_the_cells_own_name() -> None:
    kept = TaskSolver({"0a1b2c": CELLS["dual_ur3e_lift"]}, {}, plan=a_plan, certify=verdict(passed=True))
    plan = kept.solve(read_task(task(cell="0a1b2c", options={"remedies": False})))
    assert plan.certificate is not None
    assert (plan.task.cell, plan.cell.name) == ("0a1b2c", "dual_ur3e_lift")


def test_each_stage_of_each_object_is_told_apart_and_without_the_name_that_its_caller_gave_it() -> None:
    body = task("domino_pile.json", options={"simulate": False})
    names = [each["name"] for each in body["objects"]]
    seconds = {f"first regrasp {name}": float(place) for place, name in enumerate(names)}

    def plan(accepted: Any, scene: Any, *_: Any) -> Plan:
        times = [StageTime(name=name, seconds=each) for name, each in seconds.items()]
        statistics = a_plan().statistics.model_copy(update={"stages": times})
        stated = {"task": accepted, "cell": scene.cell.document(), "statistics": statistics, "simulation": None}
        return a_plan().model_copy(update=stated)

    solver = TaskSolver({body["cell"]: load_cell(body["cell"])}, load_tools(), plan=plan, certify=lambda *_: None)
    stages = Pipeline(solver).answer(SolverRequest("p1", body), silent).stages
    assert [name for name, _ in stages] == ["scene", *["first regrasp"] * len(names), "certify"]
    assert [each for name, each in stages if name == "first regrasp"] == list(seconds.values())


def test_a_plan_that_fails_its_certificate_is_not_delivered_and_is_kept_to_be_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(REJECTED_VARIABLE, str(tmp_path / "rejected"))
    with pytest.raises(CertificateFailed, match=r"friction_cones \(margin -0.5 N at segment 3, sample 2\)"):
        pipeline(passed=False).solve(REQUEST, silent)
    kept = json.loads((tmp_path / "rejected" / "p1.json").read_text())
    assert kept["certificate"]["passed"] is False


def test_what_was_not_found_has_no_certificate_and_is_delivered() -> None:
    told = pipeline(passed=True, plan=nothing, certify=lambda *_: None).solve(NO_REMEDIES, silent)
    assert told.certificate is None
    assert [name for name, _ in told.statistics.times] == ["scene", "search", "certify"]
    assert told.statistics.total_seconds == 3.0


def test_what_was_not_found_and_is_malformed_is_a_fault_of_ours() -> None:
    malformed = certificate_with(name="structure", passed=False, margin=-1.0, unit="1", where="/task: is missing")
    told = pipeline(passed=True, plan=nothing, certify=lambda *_: malformed)
    with pytest.raises(CertificateFailed, match="/task: is missing"):
        told.solve(NO_REMEDIES, silent)


def test_stages_are_reported_in_order() -> None:
    seen: list[str] = []
    pipeline(passed=True).solve(REQUEST, lambda report: seen.append(report.stage))
    assert list(dict.fromkeys(seen)) == ["scene", "certify", "simulate"]


def test_a_simulation_that_fails_is_told_and_the_plan_is_delivered() -> None:
    request = SolverRequest("p1", {**task(options={"remedies": False}), "seed": 7})
    plan = pipeline(passed=True, simulate=a_slip).solve(request, silent)
    assert isinstance(plan.simulation, LiftSimulation)
    assert (plan.simulation.outcome, plan.simulation.seed) == ("slipped", 7)
    # Whether or not somebody wants remedies.
    assert "In physics it failed: slipped" in plan.explanation.summary
    assert plan.digest == plan.sealed().digest
    lifted = pipeline(passed=True).solve(request, silent)
    assert "In physics" not in lifted.explanation.summary


def test_uploaded_meshes_come_with_the_request() -> None:
    scenes: list[Any] = []

    def plan(_task: Any, scene: Any, *_: Any) -> Plan:
        scenes.append(scene)
        return a_plan()

    bin_shape = {"type": "mesh", "upload": "bin", "scale": 0.001}
    body = {**task(), "obstacles": [{"name": "bin", "shape": bin_shape, "pose": [0.7, 0.6, 1.25, 1, 0, 0, 0]}]}
    content = trimesh.creation.box((100, 200, 300)).export(file_type="stl")
    mesh = take_mesh(content, "stl").document()
    request = SolverRequest("p1", body, {"bin": json.loads(json.dumps(mesh))})
    pipeline(passed=True, plan=plan).solve(request, silent)
    (scene,) = scenes
    vertices, _ = scene.obstacles[0].solid.surface()
    assert np.ptp(vertices, axis=0) == pytest.approx([0.1, 0.2, 0.3])
    with pytest.raises(SceneError, match="there is no upload bin"):
        pipeline(passed=True).solve(SolverRequest("p1", body), silent)


def test_what_is_handed_over_before_the_simulation_is_simulated_later_as_it_would_have_been_then() -> None:
    document = {**lift_document(CELLS["dual_ur3e_lift"]), "outcome": "solved"}
    planned = Plan.read(json.dumps({**document, "certificate": None, "simulation": None}).encode())
    simulated = Plan.read(json.dumps({**document, "simulation": simulation(1.0)}).encode()).simulation
    seeds: list[int] = []

    def simulate(_plan: Any, _scene: Any, _progress: Any, seed: int) -> Any:
        seeds.append(seed)
        return simulated

    def planned_once(*_: Any) -> Plan:
        planning.append("planned")
        return planned

    planning: list[str] = []
    handed: list[Answer] = []
    solver = pipeline(passed=True, plan=planned_once, simulate=simulate)
    request = SolverRequest("p1", planned.document()["task"])
    at_once = json.loads(solver.answer(request, silent, handed.append).document)
    (before,) = handed
    assert json.loads(before.document)["simulation"] is None
    kept = base64.b64encode(gzip.compress(before.document)).decode()
    later = json.loads(solver.answer(replace(request, certified=kept), silent, handed.append).document)
    assert later == at_once
    assert later["simulation"] is not None
    assert (len(handed), planning, len(set(seeds)), len(seeds)) == (1, ["planned"], 1, 2)


def test_a_task_may_leave_the_simulation_out() -> None:
    body = {**task(), "options": {"simulate": False}}
    plan = pipeline(passed=True).solve(SolverRequest("p1", body), silent)
    assert not hasattr(plan, "simulation")
    assert [name for name, _ in plan.statistics.times] == ["scene", "search", "certify"]
    assert plan.statistics.total_seconds == 3.0


def test_the_planner_is_given_where_handovers_are_kept() -> None:
    given: list[Any] = []

    def plan(*arguments: Any) -> Plan:
        given.append(arguments[-1])
        return a_plan()

    def kept(*_: Any) -> Any:
        return pytest.fail("a plate lift has no handovers")

    pipeline(passed=True, plan=plan, handovers=kept).solve(REQUEST, silent)
    assert given == [kept]
