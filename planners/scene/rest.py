"""What bodies rest on, where they settle, and whether one would tip off what carries it.

A task may place a body up to 1 mm and 0.1 degrees off the surface it lies on; it is settled onto that surface, so
that everything later can take a resting body to touch what carries it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from planners.geometry import polygon
from planners.geometry.pose import Array, Transform, rotation_from_vector, to_pose7
from planners.scene.solid import ExtrudedSolid, FlatFace, Solid

REST_GAP = 1e-3
"""Every corner of a resting face is at most this far from the surface's height [m]."""
REST_TILT = math.radians(0.1)
"""[rad]"""
EDGE_SLACK = 1e-6
"""A face may stick out this far over the edge of its surface: rounding, not intention [m]."""
_SCALAR = 1e-3
"""A quaternion's component counts as 0 below this [1]: written with few digits."""
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class LevelFace:
    """A level, convex face that bodies can rest on."""

    name: str
    height: float
    """z in the world [m]."""
    outline: Array
    """(n, 2) in the world, counter-clockwise [m]."""


def lowest_face(solid: Solid, T_world_body: Transform) -> FlatFace:
    """Return the flat face that looks most nearly down, in the solid's frame."""
    down = -T_world_body[2, :3]
    return max(solid.flat_faces(), key=lambda face: float(face.normal @ down))


def face_tilt(face: FlatFace, T_world_body: Transform) -> float:
    """Return the angle between a face's outward normal and straight down [rad]."""
    normal = T_world_body[:3, :3] @ face.normal
    return math.atan2(math.hypot(normal[0], normal[1]), -normal[2])


def scalar_last_hint(T_world_body: Transform) -> str:
    """Return a question about the order of a quaternion's components, for the end of a refusal; or an empty text.

    It is asked where the body would stand upright with w last: a yaw written as x, y, z, w turns the body over, about
    an axis across its x axis, when it is read with w first.
    """
    w, x, *_ = to_pose7(T_world_body)[3:]
    upright = T_world_body[2, 2] >= math.cos(REST_TILT)
    if upright or abs(w) > _SCALAR or abs(x) > _SCALAR:
        return ""
    return "; a quaternion's w comes first: was x, y, z, w written?"


def gaps(face: FlatFace, T_world_body: Transform, height: float) -> Array:
    """Return the (k,) heights of the face's corners above `height` [m]."""
    return face.corners @ T_world_body[2, :3] + T_world_body[2, 3] - height


def rests_level(face: FlatFace, T_world_body: Transform, height: float) -> bool:
    """Tell whether a face lies on the plane at `height`, within `REST_GAP` and `REST_TILT`."""
    gap = float(np.abs(gaps(face, T_world_body, height)).max())
    return gap <= REST_GAP + _ROUNDING and face_tilt(face, T_world_body) <= REST_TILT + _ROUNDING


def settled(face: FlatFace, T_world_body: Transform, height: float) -> Transform:
    """Return the pose of a body after its face was turned level, the shortest way, and put at `height` exactly."""
    normal = T_world_body[:3, :3] @ face.normal
    axis = np.cross(normal, [0.0, 0.0, -1.0])
    sine = float(np.linalg.norm(axis))
    T = T_world_body.copy()
    if sine > 0.0:
        T[:3, :3] = rotation_from_vector(axis / sine * math.atan2(sine, -normal[2])) @ T[:3, :3]
    T[2, 3] -= float(gaps(face, T, height).mean())
    return T


def footprint(face: FlatFace, T_world_body: Transform) -> Array:
    """Return the (k, 2) corners of a downward face seen from above, in the world, counter-clockwise [m]."""
    return (face.corners @ T_world_body[:2, :3].T + T_world_body[:2, 3])[::-1]


def overhang(corners: Array, surface: LevelFace) -> float:
    """Return how far the farthest of (k, 2) points lies outside a surface [m]; 0 when none does."""
    outside = -float(polygon.depth_inside(surface.outline, corners).min())
    return outside if outside > EDGE_SLACK else 0.0


def lowest_point(solid: Solid, T_world_body: Transform) -> float:
    """Return the least height of a placed body's surface in the world [m]."""
    return float((solid.surface()[0] @ T_world_body[2, :3]).min() + T_world_body[2, 3])


def upper_surface(name: str, solid: Solid, T_world_body: Transform) -> LevelFace | None:
    """Return the top of a settled body as a surface: its highest flat face; None where that is not level."""
    face = max(solid.flat_faces(), key=lambda face: float(T_world_body[2, :3] @ face.normal))
    corners = face.corners @ T_world_body[:3, :3].T + T_world_body[:3, 3]
    if float(np.ptp(corners[:, 2])) > EDGE_SLACK:
        return None
    return LevelFace(name, float(corners[:, 2].mean()), corners[:, :2])


