"""The dense contact state graph (DCSG, paper B, IV-A): contact states sampled into plate poses, and their edges.

A pose with yaw kept is a tilt, a clearance and a horizontal place. The tilt is a horizontal rotation vector t of the
world frame: `R_world_plate = exp([t, 0]) @ R_world_plate_at_rest`. At rest the bottom is flat, so the height of a
bottom vertex at u (horizontal, world) is `sin|t| · cross(t / |t|, u)`: linear in the direction of t alone. The lowest
vertex is thus k exactly when the direction of t lies in the cone between the bottom edges that meet at k (each edge
taken as a counter-clockwise vector), and edge k touches when t points along it. The cones are convex: on a straight
line in t inside one closed cone the same vertex stays lowest. Poses in contact pivot in place: the touching vertices
stay where they are at rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planners.errors import LiftwrightError
from planners.geometry.polygon import area, side_directions
from planners.geometry.polyhedron import ConvexPrism, Element, ElementKind
from planners.geometry.pose import Array, Transform
from planners.manipulation.contacts.contact_states import (
    ENVIRONMENT_FACE,
    NO_CONTACT,
    ContactStateGraph,
    PrincipalContact,
    contact_state_graph,
    restraint,
)

_FLAT = 1e-9
"""Largest tilt of a plate at rest [rad]."""
_SAME_HEIGHT = 1e-9
"""Clearances that differ by less are equal [m]."""
_LENGTH_STEPS = 32
"""Chords, at least, by which the length of a motion is measured."""


@dataclass(frozen=True)
class ContactSampling:
    """How densely contact states are sampled and how far apart joined poses may be.

    The defaults give a rectangle the 151 poses of paper B, Table III; the paper publishes none of them. A denser
    sampling contains the poses of every sampling whose densities divide its own.
    """

    edge_tilts: tuple[float, float, int] = (math.radians(4.0), math.radians(40.0), 10)
    """Smallest and largest tilt [rad] about an edge, and how many."""
    vertex_tilts: tuple[float, float, int] = (math.radians(6.0), math.radians(30.0), 5)
    """Smallest and largest tilt [rad] on a vertex, and how many."""
    vertex_azimuths: int = 3
    """Tilt directions, evenly inside the cone of a vertex."""
    lifted_tilts: tuple[float, float, int] = (math.radians(10.0), math.radians(30.0), 3)
    """Smallest and largest tilt [rad] off the environment, and how many; level is sampled too."""
    lifted_azimuths: int = 8
    """Tilt directions off the environment, evenly around from the plate's x axis."""
    goal_height: float = 0.03
    """Clearance of the lowest vertex that a plate must reach off the environment [m]: one layer of poses has it."""
    first_layer: float = 0.03
    """Clearance of the lowest layer off the environment, where the goal is higher [m]."""
    lifted_step: float = 0.05
    """Clearance of one more layer above the goal [m]."""
    com_threshold_per_size: float = 0.15
    """Poses are joined below this displacement of the centre of mass, per square root of the plate's area [m/m]."""
    rotation_threshold: float = math.radians(17.0)
    """Poses are joined below this angle of rotation [rad]."""
    tilt_density: int = 1
    """How many steps each step between two tilts is cut into."""
    azimuth_density: int = 1
    """How many steps each step between two azimuths is cut into."""

    def __post_init__(self) -> None:
        ranges = (self.edge_tilts, self.vertex_tilts, self.lifted_tilts)
        if any(not (0.0 < low <= high < math.pi / 2 and count >= 1) for low, high, count in ranges):
            raise LiftwrightError("tilts lie between 0 and 90 degrees, smallest first, and there is at least one")
        if min(self.vertex_azimuths, self.lifted_azimuths, self.tilt_density, self.azimuth_density) < 1:
            raise LiftwrightError("numbers of azimuths and densities are at least 1")
        lengths = (self.goal_height, self.first_layer, self.lifted_step, self.com_threshold_per_size)
        if min(*lengths, self.rotation_threshold) <= 0.0:
            raise LiftwrightError("heights and thresholds are positive")

    def scaled(self, density: float) -> ContactSampling:
        """Return a sampling with about `density` times as many poses: more tilts in contact, more azimuths without."""

        def times(spread: tuple[float, float, int]) -> tuple[float, float, int]:
            return (*spread[:2], max(1, round(spread[2] * density)))

        return replace(
            self,
            edge_tilts=times(self.edge_tilts),
            vertex_tilts=times(self.vertex_tilts),
            lifted_azimuths=max(1, round(self.lifted_azimuths * density)),
        )

    def tilts(self, spread: tuple[float, float, int]) -> Array:
        """Return the tilts (m,) of one of the spreads above at this density [rad]."""
        low, high, count = spread
        return np.linspace(low, high, (count - 1) * self.tilt_density + 1)

    def cone_fractions(self) -> Array:
        """Return the vertex azimuths (m,) as fractions [1] of the vertex's cone, its two edges excluded."""
        steps = (self.vertex_azimuths + 1) * self.azimuth_density
        return np.arange(1, steps) / steps

    def lifted_directions(self) -> Array:
        """Return the azimuths (m,) off the environment, from the plate's x axis at rest [rad]."""
        count = self.lifted_azimuths * self.azimuth_density
        return 2.0 * np.pi * np.arange(count) / count


