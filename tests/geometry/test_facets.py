"""Facets of meshes: what must hold however a surface is triangulated and placed."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from planners.errors import LiftwrightError
from planners.geometry.facets import Facet, FacetSettings, find_facets
from planners.geometry.polygon import area
from planners.geometry.pose import inverse, rotation_from_vector, transform
from planners.geometry.surface import side_neighbours

ANGLE = FacetSettings().largest_angle


def flat_loops(facet: Facet) -> list[np.ndarray]:
    """The corners (n, 2) of each border, in the facet frame."""
    T = facet.T_body_facet
    return [(loop - T[:3, 3]) @ T[:3, :2] for loop in facet.loops]


def outlines(facet: Facet) -> list[np.ndarray]:
    """Outer borders, counter-clockwise."""
    return [loop for loop in flat_loops(facet) if area(loop) > 0.0]


def holes(facet: Facet) -> list[np.ndarray]:
    """Inner borders, clockwise."""
    return [loop for loop in flat_loops(facet) if area(loop) <= 0.0]


def arrays(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)


def facets_of(mesh: trimesh.Trimesh, **changes: float) -> tuple[Facet, ...]:
    return find_facets(*arrays(mesh), FacetSettings(**changes))


def l_profile() -> trimesh.Trimesh:
    outline = np.array([[0, 0], [0.16, 0], [0.16, 0.05], [0.05, 0.05], [0.05, 0.12], [0, 0.12]], dtype=float)
    return extruded(outline, [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)], 0.03)


def extruded(outline: np.ndarray, caps: list[tuple[int, int, int]], height: float) -> trimesh.Trimesh:
    n = len(outline)
    vertices = np.vstack([np.column_stack([outline, np.full(n, z)]) for z in (0.0, height)])
    top = [(a + n, b + n, c + n) for a, b, c in caps]
    bottom = [(c, b, a) for a, b, c in caps]
    walls = [face for k in range(n) for j in [(k + 1) % n] for face in ((k, j, j + n), (k, j + n, k + n))]
    return trimesh.Trimesh(vertices, np.array(top + bottom + walls), process=False)


MESHES = {
    "box": trimesh.creation.box([0.24, 0.115, 0.06]),
    "cylinder": trimesh.creation.cylinder(0.033, 0.122, sections=24),
    "round cylinder": trimesh.creation.cylinder(0.033, 0.122, sections=96),
    "ring": trimesh.creation.annulus(0.02, 0.05, 0.03, sections=32),
    "ball": trimesh.creation.icosphere(subdivisions=3, radius=0.05),
    "L": l_profile(),
}
FLAT = ("box", "L")


def described(facet: Facet) -> tuple[float, ...]:
    """What a facet is, whatever its triangles and its place among the others."""
    normal, origin = facet.T_body_facet[:3, 2], facet.T_body_facet[:3, 3]
    perimeter = float(np.linalg.norm(facet.border[:, 1] - facet.border[:, 0], axis=1).sum())
    return tuple(np.round([*normal, *origin, facet.area, perimeter], 6) + 0.0)


@pytest.mark.parametrize("name", MESHES)
def test_facets_cover_the_surface(name):
    mesh = MESHES[name]
    covered = np.unique(np.concatenate([facet.triangles for facet in facets_of(mesh)]))
    assert covered.tolist() == list(range(len(mesh.faces)))


@pytest.mark.parametrize("name", MESHES)
def test_normals_within_a_facet_differ_from_its_own_by_less_than_the_largest_angle(name):
    mesh = MESHES[name]
    for facet in facets_of(mesh):
        cosines = mesh.face_normals[facet.triangles] @ facet.T_body_facet[:3, 2]
        assert np.arccos(np.clip(cosines, -1, 1)).max() < ANGLE


@pytest.mark.parametrize("name", MESHES)
def test_outlines_less_holes_enclose_the_projected_area(name):
    mesh = MESHES[name]
    for facet in facets_of(mesh):
        vectors = 0.5 * np.cross(*np.moveaxis(np.diff(mesh.triangles[facet.triangles], axis=1), 1, 0))
        projected = float(vectors.sum(axis=0) @ facet.T_body_facet[:3, 2])
        loops = flat_loops(facet)
        x, y = zip(*(loop.T for loop in loops), strict=True)
        enclosed = sum(0.5 * (a @ np.roll(b, -1) - b @ np.roll(a, -1)) for a, b in zip(x, y, strict=True))
        assert enclosed == pytest.approx(projected, rel=1e-6)
        assert facet.area == pytest.approx(mesh.area_faces[facet.triangles].sum())


def test_a_box_has_its_six_faces_with_the_long_side_along_x():
    facets = facets_of(MESHES["box"])
    sizes = [np.ptp(outlines(facet)[0], axis=0).round(9).tolist() for facet in facets]
    assert sorted(sizes) == sorted([[0.24, 0.115]] * 2 + [[0.24, 0.06]] * 2 + [[0.115, 0.06]] * 2)
    assert all(facet.flat and len(outlines(facet)[0]) == 4 and not holes(facet) for facet in facets)


def test_the_hole_of_a_ring_is_a_hole_of_its_end_faces():
    ends = [facet for facet in facets_of(MESHES["ring"]) if abs(facet.T_body_facet[2, 2]) > 0.99]
    assert [(len(outlines(end)), len(holes(end))) for end in ends] == [(1, 1), (1, 1)]
    radii = [np.linalg.norm(holes(end)[0], axis=1).max() for end in ends]
    assert radii == pytest.approx([0.02, 0.02])


def test_the_mantle_of_a_cylinder_with_coarse_sides_is_not_joined():
    mantle = [facet for facet in facets_of(MESHES["cylinder"]) if abs(facet.T_body_facet[2, 2]) < 0.5]
    assert len(mantle) == 24
    assert all(facet.flat for facet in mantle)


@pytest.mark.parametrize("sections", [48, 96, 180])
def test_facets_of_a_fine_mantle_overlap_and_are_known_to_be_curved(sections):
    mesh = trimesh.creation.cylinder(0.033, 0.122, sections=sections)
    mantle = [facet for facet in facets_of(mesh) if abs(facet.T_body_facet[2, 2]) < 0.5]
    assert not any(facet.flat for facet in mantle)
    assert sum(len(facet.triangles) for facet in mantle) > 2 * sections
    assert all(np.ptp(outlines(facet)[0], axis=0).min() <= 2 * 0.033 * math.sin(ANGLE) + 1e-9 for facet in mantle)


@pytest.mark.parametrize("radius", [0.02, 0.3])
def test_no_facet_of_a_ball_is_larger_than_the_angle_allows(radius):
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    side = mesh.edges_unique_length.max()
    for facet in facets_of(mesh):
        middle = radius * facet.T_body_facet[:3, 2]
        away = np.linalg.norm(mesh.vertices[np.unique(mesh.faces[facet.triangles])] - middle, axis=1)
        assert away.max() <= 2.0 * radius * math.sin(0.5 * ANGLE) + 2.0 * side


@pytest.mark.parametrize("name", MESHES)
@given(turn=st.tuples(*[st.floats(-3, 3)] * 3), shift=st.tuples(*[st.floats(-1, 1)] * 3))
@settings(max_examples=8, deadline=None)
def test_facets_move_with_the_mesh(name, turn, shift):
    vertices, faces = arrays(MESHES[name])
    T = transform(rotation_from_vector(np.array(turn)), np.array(shift))
    moved = find_facets(vertices @ T[:3, :3].T + T[:3, 3], faces)
    for facet, other in zip(find_facets(vertices, faces), moved, strict=True):
        assert inverse(T) @ other.T_body_facet == pytest.approx(facet.T_body_facet, abs=1e-8)
        assert set(other.triangles) == set(facet.triangles)


@pytest.mark.parametrize("name", FLAT)
def test_dividing_triangles_changes_no_facet(name):
    mesh = MESHES[name]
    expected = sorted(described(facet) for facet in facets_of(mesh))
    for _ in range(2):
        mesh = mesh.subdivide()
        assert sorted(described(facet) for facet in facets_of(mesh)) == expected


@pytest.mark.parametrize("name", FLAT)
def test_numbering_triangles_otherwise_changes_no_facet(name):
    vertices, faces = arrays(MESHES[name])
    expected = sorted(described(facet) for facet in find_facets(vertices, faces))
    rng = np.random.default_rng(4)
    for _ in range(4):
        mixed = np.array([np.roll(face, rng.integers(3)) for face in rng.permutation(faces)])
        assert sorted(described(facet) for facet in find_facets(vertices, mixed)) == expected


def with_needles(mesh: trimesh.Trimesh, offset: float, rng: np.random.Generator) -> trimesh.Trimesh:
    """Split every triangle at a point next to the middle of a side: one of the three is a needle of random normal."""
    vertices, faces = arrays(mesh)
    added, split = list(vertices), []
    for a, b, c in faces:
        middle = 0.5 * (vertices[a] + vertices[b])
        inward = vertices[c] - middle
        added.append(middle + offset * inward / np.linalg.norm(inward) + offset * rng.uniform(-1, 1, 3))
        new = len(added) - 1
        split += [(a, b, new), (b, c, new), (c, a, new)]
    return trimesh.Trimesh(np.array(added), np.array(split), process=False)


@pytest.mark.parametrize("offset", [0.0, 1e-9, 1e-7, 1e-6])
@pytest.mark.parametrize("name", FLAT)
def test_needles_do_not_matter(name, offset):
    mesh = MESHES[name]
    facets = facets_of(with_needles(mesh, offset, np.random.default_rng(1)), least_area=1e-4)
    expected = facets_of(mesh, least_area=1e-4)
    assert len(facets) == len(expected)
    for facet in expected:
        likest = max(
            facets,
            key=lambda other: (
                float(other.T_body_facet[:3, 2] @ facet.T_body_facet[:3, 2])
                - 10 * float(np.linalg.norm(other.T_body_facet[:3, 3] - facet.T_body_facet[:3, 3]))
            ),
        )
        assert likest.flat
        assert likest.area == pytest.approx(facet.area, rel=1e-3)
        assert likest.T_body_facet[:3, 2] @ facet.T_body_facet[:3, 2] > math.cos(1e-3)


def test_facets_below_the_least_area_are_left_out():
    assert len(facets_of(MESHES["box"], least_area=0.115 * 0.06 + 1e-6)) == 4


def test_neighbours_are_across_the_common_side():
    _, faces = arrays(MESHES["L"])
    neighbours = side_neighbours(faces)
    for face in range(len(faces)):
        for side in range(3):
            a, b = faces[face, side], faces[face, (side + 1) % 3]
            across = faces[neighbours[face, side]].tolist()
            assert across[(across.index(b) + 1) % 3] == a


def test_a_side_of_three_triangles_is_a_border():
    faces = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    assert np.all(side_neighbours(faces) == -1)


@given(
    faces=st.lists(st.tuples(*[st.integers(0, 7)] * 3), min_size=0, max_size=30),
    seed=st.integers(0, 1000),
)
@settings(max_examples=60, deadline=None)
def test_any_heap_of_triangles_has_facets_with_finite_frames(faces, seed):
    vertices = np.random.default_rng(seed).integers(0, 3, (8, 3)) * 0.05
    for facet in find_facets(vertices, np.array(faces, dtype=np.int64).reshape(-1, 3)):
        assert np.all(np.isfinite(facet.T_body_facet))
        assert facet.area > 0.0


@pytest.mark.parametrize("changes", [{"largest_angle": 0.0}, {"largest_angle": 2.0}, {"coplanar": 0.0}])
def test_settings_that_mean_nothing_are_refused(changes):
    with pytest.raises(LiftwrightError):
        FacetSettings(**changes)
