"""Meshes are repaired or refused, and what a file claims is not believed."""

import json
import struct

import numpy as np
import pytest
import trimesh

from planners.geometry.mesh_file import MOST_TRIANGLES, MeshRefused, read_mesh_file
from planners.geometry.solid_mesh import SolidMesh, repaired, take_mesh
from tests.geometry.mesh_shapes import angle, file_of

FLAT = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.3, 0]]
BOX = trimesh.creation.box((0.1, 0.2, 0.3))


def volume_of(solid):
    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    return mesh.volume


def with_faces(mesh, faces):
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "ply", "obj", "glb"])
@pytest.mark.parametrize("mesh", [BOX, angle()], ids=["box", "angle"])
def test_a_solid_is_the_same_whatever_the_file(kind, mesh):
    solid = take_mesh(file_of(mesh, kind), kind.removesuffix("_ascii"))
    assert volume_of(solid) == pytest.approx(mesh.volume, rel=1e-5)
    assert len(solid.vertices) == len(mesh.vertices)
    assert solid.size == pytest.approx(mesh.extents, rel=1e-6)


def test_a_mesh_that_is_inside_out_is_turned():
    inverted = with_faces(angle(), angle().faces[:, ::-1])
    assert inverted.volume < 0
    assert volume_of(take_mesh(file_of(inverted, "stl"), "stl")) == pytest.approx(angle().volume, rel=1e-5)


@pytest.mark.parametrize("seed", range(5))
def test_triangles_that_are_turned_over_are_turned_back(seed):
    mesh = trimesh.creation.torus(0.05, 0.015)
    faces = np.array(mesh.faces)
    over = np.random.default_rng(seed).random(len(faces)) < 0.3
    faces[over] = faces[over][:, ::-1]
    vertices, mended = repaired(np.array(mesh.vertices), faces)
    assert trimesh.Trimesh(vertices, mended, process=False).volume == pytest.approx(mesh.volume)


def test_triangles_without_area_or_given_twice_are_dropped():
    faces = np.vstack([BOX.faces, BOX.faces[:3], [[0, 0, 1], [2, 2, 2]]])
    vertices, mended = repaired(np.array(BOX.vertices), faces)
    assert len(mended) == 12
    assert trimesh.Trimesh(vertices, mended, process=False).volume == pytest.approx(BOX.volume)


def moebius():
    n = 24
    angles = np.linspace(0, 2 * np.pi, n, endpoint=False)
    rows = []
    for u in angles:
        ring = []
        for v in (-0.3, 0.3):
            ring.append([(1 + v * np.cos(u / 2)) * np.cos(u), (1 + v * np.cos(u / 2)) * np.sin(u), v * np.sin(u / 2)])
        rows += ring
    faces = []
    for k in range(n):
        a, b = 2 * k, 2 * k + 1
        c, d = (2 * k + 2, 2 * k + 3) if k < n - 1 else (1, 0)
        faces += [(a, b, c), (b, d, c)]
    return trimesh.Trimesh(rows, faces, process=False)


def klein():
    """A closed surface with one side: a grid whose one pair of sides is joined the wrong way round."""
    n = 8
    number = lambda i, j: (i % n) * n + ((j if i < n else -j) % n)  # noqa: E731
    faces = []
    for i in range(n):
        for j in range(n):
            a, b, c, d = number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)
            faces += [(a, b, c), (a, c, d)]
    return np.random.default_rng(0).random((n * n, 3)), np.array(faces)


def beside(offset):
    return trimesh.util.concatenate([BOX, BOX.copy().apply_translation(offset)])


def hourglass():
    """One closed surface that passes through itself: a box whose top is turned past its bottom."""
    box = trimesh.creation.box((0.1, 0.1, 0.1)).subdivide().subdivide()
    vertices = np.array(box.vertices)
    vertices[:, :2] *= np.where(vertices[:, 2:] > 0, -1.0, 1.0)
    vertices[vertices[:, 2] > 0.01, 2] -= 0.13
    return trimesh.Trimesh(vertices, box.faces, process=False)


