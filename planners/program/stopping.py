"""How fast a pile's plan may be executed so that a stop on the path loses nothing.

Fingers and cup bear the plan's own motion, with a reserve. A stop asks more of them: a path that is followed at a share
s of the planned speed and comes to rest within a time T is braked by s / T, whichever way it is followed. With p the
momentum of what is borne along the plan, and p' its rate, what must be exerted beside weight is q^2 p' -+ (s / T) p
with 0 <= q <= s. The brake comes at once, and fingers and cup give way like springs: a load that is applied suddenly
asks up to twice as much of a spring, so that the brake counts twice. What cup and fingers can exert is convex, so that
the ends decide: q = 0 and q = s, braked one way and the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product, takewhile

import numpy as np

from planners.certify.plan_view import BodyView
from planners.geometry.pose import Array
from planners.geometry.wrench import in_axes, wrench_about
from planners.plan.contacts import SoftFingerContact, SuctionContact
from planners.plan.plan import Plan
from planners.plan.segment import Grip, Segment, SegmentKind
from planners.regrasp.statics.finger_forces import least_squeeze
from planners.regrasp.statics.hold_statics import SUDDEN
from planners.regrasp.statics.mass_properties import MassProperties
from planners.regrasp.suction.suction_hold import cup_uses
from planners.scene.suction_tool import TOOL_NAME, CupData

SHARES = (0.01, 0.02, 0.03, 0.04, *(0.05 * k for k in range(1, 21)))
"""Of the planned speed, those that are asked about: the answer is one of them."""

_FEWEST_SAMPLES = 3
"""Of a motion whose rates can be told."""


@dataclass(frozen=True, eq=False)
class _Asked:
    """What must be exerted on a body at n samples of a segment: (n, 6) each [N, Nm]."""

    still: Array
    """While it rests."""
    rates: Array
    """In addition at the planned speed; it grows with its square."""
    momenta: Array
    """In addition for each 1/s by which the speed, as a share of the planned one, rises."""

    def at(self, speed: float, rise: float) -> Array:
        """Return what must be exerted at a share of the planned speed, that rises at a rate [1/s]."""
        return self.still + speed**2 * self.rates + rise * self.momenta

    def each(self, change: Callable[[Array], Array]) -> _Asked:
        """Return all of it written otherwise."""
        return _Asked(change(self.still), change(self.rates), change(self.momenta))

    def __add__(self, other: _Asked) -> _Asked:
        return _Asked(self.still + other.still, self.rates + other.rates, self.momenta + other.momenta)


@dataclass(frozen=True, eq=False)
class _Hold:
    """A cup or two fingers, and what they must exert."""

    asked: _Asked
    used: Callable[[Array], Array]
    """Which parts of what it has are used by wrenches (n, 6)."""

    def bears(self, share: float, duration: float) -> bool:
        """Tell whether it bears stops within a duration [s], in both directions, from a share of the planned speed."""
        brake = SUDDEN * share / duration
        return all(
            self.used(self.asked.at(speed, rise)).max() <= 1.0 for speed, rise in product((0.0, share), (-brake, brake))
        )


class StopBearing:
    """What the fingers and the cup of a plan bear of stops."""

    def __init__(self, plan: Plan, duration: float) -> None:
        """Take masses and shapes from the plan of a pile; a stop takes a duration [s], from any speed."""
        self._gravity, self._duration = plan.cell.gravity, duration
        self._bodies = {
            name: _mass_properties(BodyView.of(name, body)) for name, body in plan.bodies.items() if not body.static
        }

    def share(self, segment: Segment) -> float:
        """Return the largest of `SHARES` from which a stop in a segment, in either direction, loses nothing.

        1 where nothing is carried; 0 where not even the least of them is borne.
        """
        if segment.kind is not SegmentKind.TRANSFER:
            return 1.0
        if len(segment.time) < _FEWEST_SAMPLES:
            return 0.0
        holds = list(self._holds(segment))
        borne = takewhile(lambda share: all(hold.bears(share, self._duration) for hold in holds), SHARES)
        return max(borne, default=0.0)

    def _holds(self, segment: Segment) -> Iterator[_Hold]:
        tool = segment.transforms[TOOL_NAME]
        lip = tool[:, :3, 3]
        needed = self._asked(TOOL_NAME, segment, lip)
        for name, ride in segment.rides:
            if ride.to == TOOL_NAME:
                suction = self._asked(name, segment, lip)
                needed += suction
                yield _Hold(suction.each(partial(in_axes, tool)), partial(_used_of_cup, _cup(segment, name)))
        for grip in segment.grips:
            tcp = tool @ grip.T_body_tcp
            about = needed.each(partial(wrench_about, point=lip, about=tcp[:, :3, 3]))
            yield _Hold(about.each(partial(in_axes, tcp)), partial(_used_of_fingers, grip, _finger(segment, grip)))

    def _asked(self, name: str, segment: Segment, about: Array) -> _Asked:
        """Return what must be exerted on a body, about points (n, 3), world axes."""
        body, time, poses = self._bodies[name], segment.time, segment.transforms[name]
        between = body.momenta(time, poses)
        # The ends have what is beside them.
        momenta = np.vstack([between[:1], 0.5 * (between[:-1] + between[1:]), between[-1:]])
        weight = np.tile([*(body.mass * self._gravity), 0.0, 0.0, 0.0], (len(poses), 1))
        asked = _Asked(-weight, -body.inertial_wrenches(time, poses), momenta)
        return asked.each(partial(wrench_about, point=body.centres(poses), about=about))


def _mass_properties(body: BodyView) -> MassProperties:
    assert body.mass is not None, "what moves has a mass"
    return MassProperties(body.mass, body.com, body.inertia)


def _used_of_cup(cup: CupData, wrenches: Array) -> Array:
    pulls = wrenches.copy()
    # A lip bears any pressure.
    pulls[:, 2] = np.maximum(pulls[:, 2], 0.0)
    return cup_uses(pulls, cup)


def _used_of_fingers(grip: Grip, finger: SoftFingerContact, wrenches: Array) -> Array:
    assert grip.squeeze is not None, "a plan that may be executed states every squeeze"
    return least_squeeze(wrenches, grip.width, finger.mu, finger.eps) / grip.squeeze


def _cup(segment: Segment, name: str) -> CupData:
    contact = next(each for each in segment.contacts if isinstance(each, SuctionContact) and each.body == name)
    return CupData(contact.radius, contact.limit, contact.mu, contact.kappa)


def _finger(segment: Segment, grip: Grip) -> SoftFingerContact:
    return next(each for each in segment.contacts if isinstance(each, SoftFingerContact) and each.by == grip.arm)
