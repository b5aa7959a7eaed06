"""From a depth view to the table and its objects (paper A, V.A): top facets, carried down to what they stand on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from planners.contract.scene_document import TABLE
from planners.contract.shapes import Box, Cylinder
from planners.geometry.convex import ConvexShape
from planners.geometry.pose import Array, rotation_z, transform
from planners.perception.depth_view import DepthView
from planners.perception.outline import DiscOutline, Outline, Rectangle, fit_outline
from planners.perception.perceived_object import ObjectUncertainty, PerceivedObject, Unrecognised
from planners.perception.perception_settings import PerceptionSettings
from planners.perception.scan_files import ScanRefused
from planners.perception.seen_points import NOBODY
from planners.perception.table_plane import TablePlane, find_table
from planners.perception.top_facets import (
    EDGE_REACH,
    NOISE_REACH,
    ImageMask,
    Relief,
    TopFacet,
    find_top_facets,
    make_facet,
    pitch_at_table,
)

COARSEST = 0.008
"""With pixels farther apart on the table no edge can be told [m]."""


@dataclass(frozen=True, eq=False)
class KnownPlace:
    """What is known of the place before anybody looks."""

    table_height: float | None = None
    """z of the table's top in the world; None: not known [m]."""
    workspace: Array | None = None
    """(n, 2) convex, counter-clockwise outline, in the world, of where objects may be; None: anywhere [m]."""
    bodies: Sequence[ConvexShape] = ()
    """What is there anyway, in the world: no part of it is an object."""


@dataclass(frozen=True, eq=False)
class SeenTable:
    """A table and what stands on it."""

    plane: TablePlane
    findings: Findings
    view: DepthView
    """As it was looked at."""


def perceive_objects(
    view: DepthView, place: KnownPlace, settings: PerceptionSettings, rng: np.random.Generator
) -> SeenTable:
    """Find the table and the objects on it.

    Raises:
        ScanRefused: There is no table to be seen, or its pixels are too far apart.
    """
    points = view.points()
    plane = find_table(points[np.isfinite(view.depth)], view.eye, place.table_height, settings, rng)
    pitch = pitch_at_table(view, plane)
    if pitch > COARSEST:
        detail = f"the image's pixels are {1e3 * pitch:.1f} mm apart on the table, more than {1e3 * COARSEST:g} mm"
        raise ScanRefused("depth", detail)
    view = view.thinned(max(1, round(settings.pitch / pitch)))
    relief = Relief.of(view, plane, _known(view, place.bodies, settings), settings)
    return SeenTable(plane, find_objects(relief, place.workspace, settings), view)


def _known(view: DepthView, bodies: Sequence[ConvexShape], settings: PerceptionSettings) -> ImageMask:
    """Tell which pixels show bodies that are known."""
    points = view.points()
    known = np.zeros(view.shape, dtype=bool)
    for body in bodies:
        margin = settings.margin_of_known + body.radius
        low, high = body.vertices.min(axis=0) - margin, body.vertices.max(axis=0) + margin
        with np.errstate(invalid="ignore"):
            near = np.argwhere(np.all((points >= low) & (points <= high), axis=2))
        planes = ConvexHull(body.vertices).equations
        seen = points[near[:, 0], near[:, 1]]
        inside = np.all(seen @ planes[:, :3].T + planes[:, 3] <= margin, axis=1)
        known[near[inside, 0], near[inside, 1]] = True
    return known


CUT = "it is cut by the border of the image"
HIDDEN = "too little of its top's edge is seen"
NO_OUTLINE = "its top is neither a rectangle nor a disc"
NOT_UPRIGHT = "its sides do not go straight down from its top"
NO_TOP = "it has no level top"
MOST_PARTS = 20
"""So many tops that something stands on are tried as parts of one another [1]."""
THINNEST = 0.010
"""What is thinner, on whatever it lies, is not told apart from it [m]."""
WIDER = 0.0025
"""A body so much wider than its top's edge is wider [m]: the shoulder of a can."""
WIDEST = 0.018
"""... but no more than this [m]."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A top with the outline that was found for it."""

    facet: TopFacet
    outline: Outline
    bottom: float = 0.0
    """Height, above the table, of what it stands on [m]."""
    carrier: Candidate | None = None
    """What it stands on; None: the table."""
    parts: tuple[TopFacet, ...] = ()
    """What its top was put together from."""


