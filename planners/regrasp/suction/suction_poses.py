"""Suction poses: where a cup can sit on an object (paper A, IV-A).

Samples on the object's facets are kept where the whole pad seals and the cup alone holds the object's weight. They are
thinned out, turned about the normal, and ordered: the middle of the facet on top first, then by how well they hold.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from planners.errors import LiftwrightError
from planners.geometry import surface
from planners.geometry.facets import Facet, FacetSettings, Indices, find_facets
from planners.geometry.pose import Array, Transform, rotation_z
from planners.graph.rejections import Rejection, Rejections
from planners.regrasp.suction.pad_seal import Pad, PadFit, PadSurface, facet_grid, narrow_places
from planners.regrasp.suction.suction_hold import CupStrength, cup_wrenches, least_margin, suction_margin, weight
from planners.scene.moved_object import side_of
from planners.scene.solid import Surface

STAGE = "suction"
"""Under which suction poses are counted among the rejections."""
_MEASURED = 6
"""So many flat places are measured where all are too small: the largest ones."""
_ROUNDING = 1e-9
"""Lengths within it are equal [m]."""
_DIGITS = 6
"""Lengths are compared to the micrometre: rounding does not decide what comes first."""


class SuctionFault(StrEnum):
    """Why a cup cannot sit at a place; the value is the sentence for a person."""

    NOT_CLOSED = "The object's surface is not closed, or inside out."
    NO_FACET = "No flat place of the object is as large as the pad."
    BORDER = "The pad would reach over the border of the flat place."
    CURVED = "The surface under the pad is not flat enough to seal."
    DOWN = "The flat place looks down at the start or at the goal, and the cup cannot push the object up."
    WEAK = "The cup alone cannot hold the object's weight there."
    COVERED = "Another part of the object is where the pad would be."


@dataclass(frozen=True)
class SuctionSettings:
    """Which suction poses are generated."""

    facets: FacetSettings = field(default_factory=FacetSettings)
    border: float = 0.007
    """Least distance of a pad's centre from the border of its facet [m]; the authors' value."""
    rim: float = 0.001
    """Least distance of the pad's rim from the border [m]; our choice: what planning may be off."""
    flatness: float = 0.0005
    """Most distance of the surface under the pad from the pad's plane [m]; our choice: soft lips follow more."""
    stand_off: float = 0.003
    """Height above the pad in which nothing else of the object is [m]; the authors' value for the whole tool."""
    spacing: float = 0.003
    """Of samples on a facet [m]; the size of the authors' clusters."""
    finest: float = 0.0002
    """Of samples on a flat facet where no other sample seals [m]; our choice."""
    most_samples: int = 8000
    """On all facets together; larger objects are sampled more coarsely."""
    cluster: float = 0.015
    """Poses nearer than this on one facet count as one [m]; our choice: half a pad."""
    same_normal: float = math.radians(15.0)
    """Normals nearer than this are of one cluster [rad]; as for facets."""
    rolls: int = 8
    """Turns of the tool about the normal, evenly around; the authors' value."""
    margin_step: float = 0.02
    """Margins of the hold that differ by less are equal, and the centre of mass decides; our choice."""
    top_tilt: float = math.radians(15.0)
    """Largest angle between the normal of a facet on top and the vertical [rad]; as for facets."""

    def __post_init__(self) -> None:
        lengths = (self.flatness, self.stand_off, self.spacing, self.finest, self.cluster)
        if min(lengths) <= 0.0 or min(self.border, self.rim) < 0.0 or min(self.rolls, self.most_samples) < 1:
            raise LiftwrightError("suction poses have positive lengths, samples and rolls")

    def clearance(self, cup: CupStrength) -> float:
        """Return the least distance of the cup's centre from the border of a facet [m]."""
        return max(self.border, cup.radius + self.rim)


DEFAULT_SUCTION = SuctionSettings()


