"""Pushes: where the tip of a stick can press against a plate, and from which directions (paper B, Fig. 5b)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planners.errors import LiftwrightError
from planners.geometry.polyhedron import ConvexPrism
from planners.geometry.pose import Array, frame_from_z, rotation_z, transform
from planners.manipulation.holds.rim import RimPatch, RimStation, rim_stations
from planners.scene.lift_placements import PUSH_CONE, GivenPush

_UP = np.array([0.0, 0.0, 1.0])
_CLEARLY = 1e-4
"""By so much a distance is larger than a margin that decides [m]."""
LARGEST_ROLLS = 8
"""Rolls times branches of the inverse kinematics must fit into a set of 64 bits (`reach.hand_reach`)."""


@dataclass(frozen=True)
class PushSampling:
    """Which pushes are generated: at every station of the rim some on the side face and some under the plate.

    Flat on its support, a plate can be pushed at its sides only, by a stick that comes from above; a push from below
    comes from outside the rim, inclined. On the top face a push helps nothing.
    """

    count: int = 16
    """Stations on the rim of paper B's square, times four pushes its 64 (Table III); else see `rim.station_count`."""
    corner_margin: float = 1.5
    """Least distance of a contact from the neighbouring sides [radii of the tip]; our choice."""
    tip_clearance: float = 0.5
    """Least distance of the tip at a side from what the plate lies on [radii of the tip]: thin plates are pushed above
    the middle."""
    top_margin: float = 0.3
    """Least distance of a side contact from the top face [radii of the tip]; our choice ..."""
    least_top_margin: float = 0.001
    """... and where that leaves no room above what the plate lies on [m]: plates lie true to 1 mm, as tasks may
    state."""
    bottom_depth: float = 2.0
    """From the side face to the contacts under the plate [radii of the tip]; our choice."""
    side_elevations: tuple[float, ...] = (math.radians(20.0), math.radians(50.0))
    """Of the stick above the plate's plane, at side contacts [rad]; found by trying."""
    bottom_elevation: float = math.radians(20.0)
    """Of the stick below the plate's plane, at bottom contacts [rad]; found by trying."""
    bottom_azimuths: tuple[float, ...] = (-math.radians(30.0), math.radians(30.0))
    """Of the stick from square to the rim, at bottom contacts [rad]; our choice."""
    axis_angle_max: float = PUSH_CONE
    """Largest angle between the stick and the contact normal [rad]."""
    rolls: int = 8
    """Turns of the hand about the stick, evenly around; the stick does not care, the arm does."""

    def __post_init__(self) -> None:
        if self.count < 1 or self.rolls < 1 or min(self.corner_margin, self.bottom_depth) < 0.0:
            raise LiftwrightError("a push sampling has a positive count, positive rolls and no negative length")
        if self.rolls > LARGEST_ROLLS:
            raise LiftwrightError(f"a push has at most {LARGEST_ROLLS} rolls, not {self.rolls}")
        if not 0.0 < self.axis_angle_max < math.pi / 2:
            raise LiftwrightError("the push cone opens by more than 0 and less than 90 degrees")


@dataclass(frozen=True, eq=False)
class PlatePush:
    """One point contact, and the poses of the hand that reach it. Everything in the plate's frame."""

    index: int
    """Its place in the list of pushes."""
    point: Array
    """(3,) contact point [m]."""
    normal: Array
    """(3,) unit contact normal into the plate."""
    axis: Array
    """(3,) unit vector along the stick, towards its tip."""
    T_plate_tcp: Array
    """(rolls, 4, 4): origin at the centre of the tip's hemisphere, z along the stick, away from the flange."""

    @property
    def retreat(self) -> Array:
        """(3,) unit direction in which the tip leaves: off the surface and back along the stick."""
        back = -(self.normal + self.axis)
        return back / np.linalg.norm(back)


def generate_pushes(
    plate: ConvexPrism,
    tip_radius: float,
    reach: float,
    sampling: PushSampling | None = None,
    *,
    lowest: float = 0.0,
) -> tuple[PlatePush, ...]:
    """Spread pushes evenly along the rim: on the side faces, and under the plate near the rim.

    Contacts on the sides are at mid-thickness, or higher where the tip would be too close to the support; as far from
    the top face as that leaves them.

    Directions outside the push cone are left out.

    Args:
        plate: what is pushed.
        tip_radius: of the stick's hemispherical tip [m].
        reach: of the arm that has the stick, as its maker states it [m].
        sampling: how many, where and from which directions.
        lowest: height above what the plate lies on, below which a tip at the plate's sides has no room [m], see
            `lowest_contact`.
    """
    sampling = sampling or PushSampling()
    aside, under = tip_radius * sampling.corner_margin, tip_radius * sampling.bottom_depth
    # The patch starts a little inside, so that the nearly straight corners of a round outline do not count.
    patch = RimPatch(aside, 0.1 * aside, under)
    # A little higher than the lowest, so that rounding decides nothing.
    below_top = min(tip_radius * sampling.top_margin, max(sampling.least_top_margin, plate.height - lowest - _CLEARLY))
    height = max(
        0.0, min(tip_radius + tip_radius * sampling.tip_clearance - 0.5 * plate.height, 0.5 * plate.height - below_top)
    )
    contacts = [
        contact
        for station in rim_stations(plate.outline, sampling.count, patch, reach)
        for contact in (*_side_contacts(station, height, sampling), *_bottom_contacts(station, plate, under, sampling))
        if _angle(contact[2], contact[1]) <= sampling.axis_angle_max + 1e-9
    ]
    return tuple(_push(index, contact, tip_radius, sampling.rolls) for index, contact in enumerate(contacts))


