"""A cell's collision margins: kept by what is planned in it, told where it has less at home, stated in documents."""

from __future__ import annotations

import copy
import itertools
import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planners.cell import cell as cell_module
from planners.cell.asset_shelf import fingerprint, read_cell_file, read_mount_file, shipped_shelf
from planners.cell.bundle import CellBundle, cell_schema
from planners.cell.cell import Cell, known_cells, load_cell
from planners.certify import certify
from planners.contract.task_spec import read_task
from planners.errors import AssetError
from planners.geometry.convex import CollisionBody
from planners.hands.workcell import Clearance
from planners.plan.plan import Plan
from planners.planning import TaskSolver, certificate_of
from planners.regrasp.grasps.handovers import find_handovers
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.scene.suction_tool import load_tool
from planners.survey.faults import load_checked, meetings_at_home
from planners.survey.reach_map import ReachMapSettings, map_reach
from planners.survey.survey import CellSurvey
from tests.cell.cell_probe import fcl_distance, fcl_object
from tests.kinematics.arm_oracle import PinocchioArm
from tests.manipulation.lift_probe import task_body
from tests.support.own_cell import written
from tests.support.tool_plans import FEW

WIDE = 0.008
"""More than twice what planning keeps where no cell says anything [m]."""
LIFT, TOOL = "dual_ur3e_lift", "dual_ur3e_tool"


def described(name: str, **members: Any) -> CellBundle:
    """Return a shipped cell under another name, with these members beside its own."""
    return CellBundle.of_text(written({**shipped(name), "name": "own", **members}))