@dataclass(frozen=True, eq=False)
class Findings:
    """What stands on a table."""

    objects: tuple[PerceivedObject, ...]
    unrecognised: tuple[Unrecognised, ...]
    owners: NDArray[np.int16]
    """(h, w) index of the object whose top a pixel shows, else `NOBODY`."""


def find_objects(relief: Relief, workspace: Array | None, settings: PerceptionSettings) -> Findings:
    """Find all boxes and cylinders that stand upright, and what else is there.

    Args:
        relief: the view.
        workspace: (n, 2) convex, counter-clockwise outline, in the world, of where objects may be; None: anywhere.
        settings: what counts as what.
    """
    above = _above(relief, settings) & _inside(relief, workspace)
    facets = [facet for facet in find_top_facets(relief, settings) if above[facet.pixels].any()]
    candidates, reasons = _candidates(facets, relief, settings)
    candidates = [_widened(each, relief, settings) for each in _stacked(candidates)]
    upright: list[Candidate] = []
    for each in candidates:
        others = [other for other in candidates if other is not each]
        if _is_upright(each, others, relief, settings):
            upright.append(each)
        else:
            reasons.append((each.facet, NOT_UPRIGHT))
    standing = [each for each in upright if _stands(each, upright)]
    reasons += [(each.facet, NOT_UPRIGHT) for each in upright if each not in standing]
    objects, owners = _objects(standing, relief, settings)
    rest = _unrecognised(above, standing, reasons, relief, settings)
    return Findings(tuple(objects), tuple(rest), owners)


def _above(relief: Relief, settings: PerceptionSettings) -> ImageMask:
    high = (relief.smooth > settings.lowest_top) & np.isfinite(relief.heights)
    return high & (relief.smooth < settings.highest_top) & ~relief.known


def _inside(relief: Relief, workspace: Array | None) -> ImageMask:
    if workspace is None:
        return np.ones(relief.view.shape, dtype=bool)
    world = relief.view.points()[..., :2]
    inside = np.ones(relief.view.shape, dtype=bool)
    for a, b in zip(workspace, np.roll(workspace, -1, axis=0), strict=True):
        inward = np.array([a[1] - b[1], b[0] - a[0]])
        with np.errstate(invalid="ignore"):
            inside &= (world - a) @ inward >= 0.0
    return inside


def _candidates(
    facets: Sequence[TopFacet], relief: Relief, settings: PerceptionSettings
) -> tuple[list[Candidate], list[tuple[TopFacet, str]]]:
    """Return the candidates that tops make, and why the others make none.

    Something that lies across a top hides its middle: two parts at one height are one top if that makes an outline.
    """
    parts = [facet for facet in facets if facet.beside.any() or facet.hidden.any()][:MOST_PARTS]
    joined: list[Candidate] = []
    for a, b in combinations(parts, 2):
        if any(each in (a, b) for whole in joined for each in whole.parts):
            continue
        whole = _joined(a, b, relief, settings)
        if whole is not None:
            joined.append(whole)
    used = [part for whole in joined for part in whole.parts]
    found = [(facet, _candidate(facet, relief, settings)) for facet in facets if facet not in used]
    single = [each for _, each in found if isinstance(each, Candidate)]
    return [*joined, *single], [(facet, each) for facet, each in found if isinstance(each, str)]