@dataclass(frozen=True, eq=False)
class SuctionLoad:
    """What hangs on the cup, and how it stands."""

    mass: float
    """[kg]"""
    com: Array
    """(3,) in the object's frame [m]."""
    T_world_start: Transform
    """The object's pose at the start."""
    gravity: Array
    """(3,) of the cell, in the world [m/s^2]."""
    T_world_goals: Array | None = None
    """(k, 4, 4) alternative poses at the end, of which one must do; None: any."""

    def margins(self, points: Array, normals: Array, cup: CupStrength) -> Array:
        """Return the margin at the start, or at the best goal where that is worse: (n,).

        Args:
            points: (n, 3) centres of the lip, in the object's frame [m].
            normals: (n, 3) outward.
            cup: what holds; how it is turned about the normal does not matter.
        """
        T_object_tools = _frames(points, normals, np.eye(3)[np.argmin(np.abs(normals), axis=1)])
        start = self._margins_at(self.T_world_start, T_object_tools, cup)
        if self.T_world_goals is None:
            return start
        goals = self._margins_at(self.T_world_goals[:, None], T_object_tools, cup)
        return np.minimum(start, goals.max(axis=0))

    def figures(self, point: Array, normal: Array, cup: CupStrength) -> tuple[float, float, str]:
        """Return what is asked of a cup at one place (3,), what it has and the unit, where `margins` has its margin."""
        (T_object_tool,) = _frames(point[None], normal[None], np.eye(3)[[np.argmin(np.abs(normal))]])
        poses = [self.T_world_start]
        if self.T_world_goals is not None:
            poses.append(max(self.T_world_goals, key=lambda T: float(self._margins_at(T, T_object_tool, cup))))
        wrenches = cup_wrenches(weight(self.mass, self.gravity), np.array(poses), self.com, T_object_tool)
        return least_margin(wrenches, cup).figures

    @property
    def side(self) -> float:
        """1 to the robot's left, -1 to its right, see `side_of`."""
        goals = np.empty((0, 4, 4)) if self.T_world_goals is None else self.T_world_goals
        return side_of(np.vstack([self.T_world_start[None], goals]), self.com)

    def mirrored(self, vectors: Array) -> Array:
        """Return vectors (n, 3) of the object's frame in the world at the start, y away from the robot's middle.

        Those of an object and of its mirror image to the robot's other side are the same.
        """
        return np.round(vectors @ self.T_world_start[:3, :3].T * [1.0, self.side, 1.0], _DIGITS)

    def looks_down(self, normals: Array) -> NDArray[np.bool_]:
        """Return whether a pad with one of these outward normals (n, 3) looks down at the start or at all goals."""
        upward = normals @ self.T_world_start[2, :3]
        if self.T_world_goals is not None:
            upward = np.minimum(upward, (normals @ self.T_world_goals[:, 2, :3].T).max(axis=1))
        return upward < -_ROUNDING

    def _margins_at(self, T_world_objects: Array, T_object_tools: Array, cup: CupStrength) -> Array:
        return suction_margin(
            cup_wrenches(weight(self.mass, self.gravity), T_world_objects, self.com, T_object_tools), cup
        )


@dataclass(frozen=True, eq=False)
class SuctionPose:
    """A place of the cup on the object, and a turn of the tool about it."""

    T_object_tool: Transform
    """Origin in the centre of the lip, on the surface; z along the outward normal."""
    facet: int
    """Number of the facet."""
    roll: int
    """Number of the turn about the normal; 0 has the tool's x along the longest side of the facet."""
    central: bool
    """Whether it is the place on its facet that is nearest to the facet's centroid."""
    margin: float
    """Of the cup under the object's weight, see `suction_hold.suction_margin`."""


@dataclass(frozen=True, eq=False)
class SuctionCandidate:
    """A place that was considered."""

    point: Array
    """(3,) in the object's frame [m]."""
    normal: Array
    """(3,) unit, outward."""
    reason: SuctionFault | None
    """None: it is among the poses."""


@dataclass(frozen=True, eq=False)
class SuctionPoses:
    """All suction poses of an object in the order in which they are to be tried, and what was considered."""

    poses: tuple[SuctionPose, ...]
    facets: tuple[Facet, ...]
    candidates: tuple[SuctionCandidate, ...]
    """The places of the poses, and of those rejected an even choice."""
    rejections: Rejections