def shipped(name: str) -> dict[str, Any]:
    return read_cell_file(shipped_shelf().find("cells", name)).model_dump(mode="json", exclude_none=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cells")


def own(folder: Path, name: str, **members: Any) -> Cell:
    return load_checked(described(name, **members), folder)


def margins(bodies: Any) -> dict[str, Any]:
    return {"margins": {"bodies": bodies}}


def test_a_cell_that_says_nothing_is_what_it_was_and_one_that_does_is_another(folder: Path) -> None:
    silent, again = (own(folder, LIFT) for _ in range(2))
    said = [own(folder, LIFT, **margins(value)) for value in (0.003, WIDE)]
    assert silent.hash == again.hash
    assert len({silent.hash, *(cell.hash for cell in said)}) == 3
    assert all("margins" not in load_cell(name).document().model_dump(exclude_unset=True) for name in known_cells())
    stated = said[1].document().margins
    assert stated is not None
    assert stated.bodies == WIDE
    assert [Clearance.of(cell).margin for cell in (silent, *said)] == [Clearance().margin, 0.003, WIDE]


def test_margins_are_no_part_of_what_is_hashed_of_a_cell_that_says_nothing_of_them(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    hashed: list[bytes] = []

    def noted(contents: Iterable[bytes]) -> str:
        taken = list(contents)
        hashed.extend(taken)
        return fingerprint(taken)

    monkeypatch.setattr(cell_module, "fingerprint", noted)
    for said in ({}, margins(WIDE)):
        hashed.clear()
        described(LIFT, **said).load(folder)
        assert any(b"gravity" in each for each in hashed)
        assert any(b"margins" in each for each in hashed) == bool(said)


@pytest.mark.parametrize(
    ("given", "pointer", "words"),
    [
        ({"bodies": 0.0009}, "/margins/bodies", "1 to 50 mm"),
        ({"bodies": 0.051}, "/margins/bodies", "1 to 50 mm"),
        ({"bodies": 3}, "/margins/bodies", "1 to 50 mm"),
        ({"bodies": "wide"}, "/margins/bodies", "number"),
        ({}, "/margins/bodies", "required"),
        ({"bodies": WIDE, "hands": WIDE}, "/margins/hands", "not known"),
    ],
)
def test_a_margin_beyond_its_range_is_refused_where_it_stands(
    given: dict[str, Any], pointer: str, words: str, folder: Path
) -> None:
    with pytest.raises(AssetError) as refused:
        own(folder, LIFT, margins=given)
    (fault,) = refused.value.faults
    assert fault.pointer == pointer
    assert words in f"{fault.detail} {fault.allowed}"


@pytest.mark.parametrize("margin", [0.001, 0.050])
def test_both_ends_of_the_range_are_read(margin: float, folder: Path) -> None:
    cell = described(LIFT, **margins(margin)).load(folder)
    assert Clearance.of(cell).margin == margin
    bodies = cell_schema()["$defs"]["MarginsFile"]["properties"]["bodies"]
    assert bodies["minimum"] <= margin <= bodies["maximum"]


def test_what_is_nearer_at_home_than_the_margin_is_told_with_it(folder: Path) -> None:
    """Oracle: pinocchio and python-fcl. Parts of one arm belong together and are none of these."""
    usual = load_cell(LIFT)
    tip = next(body for body in usual.collision_bodies() if body.name == "left_tip")
    center, radius = ball(tip, world_frames(usual, usual.home)[tip.frame])
    mount = read_mount_file(shipped_shelf().find("mounts", usual.mount)).model_dump(mode="json", exclude_none=True)
    # A shelf, its top 20 mm below the ball that encloses the tip of the stick.
    shelf = {"center": [*center[:2], center[2] - radius - 0.025], "size": [0.1, 0.1, 0.01]}
    mount = {**mount, "name": "own_mount", "platform": {**mount["platform"], "shelf": shelf}}
    cell = described(LIFT, mount=mount, **margins(0.050)).load(folder)
    near = {
        frozenset((a.name, b.name))
        for a, b, apart in distances(cell, cell.home, {}, 0.1)
        if apart < 0.050 and (a.group != b.group or apart < 0.003)
    }
    found = list(meetings_at_home(cell))
    assert near
    assert {frozenset(meeting.bodies) for meeting in found} == near
    assert all("planning keeps 50.0 mm" in meeting.sentence() for meeting in found)


def test_what_hands_reach_with_a_wide_margin_they_reach_with_a_narrow_one(folder: Path) -> None:
    coarse = ReachMapSettings(columns=8, rolls=2)
    wide, usual = (map_reach(described(LIFT, **said).load(folder), coarse) for said in (margins(0.050), {}))
    for arm, reached in wide.reached.items():
        assert not (reached & ~usual.reached[arm]).any()
    assert sum(map(np.sum, wide.reached.values())) < sum(map(np.sum, usual.reached.values()))


def test_what_passes_the_tool_on_with_a_wide_margin_passes_it_on_with_a_narrow_one(folder: Path) -> None:
    tool = load_tool("short_asymmetric")
    found = []
    for said in (margins(0.020), {}):
        cell = described(TOOL, **said).load(folder)
        asked = replace(ToolPlannerSettings(), handovers=FEW).in_cell(cell).handovers
        found.append(find_handovers(cell, tool, asked).compatible)
    wide, usual = found
    assert not (wide & ~usual).any()
    assert 0 < wide.sum() < usual.sum()


def test_a_survey_tells_the_cells_own_margin(folder: Path) -> None:
    figures = CellSurvey.of(own(folder, LIFT, **margins(WIDE)), ReachMapSettings(columns=4, rolls=2)).figures()
    assert figures.margin == WIDE
    assert "Planning keeps bodies 8 mm apart." in figures.sentences


def distances(
    cell: Cell, q: np.ndarray, widths: dict[str, float], within: float
) -> Iterator[tuple[CollisionBody, CollisionBody, float]]:
    """Yield the pairs of bodies that may meet in a cell, an arm's with any, and how far they are apart.

    Left out are pairs of which one's box is farther than `within` [m] from the ball around the other. Kinematics is
    pinocchio's, distances are python-fcl's.
    """
    bodies = cell.collision_bodies(widths)
    placed = world_frames(cell, q)
    balls = [ball(body, placed[body.frame]) for body in bodies]
    objects = [fcl_object(body, placed[body.frame]) for body in bodies]
    for i, j in itertools.combinations(range(len(bodies)), 2):
        a, b = bodies[i], bodies[j]
        if a.frame == b.frame or tuple(sorted((a.name, b.name))) in cell.excluded_pairs:
            continue
        apart = (from_box(a, placed[a.frame], *balls[j]), from_box(b, placed[b.frame], *balls[i]))
        if max(apart) < within:
            yield a, b, fcl_distance(objects[i], objects[j])


def ball(body: CollisionBody, T: np.ndarray) -> tuple[np.ndarray, float]:
    (shape,) = body.shapes
    center = shape.vertices.mean(axis=0)
    radius = float(np.linalg.norm(shape.vertices - center, axis=1).max()) + shape.radius
    return T[:3, :3] @ center + T[:3, 3], radius


def from_box(body: CollisionBody, T: np.ndarray, center: np.ndarray, radius: float) -> float:
    """Return how far a ball is at least from the box around a body, along the axes of its frame [m]."""
    (shape,) = body.shapes
    low, high = shape.vertices.min(axis=0) - shape.radius, shape.vertices.max(axis=0) + shape.radius
    local = T[:3, :3].T @ (center - T[:3, 3])
    return float(np.linalg.norm(local - np.clip(local, low, high))) - radius


def world_frames(cell: Cell, q: np.ndarray) -> dict[str, np.ndarray]:
    """Return `T_world_frame` of all frames at twelve joint positions, by pinocchio."""
    frames = {"world": np.eye(4)}
    for i, (name, arm) in enumerate(cell.arms.items()):
        own_joints = q[6 * i : 6 * i + 6]
        frames[f"{name}/0"] = arm.T_world_base
        for links, chain in enumerate(chains(arm.dh.tobytes()), start=1):
            frames[f"{name}/{links}"] = arm.T_world_base @ chain.flange_pose(own_joints[:links])
    return frames


@cache
def chains(dh: bytes) -> list[PinocchioArm]:
    rows = np.frombuffer(dh).reshape(6, 4)
    return [PinocchioArm(rows[:links]) for links in range(1, 7)]


def nearest(plan: Plan, cell: Cell) -> float:
    """Return how near an arm comes at any sample to the other arm or to the cell, 10 mm where that is less [m]."""
    least = 0.010
    for segment in plan.segments:
        for k, q in enumerate(segment.positions):
            widths = {arm: float(opening[k]) for arm, opening in segment.gripper_width.items()}
            found = (apart for a, b, apart in distances(cell, q, widths, 0.010) if a.group != b.group)
            least = min([least, *found])
    return least


def planned(cell: Cell) -> Plan:
    ticks = count()
    solver = TaskSolver({"own": cell}, {}, clock=lambda: float(next(ticks)), certify=None)
    body = task_body("ab1", simulate=False, remedies=False)
    plan = solver.solve(read_task({**body, "cell": "own"}), "probe")
    assert plan.outcome == "solved", plan.explanation
    return plan


@pytest.mark.slow
def test_motion_keeps_its_share_of_the_cells_margin_at_all_samples(folder: Path) -> None:
    """Between arms, hands, platform and table. Without the cell's own margin something comes nearer."""
    share = Clearance().executed_share
    cells = [own(folder, LIFT, **said) for said in (margins(WIDE), {})]
    wide, usual = (nearest(planned(cell), cell) for cell in cells)
    assert wide >= share * WIDE - 1e-6
    assert share * Clearance().margin - 1e-6 <= usual < share * WIDE


@pytest.mark.slow
def test_a_document_that_states_other_margins_than_its_cell_fails(folder: Path) -> None:
    cell = own(folder, LIFT, **margins(WIDE))
    document = planned(cell).document()
    for stated, passed in (({"bodies": WIDE}, True), ({"bodies": 0.02}, False), (None, False)):
        told = copy.deepcopy(document)
        told["cell"]["margins"] = stated
        if stated is None:
            del told["cell"]["margins"]
        found = certificate_of(json.dumps(told).encode(), cell, certify)
        assert found is not None
        assert [check.name for check in found.failures] == ([] if passed else ["cell"])


def test_handovers_are_asked_for_with_the_cells_margin_and_are_the_stored_ones_without(folder: Path) -> None:
    usual = ToolPlannerSettings()
    assert usual.in_cell(load_cell(TOOL)) == usual
    wide = usual.in_cell(own(folder, TOOL, **margins(WIDE))).handovers
    assert wide.clearance.margin == WIDE
    narrow = usual.in_cell(described(TOOL, **margins(0.001)).load(folder)).handovers
    assert (narrow.clearance.margin, narrow.grasps.margin) == (0.001, 0.001)