@dataclass(frozen=True, eq=False)
class PlatePose:
    """One sample of a contact state."""

    contact: PrincipalContact
    tilt: Array
    """(2,) horizontal rotation vector from the pose at rest, world axes [rad]."""
    clearance: float
    """Height of the lowest vertex above the support [m]; 0 in contact."""
    T_world_plate: Transform
    contact_points: Array
    """(k, 3) touching vertices in the plate's frame [m]."""
    restraint: int
    """Rank of the environment's contacts, paper B, eq. (8): face 3, edge 2, vertex 1, none 0."""


@dataclass(frozen=True, eq=False)
class RestingPlate:
    """A plate that lies flat: what its poses are measured from.

    Raises:
        LiftwrightError: if the pose is not flat within 1e-9 rad (`settled` makes it so).
    """

    shape: ConvexPrism
    com: Array
    """(3,) centre of mass in the plate's frame [m]."""
    T_world_plate: Transform
    """The pose at rest; top face up."""

    def __post_init__(self) -> None:
        tilted = np.abs(self.T_world_plate[:3, 2] - [0.0, 0.0, 1.0])
        if np.max(tilted) > _FLAT:
            raise LiftwrightError("the plate at rest is not flat; take its pose from `settled`")

    @property
    def support_height(self) -> float:
        """World z of the surface the plate lies on [m]."""
        return float(self.T_world_plate[2, 3]) - 0.5 * self.shape.height

    @cached_property
    def edge_directions(self) -> Array:
        """(n, 2) world directions of the bottom edges, counter-clockwise: the tilts at which they touch."""
        return side_directions(self.shape.outline) @ self.T_world_plate[:2, :2].T

    def rotations(self, tilts: Array) -> Array:
        """Return R_world_plate (m, 3, 3) for tilts (m, 2)."""
        return _tilt_rotations(tilts) @ self.T_world_plate[:3, :3]

    def pivoted(self, tilts: Array, vertex: int) -> Array:
        """Return T_world_plate (m, 4, 4) at tilts (m, 2) about a bottom vertex that stays in its place at rest."""
        R = self.rotations(tilts)
        corner = self.shape.bottom_vertices[vertex]
        p_world_corner = self.T_world_plate[:3, :3] @ corner + self.T_world_plate[:3, 3]
        return _transforms(R, p_world_corner - R @ corner)

    def raised(self, tilts: Array, clearances: Array, com_xy: Array) -> Array:
        """Return T_world_plate (m, 4, 4) at tilts (m, 2) with the lowest vertex and the centre of mass placed.

        Args:
            tilts: (m, 2) [rad].
            clearances: (m,) height of the lowest vertex above the support [m].
            com_xy: (m, 2) horizontal world position of the centre of mass [m].
        """
        R = self.rotations(tilts)
        lowest = np.min(R[:, 2, :] @ self.shape.bottom_vertices.T, axis=1)
        position = np.empty((len(R), 3))
        position[:, :2] = com_xy - (R @ self.com)[:, :2]
        position[:, 2] = self.support_height + clearances - lowest
        return _transforms(R, position)

    def com_world(self, T_world_plate: Array) -> Array:
        """Return the centre of mass (..., 3) in the world at poses (..., 4, 4) [m]."""
        return T_world_plate[..., :3, :3] @ self.com + T_world_plate[..., :3, 3]


