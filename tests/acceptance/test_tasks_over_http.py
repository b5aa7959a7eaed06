"""The experiments of the papers, posted as a factory would: real service, real solver, certified plans."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from tests.geometry.mesh_shapes import angle, file_of
from tests.support.plan_shelf import PlanShelf
from tests.support.samples import among, sample
from tests.support.service import ROOT, ServiceProcess, finished, running_service, task, unsolved_task, warmed
from workers.settings import HANDOVERS_FOLDER

GRAVITY = 9.81
RESERVE = 0.1
"""What tasks ask for by default [1]."""
LARGEST_PILE_BYTES = 3_000_000
WITHOUT_A_PLAN = (
    ("ab1_under_beams", "not_found", "left_beam"),
    ("lid_under_roof", "not_found", "roof"),
    ("lid_too_heavy", "infeasible", "heavier than the cup bears"),
)
"""Shipped tasks, what comes of them, and words about what is in the way."""

Solved = Callable[[str], tuple[dict[str, Any], dict[str, Any]]]


@pytest.fixture(scope="module")
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an empty folder where everything is tried, else one with what was computed at set-up."""
    folder = tmp_path_factory.mktemp("data")
    return sample(warmed, lambda new: new)(folder)


@pytest.fixture(scope="module")
def service(data_dir: Path) -> Iterator[ServiceProcess]:
    """Run the service as it is installed, but that its solvers wait for no other test."""
    with running_service(data_dir, None, solver_niceness=0) as service:
        yield service


@pytest.fixture(scope="module")
def client(service: ServiceProcess) -> Iterator[httpx.Client]:
    with service.client() as client:
        yield client


