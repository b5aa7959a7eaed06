"""Convex polyhedra as faces, edges and vertices, and which of them bounds which."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np

from planners.geometry.polygon import ShapeError, convex_outline
from planners.geometry.pose import Array


class ElementKind(StrEnum):
    """What an element of a polyhedron is."""

    FACE = "face"
    EDGE = "edge"
    VERTEX = "vertex"


@dataclass(frozen=True, order=True)
class Element:
    """One face, edge or vertex of a polyhedron, by its number."""

    kind: ElementKind
    index: int


Boundary = Mapping[Element, frozenset[Element]]
"""The elements that bound each element: the edges and vertices of a face, the two vertices of an edge."""


@dataclass(frozen=True, eq=False)
class Polyhedron:
    """A closed convex polyhedron.

    Raises:
        ShapeError: if the faces and edges do not close the surface.
    """

    vertices: Array
    """(V, 3), in the body's frame [m]."""
    faces: tuple[tuple[int, ...], ...]
    """Vertex numbers of each face, counter-clockwise seen from outside."""
    edges: tuple[tuple[int, int], ...]
    """Vertex numbers of each edge."""

    def __post_init__(self) -> None:
        shared = [frozenset(pair) for face in self.faces for pair in _sides(face)]
        named = {frozenset(edge) for edge in self.edges}
        if len(named) != len(self.edges) or named != set(shared) or len(shared) != 2 * len(named):
            raise ShapeError("every edge of a polyhedron is shared by exactly two faces")
        if len(self.vertices) - len(self.edges) + len(self.faces) != 2:
            raise ShapeError("the faces of a convex polyhedron form one closed surface")

    def vertex_indices(self, element: Element) -> tuple[int, ...]:
        """Return the numbers of the vertices an element is spanned by."""
        match element.kind:
            case ElementKind.FACE:
                return self.faces[element.index]
            case ElementKind.EDGE:
                return self.edges[element.index]
            case ElementKind.VERTEX:
                return (element.index,)

    @cached_property
    def boundary(self) -> Boundary:
        """Which elements bound each element."""
        bounds: dict[Element, frozenset[Element]] = {
            Element(ElementKind.VERTEX, index): frozenset() for index in range(len(self.vertices))
        }
        for index, edge in enumerate(self.edges):
            bounds[Element(ElementKind.EDGE, index)] = _vertex_elements(edge)
        numbers = {frozenset(edge): index for index, edge in enumerate(self.edges)}
        for index, face in enumerate(self.faces):
            edges = frozenset(Element(ElementKind.EDGE, numbers[frozenset(pair)]) for pair in _sides(face))
            bounds[Element(ElementKind.FACE, index)] = edges | _vertex_elements(face)
        return bounds


@dataclass(frozen=True, eq=False)
class ConvexPrism:
    """A plate: a convex outline swept along z, its frame at mid-height, its top face towards +z.

    Numbering: bottom vertex, bottom edge and side face k belong to side k of the outline (edge k joins the bottom
    vertices k and k + 1); vertex n + k is above vertex k. Face 0 is the bottom, face 1 the top, face 2 + k side k.
    """

    outline: Array
    """(n, 2), counter-clockwise [m]."""
    height: float
    """[m]"""
    polyhedron: Polyhedron

    @staticmethod
    def from_outline(outline: Sequence[Sequence[float]] | Array, height: float) -> ConvexPrism:
        """Build the prism over a convex, counter-clockwise outline.

        Raises:
            ShapeError: if the outline is not convex and counter-clockwise or the height not positive.
        """
        corners = convex_outline(outline)
        if not (np.isfinite(height) and height > 0.0):
            raise ShapeError(f"the height of a prism is positive, not {height}")
        n = len(corners)
        half = np.full((n, 1), 0.5 * height)
        vertices = np.vstack([np.hstack([corners, -half]), np.hstack([corners, half])])
        vertices.flags.writeable = False
        following = [(k + 1) % n for k in range(n)]
        sides = tuple((k, following[k], n + following[k], n + k) for k in range(n))
        faces = (tuple(range(n - 1, -1, -1)), tuple(range(n, 2 * n)), *sides)
        edges = (
            *((k, following[k]) for k in range(n)),
            *((n + k, n + following[k]) for k in range(n)),
            *((k, n + k) for k in range(n)),
        )
        return ConvexPrism(corners, float(height), Polyhedron(vertices, faces, edges))

    @property
    def bottom(self) -> Element:
        """The bottom face."""
        return Element(ElementKind.FACE, 0)

    @property
    def bottom_vertices(self) -> Array:
        """(n, 3) corners of the bottom face, in the order of the outline [m]."""
        return self.polyhedron.vertices[: len(self.outline)]


def _sides(face: tuple[int, ...]) -> list[tuple[int, int]]:
    return [(a, face[(k + 1) % len(face)]) for k, a in enumerate(face)]


def _vertex_elements(indices: tuple[int, ...]) -> frozenset[Element]:
    return frozenset(Element(ElementKind.VERTEX, index) for index in indices)