@dataclass(frozen=True)
class MotionLength:
    """How far a plate moves."""

    rotation: float
    """Angle swept [rad]."""
    com_travel: float
    """Way of the centre of mass [m]."""


@dataclass(frozen=True, eq=False)
class PlateMotion:
    """The straight motion between two poses whose contacts are equal or related, over s in [0, 1].

    The tilt is interpolated linearly. In contact the common touching vertices stay in place. Without contact the
    clearance of the lowest vertex and the horizontal place of the centre of mass are interpolated linearly too.
    """

    plate: RestingPlate
    start: PlatePose
    end: PlatePose
    contact: PrincipalContact
    """What touches strictly between the ends: the weaker of their contacts."""
    contact_points: Array
    """(k, 3) vertices that touch all along, in the plate's frame [m]."""

    def poses(self, parameters: Sequence[float] | Array) -> Array:
        """Return T_world_plate (m, 4, 4) at the parameters (m,)."""
        s = np.asarray(parameters, dtype=float)
        tilts = _between(self.start.tilt, self.end.tilt, s)
        if self.contact != NO_CONTACT:
            return self.plate.pivoted(tilts, self._pivot)
        clearances = _between(np.array([self.start.clearance]), np.array([self.end.clearance]), s)[:, 0]
        com_xy = _between(self._com_xy(self.start), self._com_xy(self.end), s)
        return self.plate.raised(tilts, clearances, com_xy)

    def pose(self, s: float) -> Transform:
        """Return T_world_plate (4, 4) at s, 0 to 1 of the motion."""
        return self.poses([s])[0]

    @cached_property
    def length(self) -> MotionLength:
        """The angle swept and the way of the centre of mass, by chords."""
        T = self.poses(np.union1d(np.linspace(0.0, 1.0, _LENGTH_STEPS + 1), self.breaks))
        chords = np.diff(self.plate.com_world(T), axis=0)
        turns = _rotation_angles(T[:-1, :3, :3], T[1:, :3, :3])
        return MotionLength(float(np.sum(turns)), float(np.sum(np.linalg.norm(chords, axis=1))))

    @cached_property
    def breaks(self) -> Array:
        """Parameters (m,) strictly inside (0, 1) at which another vertex becomes lowest: the velocity jumps there.

        Only motions without contact have any.
        """
        if self.contact != NO_CONTACT:
            return np.empty(0)
        a, step = self.start.tilt, self.end.tilt - self.start.tilt
        # The tilt crosses the ray of an edge direction e where cross(a + s step, e) = 0 and dot(..., e) >= 0.
        directions = self.plate.edge_directions
        rates = step[0] * directions[:, 1] - step[1] * directions[:, 0]
        offsets = a[0] * directions[:, 1] - a[1] * directions[:, 0]
        crossed = np.abs(rates) > _FLAT
        s = -offsets[crossed] / rates[crossed]
        along = np.sum(_between(a, self.end.tilt, s) * directions[crossed], axis=1)
        inside = s[(along >= -_FLAT) & (s > _FLAT) & (s < 1.0 - _FLAT)]
        # Lines through the flat pose meet several rays there; they are one break.
        return np.array(sorted({round(float(value), 9) for value in inside}))

    @property
    def _pivot(self) -> int:
        element = self.contact.plate
        if element is None:
            raise LiftwrightError("a motion without contact pivots about nothing")
        return min(self.plate.shape.polyhedron.vertex_indices(element))

    def _com_xy(self, pose: PlatePose) -> Array:
        """Return the centre of mass (2,) at a pose, seen from above [m, world]."""
        return self.plate.com_world(pose.T_world_plate)[:2]