def lowest_contact(tip_radius: float, margin: float, beyond: float = math.inf) -> float:
    """Return the height above what a plate lies on [m], below which a tip at the plate's sides has no room.

    Args:
        tip_radius: of the stick's hemispherical tip [m].
        margin: distance that the tip keeps from what the plate lies on [m].
        beyond: how far what it lies on reaches beyond the plate [m].
    """
    aside = max(0.0, tip_radius - beyond)
    return math.sqrt(max(0.0, (tip_radius + margin) ** 2 - aside**2))


def least_thickness(tip_radius: float, margin: float, sampling: PushSampling, beyond: float = math.inf) -> float:
    """Return the thickness [m] up to which no plate is pushed at its sides, for want of room above what it lies on.

    Args:
        tip_radius: of the stick's hemispherical tip [m].
        margin: distance that the tip keeps from what the plate lies on [m].
        sampling: how close to the top face a plate is pushed.
        beyond: how far what it lies on reaches beyond the plate [m].
    """
    return lowest_contact(tip_radius, margin, beyond) + sampling.least_top_margin


def largest_tip(thickness: float, margin: float, sampling: PushSampling, beyond: float = math.inf) -> float:
    """Return the radius [m] up to which a tip has room at the sides of a plate; none has if it is not positive.

    The inverse of `least_thickness`, with its arguments but for the tip's radius, in place of which is the plate's
    thickness [m].
    """
    room = thickness - sampling.least_top_margin
    if room - margin <= beyond:
        return room - margin
    return (room**2 + beyond**2 - margin**2) / (2.0 * (margin + beyond))


def given_pushes(given: Sequence[GivenPush], tip_radius: float, rolls: int) -> tuple[PlatePush, ...]:
    """Make pushes of those that a task gives, at `rolls` turns of the hand about the stick."""
    contacts = ((push.point, push.normal, push.axis) for push in given)
    return tuple(_push(index, contact, tip_radius, rolls) for index, contact in enumerate(contacts))


_Contact = tuple[Array, Array, Array]
"""Point, normal into the plate, and stick axis, (3,) each."""


def _side_contacts(station: RimStation, height: float, sampling: PushSampling) -> list[_Contact]:
    """On the side face at a height from mid-thickness, the stick coming from outside and above."""
    inward = np.array([*station.inward, 0.0])
    point = np.array([*station.point, height])
    return [
        (point, inward, math.cos(elevation) * inward - math.sin(elevation) * _UP)
        for elevation in sampling.side_elevations
    ]


def _bottom_contacts(station: RimStation, plate: ConvexPrism, depth: float, sampling: PushSampling) -> list[_Contact]:
    """Under the plate, as far from the side face as told [m], the stick coming from outside the rim and below."""
    inward, along = np.array([*station.inward, 0.0]), np.array([*station.along, 0.0])
    point = np.array([*(station.point + depth * station.inward), -0.5 * plate.height])
    level, rise = math.cos(sampling.bottom_elevation), math.sin(sampling.bottom_elevation)
    return [
        (point, _UP, level * (math.cos(azimuth) * inward + math.sin(azimuth) * along) + rise * _UP)
        for azimuth in sampling.bottom_azimuths
    ]


def _push(index: int, contact: _Contact, tip_radius: float, rolls: int) -> PlatePush:
    point, normal, axis = contact
    frame = frame_from_z(axis, _square_hint(axis))
    centre = point - tip_radius * normal
    turns = 2.0 * math.pi * np.arange(rolls) / rolls
    T_plate_tcp = np.array([transform(frame @ rotation_z(float(turn)), centre) for turn in turns])
    return PlatePush(index, point, normal, axis, T_plate_tcp)


def _square_hint(axis: Array) -> Array:
    """Return the plate's z (3,), or its x for a stick whose axis (3,) is along z; plate frame."""
    return _UP if abs(axis[2]) < 0.99 else np.array([1.0, 0.0, 0.0])


def _angle(a: Array, b: Array) -> float:
    """Return the angle between two unit vectors [rad]."""
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))
