"""Principal contacts, their relaxations and their restraint, from the definitions."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from planners.geometry.polygon import rectangle
from planners.geometry.polyhedron import ConvexPrism, Element, ElementKind, Polyhedron
from planners.geometry.pose import rotation_from_vector
from planners.manipulation.contacts.contact_states import (
    ENVIRONMENT_FACE,
    NO_CONTACT,
    PrincipalContact,
    contact_state_graph,
    goal_contact_relaxation,
    includes,
    merge,
    restraint,
    restraint_matrix,
)


def polygon(n: int) -> ConvexPrism:
    return ConvexPrism.from_outline([[np.cos(a), np.sin(a)] for a in 2 * np.pi / n * np.arange(n)], 0.1)


def points(contact: PrincipalContact, plate: Polyhedron, environment: Polyhedron) -> tuple[set[int], set[int]]:
    assert contact.plate is not None
    assert contact.environment is not None
    return set(plate.vertex_indices(contact.plate)), set(environment.vertex_indices(contact.environment))


def test_inclusion_is_one_element_shrinking_while_the_other_shrinks_or_stays():
    plate, environment = polygon(3).polyhedron, ConvexPrism.from_outline(rectangle(1, 1), 1).polyhedron
    contacts = [PrincipalContact(a, b) for a, b in product(plate.boundary, environment.boundary)]
    for strong, weak in product(contacts[::3], contacts[::2]):
        (a, b), (c, d) = points(strong, plate, environment), points(weak, plate, environment)
        expected = c <= a and d <= b and (c, d) != (a, b)
        assert includes(strong, weak, plate.boundary, environment.boundary) == expected


@pytest.mark.parametrize("n", [3, 4, 6, 9])
def test_a_plate_with_n_sides_has_one_face_n_edges_n_vertices_and_no_contact(n):
    graph = contact_state_graph(polygon(n))
    kinds = [contact.element for contact in graph.contacts]
    assert kinds == ["face"] + ["edge"] * n + ["vertex"] * n + ["none"]
    assert [c.index for c in graph.contacts] == [0, *range(n), *range(n), None]
    assert len(set(graph.contacts)) == 2 * n + 2


def test_relaxations_of_a_rectangle_are_those_of_fig_4_of_the_paper():
    graph = contact_state_graph(ConvexPrism.from_outline(rectangle(0.3, 0.3), 0.04))

    def weaker(kind: str, index: int) -> set[tuple[str, int | None]]:
        return {(b.element, b.index) for a, b in graph.relaxations if (a.element, a.index) == (kind, index)}

    none = ("none", None)
    assert weaker("face", 0) == {*product(["edge", "vertex"], range(4)), none}
    for k in range(4):
        assert weaker("edge", k) == {("vertex", k), ("vertex", (k + 1) % 4), none}
        assert weaker("vertex", k) == {none}


def test_every_contact_relaxes_to_no_contact_and_that_to_nothing():
    graph = contact_state_graph(polygon(5))
    assert {a for a, b in graph.relaxations if b == NO_CONTACT} == set(graph.contacts) - {NO_CONTACT}
    assert not [b for a, b in graph.relaxations if a == NO_CONTACT]


def test_relaxation_is_transitive_and_never_mutual():
    relaxations = contact_state_graph(polygon(4)).relaxations
    for (a, b), (c, d) in product(relaxations, repeat=2):
        assert b != c or (a, d) in relaxations
        assert (a, b) != (d, c)


def test_merging_graphs_keeps_shared_states_once():
    plate = ConvexPrism.from_outline(rectangle(1, 1), 0.1)
    boundary = plate.polyhedron.boundary
    both = {ENVIRONMENT_FACE: frozenset[Element](), Element(ElementKind.FACE, 1): frozenset[Element]()}
    graphs = [goal_contact_relaxation(PrincipalContact(plate.bottom, face), boundary, both) for face in both]
    merged = merge(graphs)
    assert len(merged.contacts) == 9 + 9 + 1
    assert merged.relaxations == graphs[0].relaxations | graphs[1].relaxations
    assert merge([graphs[0], graphs[0]]) == graphs[0]


def test_the_weaker_of_two_related_contacts_does_not_depend_on_their_order():
    graph = contact_state_graph(polygon(4))
    for strong, weak in graph.relaxations:
        assert graph.related(strong, weak)
        assert graph.related(weak, strong)
        assert graph.weaker(strong, weak) == graph.weaker(weak, strong) == weak
    edges = [c for c in graph.contacts if c.element == "edge"]
    assert not graph.related(edges[0], edges[1])


@pytest.mark.parametrize("seed", range(5))
def test_a_row_of_the_restraint_matrix_gives_the_speed_of_the_contact_point_along_its_normal(seed):
    rng = np.random.default_rng(seed)
    points, normals, v, omega = rng.normal(size=(4, 3)), rng.normal(size=(4, 3)), rng.normal(size=3), rng.normal(size=3)
    speeds = np.sum((v + np.cross(omega, points)) * normals, axis=1)
    assert restraint_matrix(points, normals) @ np.concatenate([v, omega]) == pytest.approx(speeds)


@pytest.mark.parametrize("n", [3, 4, 7])
@pytest.mark.parametrize("seed", range(3))
def test_a_face_restrains_three_directions_an_edge_two_a_vertex_one_and_nothing_none(n, seed):
    rng = np.random.default_rng(seed)
    R = rotation_from_vector(rng.normal(size=3))
    corners = (polygon(n).bottom_vertices - 0.1 * rng.normal(size=3)) @ R.T
    for count, rank in ((n, 3), (2, 2), (1, 1), (0, 0)):
        assert restraint(corners[:count], np.tile(R[:, 2], (count, 1))) == rank