@dataclass(frozen=True, eq=False)
class DenseContactStateGraph:
    """Poses sampled from every contact state, joined where the straight motion between them is short and possible."""

    plate: RestingPlate
    sampling: ContactSampling
    contacts: ContactStateGraph
    poses: tuple[PlatePose, ...]
    """The flat pose first, then edges, vertices and no contact."""
    edges: NDArray[np.int64]
    """(E, 2) pose numbers i < j, sorted."""

    @staticmethod
    def build(
        shape: ConvexPrism,
        com: Sequence[float] | Array,
        T_world_plate: Transform,
        sampling: ContactSampling | None = None,
    ) -> DenseContactStateGraph:
        """Sample the contact states of a plate that lies flat and join the samples.

        Args:
            shape: the plate.
            com: (3,) centre of mass in the plate's frame [m].
            T_world_plate: the pose at rest, exactly flat (see `settled`).
            sampling: densities and thresholds.

        Raises:
            LiftwrightError: if the pose at rest is not flat.
        """
        sampling = sampling or ContactSampling()
        plate = RestingPlate(shape, np.array(com, dtype=float), np.array(T_world_plate, dtype=float))
        contacts = contact_state_graph(shape)
        poses = tuple(pose for contact in contacts.contacts for pose in _samples(plate, contact, sampling))
        return DenseContactStateGraph(
            plate, sampling, contacts, poses, _edges(plate, contacts, poses, _thresholds(shape, sampling))
        )

    @property
    def flat(self) -> int:
        """The number of the pose at rest."""
        return 0

    @cached_property
    def lifted(self) -> tuple[int, ...]:
        """The numbers of the poses without contact."""
        return tuple(index for index, pose in enumerate(self.poses) if pose.contact == NO_CONTACT)

    @cached_property
    def goals(self) -> tuple[int, ...]:
        """The numbers of the poses without contact that are as high as the goal."""
        poses, height = self.poses, self.sampling.goal_height - _SAME_HEIGHT
        return tuple(index for index in self.lifted if poses[index].clearance >= height)

    @cached_property
    def neighbours(self) -> tuple[NDArray[np.int64], ...]:
        """(poses,) of (k,) sorted numbers of the poses that each pose is joined to."""
        both = np.vstack([self.edges, self.edges[:, ::-1]])
        both = both[np.lexsort((both[:, 1], both[:, 0]))]
        starts = np.searchsorted(both[:, 0], np.arange(1, len(self.poses)))
        return tuple(np.split(both[:, 1], starts))

    def travel(self, edge: int) -> float:
        """Return the largest distance between the places of any one corner of the plate at the ends of an edge [m]."""
        return float(self._travels[edge])

    @cached_property
    def _travels(self) -> Array:
        """(edges,) `travel` of every edge [m]."""
        T = np.array([pose.T_world_plate for pose in self.poses])
        corners = self.plate.shape.polyhedron.vertices @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
        ways = corners[self.edges[:, 0]] - corners[self.edges[:, 1]]
        return np.max(np.linalg.norm(ways, axis=2), axis=1)

    def motion_between(self, i: int, j: int) -> PlateMotion:
        """Return the straight motion from pose i to pose j; they need not be joined, only related.

        Raises:
            LiftwrightError: if neither contact includes the other, so that no straight motion keeps a contact.
        """
        start, end = self.poses[i], self.poses[j]
        if not self.contacts.related(start.contact, end.contact):
            raise LiftwrightError(
                f"no straight motion joins a pose on {start.contact.element} {start.contact.index} "
                f"to one on {end.contact.element} {end.contact.index}"
            )
        contact = self.contacts.weaker(start.contact, end.contact)
        points = start.contact_points if contact == start.contact else end.contact_points
        return PlateMotion(self.plate, start, end, contact, points)


