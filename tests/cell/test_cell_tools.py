"""A cell's own suction tools: named as the shipped ones are, told of with all else that is wrong, planned with."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import Any

import pytest
import trimesh

from planners.cell.bundle import CellBundle, cell_schema
from planners.cell.cell import Cell
from planners.certify import Certificate, certify
from planners.contract.task_spec import SuctionToolTask, read_task
from planners.errors import AssetError, SceneError
from planners.planning import TaskSolver, certificate_of
from planners.regrasp.grasps.handovers import handover_key
from planners.scene.scene import build_scene
from planners.scene.suction_tool import known_tools, load_tool, load_tools, tool_of_cell
from planners.survey.cell_limits import CellLimits
from planners.survey.faults import load_checked
from tests.support.own_cell import written, zipped
from tests.support.tool_plans import FEW, block, few_handovers

TURN = [1, 0, 0, 0]
COLUMN = {"mesh": {"path": "meshes/column.stl", "scale": 0.001}, "pose": [0, 0, 0.050, *TURN]}
"""A column of 25 x 25 x 80 mm, drawn in millimetres."""
TOOL: dict[str, Any] = {
    "tool": {
        "shapes": [
            {"shape": {"type": "cylinder", "radius": 0.0175, "height": 0.010}, "pose": [0, 0, 0.005, *TURN]},
            COLUMN,
            {"shape": {"type": "box", "size": [0.070, 0.020, 0.020]}, "pose": [0.0475, 0, 0.080, *TURN]},
        ],
        "mass": 0.20,
        "com": [0.0152, 0.0, 0.0546],
        "cup": {"radius": 0.0175, "max_force": 20.0, "mu": 0.5},
    }
}
"""The short tool, whose column is a mesh."""


def cell_document(**members: Any) -> dict[str, Any]:
    grips = {"robot": "ur3e", "hand": "robotiq_2f85_ft300"}
    return {
        "name": "workshop",
        "mount": "dual_column",
        "arms": {"left": grips, "right": grips},
        "gravity": [0.0, 0.0, -9.81],
        "tool_rest": {"position": [0.22, 0.0], "clearance": 0.024, "height": 0.050, "thickness": 0.005},
        **members,
    }


def files(tool: Mapping[str, Any] = TOOL) -> dict[str, bytes]:
    return {
        "cell.yaml": written(cell_document()),
        "tools/handle.yaml": written({"name": "handle", **tool}),
        "meshes/column.stl": column(25.0),
    }


def column(width: float) -> bytes:
    content = trimesh.creation.box((25.0, width, 80.0)).export(file_type="stl")
    assert isinstance(content, bytes)
    return content


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    return load_checked(CellBundle.of_zip(zipped(files())), tmp_path_factory.mktemp("cells"))


def task(**members: Any) -> SuctionToolTask:
    options = {"simulate": False, "remedies": False}
    body = {"kind": "suction_tool", "cell": "workshop", "tool": "handle", "objects": [block()], "options": options}
    read = read_task({**body, **members})
    assert isinstance(read, SuctionToolTask)
    return read


def test_a_tool_in_a_file_and_one_in_the_cells_own_are_the_same(workshop: Cell, tmp_path: Path) -> None:
    inline = files()
    del inline["tools/handle.yaml"]
    inline["cell.yaml"] = written(cell_document(tools={"handle": TOOL}))
    cell = CellBundle.of_zip(zipped(inline)).load(tmp_path)
    assert cell.hash == workshop.hash
    assert list(cell.tools) == list(workshop.tools) == ["handle"]
    again = CellBundle.of_zip(CellBundle.of_zip(zipped(inline)).zip()).load(tmp_path)
    assert again.hash == workshop.hash
    assert CellLimits.of(cell).tools == ("handle",)


def test_the_hash_of_a_cell_follows_its_tools_and_their_meshes(workshop: Cell, tmp_path: Path) -> None:
    heavier = copy.deepcopy(TOOL)
    heavier["tool"]["mass"] = 0.21
    wider = {**files(), "meshes/column.stl": column(26.0)}
    hashes = {CellBundle.of_zip(zipped(each)).load(tmp_path).hash for each in (files(heavier), wider)}
    assert len({workshop.hash, *hashes}) == 3


def test_a_tool_of_the_cell_has_the_mass_and_the_surface_that_its_parts_have(workshop: Cell) -> None:
    """The mesh is the shipped tool's box: the same solid but for how its surface is cut into triangles."""
    own, shipped = tool_of_cell(workshop.tools["handle"]), load_tool("short_asymmetric")
    assert own.mass == shipped.mass
    assert own.cup == shipped.cup
    assert own.body.solid.centroid == pytest.approx(shipped.body.solid.centroid, abs=1e-9)
    low, high = (getattr(own.body.solid.surface()[0], side)(axis=0) for side in ("min", "max"))
    assert low == pytest.approx(shipped.body.solid.surface()[0].min(axis=0), abs=1e-9)
    assert high == pytest.approx(shipped.body.solid.surface()[0].max(axis=0), abs=1e-9)
    assert handover_key(workshop, own, FEW) != handover_key(workshop, shipped, FEW)


def test_a_task_may_name_the_cells_tools_and_the_shipped_ones_and_no_other(workshop: Cell) -> None:
    cells = {"workshop": workshop}
    assert build_scene(task(), cells).tool.name == "handle"
    assert build_scene(task(tool="short_asymmetric"), cells, tools=load_tools()).tool.name == "short_asymmetric"
    with pytest.raises(SceneError) as refused:
        build_scene(task(tool="spanner"), cells)
    assert refused.value.pointer == "/tool"
    assert refused.value.allowed == sorted([*known_tools(), "handle"])


