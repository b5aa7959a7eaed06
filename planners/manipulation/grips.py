"""Grips: where a parallel gripper can take a plate at its rim, one finger on each face (paper B, Fig. 5a)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from planners.errors import LiftwrightError, SceneError
from planners.geometry.polyhedron import Polyhedron, Prism
from planners.geometry.pose import Array, from_pose7, rotation_z, transform
from planners.manipulation.rim import RimPatch, RimStation, rim_stations

_CENTRED = 1e-3
"""How far from midway between its contacts a given grip may be [m]: what the closing fingers may shift."""


@dataclass(frozen=True)
class GripSampling:
    """Which grips are generated."""

    count: int = 30
    """Grips on a rim of 1.2 m (paper B, Table III, AB); other rims: `rim.station_count`."""
    depth: float = 0.018
    """From the side face to the middle of the pads [m]: nearly half a pad of the 2F-85; our choice."""
    rim_tolerance: float = 0.002
    """Strip along the rim that a pad may overhang, as at rounded corners [m]; our choice."""
    opening_clearance: float = 0.004
    """Least opening of the gripper beyond the plate's thickness, both fingers together [m]; our choice."""
    cup_clearance: float = 0.002
    """Least distance between a pad and the cup's pad [m]; our choice."""

    def __post_init__(self) -> None:
        if self.count < 1 or min(self.depth, self.rim_tolerance, self.opening_clearance, self.cup_clearance) < 0.0:
            raise LiftwrightError("a grip sampling has a positive count and no negative length")


@dataclass(frozen=True)
class Jaw:
    """What matters of a gripper to where it can grip."""

    width_max: float
    """Largest inner distance of the pads [m]."""
    pad_size: tuple[float, float]
    """Pad across and along the approach direction [m]."""


@dataclass(frozen=True)
class CupFootprint:
    """The disc that the lifter's cup covers on the top face."""

    centre: tuple[float, float]
    """In the plate's axes [m]."""
    radius: float
    """[m]"""


@dataclass(frozen=True, eq=False)
class Grip:
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


def generate_grips(
    plate: Prism, jaw: Jaw, *, cup: CupFootprint | None = None, sampling: GripSampling | None = None
) -> tuple[Grip, ...]:
    """Spread grips evenly along the rim, square to the side faces, fingers on top and bottom.

    Left out are grips whose pad would stick out at a corner or meet the cup's pad; none is left on a plate that the
    gripper does not open for.
    """
    sampling = sampling or GripSampling()
    if plate.height > jaw.width_max - sampling.opening_clearance:
        return ()
    across, along = jaw.pad_size
    depth_to = sampling.depth + 0.5 * along
    patch = RimPatch(0.5 * across, min(sampling.rim_tolerance, depth_to), depth_to)
    stations = [
        station
        for station in rim_stations(plate.outline, sampling.count, patch)
        if cup is None or _pad_distance(station, jaw, sampling, cup) >= cup.radius + sampling.cup_clearance
    ]
    return tuple(_rim_grip(index, station, plate, sampling.depth) for index, station in enumerate(stations))


def grips_from_data(
    data: Sequence[Mapping[str, Any]], plate: Prism, jaw: Jaw, *, friction: float, pointer: str
) -> tuple[Grip, ...]:
    """Read a list of grips from plain data: `{"pose": [x, y, z, w, x, y, z]}`, the TCP in the plate's frame.

    Contacts and width follow from the plate: its surface along the opening axis to either side of the TCP.

    Args:
        data: the grips.
        plate: what is gripped.
        jaw: what grips.
        friction: coefficient between pads and plate.
        pointer: RFC 6901 path of the list, for errors.

    Raises:
        SceneError: naming the first grip that misses the plate, is not antipodal within the friction cones, is not
            midway between its contacts, or is wider than the gripper opens.
    """
    return tuple(
        _given_grip(index, entry, plate.polyhedron, jaw, (friction, f"{pointer}/{index}"))
        for index, entry in enumerate(data)
    )


def _rim_grip(index: int, station: RimStation, plate: Prism, depth: float) -> Grip:
    approach = np.array([*station.inward, 0.0])
    opening = np.array([0.0, 0.0, 1.0])
    rotation = np.column_stack([np.cross(opening, approach), opening, approach])
    T_plate_tcp = transform(rotation, [*(station.point + depth * station.inward), 0.0])
    return _grip(index, T_plate_tcp, (-0.5 * plate.height, 0.5 * plate.height), (opening, -opening))


def _grip(index: int, T_plate_tcp: Array, reach: tuple[float, float], normals: tuple[Array, Array]) -> Grip:
    """Assemble a grip from its first flip, the contacts' places along the opening axis and their normals."""
    opening, origin = T_plate_tcp[:3, 1], T_plate_tcp[:3, 3]
    points = np.array([origin + way * opening for way in reach])
    turned = T_plate_tcp @ transform(rotation_z(math.pi))
    both = np.array(normals)
    return Grip(
        index=index,
        T_plate_tcp=np.array([T_plate_tcp, turned]),
        width=reach[1] - reach[0],
        points=np.array([points, points[::-1]]),
        normals=np.array([both, both[::-1]]),
    )


def _given_grip(index: int, entry: Mapping[str, Any], body: Polyhedron, jaw: Jaw, context: tuple[float, str]) -> Grip:
    friction, pointer = context
    T_plate_tcp = from_pose7(_numbers(entry, "pose", 7, pointer))
    opening = T_plate_tcp[:3, 1]
    chord = body.chord(T_plate_tcp[:3, 3], opening)
    if chord is None:
        raise SceneError(f"{pointer}/pose", "the opening axis of the gripper misses the plate")
    middle = 0.5 * (chord.enters + chord.leaves)
    if abs(middle) > _CENTRED:
        raise SceneError(f"{pointer}/pose", f"the TCP is {abs(middle):.4f} m from midway between its two contacts")
    width = chord.leaves - chord.enters
    if width > jaw.width_max:
        raise SceneError(f"{pointer}/pose", f"the plate is {width:.4f} m wide here, the gripper {jaw.width_max:.4f} m")
    normals = (-body.face_normal(chord.enters_at), -body.face_normal(chord.leaves_at))
    least = math.cos(math.atan(friction))
    if float(normals[0] @ opening) < least or float(normals[1] @ -opening) < least:
        raise SceneError(f"{pointer}/pose", "the contacts are not antipodal: the opening axis leaves a friction cone")
    return _grip(index, T_plate_tcp, (chord.enters, chord.leaves), normals)


def _numbers(entry: Mapping[str, Any], member: str, count: int, pointer: str) -> Array:
    """Read a member that is a list of `count` finite numbers."""
    if member not in entry:
        raise SceneError(f"{pointer}/{member}", "missing")
    values = np.asarray(entry[member], dtype=float)
    if values.shape != (count,) or not np.all(np.isfinite(values)):
        raise SceneError(f"{pointer}/{member}", f"a list of {count} finite numbers")
    return values


def _pad_distance(station: RimStation, jaw: Jaw, sampling: GripSampling, cup: CupFootprint) -> float:
    """Return the distance from the cup's centre to the rectangle of the pad on the top face [m]."""
    offset = np.array(cup.centre) - (station.point + sampling.depth * station.inward)
    across, along = abs(float(offset @ station.along)), abs(float(offset @ station.inward))
    return math.hypot(max(0.0, across - 0.5 * jaw.pad_size[0]), max(0.0, along - 0.5 * jaw.pad_size[1]))
