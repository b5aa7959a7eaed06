"""Grips: where a parallel gripper can take a plate at its rim, one finger on each face (paper B, Fig. 5a)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from planners.errors import LiftwrightError
from planners.geometry.polygon import inward_normals, segment_distance
from planners.geometry.polyhedron import ConvexPrism
from planners.geometry.pose import Array, rotation_z, transform
from planners.graph.rejections import Rejection
from planners.manipulation.holds.rim import RimPatch, RimStation, rim_stations
from planners.scene.lift_placements import GivenGrip


@dataclass(frozen=True)
class GripSampling:
    """Which grips are generated."""

    count: int = 30
    """Grips on the rim of paper B's square (Table III, AB); else see `rim.station_count`."""
    depth: float = 0.018
    """From the side face to the middle of the pads [m]: nearly half a pad of the 2F-85; our choice."""
    palm_clearance: float = 0.005
    """Least distance between side face and palm [m], where there is less room than `depth` asks for; our choice."""
    rim_tolerance: float = 0.002
    """Strip along the rim that a pad may overhang, as at rounded corners [m]; our choice."""
    opening_clearance: float = 0.004
    """Least opening of the gripper beyond the plate's thickness, both fingers together [m]; our choice."""
    cup_clearance: float = 0.002
    """Least distance between a pad and the cup's pad [m]; our choice."""

    def __post_init__(self) -> None:
        lengths = self.depth, self.palm_clearance, self.rim_tolerance, self.opening_clearance, self.cup_clearance
        if self.count < 1 or min(lengths) < 0.0:
            raise LiftwrightError("a grip sampling has a positive count and no negative length")

    def in_jaw(self, jaw: Jaw) -> GripSampling:
        """Return a sampling whose grips are no deeper than a plate gets into a gripper."""
        return replace(self, depth=min(self.depth, max(0.0, jaw.room - self.palm_clearance)))


@dataclass(frozen=True)
class Jaw:
    """What matters of a gripper to where it can grip."""

    width_max: float
    """Largest inner distance of the pads [m]."""
    pad_size: tuple[float, float]
    """Pad across and along the approach direction [m]."""
    room: float = math.inf
    """From the palm to the middle of the pads: so far a plate gets between them at most [m]."""


@dataclass(frozen=True)
class CupFootprint:
    """The disc that the lifter's cup covers on the top face."""

    centre: tuple[float, float]
    """In the plate's axes [m]."""
    radius: float
    """[m]"""


@dataclass(frozen=True, eq=False)
class PlateGrip:
    """Two antipodal contacts, and the two poses of the hand that reach them. Everything in the plate's frame.

    The hand can be turned by half a turn about its approach direction; this swaps the fingers. The first axis of the
    arrays is that flip; the second of points and normals is the finger. Finger 0 is at the TCP's -y.
    """

    index: int
    """Its place in the list of grips."""
    T_plate_tcp: Array
    """(2, 4, 4): origin midway between the pads, z along the approach, y along the opening."""
    width: float
    """Inner distance of the pads [m]."""
    points: Array
    """(2, 2, 3) contact points [m]."""
    normals: Array
    """(2, 2, 3) unit contact normals into the plate."""

    @property
    def approach(self) -> Array:
        """(3,) unit direction of the hand's way in."""
        return self.T_plate_tcp[0, :3, 2]


def least_opening(plate: ConvexPrism, friction: float) -> float:
    """Return a lower bound of the opening with which two pads can hold a plate anywhere, antipodal with friction [m].

    Two pads hold two faces whose normals are opposite within twice the friction angle. Besides top and bottom these
    may be sides; where friction reaches 45 degrees even two faces that share an edge.
    """
    if friction >= 1.0:
        return 0.0
    normals, corners = inward_normals(plate.outline), plate.outline
    ends = np.roll(corners, -1, axis=0)
    widths = [plate.height]
    for i, j in combinations(range(len(corners)), 2):
        if math.acos(max(-1.0, min(1.0, -float(normals[i] @ normals[j])))) <= 2.0 * math.atan(friction):
            points = np.array([corners[i], ends[i]]), np.array([corners[j], ends[j]])
            widths.append(segment_distance(*points))
    return min(widths)