SMALLEST_OVERLAP = 1e-9
"""Places that share less are beside one another, not above [m²]."""
SAME_HEIGHT = 1e-5
"""Places no farther apart in height carry a body together [m]."""
SAME_PLANE = 1e-5
"""How far a flat piece may be off the plane of the face that rests and still belong to it [m]."""
_LYING = math.radians(45.0)
"""A cylinder whose ends are steeper lies on its side [rad]."""
TIP_SLACK = 1e-6
"""How far beyond what carries it a centre of mass may be: rounding [m]."""


@dataclass(frozen=True, eq=False)
class Footing:
    """Where a body rests once it is settled, and on what."""

    T_world_body: Transform
    supports: tuple[str, ...]
    """Names of the bodies that carry it, sorted."""
    points: Array
    """(k, 2) where it is carried: corners of what touches, in the world [m]."""
    by: tuple[str, ...]
    """The body below each point."""

    def inside(self, com: Array) -> float:
        """Return how far inside the hull of what carries the body its centre of mass, (3,) in its frame, is [m]."""
        return -beyond(self.points, (self.T_world_body[:3, :3] @ com + self.T_world_body[:3, 3])[:2])


@dataclass(frozen=True)
class Unsupported:
    """Why a body does not rest."""

    reason: str
    """Said of the body: "is tilted …"."""


def level_places(name: str, solid: Solid, T_world_body: Transform) -> list[LevelFace]:
    """Return the level, upward places of a body's surface, which others can rest on; each is convex."""
    places = []
    for piece in solid.flat_pieces():
        corners = piece.corners @ T_world_body[:3, :3].T + T_world_body[:3, 3]
        if T_world_body[2, :3] @ piece.normal > 0.0 and float(np.ptp(corners[:, 2])) <= EDGE_SLACK:
            places.append(LevelFace(name, float(corners[:, 2].mean()), corners[:, :2]))
    return [place for place in places if polygon.area(place.outline) > SMALLEST_OVERLAP]


def find_footing(
    solid: Solid, T_world_body: Transform, com: Array, places: Iterable[LevelFace]
) -> Footing | Unsupported:
    """Settle a body on the places under it.

    It rests if its lowest flat face is within `REST_GAP` and `REST_TILT` of the highest places it is above, and its
    centre of mass is above the hull of what touches. It may stick out over an edge, or bridge two places.

    Args:
        solid: of the body; a mesh rests on a face of its convex hull.
        T_world_body: where it is, not settled yet.
        com: (3,) in the body frame [m].
        places: level places that may carry it.
    """
    places = list(places)
    face = lowest_face(solid, T_world_body)
    tilt = face_tilt(face, T_world_body)
    seen_from_above = footprint(face, T_world_body)
    below = [place for place in places if _shares(seen_from_above, place.outline)]
    if tilt > REST_TILT:
        return Unsupported(_why_tilted(solid, tilt) + _advice(solid, T_world_body, com, below))
    if not below:
        return Unsupported(f"rests on nothing: nothing level is below it{_table_told(places)}")
    fitting = [place for place in below if rests_level(face, T_world_body, place.height)]
    if not fitting:
        nearest = _nearest(face, T_world_body, below)
        why = why_apart(face, T_world_body, nearest.height, nearest.name)
        return Unsupported(why + _advice(solid, T_world_body, com, below))
    footing = _highest_footing(solid, face, T_world_body, fitting)
    if footing is None:
        return Unsupported("rests on nothing: what is level below it is beside its feet")
    outside = -footing.inside(com)
    if math.isinf(outside):
        return Unsupported("would tip over: it touches what carries it along a line only")
    if outside > TIP_SLACK:
        return Unsupported(f"would tip over: its centre of mass is {1e3 * outside:.4g} mm beyond what carries it")
    return footing


def _highest_footing(
    solid: Solid, face: FlatFace, T_world_body: Transform, fitting: Sequence[LevelFace]
) -> Footing | None:
    """Return the footing on the highest places that touch a body; None where none of them does.

    Places below the hull of a body that has feet may be between these.
    """
    for height in sorted({place.height for place in fitting}, reverse=True):
        T_settled = settled(face, T_world_body, height)
        level = [place for place in fitting if 0.0 <= height - place.height <= SAME_HEIGHT]
        points = {place: _touching_points(solid, face, T_settled, place) for place in level}
        by = tuple(place.name for place, corners in points.items() for _ in corners)
        if by:
            return Footing(T_settled, tuple(sorted(set(by))), np.vstack(list(points.values())), by)
    return None


def _table_told(places: Iterable[LevelFace]) -> str:
    return next((f"; the table {reaches(place)}" for place in places if place.name == "table"), "")