def _joined(a: TopFacet, b: TopFacet, relief: Relief, settings: PerceptionSettings) -> Candidate | None:
    """Return the candidate that two parts of a top make together; None where they make none."""
    if abs(a.height - b.height) > EDGE_REACH * relief.noise:
        return None
    whole = _candidate(make_facet(a.pixels | b.pixels, relief), relief, settings)
    return replace(whole, parts=(a, b)) if isinstance(whole, Candidate) else None


def _candidate(facet: TopFacet, relief: Relief, settings: PerceptionSettings) -> Candidate | str:
    """Return the candidate that a top makes, or why it makes none."""
    if facet.cut:
        return CUT
    outline = fit_outline(facet, settings)
    if outline is None or outline.sides_seen < settings.seen_side:
        return HIDDEN if facet.hidden.mean() > 0.2 else NO_OUTLINE
    if outline.fitting < settings.fitting_edge or _coverage(facet, outline, relief) < settings.coverage:
        return NO_OUTLINE
    return Candidate(facet, _without_sides(facet, outline, relief))


def _coverage(facet: TopFacet, outline: Outline, relief: Relief) -> float:
    """Return the share of an outline that its top fills, or something that hides it."""
    corners = outline.corners(-0.5 * facet.pitch)
    model = _filled(corners, facet.height, relief)
    with np.errstate(invalid="ignore"):
        hiding = relief.heights > facet.height + NOISE_REACH * relief.noise
    count = int(model.sum())
    if count == 0:
        return 0.0
    unmeasured = model & ~np.isfinite(relief.heights) & ~facet.pixels
    if unmeasured.sum() > 0.4 * count:
        return 0.0
    return float((model & (facet.pixels | hiding)).sum() / (count - unmeasured.sum()))


def _filled(corners: Array, height: float, relief: Relief) -> ImageMask:
    """Return the pixels of the polygon (n, 2), in the table's frame, at a height."""
    T = relief.table.T_world_table
    world = np.column_stack([corners, np.full(len(corners), height)]) @ T[:3, :3].T + T[:3, 3]
    rows, columns = relief.view.pixels(world)
    image = np.zeros(relief.view.shape, np.uint8)
    cv2.fillPoly(image, [np.column_stack([columns, rows]).astype(np.int32)], 1)
    return image > 0


def _without_sides(facet: TopFacet, outline: Outline, relief: Relief) -> Outline:
    """Take off what is seen of an object's sides within the noise of its top: the part that looks to the camera."""
    eye = relief.table.in_table(relief.view.eye)
    away = (eye[:2] - outline.center) / max(eye[2] - facet.height, 0.05)
    drop = EDGE_REACH * relief.noise
    if isinstance(outline, DiscOutline):
        reach = drop * float(np.linalg.norm(away))
        center = outline.center - 0.5 * _toward(away, reach)
        return replace(outline, center=center, radius=outline.radius - reach / math.pi)
    center, size = outline.center.copy(), list(outline.size)
    for k in (0, 1):
        axis = outline.axes[:, k]
        lean = float(axis @ away)
        edge = 0.5 * outline.size[k] / max(eye[2] - facet.height, 0.05)
        beyond = max(0.0, abs(lean) - edge) * drop
        size[k] -= beyond
        center -= 0.5 * math.copysign(beyond, lean) * axis
    return replace(outline, center=center, size=(size[0], size[1]))


def _toward(direction: Array, length: float) -> Array:
    norm = float(np.linalg.norm(direction))
    return direction * (length / norm) if norm > 0.0 else np.zeros(2)


