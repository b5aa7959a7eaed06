"""Pairs of pad contacts, with trimesh's rays and boolean-free solids as the authorities."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from trimesh.ray.ray_triangle import ray_triangle_id

from planners.geometry.pose import rotation_from_vector
from planners.regrasp.grasps.pad_contacts import PadContacts, PadContactSettings, all_pad_contacts, spread

SETTINGS = PadContactSettings()
STROKE = 0.085


def contacts_of(*meshes: trimesh.Trimesh, settings: PadContactSettings = SETTINGS) -> PadContacts:
    """Contacts on closed meshes that are put together without being merged."""
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = np.vstack([mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)])
    vertices = np.vstack([mesh.vertices for mesh in meshes])
    return spread(all_pad_contacts(vertices, faces, STROKE, settings), settings)


def box(size: list[float], center: list[float] | None = None) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(center or [0.0, 0.0, 0.0])
    return mesh


class AllTriangles:
    """What trimesh asks for candidates of a ray: all of them."""

    def __init__(self, triangles: np.ndarray) -> None:
        self.bounds = np.concatenate([triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))])
        self._all = list(range(len(triangles)))

    def intersection(self, _bounds: np.ndarray) -> list[int]:
        return self._all


def outermost(mesh: trimesh.Trimesh, origins: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """How far along `direction` from each origin (n, 3) a ray first meets the mesh; infinite where it misses."""
    directions = np.tile(direction, (len(origins), 1))
    _, rays, places = ray_triangle_id(mesh.triangles, origins, directions, tree=AllTriangles(mesh.triangles))
    result = np.full(len(origins), np.inf)
    np.minimum.at(result, rays, np.einsum("ij,j->i", places - origins[rays], direction))
    return result


@pytest.mark.parametrize("turn", [[0.0, 0.0, 0.0], [0.4, -1.1, 0.7]])
def test_a_box_is_gripped_square_to_its_faces_and_as_wide_as_it_is(turn):
    size = np.array([0.018, 0.025, 0.170])
    mesh, R = box(size.tolist()), rotation_from_vector(turn)
    mesh.apply_transform(np.block([[R, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]]))
    found = contacts_of(mesh)
    along = np.abs(found.axes @ R)
    faces = along.argmax(axis=1)
    assert set(faces) == {0, 1}, "the third side is longer than the stroke"
    assert along.max(axis=1) == pytest.approx(1.0)
    assert found.widths == pytest.approx(size[faces], abs=1e-9)
    local = found.midpoints @ R
    assert np.take_along_axis(local, faces[:, None], axis=1) == pytest.approx(0.0, abs=1e-9)
    # It is gripped all along its length, and nowhere by an edge.
    across = np.take_along_axis(local, 1 - faces[:, None], axis=1)[:, 0]
    assert (np.abs(across) <= 0.5 * size[1 - faces] - 0.003).all()
    assert np.median(np.abs(across)) <= SETTINGS.grid
    assert local[:, 2].max() - local[:, 2].min() > 0.170 - 2 * SETTINGS.spacing


def test_a_rod_is_gripped_across_its_diameter_from_several_sides():
    radius, sections = 0.012, 96
    found = contacts_of(trimesh.creation.cylinder(radius, 0.150, sections=sections))
    # The pads come to lie on the farthest of the lines that were tried, on flats inside the circle.
    farthest = math.sqrt(radius**2 - (0.5 * SETTINGS.grid) ** 2) - radius * (1.0 - math.cos(math.pi / sections))
    assert found.widths.max() <= 2.0 * radius
    assert found.widths.min() >= 2.0 * farthest
    assert np.abs(found.axes[:, 2]).max() < 1e-6
    assert np.abs(found.midpoints[:, :2]).max() <= 0.5 * SETTINGS.grid + 1e-6
    bearings = np.unique(np.degrees(np.arctan2(found.axes[:, 1], found.axes[:, 0]) % math.pi).round(3))
    assert len(bearings) >= 3
    assert np.diff(bearings).min() >= math.degrees(SETTINGS.axis_spacing) - 1e-3


def test_nothing_wider_than_the_stroke_is_gripped():
    assert len(contacts_of(box([0.09, 0.10, 0.11]))) == 0


def test_nothing_is_gripped_where_no_two_places_face_away_from_each_other():
    # Its slopes are 33 degrees apart, more than two pads can make up for; all else is farther apart than the stroke.
    corners = [[x, y, z] for x, y in ((0.0, -0.03), (0.1, 0.0), (0.0, 0.03)) for z in (0.0, 0.2)]
    assert len(contacts_of(trimesh.convex.convex_hull(np.array(corners)))) == 0


def test_an_edge_too_sharp_for_a_pad_is_not_gripped():
    ridge = trimesh.creation.icosphere(4, 0.003)
    assert len(contacts_of(ridge)) == 0


@pytest.mark.parametrize("second", [[0.10, 0.05], [0.08, 0.04]], ids=["touching", "overlapping"])
def test_a_shaft_in_two_pieces_is_gripped_like_one_in_one_piece(second):
    whole = contacts_of(box([0.018, 0.017, 0.200]))
    low = box([0.018, 0.017, 0.100], [0.0, 0.0, -0.05])
    high = box([0.018, 0.017, 0.200 - second[0] + 0.0], [0.0, 0.0, 0.1 - 0.5 * (0.200 - second[0])])
    pieces = contacts_of(low, high)
    assert len(pieces) == len(whole)
    assert pieces.widths == pytest.approx(whole.widths)
    assert pieces.midpoints == pytest.approx(whole.midpoints, abs=1e-9)


@pytest.mark.parametrize("shape", ["cylinder", "hexagon", "bulb"])
def test_enough_of_the_surface_about_each_contact_lies_on_the_pad(shape):
    """Authority: trimesh's rays from either pad; the surface is nowhere beyond it, and near enough where it should."""
    meshes = {
        "cylinder": trimesh.creation.cylinder(0.015, 0.06, sections=64),
        "hexagon": trimesh.creation.cylinder(0.020, 0.08, sections=6),
        "bulb": trimesh.creation.icosphere(3, 0.040),
    }
    mesh = meshes[shape]
    found = contacts_of(mesh)
    assert len(found) > 2
    radius = np.sqrt(np.random.default_rng(3).uniform(0.0, 1.0, 80)) * SETTINGS.patch_radius
    angle = np.random.default_rng(4).uniform(0.0, 2.0 * math.pi, 80)
    for midpoint, axis, width in zip(found.midpoints, found.axes, found.widths, strict=True):
        x = np.cross(axis, [0.6, 0.64, 0.48])
        x /= np.linalg.norm(x)
        disc = np.outer(radius * np.cos(angle), x) + np.outer(radius * np.sin(angle), np.cross(axis, x))
        for side in (1.0, -1.0):
            start = midpoint + side * (0.5 * width + 0.05) * axis + disc
            depth = outermost(mesh, start, -side * axis) - 0.05
            on_pad = depth <= 2.0 * SETTINGS.compliance + 1e-6
            # The search counts cells of a grid: a tenth of the disc is not told apart.
            assert on_pad.mean() >= SETTINGS.patch_share - 0.1
            assert depth.min() > -2e-4, "the surface sticks into the pad"


def test_contacts_that_close_alike_keep_their_distance():
    found = contacts_of(trimesh.creation.cylinder(0.020, 0.10, sections=48), box([0.06, 0.02, 0.02], [0.03, 0.0, 0.04]))
    for i in range(len(found)):
        for j in range(i):
            apart = np.linalg.norm(found.midpoints[i] - found.midpoints[j]) >= SETTINGS.spacing - 1e-5
            turned = abs(found.axes[i] @ found.axes[j]) <= math.cos(SETTINGS.axis_spacing) + 1e-9
            assert apart or turned
