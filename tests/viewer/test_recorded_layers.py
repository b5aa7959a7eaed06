"""A recording shows with any layers what the viewer shows with them, though it has them all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser

from app.viewer.drawing.body_drawing import Stage
from app.viewer.drawing.link_meshes import LinkMeshes
from app.viewer.drawing.plan_scene import FIRST_LAYERS, LAYERS, Gate, PlanScene
from app.viewer.playback import Playback
from planners.cell.cell import Cell, load_cell
from tests.support.documents import plan_of
from tests.support.tool_documents import CUP, tool_document

TIMES = (0.0, 0.15, 1.4)
"""The two objects are moved one after the other [s]."""


@pytest.fixture(scope="module")
def cell() -> Cell:
    return load_cell("dual_ur3e_tool")


@pytest.fixture(scope="module")
def played(cell: Cell) -> Playback:
    """Return a plan in which a hand grips the tool, and the cup an object, with forces that change."""
    document = tool_document(cell)
    for number, segment in enumerate(document["segments"]):
        segment["contacts"] = [
            each for sample in range(len(segment["time"])) for each in contacts(sample, 1.0 + 0.1 * sample + number)
        ]
    return Playback(plan_of(document))


def contacts(sample: int, force: float) -> Iterator[dict[str, Any]]:
    """Yield what both fingers press, and what the cup bears."""
    for finger, side in ((0, 1.0), (1, -1.0)):
        yield {
            "sample": sample, "body": "tool", "by": "left", "finger": finger, "kind": "soft_finger",
            "point": [0.4, 0.0, 1.2], "normal": [0.0, side, 0.0], "wrench": [0.2, side * 9.0, force, 0.0, 0.0, 0.0],
            "mu": 0.5, "eps": 0.0075, "limit": 60.0,
        }  # fmt: skip
    yield {
        "sample": sample, "body": "first", "by": "tool", "finger": None, "kind": "suction",
        "point": [0.4, 0.0, 1.114], "normal": [0.0, 0.0, -1.0], "x_axis": [1.0, 0.0, 0.0],
        "wrench": [0.0, 0.0, force, 0.0, 0.0, 0.0], "mu": CUP["mu"], "radius": CUP["radius"], "kappa": CUP["kappa"],
        "limit": CUP["max_force"], "suction_force": force,
    }  # fmt: skip


class Drawn:
    """A plan in a scene of its own."""

    def __init__(self, server: viser.ViserServer, cell: Cell, meshes: LinkMeshes, played: Playback) -> None:
        self._nodes = server.scene._handle_from_node_name
        self.scene = PlanScene(Stage(server.scene, "/stage", cell, meshes), "/plan", played)

    def seen(self, hidden: Iterable[str] = ()) -> Counter[tuple[object, ...]]:
        """Return what is seen: all nodes that are visible with all above them, by what they show and where."""
        closed = {name for name, node in self._nodes.items() if not node.visible} | set(hidden)
        return Counter(
            what
            for name, node in self._nodes.items()
            if not any(above == name or name.startswith(f"{above}/") for above in closed)
            and (what := contents(name, node)) is not None
        )


def contents(name: str, node: viser.SceneNodeHandle) -> tuple[object, ...] | None:
    """Return what a node shows; None: nothing by itself."""
    place = (*np.round(node.position, 6), *np.round(node.wxyz, 6))
    match node:
        case viser.LabelHandle():
            return ("label", node.text, *place)
        case viser.ArrowsHandle():
            return ("arrows", np.round(node.points, 6).tobytes())
        case viser.FrameHandle():
            return ("axes", *place) if node.show_axes else None
        case viser.MeshHandle():
            return ("mesh", np.asarray(node.vertices).tobytes(), *place)
        case _:
            return (type(node).__name__, name)


@pytest.fixture(scope="module")
def both(cell: Cell, played: Playback, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Drawn, Drawn]]:
    """Yield the plan as the viewer shows it, and once more for a recording."""
    meshes = LinkMeshes(Path(tmp_path_factory.getbasetemp()) / "meshes")
    servers = [viser.ViserServer(host="127.0.0.1", port=0, verbose=False) for _ in range(2)]
    live, recorded = (Drawn(server, cell, meshes, played) for server in servers)
    yield live, recorded
    for server in servers:
        server.stop()


@pytest.fixture(scope="module")
def gates(both: tuple[Drawn, Drawn]) -> tuple[Gate, ...]:
    return both[1].scene.show_all_layers()


def layers_shown() -> list[frozenset[str]]:
    """Return those that are shown at first, none, each alone, all pairs, and all but one."""
    few = [frozenset(each) for number in range(3) for each in combinations(LAYERS, number)]
    return [FIRST_LAYERS, *few, *(frozenset(LAYERS) - {layer} for layer in LAYERS), frozenset(LAYERS)]


@pytest.mark.parametrize("time", TIMES)
def test_whatever_layers_are_chosen_a_recording_shows_what_the_viewer_shows(
    both: tuple[Drawn, Drawn], gates: tuple[Gate, ...], time: float
) -> None:
    live, recorded = both
    for each in both:
        each.scene.show("plan", time)
    everything = set[tuple[object, ...]]()
    for shown in layers_shown():
        for layer in LAYERS:
            live.scene.set_layer(layer, layer in shown)
        closed = [gate.node for gate in gates if not is_open(gate, shown)]
        expected = live.seen()
        assert recorded.seen(closed) == expected, f"with {sorted(shown)}"
        everything |= set(expected)
    assert {"label", "arrows", "axes", "mesh"} <= {str(what[0]) for what in everything}


def is_open(gate: Gate, shown: frozenset[str]) -> bool:
    return shown.issuperset(gate.shown_with) and shown.isdisjoint(gate.hidden_with)
