"""Whole plate lifts: other plates, other cells, other lists of holds; an answer with reasons, never an exception."""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from planners.cell.cell import Cell, load_cells
from planners.certify import RobotSurfaces, load_surfaces
from planners.contract.task_spec import read_task
from planners.plan.verdicts import PlanningOutcome
from planners.planning import plan, reference_of
from planners.scene.scene import build_scene
from tests.manipulation.lift_probe import ROOT, planner_of, task_body
from tests.support.documents import certified
from tests.support.own_cell import load_cell_file
from tests.support.samples import told

CASES = yaml.load((ROOT / "tests/problems/plate_lifts.yaml").read_text(), yaml.CSafeLoader)
MOUNT = yaml.safe_load((ROOT / "assets/mounts/dual_column.yaml").read_text())
CELL = yaml.safe_load((ROOT / "assets/cells/dual_ur3e_lift.yaml").read_text())


@pytest.fixture(scope="module")
def surfaces() -> RobotSurfaces:
    return load_surfaces()


@pytest.fixture(scope="module")
def cells() -> dict[str, Cell]:
    return load_cells()


def document_of(body: dict[str, Any], cells: dict[str, Cell]) -> dict[str, Any]:
    task = read_task(body)
    return plan(task, build_scene(task, cells), lambda *_: None, lambda: 0.0).document()


def body_of(case: dict[str, Any]) -> dict[str, Any]:
    body = task_body(case.get("task", "ab1"))
    for pointer, value in copy.deepcopy(case["with"]).items():
        *path, key = pointer.split("/")[1:]
        container = body
        for step in path:
            container = container[step]
        container[key] = value
    return body


@pytest.mark.parametrize("case", told(CASES))
def test_a_lift_is_planned_and_certified_or_it_is_said_why_not(case, cells, surfaces):
    document = document_of(body_of(case), cells)
    explanation = document["explanation"]
    assert document["outcome"] == case["outcome"], explanation
    assert explanation["summary"]
    cell = cells[document["cell"]["name"]]
    known = reference_of(cell)
    written = document | {"id": "problem", "software": {"name": "liftwright", "version": "0", "commit": None}}
    certificate = certified(written, surfaces, known)
    # What was not found claims nothing.
    assert (certificate is None) == (document["outcome"] == "not_found")
    assert certificate is None or {check.name: check.where for check in certificate.failures} == {}
    solved = document["outcome"] == "solved"
    assert solved == bool(document["segments"])
    assert solved or explanation["causes"]
    said = " ".join([explanation["summary"], *(cause["reason"] for cause in explanation["causes"])])
    assert case.get("says", "") in said


@pytest.mark.slow
def test_figures_by_contact_state_add_up_to_those_of_the_whole_graph(cells):
    graph = document_of(task_body("pb1"), cells)["statistics"]["graph"]
    by_contact = graph["contact_states"]
    assert {"face", "no contact"} <= set(by_contact)
    for column in ("poses", "nodes", "alive", "dead"):
        assert sum(figures[column] for figures in by_contact.values()) == graph[column]


@pytest.mark.parametrize("name", ["ab3", "pb1_weak_cup"])
def test_same_task_same_document_but_for_the_times(name, cells):
    documents = [document_of(task_body(name), cells) for _ in range(2)]
    for document in documents:
        del document["statistics"]["total_seconds"], document["statistics"]["stages"]
    assert documents[0] == documents[1]


# Cells that are not the shipped one.


def write_cell(folder: Path, cell: dict[str, Any], mount: dict[str, Any]) -> dict[str, Cell]:
    """Write a cell with its mount and load it."""
    for kind, data in (("cells", {**cell, "name": "own", "mount": "own"}), ("mounts", {**mount, "name": "own"})):
        (folder / kind).mkdir()
        (folder / kind / "own.yaml").write_text(yaml.safe_dump(data))
    return {"own": load_cell_file(folder / "cells/own.yaml")}


def quarter_turn(mount: dict[str, Any], shift: list[float]) -> dict[str, Any]:
    """Turn everything by 90 degrees about the world's z axis, then shift it."""

    def turned(point: list[float]) -> list[float]:
        x, y, z = point
        return [-y + shift[0], x + shift[1], z + shift[2]]

    result = copy.deepcopy(mount)
    for arm in result["arms"].values():
        arm["position"] = turned(arm["position"])
        arm["rpy_deg"][2] += 90
    for box in (result["table"], *result["platform"].values()):
        box["center"], box["size"] = turned(box["center"]), [box["size"][1], box["size"][0], box["size"][2]]
    return result


