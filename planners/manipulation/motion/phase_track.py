"""The joints of one arm over one hold phase: approach, every motion of the plate, retreat, without a jump."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planners.geometry.pose import Array, Transform, inverse
from planners.kinematics.inverse import BRANCHES
from planners.kinematics.windings import all_windings
from planners.manipulation.motion.manipulation_sequence import HoldPhase, ManipulationSequence
from planners.manipulation.motion.posture_follower import PostureFollower
from planners.manipulation.reach.hand_reach import HandReach

_TURN = 2.0 * math.pi


@dataclass(eq=False)
class PhaseTrack:
    """The joints of one arm over one phase, continuous from approach to retreat."""

    reach: HandReach
    hold: int
    posture: int
    first: int
    approach: Array
    """(n, 6) from contact to the stand-off, at the first place."""
    motions: dict[int, Array]
    """By place: (m, 6) along the motion that starts there, in its direction."""
    retreat: Array
    """(n, 6) from contact to the stand-off, at the last place; no rows for a hand that stays."""
    carrier_ends: tuple[Transform, Transform]
    """T_plate_carrier at contact and at the stand-off."""

    @classmethod
    def of(
        cls, follower: PostureFollower, sequence: ManipulationSequence, phase: HoldPhase, posture: int
    ) -> PhaseTrack:
        """Follow a posture over its phase, starting in the turns that are nearest to zero."""
        reach, hold = follower.hand(phase.hand), phase.hold.index

        def carriers(place: int) -> Array:
            """The hand's carriers (n, 4, 4) on its straight way to the plate, at a place of the sequence."""
            T_world_plate = follower.poses.poses[sequence.poses[place]].T_world_plate
            return follower.approach_carriers(T_world_plate, phase.hand, hold)

        away = carriers(phase.first)
        approach = reach.follow(away, hold, posture)
        last = approach[0]
        motions: dict[int, Array] = {}
        for place in range(phase.first, phase.last):
            step = sequence.motions[place]
            if step is None:
                continue
            number, forth = step
            samples = follower.samples(number)
            along = _continued(reach, samples if forth else samples[::-1], hold, posture, last)
            motions[place] = along
            last = along[-1]
        retreat = np.empty((0, 6))
        if phase.goes:
            retreat = _continued(reach, carriers(phase.last), hold, posture, last)
        back = inverse(follower.poses.poses[sequence.poses[phase.first]].T_world_plate)
        return cls(reach, hold, posture, phase.first, approach, motions, retreat, (back @ away[0], back @ away[-1]))

    def windings(self, lo: Array, hi: Array) -> Array:
        """Return (k, 6) whole turns [rad] after which the whole phase is within limits."""
        everything = np.concatenate([self.approach, *self.motions.values(), self.retreat])
        return all_windings(np.zeros(6), lo - everything.min(axis=0), hi - everything.max(axis=0))

    def turn(self, turns: Array) -> None:
        """Add whole turns (6,) to all joints [rad]."""
        self.approach = self.approach + turns
        self.retreat = self.retreat + turns
        self.motions = {place: along + turns for place, along in self.motions.items()}

    @property
    def T_flange_plate(self) -> Transform:
        """Pose (4, 4) of the plate in the flange frame, as the hand holds it."""
        return inverse(self.reach.T_plate_flange[self.hold, self.posture // BRANCHES])

    def along(self, place: int) -> Array:
        """Return the joint positions (m, 6) along the motion that starts at a place [rad]."""
        return self.motions[place]

    def exact(self, T_world_carriers: Array, reference: Array) -> Array:
        """Return (n, 6) joint positions at exact poses of the plate, in the turns of `reference`."""
        return self.reach.follow(T_world_carriers, self.hold, self.posture, reference)


def _continued(reach: HandReach, T_world_carriers: Array, hold: int, posture: int, last: Array) -> Array:
    """Follow a posture along carriers (n, 4, 4) from joint positions (6,) that it is at already: (n, 6) [rad]."""
    along = reach.follow(T_world_carriers, hold, posture)
    return along + np.rint((last - along[0]) / _TURN) * _TURN