def reaches(place: LevelFace) -> str:
    """Say from where to where a level place reaches in the world."""
    (x_low, y_low), (x_high, y_high) = place.outline.min(axis=0), place.outline.max(axis=0)
    return f"reaches from x = {x_low:.4g} to {x_high:.4g} and from y = {y_low:.4g} to {y_high:.4g}"


def _shares(outline: Array, other: Array) -> bool:
    if np.any(outline.max(axis=0) < other.min(axis=0)) or np.any(other.max(axis=0) < outline.min(axis=0)):
        return False
    shared = polygon.overlap(outline, other)
    return len(shared) > 2 and polygon.area(shared) > SMALLEST_OVERLAP


def _touching_points(solid: Solid, face: FlatFace, T_world_body: Transform, place: LevelFace) -> Array:
    """Return the (k, 2) corners of what a face, or of a mesh the flat pieces in its plane, shares with a place."""
    on_place = footprint(face, T_world_body)
    corners = [on_place[polygon.depth_inside(place.outline, on_place) >= -EDGE_SLACK]]
    for piece in solid.flat_pieces():
        if piece.normal @ face.normal > 0.0 and lies_in_plane(piece, face):
            corners.append(polygon.overlap(footprint(piece, T_world_body), place.outline))
    return np.vstack(corners)


def lies_in_plane(piece: FlatFace, face: FlatFace) -> bool:
    """Tell whether a flat piece of a body lies in the plane of a face of it, whichever way it looks."""
    return float(np.abs((piece.corners - face.corners[0]) @ face.normal).max()) <= SAME_PLANE


def beyond(points: Array, center: Array) -> float:
    """Return how far (2,) `center` is outside the hull of (k, 2) points [m]; infinite if they span no area."""
    try:
        hull = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        return math.inf
    return -float(polygon.depth_inside(hull, center[None])[0])


def _why_tilted(solid: Solid, tilt: float) -> str:
    if isinstance(solid, ExtrudedSolid) and solid.is_round and tilt > _LYING:
        return "lies on its round side, on which it would roll; it can rest on a flat face only"
    degrees = math.degrees(tilt)
    return (
        f"is tilted by {degrees:.3g} degrees, on an edge or a rounding; "
        "a resting face is flat, and level within 0.1 degrees"
    )


def why_apart(face: FlatFace, T_world_body: Transform, height: float, below: str) -> str:
    """Say of a body that a level face of it is too far from the top, at `height` [m], of what is below it."""
    heights = gaps(face, T_world_body, height)
    farthest = 1e3 * float(heights[np.argmax(np.abs(heights))])
    where = "above" if farthest > 0.0 else "below"
    return (
        f"rests on nothing: its bottom face is {abs(farthest):.4g} mm {where} the top of {below}, "
        f"more than {1e3 * REST_GAP:g} mm"
    )


def _advice(solid: Solid, T_world_body: Transform, com: Array, below: Sequence[LevelFace]) -> str:
    """Say where the body would rest, on the face that looks most nearly down among those it does not tip off.

    Or ask about its quaternion where the order of its components would explain how it is turned. No pose is told at
    which the body would tip off the edge of what is nearest.
    """
    hint = scalar_last_hint(T_world_body)
    steady = [face for face in solid.flat_faces() if _is_steady(face, com)]
    if hint or not below or not steady:
        return hint
    face = max(steady, key=lambda face: float(face.normal @ -T_world_body[2, :3]))
    nearest = _nearest(face, T_world_body, below)
    level = [place for place in below if abs(place.height - nearest.height) <= SAME_HEIGHT]
    footing = _highest_footing(solid, face, T_world_body, level)
    if footing is None or -footing.inside(com) > TIP_SLACK:
        return f"; put down on {nearest.name} it would tip over its edge"
    pose = [round(value, 6) + 0.0 for value in to_pose7(footing.T_world_body)]
    return f"; on {nearest.name} it would rest at {pose}"


def _is_steady(face: FlatFace, com: Array) -> bool:
    """Tell whether the centre of mass (3,) is above a face that lies on a level plane."""
    sides = np.roll(face.corners, -1, axis=0) - face.corners
    return bool(np.all(np.cross(sides, com - face.corners) @ face.normal >= 0.0))


def _nearest(face: FlatFace, T_world_body: Transform, below: Sequence[LevelFace]) -> LevelFace:
    """Return the place to which a body is nearest: over the table none under it, where nothing is put down."""
    top = max((place.height for place in below if place.name == "table"), default=-math.inf)
    return min(
        (place for place in below if place.height >= top),
        key=lambda place: float(np.abs(gaps(face, T_world_body, place.height)).max()),
    )
