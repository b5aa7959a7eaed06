"""Whether the path of a plan can still be gone when forces change: another cup, mass, friction or limit, same motion.

A path is a chain of poses, each held by hands, table and cup as the plan says. Where only what bears on the plate
changes, the motion of arms and plate stays as it is, and all there is to ask is program (5) at the poses of the path:
some hundred small programs, where a search of the whole lift takes many thousands. Whether the cup at another place
meets an arm on the way is not looked at, nor are tolerances of mass and centre of mass.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from planners.balance.balanced import HeldPlate, Unbalanced
from planners.balance.contacts import GripContacts, PushContact
from planners.balance.solver import Balance
from planners.geometry.pose import Array, from_pose7
from planners.manipulation.statics.lift_programs import balance_program
from planners.manipulation.statics.reserves import STEPS
from planners.plan.contacts import EnvironmentContact, PointContact, SoftFingerContact
from planners.plan.plan import Plan
from planners.plan.segment import Segment
from planners.scene.lift_scene import PlateLiftScene

FORCES = ("/cup", "/lifter_model", "/friction", "/hand_force_limit", "/plate/mass", "/plate/mass_tolerance")
"""Members of a task that change what bears on the plate, and not where plate and hands can be."""
MOST_RESERVE = 0.64
"""More is not looked for [1]."""
MOST_TIMES = 4.0
"""A limit that must be more than so many times as large is not what is short [1]."""
HALVINGS = 8
"""Of the interval in which it is found how much a limit is short [1]."""
_DIGITS = 6


@dataclass(frozen=True, eq=False)
class PathPose:
    """A pose of the path, and how the plate is held there."""

    held: HeldPlate
    time: float
    """When it is reached first, from the plan's begin [s]."""
    element: str
    """What of the plate touches its support: "face", "edge", "vertex" or "none"."""


@dataclass(frozen=True)
class PathHolds:
    """Every pose of the path is held."""

    reserve: float
    """The largest share of every limit that can be kept back all along, rounded down to a step [1]."""


@dataclass(frozen=True)
class PathFails:
    """At some pose of the path the plate is not held; one limit that is larger may do."""

    time: float
    """Of one such pose [s]."""
    element: str
    """As of a `PathPose`."""
    limit: str | None
    """The limit that is short by the smallest share of itself for the whole path; None where no single one helps."""
    missing: float
    """How much larger it would have to be, rounded up [N]; 0 for None."""


class PathForces:
    """The poses of one lift's path, asked again and again with other forces. Not for two threads at once."""

    def __init__(self, plan: Plan) -> None:
        """Take the poses of a solved plate lift at which a hand is on the plate, each once."""
        self.poses = tuple(_poses(plan))
        # The pose that failed last most likely fails next.
        self._order = list(range(len(self.poses)))

    def ask(self, scene: PlateLiftScene) -> PathHolds | PathFails:
        """Tell whether the path holds, and how well, or where it does not and what is short there.

        Args:
            scene: of the task as it is now; plate, place and obstacles are those of the plan.
        """
        program = balance_program(scene)
        failing = self._failing(program)
        if failing is not None:
            return self._what_is_short(program, failing)
        low, high = 0, int(MOST_RESERVE * STEPS)
        while high - low > 1:
            middle = (low + high) // 2
            if self._failing(program.keeping_back(middle / STEPS)) is None:
                low = middle
            else:
                high = middle
        return PathHolds(low / STEPS)

    def _failing(self, program: Balance) -> PathPose | None:
        """Return a pose that does not hold."""
        for place, number in enumerate(self._order):
            held = self.poses[number].held
            answer = program.solve(held.rotation_world_plate, held.environment_points, held.grip, held.push)
            if isinstance(answer, Unbalanced):
                self._order.insert(0, self._order.pop(place))
                return self.poses[number]
        return None

    def _what_is_short(self, program: Balance, failing: PathPose) -> PathFails:
        """Look for the limit that has to be larger by least of itself for the whole path to hold."""
        limits, cup = program.limits, program.cup
        larger: dict[str, tuple[float, Callable[[float], Balance]]] = {
            "cup": (
                cup.max_force,
                lambda times: program.with_limits(cup=replace(cup, max_force=times * cup.max_force)),
            ),
            "gripping hand": (
                limits.grip,
                lambda times: program.with_limits(
                    limits=replace(limits, grip=times * limits.grip, normal=times * limits.normal)
                ),
            ),
            "pushing hand": (
                limits.pushing,
                lambda times: program.with_limits(
                    limits=replace(limits, push=times * limits.push, normal=times * limits.normal)
                ),
            ),
        }
        found = {name: self._least_share(enlarged) for name, (_, enlarged) in larger.items()}
        shares = {name: share for name, share in found.items() if share is not None}
        if not shares:
            return PathFails(failing.time, failing.element, None, 0.0)
        name = min(shares, key=shares.__getitem__)
        return PathFails(failing.time, failing.element, name, shares[name] * larger[name][0])

    def _least_share(self, enlarged: Callable[[float], Balance]) -> float | None:
        """Return by which share of itself a limit must be larger [1], rounded up; None where that does not help."""
        low, high = 1.0, MOST_TIMES
        if self._failing(enlarged(high)) is not None:
            return None
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self._failing(enlarged(middle)) is None else (middle, high)
        return high - 1.0


def _poses(plan: Plan) -> Iterator[PathPose]:
    """Yield each way in which the plate is held on the path, once."""
    seen: set[bytes] = set()
    T_world_plate = plan.bodies["plate"].T_world_start
    for segment in plan.segments:
        moving = segment.body_poses.get("plate")
        state = "none" if segment.contact_state is None else segment.contact_state.element
        for sample in sorted({contact.sample for contact in segment.contacts}):
            T = T_world_plate if moving is None else from_pose7(moving[sample])
            held = _held(segment, sample, T[:3, :3], T[:3, 3])
            key = _key(held)
            if (held.grip is not None or held.push is not None) and key not in seen:
                seen.add(key)
                yield PathPose(held, float(segment.time[sample]), state)
        if moving is not None:
            T_world_plate = from_pose7(moving[-1])


def _held(segment: Segment, sample: int, R: Array, position: Array) -> HeldPlate:
    """Return how a sample holds the plate, which is turned by R (3, 3), its origin at a position (3,) [m, world]."""
    contacts = [contact for contact in segment.contacts if contact.sample == sample]
    fingers = [each for each in contacts if isinstance(each, SoftFingerContact)]
    fingers.sort(key=lambda each: each.finger or 0)
    tips = [each for each in contacts if isinstance(each, PointContact)]
    points = [R.T @ (each.point - position) for each in contacts if isinstance(each, EnvironmentContact)]
    grip = push = None
    if len(fingers) == 2:
        grip = GripContacts(
            np.array([R.T @ (each.point - position) for each in fingers]),
            np.array([R.T @ each.normal for each in fingers]),
        )
    if tips:
        push = PushContact(R.T @ (tips[0].point - position), R.T @ tips[0].normal)
    return HeldPlate(R, np.array(points).reshape(-1, 3), grip, push)


def _key(held: HeldPlate) -> bytes:
    """Return what two poses share that ask for the same balance: yaw and place of the plate do not matter to it."""
    parts = [held.rotation_world_plate[2], held.environment_points.ravel()]
    parts += [] if held.grip is None else [held.grip.points.ravel()]
    parts += [] if held.push is None else [held.push.point]
    return (np.round(np.concatenate(parts), _DIGITS) + 0.0).tobytes() + bytes([held.grip is None, held.push is None])
