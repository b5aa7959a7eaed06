"""What is written into the scene: the names of things, and the newtons of the forces that are drawn."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser

from app.viewer.drawing.body_drawing import MOST_LETTERS, Stage, shortened
from app.viewer.drawing.link_meshes import LinkMeshes
from app.viewer.drawing.plan_scene import PlanScene
from app.viewer.playback import Playback
from planners.cell.cell import Cell
from tests.support.documents import plan_of
from tests.support.lift_documents import contact, segment

PULL, WEIGHT = 12.3, 27.0


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


@pytest.fixture
def scene(
    server: viser.ViserServer, document: dict[str, Any], cell: Cell, tmp_path_factory: pytest.TempPathFactory
) -> PlanScene:
    """Return a plate that the left hand pushes up with one force, and the environment with another."""
    server.scene.reset()
    contacts = [
        each
        for sample in range(2)
        for each in (
            contact(sample, "left", "point", (0.0, 0.0, PULL)),
            contact(sample, "table", "environment", (0.0, 0.0, WEIGHT)),
        )
    ]
    document |= {"outcome": "solved", "segments": [segment(0.0, 2, contacts=contacts)]}
    meshes = LinkMeshes(Path(tmp_path_factory.getbasetemp()) / "meshes")
    return PlanScene(Stage(server.scene, "/stage", cell, meshes), "/plan", Playback(plan_of(document)))


def shown(server: viser.ViserServer) -> dict[str, str]:
    """Return the texts of all labels that are seen, by name."""
    nodes = server.scene._handle_from_node_name.items()
    return {name: node.text for name, node in nodes if isinstance(node, viser.LabelHandle) and node.visible}


def test_each_force_has_its_newtons_and_the_plate_its_name(server: viser.ViserServer, scene: PlanScene) -> None:
    texts = list(shown(server).values())
    assert sorted(text for text in texts if text.endswith(" N")) == [f"{PULL} N", f"{WEIGHT} N"]
    assert "plate" in texts


def test_newtons_go_with_the_arrows_and_names_by_themselves(server: viser.ViserServer, scene: PlanScene) -> None:
    scene.set_layer("forces", False)
    assert not any(text.endswith(" N") for text in shown(server).values())
    scene.set_layer("forces", True)
    scene.set_layer("newtons", False)
    assert list(shown(server).values()) == ["plate"]
    scene.set_layer("names", False)
    assert shown(server) == {}


def test_a_label_stands_at_its_arrow(server: viser.ViserServer, scene: PlanScene) -> None:
    (arrows,) = (node for name, node in server.scene._handle_from_node_name.items() if name.endswith("arrows/left"))
    assert isinstance(arrows, viser.ArrowsHandle)
    (name,) = (name for name, text in shown(server).items() if text == f"{PULL} N")
    label = server.scene._handle_from_node_name[name]
    assert any(np.allclose(label.position, end, atol=1e-6) for end in arrows.points[0])


@pytest.mark.parametrize("length", [1, MOST_LETTERS, MOST_LETTERS + 1, 64])
def test_a_name_in_the_scene_keeps_its_begin_and_end_and_is_never_long(length: int) -> None:
    name = "".join(chr(ord("a") + place % 26) for place in range(length))
    told = shortened(name)
    assert len(told) == min(length, MOST_LETTERS)
    begin, _, end = told.partition("…")
    assert name.startswith(begin)
    assert name.endswith(end)