def _stacked(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Let every candidate stand on the highest one below it that its centre is over, else on the table."""
    stacked: list[Candidate] = []
    for each in sorted(candidates, key=lambda candidate: candidate.facet.height):
        center = each.outline.center[None]
        below = [
            other
            for other in stacked
            if other.facet.height < each.facet.height - THINNEST and float(other.outline.beyond(center)[0]) < 0.0
        ]
        carrier = max(below, key=lambda other: other.facet.height, default=None)
        bottom = 0.0 if carrier is None else carrier.facet.height
        stacked.append(replace(each, bottom=bottom, carrier=carrier))
    return stacked


def _widened(candidate: Candidate, relief: Relief, settings: PerceptionSettings) -> Candidate:
    """Give a cylinder the radius of its body where that is wider than its top: a can's rim is narrower than the can."""
    disc, facet = candidate.outline, candidate.facet
    if not isinstance(disc, DiscOutline):
        return candidate
    height = facet.height - candidate.bottom
    x, y, z = _around(disc, facet.pitch, relief)
    radii = np.hypot(x - disc.center[0], y - disc.center[1])
    near = (radii > disc.radius - facet.pitch) & (radii < disc.radius + WIDEST)
    eye = relief.table.in_table(relief.view.eye)[:2] - disc.center
    azimuth = np.arctan2(y - disc.center[1], x - disc.center[0]) - math.atan2(eye[1], eye[0])
    facing = np.cos(azimuth) > math.cos(math.radians(60.0))
    on_side = near & facing & (z > candidate.bottom + 0.2 * height) & (z < candidate.bottom + 0.8 * height)
    if int(on_side.sum()) >= 3 * settings.fewest_pixels // 2:
        radius = float(np.median(radii[on_side]))
    else:
        on_shoulder = near & (z > facet.height - 0.025) & (z < facet.height - NOISE_REACH * relief.noise)
        if int(on_shoulder.sum()) < settings.fewest_pixels:
            return candidate
        radius = float(np.quantile(radii[on_shoulder], 0.85)) + 0.25 * facet.pitch
    if radius < disc.radius + WIDER:
        return candidate
    return replace(candidate, outline=replace(disc, radius=radius))


def _around(outline: Outline, pitch: float, relief: Relief) -> tuple[Array, Array, Array]:
    """Return x, y and z, (n,) each, in the table's frame, of what was measured near an outline [m]."""
    reach = float(np.ptp(outline.corners(), axis=0).max()) * 0.5 + WIDEST + 4.0 * pitch
    x, y, z = np.moveaxis(relief.points, -1, 0)
    with np.errstate(invalid="ignore"):
        near = (np.abs(x - outline.center[0]) < reach) & (np.abs(y - outline.center[1]) < reach)
    near &= ~relief.known
    return x[near], y[near], z[near]


def _is_upright(
    candidate: Candidate, others: Sequence[Candidate], relief: Relief, settings: PerceptionSettings
) -> bool:
    """Tell whether nothing is seen beside an object, between its top and its bottom, that would be its own side."""
    facet, outline = candidate.facet, candidate.outline
    x, y, z = _around(outline, facet.pitch, relief)
    places = np.column_stack([x, y])
    low = candidate.bottom + max(THINNEST, 0.25 * (facet.height - candidate.bottom))
    between = (z > low) & (z < facet.height - NOISE_REACH * relief.noise)
    beyond = outline.beyond(places)
    skirt = between & (beyond > 1.5 * facet.pitch) & (beyond < 1.5 * facet.pitch + settings.skirt)
    for other in others:
        own = (other.outline.beyond(places) < 2.0 * facet.pitch) & (z < other.facet.height + 0.01)
        skirt &= ~own
    return int(skirt.sum()) <= settings.skirt_share * len(facet.edge)


def _stands(candidate: Candidate, upright: Sequence[Candidate]) -> bool:
    """Tell whether what carries an object is an object itself."""
    while candidate.carrier is not None:
        carrier = next((each for each in upright if each.facet is candidate.carrier.facet), None)
        if carrier is None:
            return False
        candidate = carrier
    return True


def _objects(
    standing: Sequence[Candidate], relief: Relief, settings: PerceptionSettings
) -> tuple[list[PerceivedObject], NDArray[np.int16]]:
    """Name the objects from left to right, far to near, and put them into the world; tell whose tops pixels show."""

    def place(candidate: Candidate) -> tuple[float, float, float]:
        x, y = candidate.outline.center
        return (-round(float(y), 3), round(float(x), 3), candidate.facet.height)

    ordered = sorted(standing, key=place)
    names = {id(each.facet): f"object_{i + 1}" for i, each in enumerate(ordered)}
    objects, owners = [], np.full(relief.view.shape, NOBODY, np.int16)
    for i, each in enumerate(ordered):
        owners[each.facet.pixels] = i
        carrier = TABLE if each.carrier is None else names[id(each.carrier.facet)]
        objects.append(_object(names[id(each.facet)], each, carrier, relief, settings))
    return objects, owners


def _object(
    name: str, candidate: Candidate, carrier: str, relief: Relief, settings: PerceptionSettings
) -> PerceivedObject:
    facet, outline = candidate.facet, candidate.outline
    height = facet.height - candidate.bottom
    height_std = math.hypot(settings.height_floor, relief.noise / math.sqrt(facet.size))
    middle = 0.5 * (facet.height + candidate.bottom)
    yaw = outline.yaw if isinstance(outline, Rectangle) else 0.0
    T_table_object = transform(rotation_z(yaw), [*outline.center, middle])
    if isinstance(outline, Rectangle):
        shape = Box(type="box", size=(*outline.size, height))
        # Of both sides' errors the sum is the size, half the difference the centre; what they share is in the sum only.
        stds = [std / math.sqrt(2.0) for std in outline.edge_std]
        shared = 2.0 * settings.edge_shared * facet.pitch
        size = (math.hypot(2.0 * stds[0], shared), math.hypot(2.0 * stds[1], shared), height_std)
        uncertainty = ObjectUncertainty((stds[0], stds[1], height_std), outline.yaw_std, size)
    else:
        shape = Cylinder(type="cylinder", radius=outline.radius, height=height)
        std = outline.edge_std
        uncertainty = ObjectUncertainty((std, std, height_std), 0.0, (2.0 * std, 2.0 * std, height_std))
    T_world_object = relief.table.T_world_table @ T_table_object
    points = relief.view.points()[facet.pixels & np.isfinite(relief.heights)]
    some = points[:: max(1, math.ceil(len(points) / settings.support_points))]
    return PerceivedObject(name, shape, T_world_object, uncertainty, carrier, facet.size, some)


def _unrecognised(
    above: ImageMask,
    standing: Sequence[Candidate],
    reasons: Sequence[tuple[TopFacet, str]],
    relief: Relief,
    settings: PerceptionSettings,
) -> list[Unrecognised]:
    """Return the pieces of what is above the table and belongs to no object."""
    rest = above.copy()
    rows, columns = np.nonzero(above)
    points = relief.points[rows, columns]
    for each in standing:
        own = each.outline.beyond(points[:, :2]) < settings.skirt
        own &= points[:, 2] < each.facet.height + NOISE_REACH * relief.noise + 0.5 * THINNEST
        rest[rows[own], columns[own]] = False
    opened = cv2.morphologyEx(rest.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    count, labels = cv2.connectedComponents(opened, connectivity=8)
    pieces = []
    for label in range(1, count):
        piece = labels == label
        if piece.sum() >= settings.fewest_pixels:
            pieces.append(_piece(piece, reasons, relief))
        if len(pieces) == settings.most_tops:
            break
    return [piece for piece in pieces if piece is not None]


def _piece(piece: ImageMask, reasons: Sequence[tuple[TopFacet, str]], relief: Relief) -> Unrecognised | None:
    points = relief.view.points()[piece]
    try:
        hull = points[ConvexHull(points[:, :2]).vertices, :2]
    except QhullError:
        return None
    shared: list[tuple[int, str]] = [(int((facet.pixels & piece).sum()), reason) for facet, reason in reasons]
    most, reason = max(shared, default=(0, NO_TOP))
    return Unrecognised(reason if most > 0 else NO_TOP, hull, float(np.quantile(points[:, 2], 0.99)))
