"""Contact states of a plate: principal contacts, what they relax to, and how much they restrain (paper B, IV-A)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np

from planners.geometry.polyhedron import Boundary, ConvexPrism, Element, ElementKind
from planners.geometry.pose import Array, skew
from planners.geometry.sides import told_side


@dataclass(frozen=True)
class PrincipalContact:
    """⟨element of the plate, element of the environment⟩; both are None when nothing touches."""

    plate: Element | None
    environment: Element | None

    @property
    def element(self) -> str:
        """The kind of the plate's touching element: "face", "edge", "vertex" or "none"."""
        return "none" if self.plate is None else self.plate.kind.value

    @property
    def index(self) -> int | None:
        """The number of the plate's touching element, None without contact."""
        return None if self.plate is None else self.plate.index

    @property
    def name(self) -> str:
        """As reports say it: "face", "edge 3", "vertex 0", "no contact"."""
        if self.index is None:
            return "no contact"
        return "face" if self.element == "face" else f"{self.element} {self.index}"

    def told(self, outline: Array, R_world_plate: Array) -> str:
        """As people say it who see the plate lie: "face", "edge 3, to the left", "vertex 0, …", "no contact".

        Args:
            outline: (n, 2) of the plate, counter-clockwise [m].
            R_world_plate: how it lies at the start.
        """
        if self.plate is None or self.plate.kind is ElementKind.FACE:
            return self.name
        return f"{self.name}, {told_side(outline, R_world_plate, self.plate.kind.value, self.plate.index)}"


NO_CONTACT = PrincipalContact(None, None)
"""The plate is off the environment. Every contact can relax to it."""

ENVIRONMENT_FACE = Element(ElementKind.FACE, 0)
"""The one element of an environment that is a sufficiently large flat surface."""

FLAT_ENVIRONMENT: Boundary = {ENVIRONMENT_FACE: frozenset()}
"""The environment of paper B: one face, which nothing bounds."""


def includes(stronger: PrincipalContact, weaker: PrincipalContact, plate: Boundary, environment: Boundary) -> bool:
    """Tell whether ⟨a, b⟩ includes ⟨c, d⟩: paper B's three conditions.

    1) c bounds a and d bounds b; 2) c bounds a and d is b; 3) c is a and d bounds b. The paper prints "or" inside
    each condition, where the work it cites and its own Fig. 4 have "and". No contact is included in every contact.
    """
    a, b, c, d = stronger.plate, stronger.environment, weaker.plate, weaker.environment
    if a is None or b is None:
        return False
    if c is None or d is None:
        return True
    c_bounds_a, d_bounds_b = c in plate[a], d in environment[b]
    return (c_bounds_a and d_bounds_b) or (c_bounds_a and d == b) or (c == a and d_bounds_b)


@dataclass(frozen=True)
class ContactStateGraph:
    """Contact states and the relaxations between them: one GCR graph, or several merged."""

    contacts: tuple[PrincipalContact, ...]
    relaxations: frozenset[tuple[PrincipalContact, PrincipalContact]]
    """Pairs (stronger, weaker)."""

    def related(self, one: PrincipalContact, other: PrincipalContact) -> bool:
        """Tell whether the contacts are equal or one relaxes to the other."""
        return one == other or (one, other) in self.relaxations or (other, one) in self.relaxations

    def weaker(self, one: PrincipalContact, other: PrincipalContact) -> PrincipalContact:
        """Return the weaker of two related contacts: the one that holds between a pose of each."""
        return one if (other, one) in self.relaxations else other


def goal_contact_relaxation(strongest: PrincipalContact, plate: Boundary, environment: Boundary) -> ContactStateGraph:
    """Relax the strongest contact step by step until nothing touches (GCR graph).

    Returns:
        The contacts in the order they are found (strongest first, NO_CONTACT last) and every inclusion among them.
    """
    found = [strongest]
    for contact in found:
        found.extend(weaker for weaker in _relaxed(contact, plate, environment) if weaker not in found)
    found.append(NO_CONTACT)
    pairs = product(found, repeat=2)
    return ContactStateGraph(tuple(found), frozenset((a, b) for a, b in pairs if includes(a, b, plate, environment)))


def merge(graphs: Iterable[ContactStateGraph]) -> ContactStateGraph:
    """Merge GCR graphs into the contact state graph; a contact found twice is one state."""
    contacts: dict[PrincipalContact, None] = {}
    relaxations: frozenset[tuple[PrincipalContact, PrincipalContact]] = frozenset()
    for graph in graphs:
        contacts.update(dict.fromkeys(graph.contacts))
        relaxations |= graph.relaxations
    return ContactStateGraph(tuple(contacts), relaxations)


def contact_state_graph(plate: ConvexPrism) -> ContactStateGraph:
    """Return the contact states of a plate's bottom on a flat environment: face, edges, vertices, no contact."""
    strongest = PrincipalContact(plate.bottom, ENVIRONMENT_FACE)
    return merge([goal_contact_relaxation(strongest, plate.polyhedron.boundary, FLAT_ENVIRONMENT)])


def restraint_matrix(points: Array, normals: Array) -> Array:
    """Return T of paper B, eq. (7): row i is [[I3], [S(r_i)]] n_i.

    Args:
        points: (m, 3) contact points from the object's centre [m].
        normals: (m, 3) unit contact normals, in the same axes.

    Returns:
        (m, 6); no rows without contact.
    """
    rows = [np.concatenate([n, skew(r) @ n]) for r, n in zip(points, normals, strict=True)]
    return np.array(rows).reshape(-1, 6)


def restraint(points: Array, normals: Array) -> int:
    """Return c = rank T of paper B, eq. (8), for points [m] and normals, both (n, 3).

    For a plate's bottom: 3 on a face, 2 on an edge, 1 on a vertex, else 0.
    """
    matrix = restraint_matrix(points, normals)
    return int(np.linalg.matrix_rank(matrix)) if len(matrix) else 0


def _relaxed(contact: PrincipalContact, plate: Boundary, environment: Boundary) -> list[PrincipalContact]:
    """List the contacts that one contact includes, larger elements first."""
    if contact.plate is None or contact.environment is None:
        return []
    on_plate = [contact.plate, *sorted(plate[contact.plate])]
    on_environment = [contact.environment, *sorted(environment[contact.environment])]
    candidates = [PrincipalContact(c, d) for c, d in product(on_plate, on_environment)]
    return [candidate for candidate in candidates if includes(contact, candidate, plate, environment)]