def _samples(plate: RestingPlate, contact: PrincipalContact, sampling: ContactSampling) -> list[PlatePose]:
    """Sample one contact state."""
    element = contact.plate
    if element is None:
        return _lifted_samples(plate, sampling)
    match element.kind:
        case ElementKind.FACE:
            tilts = np.zeros((1, 2))
        case ElementKind.EDGE:
            tilts = sampling.tilts(sampling.edge_tilts)[:, None] * plate.edge_directions[element.index]
        case ElementKind.VERTEX:
            tilts = _cone_tilts(plate, element.index, sampling)
    return _contact_samples(plate, element, tilts)


def _layers(shape: ConvexPrism, sampling: ContactSampling) -> list[float]:
    """Return the clearances of the poses off the environment: near enough to be joined, and one above the goal."""
    joined = _thresholds(shape, sampling)[0]
    step, first = 0.8 * joined, min(sampling.first_layer, sampling.goal_height)
    if first >= joined:
        # Of a small plate, that layer is out of reach of all poses in contact.
        first = step
    count = math.ceil((sampling.goal_height - first) / step)
    layers = np.linspace(first, sampling.goal_height, count + 1).tolist()
    return [*layers, sampling.goal_height + sampling.lifted_step]


def _contact_samples(plate: RestingPlate, element: Element, tilts: Array) -> list[PlatePose]:
    """Sample the contact of an element of the plate at tilts (m, 2), see `RestingPlate.pivoted`."""
    contact = PrincipalContact(element, ENVIRONMENT_FACE)
    vertices = sorted(plate.shape.polyhedron.vertex_indices(element))
    points = plate.shape.bottom_vertices[vertices]
    if element.kind is ElementKind.FACE:
        transforms = plate.T_world_plate[None]
    else:
        transforms = plate.pivoted(tilts, vertices[0])
    # Touching vertices stay where they are at rest, so one pose tells the restraint of all.
    r_world = (points - plate.com) @ transforms[0, :3, :3].T
    rank = restraint(r_world, np.tile([0.0, 0.0, 1.0], (len(points), 1)))
    return [PlatePose(contact, tilt, 0.0, T, points, rank) for tilt, T in zip(tilts, transforms, strict=True)]


def _cone_tilts(plate: RestingPlate, vertex: int, sampling: ContactSampling) -> Array:
    """Return tilts (m, 2) inside the cone between the two edges that meet at a bottom vertex."""
    into, out_of = plate.edge_directions[vertex - 1], plate.edge_directions[vertex]
    opening = math.atan2(into[0] * out_of[1] - into[1] * out_of[0], float(into @ out_of))
    azimuths = math.atan2(into[1], into[0]) + opening * sampling.cone_fractions()
    return _polar(sampling.tilts(sampling.vertex_tilts), azimuths)


def _lifted_samples(plate: RestingPlate, sampling: ContactSampling) -> list[PlatePose]:
    """Sample no contact: layers of clearance, each level and tilted all around, above the place at rest."""
    x_axis = plate.T_world_plate[:2, 0]
    azimuths = math.atan2(x_axis[1], x_axis[0]) + sampling.lifted_directions()
    tilts = np.vstack([np.zeros((1, 2)), _polar(sampling.tilts(sampling.lifted_tilts), azimuths)])
    com_xy = np.tile(plate.com_world(plate.T_world_plate)[:2], (len(tilts), 1))
    samples: list[PlatePose] = []
    for clearance in _layers(plate.shape, sampling):
        transforms = plate.raised(tilts, np.full(len(tilts), clearance), com_xy)
        samples += [
            PlatePose(NO_CONTACT, tilt, clearance, T, np.empty((0, 3)), 0)
            for tilt, T in zip(tilts, transforms, strict=True)
        ]
    return samples