@pytest.fixture(scope="module")
def sharing(shelf: PlanShelf, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """Talk to a service whose plans other tests look at too."""
    folder = tmp_path_factory.mktemp("sharing")
    (folder / "drawings").symlink_to(shelf.drawings)
    with running_service(folder, shelf.solver, solver_niceness=0) as service, service.client() as client:
        yield client


def solve(client: httpx.Client, body: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Post a task, wait for its end, and return the plan and its document."""
    answer = client.post("/v1/plans", json=body)
    assert answer.status_code == 202, answer.text
    plan = finished(client, answer.json())
    assert plan["state"] == "succeeded", plan["error"]
    return plan, client.get(plan["links"]["document"]).json()


@pytest.fixture(scope="module")
def solved(shelf: PlanShelf, sharing: httpx.Client) -> Solved:
    """Return how a shipped task's plan and document are had; each is posted once."""

    def one(name: str) -> tuple[dict[str, Any], dict[str, Any]]:
        body = unsolved_task(name) if name in {case[0] for case in WITHOUT_A_PLAN} else task(f"{name}.json")
        if sample(quick=True, whole=False):
            # Planned here, where planners are loaded once for all.
            shelf.document(body)
        return solve(sharing, body)

    return cache(one)


@pytest.mark.slow
def test_a_lift_in_a_cell_of_ones_own_is_solved_and_certified(client: httpx.Client) -> None:
    """The cell and the task of docs/cell.md."""
    page = (ROOT / "docs" / "cell.md").read_text()
    cell, told = page.partition("```yaml\n")[2].partition("```")[0], page.partition("```json\n")[2].partition("```")[0]
    kept = client.post("/v1/cells", content=cell, headers={"Content-Type": "application/yaml"}).json()
    plan, document = solve(client, {**json.loads(told), "options": {"simulate": False}})
    assert (plan["outcome"], document["certificate"]["passed"]) == ("solved", True)
    assert document["task"]["cell"] == kept["id"]


@pytest.mark.parametrize(
    "name",
    [
        "ab1",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("ab2", "ab3", "pb1", "pb2", "ab1_ur3", "sheet_ur10e")
        ),
    ],
)
def test_a_shipped_lift_is_solved_and_certified(solved: Solved, name: str) -> None:
    body = task(f"{name}.json")
    plan, document = solved(name)
    assert plan["outcome"] == document["outcome"] == "solved"
    failed = [check for check in document["certificate"]["checks"] if not check["passed"]]
    assert failed == []
    assert document["certificate"]["passed"] is True
    assert document["id"] == plan["id"]
    assert document["task"]["plate"]["mass"] == body["plate"]["mass"]
    assert document["software"]["name"] == "liftwright"
    kept = document["statistics"]["reserve"]
    assert kept["value"] >= RESERVE or kept["limited_by"] in document["explanation"]["summary"]


@pytest.mark.parametrize(
    "name",
    ["ab1", *(pytest.param(name, marks=pytest.mark.slow) for name in ("ab2", "ab3", "pb1", "pb2", "sheet_ur10e"))],
)
def test_a_shipped_lift_is_lifted_in_physics(solved: Solved, name: str) -> None:
    _, document = solved(name)
    assert document["simulation"]["outcome"] == "lifted", document["simulation"]["cause"]


@pytest.mark.parametrize("name", ["ab1", pytest.param("pb2", marks=pytest.mark.slow)])
def test_a_lift_begins_on_the_support_and_ends_in_the_air(solved: Solved, name: str) -> None:
    _, document = solved(name)
    states = [segment["contact_state"]["element"] for segment in document["segments"] if segment["contact_state"]]
    assert (states[0], states[-1]) == ("face", "none")


@pytest.mark.parametrize("name", among(["pb1_weak_cup", "pb2_weak_cup"], ["pb1_weak_cup"]))
def test_a_cup_that_is_too_weak_is_infeasible_and_the_missing_newtons_are_told(solved: Solved, name: str) -> None:
    body = task(f"{name}.json")
    plan, document = solved(name)
    assert plan["outcome"] == document["outcome"] == "infeasible"
    assert document["segments"] == []
    assert document["explanation"]["summary"]
    in_newtons = [cause for cause in document["explanation"]["causes"] if cause["unit"] == "N"]
    assert in_newtons
    weight = body["plate"]["mass"] * GRAVITY
    for cause in in_newtons:
        assert cause["available"] < cause["needed"]
    assert any(cause["needed"] == pytest.approx(weight, rel=0.01) for cause in in_newtons)


@pytest.mark.parametrize(
    ("name", "outcome", "in_the_way"),
    among(WITHOUT_A_PLAN, [case for case in WITHOUT_A_PLAN if case[0] != "lid_under_roof"]),
)
@pytest.mark.slow
def test_an_example_without_a_plan_names_what_is_in_its_way(
    sharing: httpx.Client, solved: Solved, name: str, outcome: str, in_the_way: str
) -> None:
    plan, document = solved(name)
    assert plan["outcome"] == document["outcome"] == outcome
    assert document["segments"] == []
    assert any(in_the_way in cause["reason"] for cause in document["explanation"]["causes"])
    assert "</html>" in sharing.get(plan["links"]["recording"]).raise_for_status().text


@pytest.mark.slow
def test_the_same_task_gives_the_same_plan(client: httpx.Client, solved: Solved) -> None:
    documents = [dict(solved("ab1")[1]), solve(client, task("ab1.json"))[1]]
    for document in documents:
        for changing in ("id", "statistics"):
            del document[changing]
    assert documents[0] == documents[1]


@pytest.mark.parametrize(
    "name",
    [
        "domino_pile",
        pytest.param("can_stack", marks=pytest.mark.slow),
        pytest.param("tissue_pile", marks=pytest.mark.slow),
        pytest.param("tissue_pile_short_tool", marks=pytest.mark.slow),
        pytest.param("tissue_pile_ur3", marks=pytest.mark.slow),
        pytest.param("domino_pile_large_pad", marks=pytest.mark.slow),
        pytest.param("carton_pile", marks=pytest.mark.slow),
    ],
)
def test_a_pile_is_built_and_certified_and_its_document_stays_small(
    sharing: httpx.Client, solved: Solved, name: str
) -> None:
    plan, document = solved(name)
    assert plan["outcome"] == document["outcome"] == "solved"
    assert document["certificate"]["passed"] is True
    assert document["simulation"]["outcome"] == "done"
    wanted = {each["name"] for each in document["task"]["objects"]}
    assert set(document["statistics"]["considered"]["order"]) == wanted
    assert len(sharing.get(plan["links"]["document"]).content) <= LARGEST_PILE_BYTES


def handovers_of(data_dir: Path) -> dict[str, int]:
    """Return the handovers that are kept, with the number that a file written anew would not have."""
    return {path.name: path.stat().st_ino for path in (data_dir / HANDOVERS_FOLDER).glob("*.handovers")}


@pytest.mark.slow
def test_handovers_of_the_shipped_tools_are_there_before_the_first_job_and_are_not_computed_again(
    client: httpx.Client, data_dir: Path
) -> None:
    kept = handovers_of(data_dir)
    # Of each of the two tools, standing and lying.
    assert len(kept) == 4
    stack = task("can_stack.json")
    plan, _ = solve(client, sample({**stack, "objects": stack["objects"][:1], "options": {"simulate": False}}, stack))
    events = client.get(plan["links"]["events"]).text
    assert '"stage":"handovers"' not in events.replace(" ", "")
    assert handovers_of(data_dir) == kept


MEDIA = {"stl": "model/stl", "ply": "model/ply", "obj": "model/obj", "glb": "model/gltf-binary"}
PART = angle().apply_scale([2.0, 2.0, 1.0])
"""An L whose legs are 40 mm wide."""


@pytest.mark.slow
def test_a_part_is_the_same_in_every_format_and_is_moved(client: httpx.Client) -> None:
    meshes = {}
    for kind, media in MEDIA.items():
        answer = client.post("/v1/meshes", content=file_of(PART, kind), headers={"Content-Type": media})
        assert answer.status_code == 201, answer.text
        meshes[kind] = answer.json()
    known = [(mesh["triangles"], mesh["convex_parts"], mesh["hint"]) for mesh in meshes.values()]
    assert known == 4 * [(len(PART.faces), 2, None)]
    for mesh in meshes.values():
        assert mesh["size"] == pytest.approx(PART.extents.tolist(), abs=1e-6)
    part = {
        "name": "part",
        "shape": {"type": "mesh", "upload": meshes["glb"]["id"]},
        "mass": 0.15,
        "com": PART.center_mass.tolist(),
        "pose": [0.3, 0.2, 1.094, 1, 0, 0, 0],
        "goal_pose": [0.45, 0.1, 1.094, 0, 0, 0, 1],
    }
    plan, document = solve(client, {"kind": "suction_tool", "objects": [part], "options": {"simulate": False}})
    assert plan["outcome"] == "solved", document["explanation"]
    assert document["certificate"]["passed"] is True
    stated = document["bodies"]["part"]["shape"]
    corners = np.array(stated["vertices"])
    distances = np.linalg.norm(corners[:, None] - PART.vertices[None], axis=2)
    assert distances.min(axis=0).max() < 1e-6
    assert distances.min(axis=1).max() < 1e-6
    end = [rows["part"][-1] for rows in (segment["body_poses"] for segment in document["segments"]) if "part" in rows][
        -1
    ]
    np.testing.assert_allclose(end[:3], part["goal_pose"][:3], atol=1e-6)
    assert abs(np.dot(end[3:], part["goal_pose"][3:])) == pytest.approx(1.0)
