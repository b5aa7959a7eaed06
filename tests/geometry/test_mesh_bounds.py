"""What a mesh file costs: in proportion to its length, whatever is in it."""

import time
import tracemalloc

import numpy as np
import pytest
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from planners.geometry import solid_mesh
from planners.geometry.mesh_file import MOST_TRIANGLES, MeshFormat, MeshRefused
from planners.geometry.solid_mesh import SAME_VERTEX, repaired, take_mesh
from tests.geometry.mesh_shapes import angle, file_of
from tests.support import mesh_bombs

FORMATS: dict[str, MeshFormat] = {
    "model/stl": "stl",
    "model/obj": "obj",
    "model/ply": "ply",
    "model/gltf-binary": "glb",
}
BOMBS = list(mesh_bombs.meshes())
SOLIDS = {"angle": angle(), "torus": trimesh.creation.torus(0.05, 0.015), "ball": trimesh.creation.icosphere(3)}
SLACK = 2.5
"""Of what costs in proportion to its length, four times the length may cost four times this."""


def refusal(content: bytes, kind: MeshFormat) -> str:
    with pytest.raises(MeshRefused) as refused:
        take_mesh(content, kind)
    return str(refused.value)


def work_of(content: bytes, kind: MeshFormat) -> float:
    """Return the processor time of a refusal, the least of some [s]."""

    def once() -> float:
        begin = time.thread_time()
        refusal(content, kind)
        return time.thread_time() - begin

    return min(once() for _ in range(3))


def memory_of(content: bytes, kind: MeshFormat) -> int:
    tracemalloc.start()
    try:
        refusal(content, kind)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("number", range(len(BOMBS)))
def test_a_file_made_to_hurt_is_refused_with_a_reason(number):
    media_type, content = BOMBS[number]
    assert refusal(content, FORMATS[media_type])


@pytest.mark.parametrize(
    ("kind", "made"),
    [
        ("obj", lambda n: b"\n" * 10 * n),
        ("obj", lambda n: b"\n \t" * 4 * n),
        ("obj", lambda n: b"f " + b" " * 10 * n),
        ("obj", lambda n: mesh_bombs.grouped_obj(n // 4)),
        ("stl", lambda n: b"solid a\n" + b"\n" * 10 * n),
        ("stl", lambda n: mesh_bombs.solids_stl(n // 4)),
        ("ply", lambda n: mesh_bombs.ply_of_properties(n // 10)),
    ],
    ids=["lines", "blanks", "blanks in a line", "materials", "lines of STL", "solids", "properties"],
)
def test_four_times_the_file_is_four_times_the_work(kind, made):
    refusal(made(10), kind)
    assert work_of(made(16_000), kind) < SLACK * 4.0 * max(work_of(made(4_000), kind), 1e-3)


@pytest.mark.parametrize(
    ("kind", "made"),
    [
        ("stl", lambda n: mesh_bombs.heaped_stl(n, 0.0)),
        ("stl", lambda n: mesh_bombs.heaped_stl(n, 1e-7)),
        ("stl", lambda n: mesh_bombs.heaped_stl(n, 1e-6)),
        ("ply", lambda n: mesh_bombs.ply_with_rows_behind(20 * n)),
        ("glb", lambda n: mesh_bombs.glb_of_accessors(n // 10, bytes(1200 * n))),
        ("glb", lambda n: mesh_bombs.glb_of_views(n // 10, bytes(12 * n))),
    ],
    ids=["equal vertices", "near vertices", "vertices as far as near ones are", "rows", "accessors", "views"],
)
def test_a_file_takes_memory_in_proportion_to_its_length(kind, made):
    small, large = made(500), made(2_000)
    refusal(small, kind)
    assert memory_of(large, kind) < SLACK * len(large) / len(small) * memory_of(small, kind)
    assert memory_of(large, kind) < 100 * len(large)


def test_as_many_equal_vertices_as_a_file_may_have_take_little_memory():
    assert memory_of(mesh_bombs.heaped_stl(MOST_TRIANGLES - 1, 0.0), "stl") < 60e6


def labels_of_all_pairs(vertices, radius):
    """Join every two vertices that are near each other."""
    pairs = KDTree(vertices).query_pairs(radius, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(vertices), len(vertices)))
    return connected_components(graph, directed=False)[1]


@pytest.mark.parametrize("kind", ["stl", "ply"])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("mesh", SOLIDS.values(), ids=SOLIDS.keys())
def test_a_mesh_is_repaired_as_if_all_pairs_of_vertices_were_looked_at(kind, seed, mesh, monkeypatch):
    rng = np.random.default_rng(seed)
    read = trimesh.load_mesh(trimesh.util.wrap_as_stream(file_of(mesh, kind)), file_type=kind, process=False)
    corners, triangles = read.vertices[read.faces].reshape(-1, 3), np.arange(3 * len(read.faces)).reshape(-1, 3)
    near = 0.2 * SAME_VERTEX * float(np.linalg.norm(mesh.extents))
    vertices = corners + rng.uniform(-near, near, corners.shape)
    vertices_found, faces_found = repaired(vertices, triangles)
    monkeypatch.setattr(solid_mesh, "clusters", labels_of_all_pairs)
    vertices_wanted, faces_wanted = repaired(vertices, triangles)
    np.testing.assert_array_equal(vertices_found, vertices_wanted)
    np.testing.assert_array_equal(faces_found, faces_wanted)
    assert len(vertices_found) == len(mesh.vertices)


def test_vertices_that_no_triangle_has_are_left_out_before_anything_is_measured():
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    far = np.vstack([np.full((1, 3), 1e9), box.vertices])
    vertices, faces = repaired(far, np.array(box.faces) + 1)
    np.testing.assert_allclose(np.ptp(vertices, axis=0), box.extents)
    assert len(faces) == 12