def generate_grips(
    plate: ConvexPrism, jaw: Jaw, reach: float, *, cup: CupFootprint | None = None, sampling: GripSampling | None = None
) -> tuple[PlateGrip, ...]:
    """Spread grips evenly along the rim, square to the side faces, fingers on top and bottom.

    Left out are grips whose pad would stick out at a corner or meet the cup's pad; none is left on a plate that the
    gripper does not open for.

    Args:
        plate: what is gripped.
        jaw: of the gripper.
        reach: of its arm, as its maker states it [m].
        cup: what covers the plate.
        sampling: how many grips, and how deep.
    """
    sampling = (sampling or GripSampling()).in_jaw(jaw)
    if plate.height > jaw.width_max - sampling.opening_clearance:
        return ()
    stations = [
        station
        for station in _stations(plate, jaw, sampling, reach)
        if cup is None or _pad_distance(station, jaw, sampling, cup) >= cup.radius + sampling.cup_clearance
    ]
    return tuple(
        _level_grip(
            index, np.array([*(s.point + sampling.depth * s.inward), 0.0]), np.array([*s.inward, 0.0]), plate.height
        )
        for index, s in enumerate(stations)
    )


def lack_of_grips(
    plate: ConvexPrism, jaw: Jaw, reach: float, cup: CupFootprint | None, sampling: GripSampling
) -> Rejection:
    """Say why `generate_grips` finds no place: the plate is too thick, too small, or the cup covers what is left."""
    needed = plate.height + sampling.opening_clearance
    if needed > jaw.width_max:
        reason = (
            f"from above and below it would have to open {1e3 * needed:.1f} mm to go around the plate, and opens "
            f"{1e3 * jaw.width_max:.1f} mm"
        )
        return Rejection("sampling", reason, needed=needed, available=jaw.width_max, unit="m")
    if cup is None or not _stations(plate, jaw, sampling.in_jaw(jaw), reach):
        return Rejection("sampling", "the plate is too small for the pads")
    return Rejection("sampling", "the cup is where the pads would be")


def given_grips(given: Sequence[GivenGrip], plate: ConvexPrism) -> tuple[PlateGrip, ...]:
    """Make grips of those that a task gives."""
    return tuple(_level_grip(index, grip.position, grip.approach, plate.height) for index, grip in enumerate(given))


def _stations(plate: ConvexPrism, jaw: Jaw, sampling: GripSampling, reach: float) -> Sequence[RimStation]:
    """Spread places along the rim at which a pad lies on the face."""
    across, along = jaw.pad_size
    depth_to = sampling.depth + 0.5 * along
    patch = RimPatch(0.5 * across, min(sampling.rim_tolerance, depth_to), depth_to)
    return rim_stations(plate.outline, sampling.count, patch, reach)


def _level_grip(index: int, position: Array, approach: Array, height: float) -> PlateGrip:
    """Assemble a grip in the plate's plane, fingers on top and bottom.

    It is at `position` (3,) [m] with the hand's z along `approach` (3,), both in the plate frame; `height` is the
    plate's [m].
    """
    opening = np.array([0.0, 0.0, 1.0])
    T_plate_tcp = transform(np.column_stack([np.cross(opening, approach), opening, approach]), position)
    points = np.array([position - 0.5 * height * opening, position + 0.5 * height * opening])
    normals = np.array([opening, -opening])
    return PlateGrip(
        index=index,
        T_plate_tcp=np.array([T_plate_tcp, T_plate_tcp @ transform(rotation_z(math.pi))]),
        width=height,
        points=np.array([points, points[::-1]]),
        normals=np.array([normals, normals[::-1]]),
    )


def _pad_distance(station: RimStation, jaw: Jaw, sampling: GripSampling, cup: CupFootprint) -> float:
    """Return the distance from the cup's centre to the rectangle of the pad on the top face [m]."""
    offset = np.array(cup.centre) - (station.point + sampling.depth * station.inward)
    across, along = abs(float(offset @ station.along)), abs(float(offset @ station.inward))
    return math.hypot(max(0.0, across - 0.5 * jaw.pad_size[0]), max(0.0, along - 0.5 * jaw.pad_size[1]))