def suction_poses(
    surface_of_object: Surface, load: SuctionLoad, cup: CupStrength, settings: SuctionSettings = DEFAULT_SUCTION
) -> SuctionPoses:
    """Find the suction poses of an object.

    The object's own shape is all that is looked at: hands, the tool above its lip and other bodies are not.

    Args:
        surface_of_object: closed and outward, in the object's frame; several shells may overlap.
        load: the object's mass and how it stands.
        cup: of the tool.
        settings: which poses.
    """
    vertices, faces = surface_of_object
    rejections = Rejections()
    if not is_closed_and_outward(vertices, faces):
        rejections.add(Rejection(STAGE, SuctionFault.NOT_CLOSED))
        return SuctionPoses((), (), (), rejections)
    pads = PadSurface(np.ascontiguousarray(vertices, dtype=float), np.ascontiguousarray(faces, dtype=np.int64))
    growth = replace(settings.facets, least_area=max(settings.facets.least_area, math.pi * cup.radius**2))
    facets = find_facets(pads.vertices, pads.faces, growth)
    if not facets:
        rejections.add(_no_facet(pads, load, cup, settings))
        return SuctionPoses((), (), (), rejections)
    sampler = _Sampler(pads, load, cup, settings, _spacing(facets, settings))
    considered = [sampler.consider(number, facet) for number, facet in enumerate(facets)]
    for places in considered:
        places.count(settings, load, cup, rejections)
    kept = _Places.joined([places.only(places.kept) for places in considered])
    chosen = _thinned(kept, _preference(kept, facets, load, settings), settings)
    best = chosen.only(_preference(chosen, facets, load, settings))
    rejected = _Places.joined([places.only(~places.kept & places.coarse) for places in considered])
    candidates = (*best.candidates(), *rejected.candidates())
    return SuctionPoses(tuple(best.poses(facets, load, settings.rolls)), facets, candidates, rejections)


def _no_facet(pads: PadSurface, load: SuctionLoad, cup: CupStrength, settings: SuctionSettings) -> Rejection:
    """Say how large a flat place has to be across, and how large the roomiest of the largest ones is [m]."""
    facets = find_facets(pads.vertices, pads.faces, settings.facets)[:_MEASURED]
    sampler = _Sampler(pads, load, cup, settings, settings.spacing)
    clearances = [sampler.consider(number, facet).clearances for number, facet in enumerate(facets)]
    roomiest = max((float(each.max()) for each in clearances if len(each)), default=0.0)
    needed = settings.clearance(cup)
    return Rejection.measured(STAGE, SuctionFault.NO_FACET, "", 2.0 * needed, 2.0 * roomiest, "m")


def is_closed_and_outward(vertices: Array, faces: Indices) -> bool:
    """Whether triangles enclose a volume: every side has as many triangles on its left as on its right."""
    if len(faces) == 0 or not np.all(np.isfinite(vertices)) or faces.min() < 0 or faces.max() >= len(vertices):
        return False
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = np.minimum(tails, heads) * len(vertices) + np.maximum(tails, heads)
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.concatenate([[True], np.diff(key[order]) > 0]))
    balance = np.add.reduceat(np.sign(heads - tails)[order], first)
    return not np.any(balance) and surface.volume(vertices, faces) > 0.0