@pytest.mark.slow
def test_a_cell_turned_and_moved_with_its_task_gives_the_same_sequence(tmp_path, cells):
    shift = [1.5, -0.7, 0.03]
    moved = write_cell(tmp_path, CELL, quarter_turn(MOUNT, shift))
    body = task_body("ab3")
    x, y, z, w, *_, yaw_sine = body["plate_pose"]
    yaw = 2.0 * math.atan2(yaw_sine, w) + math.pi / 2
    pose = [-y + shift[0], x + shift[1]]
    turned = {
        **body,
        "cell": "own",
        "plate_pose": [*pose, z + shift[2], math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)],
        "support": {
            **body["support"],
            "pose": [*pose, body["support"]["pose"][2] + shift[2], math.sqrt(0.5), 0, 0, math.sqrt(0.5)],
        },
    }
    here, there = planner_of(body, cells).plan(), planner_of(turned, moved).plan()
    assert there.outcome is here.outcome is PlanningOutcome.SOLVED
    assert [(s.contact, s.hands) for s in there.steps] == [(s.contact, s.hands) for s in here.steps]
    assert [s.force for s in there.steps] == pytest.approx([s.force for s in here.steps], abs=1e-4)


@pytest.mark.slow
def test_a_mirrored_cell_lifts_the_mirrored_plate(tmp_path, cells):
    """The gripper is on the left; cup and yaw are mirrored. Which of equal sequences is taken may differ."""
    arms = {"left": CELL["arms"]["right"], "right": CELL["arms"]["left"]}
    mirrored = write_cell(tmp_path, {**CELL, "arms": arms}, MOUNT)
    body = task_body("ab3")
    body["plate_pose"][6] *= -1
    body["cup"]["position"][1] *= -1
    planner = planner_of({**body, "cell": "own"}, mirrored)
    assert (planner.sampling.workcell.gripper, planner.sampling.workcell.pusher) == ("left", "right")
    lifted = planner.plan()
    assert lifted.outcome is PlanningOutcome.SOLVED
    original = planner_of(task_body("ab3"), cells).plan()
    assert lifted.search["max_force"] == pytest.approx(original.search["max_force"], rel=0.1)


# Holds that a task gives itself.


def holds_as_given(planner) -> dict[str, Any]:
    """Write a planner's own holds as a task would give them."""
    return {
        "grips": [
            {"position": grip.T_plate_tcp[0, :3, 3].tolist(), "approach": grip.approach.tolist()}
            for grip in planner.sampling.grips
        ],
        "pushes": [
            {"position": push.point.tolist(), "normal": push.normal.tolist(), "direction": push.axis.tolist()}
            for push in planner.sampling.pushes
        ],
    }


def test_the_generated_holds_given_as_a_list_lead_to_the_same_sequence(planner, solved, cells):
    lifted = planner_of(task_body("ab3", **holds_as_given(planner)), cells).plan()
    assert [(s.pose, s.hands) for s in lifted.steps] == [(s.pose, s.hands) for s in solved.steps]


def test_only_given_holds_are_used(planner, solved, cells):
    """Those of the sequence that was found are enough to find one, and are numbered anew."""
    used = [sorted({step.hands[side] for step in solved.steps} - {None}) for side in (0, 1)]
    lists = holds_as_given(planner)
    chosen = {
        "grips": [lists["grips"][index] for index in used[0]],
        "pushes": [lists["pushes"][index] for index in used[1]],
    }
    lifted = planner_of(task_body("ab3", **chosen), cells).plan()
    assert lifted.outcome is PlanningOutcome.SOLVED
    assert (lifted.graph["grips"], lifted.graph["pushes"]) == (len(used[0]), len(used[1]))
    assert lifted.search["cost"] <= solved.search["cost"] + 1e-9


def test_one_useless_grip_is_not_enough(planner, cells):
    lifted = planner_of(task_body("ab3", grips=holds_as_given(planner)["grips"][:1]), cells).plan()
    assert lifted.outcome is PlanningOutcome.NOT_FOUND
    assert lifted.summary
    assert lifted.causes


@pytest.mark.slow
def test_lower_goals_are_reached_on_the_way_to_higher_ones(cells):
    heights = []
    for goal in (0.01, 0.06):
        planner = planner_of(task_body("ab3", goal_height=goal), cells)
        last = planner.plan().segments[-1].T_world_body[-1]
        corners = planner.sampling.prism.polyhedron.vertices @ last[2, :3] + last[2, 3]
        heights.append(corners.min() - planner.scene.support_top)
    assert heights[0] >= 0.01 - 1e-9
    assert heights[1] >= 0.06 - 1e-9
    assert np.all(np.diff(heights) > 0)