def wrong(*path: str | int, value: Any) -> dict[str, Any]:
    tool = copy.deepcopy(TOOL)
    *way, last = path
    holder: Any = tool
    for step in way:
        holder = holder[step]
    holder[last] = value
    return tool


WRONG: dict[str, tuple[dict[str, Any], str, str]] = {
    "beside": (wrong("tool", "com", value=[0.5, 0, 0]), "/tool/com", "not inside the tool"),
    "floating": (wrong("tool", "shapes", 0, "pose", 2, value=0.05), "/tool/shapes", "above its origin"),
    "thin": (
        wrong("tool", "shapes", 2, "shape", "size", value=[0.07, 0.02, -1.0]),
        "/tool/shapes/2/shape/size/2",
        "greater",
    ),
    "lost": (wrong("tool", "shapes", 1, "mesh", "path", value="meshes/none.stl"), "/tool/shapes/1/mesh", "no file"),
    "long": (wrong("tool", "shapes", 1, "mesh", "scale", value=1.0), "/tool/shapes/1/mesh", "80 m long"),
    "named": (
        wrong("tool", "shapes", 0, "shape", value={"type": "mesh", "asset": "pot"}),
        "/tool/shapes/0/shape/asset",
        "no mesh pot",
    ),
    "uploaded": (
        wrong("tool", "shapes", 0, "shape", value={"type": "mesh", "upload": "x"}),
        "/tool/shapes/0",
        "own files",
    ),
    "weightless": (wrong("tool", "mass", value=0.0), "/tool/mass", "greater"),
}
"""By name of a tool: the tool, and the member and the words of its one fault."""


@pytest.mark.parametrize("inline", [False, True])
def test_what_is_wrong_with_tools_is_told_with_all_else_that_is_wrong(inline: bool, tmp_path: Path) -> None:
    tools = {name: tool for name, (tool, _, _) in WRONG.items()}
    given = {"meshes/column.stl": files()["meshes/column.stl"]}
    if inline:
        given["cell.yaml"] = written(cell_document(gravity=[0, 0, 9.81], tools=tools))
    else:
        given["cell.yaml"] = written(cell_document(gravity=[0, 0, 9.81]))
        given |= {f"tools/{name}.yaml": written({"name": name, **tool}) for name, tool in tools.items()}
    with pytest.raises(AssetError) as refused:
        load_checked(CellBundle.of_zip(zipped(given)), tmp_path)
    told = {(fault.file, fault.pointer): fault.detail for fault in refused.value.faults}
    assert "must point along -z" in told.pop(("cell.yaml", "/gravity"))
    for name, (_, pointer, words) in WRONG.items():
        place = ("cell.yaml", f"/tools/{name}{pointer}") if inline else (f"tools/{name}.yaml", pointer)
        assert words in told.pop(place), name
    assert told == {}


def test_tools_that_are_no_mapping_and_names_that_are_none_are_refused_where_they_stand(tmp_path: Path) -> None:
    for tools, pointer in (
        (["handle"], "/tools"),
        ({"handle": "short_asymmetric"}, "/tools/handle"),
        ({"a b": TOOL}, "/tools/a b"),
        ({"handle": {"name": "other", **TOOL}}, "/tools/handle"),
    ):
        with pytest.raises(AssetError) as refused:
            load_checked(CellBundle.of_text(written(cell_document(tools=tools))), tmp_path)
        assert pointer in [fault.pointer for fault in refused.value.faults], tools


def test_the_schema_of_a_cell_has_its_tools() -> None:
    schema = json.loads(json.dumps(cell_schema()))
    reference = schema["properties"]["tools"]["additionalProperties"]["$ref"]
    assert schema["$defs"][reference.rpartition("/")[2]]["required"] == ["tool"]


@pytest.fixture(scope="module")
def document(workshop: Cell) -> dict[str, Any]:
    ticks = count()
    solver = TaskSolver(
        {"workshop": workshop}, load_tools(), few_handovers, clock=lambda: float(next(ticks)), certify=None
    )
    plan = solver.solve(task(), "probe")
    assert plan.outcome == "solved", plan.explanation
    return plan.document()


def judged(document: dict[str, Any], cell: Cell, *, alone: bool) -> Certificate | None:
    def believing(written: bytes, surfaces: Any, _: Any) -> Certificate | None:
        return certify(written, surfaces)

    return certificate_of(written(document), cell, believing if alone else certify)


@pytest.mark.slow
def test_a_plan_with_a_tool_of_the_cell_is_certified_with_its_cell_and_alone(
    workshop: Cell, document: dict[str, Any]
) -> None:
    assert document["task"]["tool"] == "handle"
    for alone in (False, True):
        found = judged(document, workshop, alone=alone)
        assert found is not None
        assert found.passed, found.failures


@pytest.mark.slow
def test_a_document_that_tells_another_tool_than_its_cell_has_fails(workshop: Cell, document: dict[str, Any]) -> None:
    """Alone, a cup is believed that the document states: one too weak to hold the object fails."""
    for alone, force, check in ((False, 30.0, "cell"), (True, 0.05, "cup_hold")):
        lie = copy.deepcopy(document)
        lie["cell"]["tools"]["handle"]["cup"]["max_force"] = force
        found = judged(lie, workshop, alone=alone)
        assert found is not None
        assert any(check in failure.name for failure in found.failures), found.failures
    lighter = copy.deepcopy(document)
    lighter["cell"]["tools"]["handle"]["mass"] = 0.1
    found = judged(lighter, workshop, alone=True)
    assert found is not None
    assert "body tool: mass" in [failure.where for failure in found.failures]