@dataclass(frozen=True, eq=False)
class _Places:
    """Places of the cup on an object, row by row."""

    facet: Indices
    """(n,)"""
    points: Array
    """(n, 3) in the object's frame [m]."""
    normals: Array
    """(n, 3)"""
    faults: Indices
    """(n,) numbers of `_FAULTS`, or -1."""
    clearances: Array
    """(n,) of the centres from the border [m]."""
    deviations: Array
    """(n,) of the surface from the pads' planes [m]."""
    margins: Array
    """(n,) of the cup under the weight."""
    central: NDArray[np.bool_]
    """(n,) whether it is the kept place nearest to the facet's centroid."""
    coarse: NDArray[np.bool_]
    """(n,) an even choice of about one in a cluster."""

    @property
    def kept(self) -> NDArray[np.bool_]:
        """(n,) whether nothing is wrong with a place."""
        return self.faults < 0

    @staticmethod
    def joined(parts: Sequence[_Places]) -> _Places:
        columns = (np.concatenate([getattr(part, column.name) for part in parts]) for column in fields(_Places))
        return _Places(*columns)

    def only(self, rows: Indices | NDArray[np.bool_]) -> _Places:
        return _Places(*(getattr(self, column.name)[rows] for column in fields(_Places)))

    def count(self, settings: SuctionSettings, load: SuctionLoad, cup: CupStrength, rejections: Rejections) -> None:
        """Add the rejected places, each kind with the figures of the best one: that is the one that decides."""

        def rejected(fault: SuctionFault, best: int) -> Rejection:
            if fault is SuctionFault.BORDER:
                needed = settings.clearance(cup)
                return Rejection.measured(STAGE, fault, "", needed, float(self.clearances[best]), "m")
            if fault is SuctionFault.CURVED:
                return Rejection.measured(STAGE, fault, "", float(self.deviations[best]), settings.flatness, "m")
            if fault is SuctionFault.WEAK:
                return Rejection.measured(STAGE, fault, "", *load.figures(self.points[best], self.normals[best], cup))
            return Rejection(STAGE, fault)

        goodness = {SuctionFault.BORDER: self.clearances, SuctionFault.CURVED: -self.deviations}
        for number, fault in enumerate(_FAULTS):
            rows = np.flatnonzero(self.faults == number)
            if len(rows):
                best = rows[np.argmax(goodness.get(fault, self.margins)[rows])]
                rejections.add(rejected(fault, int(best)), len(rows))

    def candidates(self) -> Iterator[SuctionCandidate]:
        for point, normal, fault in zip(self.points, self.normals, self.faults, strict=True):
            yield SuctionCandidate(point, normal, None if fault < 0 else _FAULTS[fault])

    def poses(self, facets: Sequence[Facet], load: SuctionLoad, rolls: int) -> Iterator[SuctionPose]:
        """Turn the tool at every place, a place after the other.

        First with its x along the longest side of the facet, that way which points forward; then on and on, the other
        way round on the robot's other side.
        """
        along = np.array([facet.T_body_facet[:3, 0] for facet in facets])[self.facet]
        turns = np.array([rotation_z(2.0 * math.pi * roll / rolls) for roll in range(rolls)])
        tools = np.repeat(_frames(self.points, self.normals, along)[:, None], rolls, axis=1)
        tools[:, :, :3, :3] = tools[:, :, :3, :3] @ turns
        rows = zip(tools, self.facet.tolist(), self.central.tolist(), self.margins.tolist(), strict=True)
        ways = np.array([0, rolls // 2] if rolls % 2 == 0 else [0])
        for turned, number, central, margin in rows:
            x, y, z = load.mirrored(turned[ways, :3, 0]).T
            first = ways[np.lexsort((-z, y, -x))[0]]
            for k in range(rolls):
                roll = int(first + load.side * k) % rolls
                yield SuctionPose(turned[roll], number, roll, central, margin)


_FAULTS = (SuctionFault.BORDER, SuctionFault.CURVED, SuctionFault.DOWN, SuctionFault.WEAK, SuctionFault.COVERED)
_FAULT_OF_FIT = np.full(len(PadFit), -1)
"""Place among `_FAULTS` of each `PadFit`; -1 for a pad that seals."""
_FAULT_OF_FIT[[PadFit.BORDER, PadFit.CURVED]] = 0, 1


@dataclass(frozen=True, eq=False)
class _Sampler:
    """Puts a cup on samples of an object's facets."""

    pads: PadSurface
    load: SuctionLoad
    cup: CupStrength
    settings: SuctionSettings
    spacing: float
    """[m]"""

    def consider(self, number: int, facet: Facet) -> _Places:
        """Put the cup on samples of one facet and say what is wrong with each."""
        grid, coarse = _samples(facet, self.spacing, self.settings)
        fits = self.pads.fit(facet, grid, self._pad)
        if facet.flat and not np.any(fits.fits == PadFit.SEALS):
            narrow = narrow_places(facet, self.spacing, self.settings.finest, self._pad.clearance)
            coarse = np.concatenate([coarse, np.zeros(len(narrow), dtype=bool)])
            fits = self.pads.fit(facet, np.concatenate([grid, narrow]), self._pad)
        on = np.flatnonzero(fits.fits != PadFit.OFF)
        points, normals = fits.points[on], fits.normals[on]
        margins = self.load.margins(points, normals, self.cup)
        faults = self._faults(facet, points, normals, fits.fits[on], margins)
        kept = np.flatnonzero(faults < 0)
        central = np.zeros(len(on), dtype=bool)
        if len(kept):
            away = np.linalg.norm(points[kept] - facet.T_body_facet[:3, 3], axis=1)
            central[kept[np.argmin(np.round(away, _DIGITS))]] = True
        return _Places(
            facet=np.full(len(on), number, dtype=np.int64),
            points=points,
            normals=normals,
            faults=faults,
            clearances=fits.clearances[on],
            deviations=fits.deviations[on],
            margins=margins,
            central=central,
            coarse=coarse[on],
        )

    def _faults(self, facet: Facet, points: Array, normals: Array, fits: Indices, margins: Array) -> Indices:
        """Return the first thing wrong with each place, as in `_Places`, the cheapest question first."""
        faults = _FAULT_OF_FIT[fits]
        weak = (faults < 0) & (margins < 0.0)
        down = self.load.looks_down(normals)
        faults[weak & down] = _FAULTS.index(SuctionFault.DOWN)
        faults[weak & ~down] = _FAULTS.index(SuctionFault.WEAK)
        left = np.flatnonzero(faults < 0)
        covered = self.pads.covered(facet, points[left], normals[left], self._pad)
        faults[left[covered]] = _FAULTS.index(SuctionFault.COVERED)
        return faults

    @property
    def _pad(self) -> Pad:
        settings = self.settings
        return Pad(self.cup.radius, settings.clearance(self.cup), settings.flatness, settings.stand_off)


def _samples(facet: Facet, spacing: float, settings: SuctionSettings) -> tuple[Array, NDArray[np.bool_]]:
    """Return a grid (n, 2) about the facet's centroid, in the facet frame, and an even choice of it (n,)."""
    grid = facet_grid(facet, spacing)
    stride = max(1, round(settings.cluster / spacing))
    return grid.astype(np.float64) * spacing, np.all(grid % stride == 0, axis=1)


def _spacing(facets: Sequence[Facet], settings: SuctionSettings) -> float:
    """Return the spacing of samples at which all facets together have no more of them than they may [m]."""
    area = sum(float(np.prod(high - low)) for low, high in (facet.extent for facet in facets))
    return max(settings.spacing, math.sqrt(area / settings.most_samples))


def _frames(points: Array, normals: Array, hints: Array) -> Array:
    """Return frames (n, 4, 4) at points with z along the normals and x along the hints' part square to them."""
    x = hints - normals * np.einsum("ij,ij->i", hints, normals)[:, None]
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    frames = np.tile(np.eye(4), (len(points), 1, 1))
    frames[:, :3, :3] = np.stack([x, np.cross(normals, x), normals], axis=-1)
    frames[:, :3, 3] = points
    return frames


def _preference(places: _Places, facets: Sequence[Facet], load: SuctionLoad, settings: SuctionSettings) -> Indices:
    """Return the order in which places are to be tried: the middle of the facet on top, then by how well they hold.

    Of those that hold as well, those on an axis of the facet come first, of which none is kept without its mirror image
    for being too close to another; then those nearer to the robot's middle: places on an object and on its mirror image
    come in the same order.
    """
    T = load.T_world_start
    upward = places.normals @ T[2, :3] >= math.cos(settings.top_tilt)
    heights = np.where(upward, places.points @ T[2, :3], -np.inf)
    on_top = np.zeros(len(heights), dtype=bool)
    if upward.any():
        on_top = places.facet == places.facet[np.argmax(np.round(heights, _DIGITS))]
    arms = np.linalg.norm(np.cross(load.com - places.points, places.normals), axis=1)
    margins = np.round(places.margins / settings.margin_step)
    T_body_facets = np.array([facet.T_body_facet for facet in facets])[places.facet]
    in_facet = np.einsum("nji,nj->ni", T_body_facets[:, :3, :2], places.points - T_body_facets[:, :3, 3])
    off_axis = np.round(np.abs(in_facet).min(axis=1), _DIGITS)
    x, y, z = load.mirrored(places.points).T
    return np.lexsort((-z, x, y, off_axis, np.round(arms, _DIGITS), -margins, ~(places.central & on_top)))


def _thinned(places: _Places, order: Indices, settings: SuctionSettings) -> _Places:
    """Keep the best place of each cluster, and the central one of each facet."""
    remaining = np.concatenate([order[places.central[order]], order[~places.central[order]]])
    least_cosine = math.cos(settings.same_normal)
    chosen: list[int] = []
    while len(remaining):
        best = remaining[0]
        chosen.append(int(best))
        near = np.linalg.norm(places.points[remaining] - places.points[best], axis=1) < settings.cluster - _ROUNDING
        remaining = remaining[~(near & (places.normals[remaining] @ places.normals[best] > least_cosine))]
    return places.only(np.array(sorted(chosen), dtype=np.int64))