def _polar(radii: Array, azimuths: Array) -> Array:
    """Return (r · a, 2) vectors of every radius (r,) at every azimuth (a,) [rad], in the unit of the radii."""
    directions = np.column_stack([np.cos(azimuths), np.sin(azimuths)])
    return (radii[:, None, None] * directions[None, :, :]).reshape(-1, 2)


def _thresholds(shape: ConvexPrism, sampling: ContactSampling) -> tuple[float, float]:
    """Return the largest displacement of the centre of mass [m] and the largest rotation [rad] of an edge."""
    return sampling.com_threshold_per_size * math.sqrt(area(shape.outline)), sampling.rotation_threshold


def _edges(
    plate: RestingPlate, contacts: ContactStateGraph, poses: tuple[PlatePose, ...], thresholds: tuple[float, float]
) -> NDArray[np.int64]:
    """Return the pairs (edges, 2) of poses of equal or related contacts that are closer than both `_thresholds`."""
    T = np.array([pose.T_world_plate for pose in poses])
    com = plate.com_world(T)
    number = {contact: index for index, contact in enumerate(contacts.contacts)}
    state = np.array([number[pose.contact] for pose in poses])
    related = np.array([[contacts.related(a, b) for b in contacts.contacts] for a in contacts.contacts])
    found: list[NDArray[np.int64]] = []
    for i in range(len(poses) - 1):
        later = np.arange(i + 1, len(poses))
        later = later[related[state[i], state[later]]]
        later = later[np.linalg.norm(com[later] - com[i], axis=1) < thresholds[0]]
        later = later[_rotation_angles(T[i : i + 1, :3, :3], T[later, :3, :3]) < thresholds[1]]
        found.append(np.column_stack([np.full(len(later), i), later]))
    return np.vstack(found).astype(np.int64)


def _between(a: Array, b: Array, s: Array) -> Array:
    """Interpolate from a (d,) to b (d,) at s (m,): (m, d), exact at both ends."""
    return np.outer(1.0 - s, a) + np.outer(s, b)


def _tilt_rotations(tilts: Array) -> Array:
    """Return exp([t, 0]) (m, 3, 3) for tilts (m, 2): Rodrigues' formula for a horizontal axis."""
    angle = np.linalg.norm(tilts, axis=1)
    axis = tilts / np.where(angle > 0.0, angle, 1.0)[:, None]
    x, y = axis[:, 0], axis[:, 1]
    sine, versine = np.sin(angle), 1.0 - np.cos(angle)
    R = np.empty((len(tilts), 3, 3))
    R[:, 0, 0], R[:, 1, 1], R[:, 2, 2] = 1.0 - versine * y * y, 1.0 - versine * x * x, 1.0 - versine
    R[:, 0, 1] = R[:, 1, 0] = versine * x * y
    R[:, 0, 2], R[:, 2, 0] = sine * y, -sine * y
    R[:, 1, 2], R[:, 2, 1] = -sine * x, sine * x
    return R


def _transforms(rotations: Array, positions: Array) -> Array:
    """Stack (m, 3, 3) rotations and (m, 3) positions into (m, 4, 4) transforms."""
    T = np.zeros((len(rotations), 4, 4))
    T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = rotations, positions, 1.0
    return T


def _rotation_angles(R_a: Array, R_b: Array) -> Array:
    """Return the angles (m,) between orientations (m, 3, 3) [rad], from their chord: accurate when small."""
    chord = np.linalg.norm((R_a - R_b).reshape(-1, 9), axis=1)
    return 2.0 * np.arcsin(np.minimum(1.0, chord / math.sqrt(8.0)))