@pytest.mark.parametrize(
    ("mesh", "reason"),
    [
        (with_faces(BOX, BOX.faces[1:]), "open: 3 edges"),
        (moebius(), "open"),
        (beside((1, 0, 0)), "2 closed surfaces"),
        (beside((0.05, 0.07, 0.02)), "2 closed surfaces"),
        (beside((0.1, 0.2, 0)), "1 edges belong to more than two triangles"),
        (trimesh.util.concatenate([BOX, trimesh.creation.box((0.05, 0.05, 0.05))]), "without cavities"),
        (trimesh.Trimesh(FLAT, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]), "flat"),
        (hourglass(), "goes through itself"),
        (trimesh.creation.icosphere(6), f"at most {MOST_TRIANGLES}"),
    ],
    ids=["open", "moebius", "two", "crossing", "edge in common", "hollow", "flat", "through itself", "huge"],
)  # fmt: skip
def test_a_mesh_that_encloses_no_one_solid_is_refused_with_the_reason(mesh, reason):
    with pytest.raises(MeshRefused, match=reason):
        take_mesh(file_of(mesh, "stl"), "stl")


def test_a_closed_surface_with_one_side_is_refused():
    with pytest.raises(MeshRefused, match="one side"):
        repaired(*klein())


def glb(tree, data=b""):
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


PLY_BOMB = b"ply\nformat ascii 1.0\nelement vertex 999999999\nelement face 3\nend_header\n"
TRIANGLE = {"primitives": [{"attributes": {"POSITION": 0}}]}


@pytest.mark.parametrize(
    ("content", "kind", "reason"),
    [
        (b"", "stl", "no STL"), (b"", "ply", "no PLY"), (b"", "obj", "no triangles"), (b"", "glb", "no GLB"),
        (b"\0" * 80 + struct.pack("<I", 10**9), "stl", "no STL"),
        (PLY_BOMB, "ply", "999999999"),
        (file_of(BOX, "ply")[:-20], "ply", "cannot be read"),
        (file_of(BOX, "glb")[:-20], "glb", "cannot be read|contradicts"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "obj", "cannot be read"),
        (b"v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "obj", "finite"),
        (b"f 1 2 3\n" * 20_001, "obj", "20001 triangles"),
        (glb({"buffers": [{"uri": "file:///etc/passwd", "byteLength": 9}]}), "glb", "refers to other files"),
        (glb({"accessors": [{"count": 10**9, "componentType": 5126, "type": "VEC3"}]}), "glb", "without data"),
        (glb({"nodes": [{}] * 1001}), "glb", "1001 nodes"),
        (glb({"nodes": [{"children": [1]}, {"children": [1]}]}), "glb", "several parents"),
        (glb({"accessors": [{"bufferView": 0, "count": 60_000}], "meshes": [TRIANGLE], "nodes": [{"mesh": 0}] * 2}),
         "glb", "40000 triangles"),
        (glb({"meshes": [TRIANGLE], "nodes": [{"mesh": 0}]}), "glb", "contradicts itself"),
        (glb({"meshes": 3}), "glb", "no list"),
    ],
)  # fmt: skip
def test_a_file_that_is_broken_or_lies_is_refused_before_it_costs_anything(content, kind, reason):
    with pytest.raises(MeshRefused, match=reason):
        take_mesh(content, kind)


@pytest.mark.parametrize("kind", ["stl", "ply", "obj", "glb"])
@pytest.mark.parametrize("seed", range(12))
def test_a_damaged_file_is_read_or_refused_and_nothing_else(kind, seed):
    rng = np.random.default_rng(seed)
    content = bytearray(file_of(angle(), kind))
    for place in rng.integers(0, len(content), 12):
        content[place] = rng.integers(0, 256)
    try:
        vertices, faces = read_mesh_file(bytes(content), kind)
    except MeshRefused:
        return
    assert faces.shape[1] == vertices.shape[1] == 3


def test_an_obj_file_does_not_open_what_it_names(tmp_path):
    named = tmp_path / "secret.mtl"
    named.write_text("newmtl a\n")
    content = f"mtllib {named}\nusemtl a\n".encode() + file_of(BOX, "obj")
    assert volume_of(take_mesh(content, "obj")) == pytest.approx(BOX.volume, rel=1e-5)


def test_a_mesh_is_the_same_after_it_was_written_down():
    solid = take_mesh(file_of(angle(), "stl"), "stl")
    again = SolidMesh.from_document(json.loads(json.dumps(solid.document())))
    assert (again.vertices == solid.vertices).all()
    assert (again.faces == solid.faces).all()
    assert all((a == b).all() for a, b in zip(again.parts, solid.parts, strict=True))
    assert again.scaled(1e-3).size == pytest.approx(1e-3 * solid.size)
