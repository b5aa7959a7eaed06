"""What holds the tool, and the object on it: compliant in all six directions, until it gives way.

All bonds of a chain hand, tool, object are solved together and implicitly, as of the end of the step. So a hold may be
as stiff as rubber is, and what it holds as light as it likes, without the step having to be shorter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planners.contract.quantities import SOFT_FINGER_EPS
from planners.geometry.pose import Array, Transform, inverse, rotation_angle, small_motion
from planners.plan.segment import Grip
from planners.regrasp.statics.finger_forces import least_squeeze
from planners.regrasp.suction.suction_hold import SuctionLimit, suction_margins
from planners.scene.suction_tool import CupData
from planners.scene.tool_scene import SuctionToolScene
from workers.simulation.settings import BondStiffness, EnduranceSettings, TakingSettings, ToolSimulationSettings
from workers.simulation.world import FreeBody


class Bond:
    """Ties a child to a parent's frame as the two are when it is made; it pulls at the parent's origin."""

    def __init__(
        self, child: FreeBody, parent: FreeBody | None, T_world_parent: Transform, give: BondStiffness
    ) -> None:
        """Tie them.

        Args:
            child: what is held.
            parent: what holds it; None: a hand, whose way is given.
            T_world_parent: the frame at whose origin it is held.
            give: its compliance.
        """
        self.child, self.parent = child, parent
        self.stiffness = np.array([give.linear] * 3 + [give.angular] * 3)
        self.damping = give.damping_time * self.stiffness
        self.T_world_parent = T_world_parent
        self.hand_twist = np.zeros(6)
        """(6,) velocity of a hand at the origin of its frame, world axes."""
        self.wrench: Array = np.zeros(6)
        """(6,) on the child about the parent's origin, world axes [N, Nm]."""
        self._T_child_parent = inverse(child.T_world_body) @ T_world_parent

    @property
    def point(self) -> Array:
        """(3,) where it acts, in the world [m]."""
        return self.T_world_parent[:3, 3]

    def follow(self, T_world_parent: Transform, hand_twist: Array | None = None) -> None:
        """Tell it where its parent is now, and how a hand moves."""
        self.T_world_parent = T_world_parent
        if hand_twist is not None:
            self.hand_twist = hand_twist

    def wrench_in_parent(self) -> Array:
        """Return the wrench (6,) on the child in the axes of the parent's frame."""
        return (self.wrench.reshape(2, 3) @ self.T_world_parent[:3, :3]).reshape(6)

    def displacement(self) -> Array:
        """Return how far (6,) the parent is ahead of the child, world axes [m, rad]."""
        T_world_rest = self.child.T_world_body @ self._T_child_parent
        # The sine of the angle times the axis: holds give way by few degrees.
        return small_motion(T_world_rest, self.T_world_parent)

    def lead(self, gained: Array) -> Array:
        """Return how fast (6,) the parent moves ahead, where free bodies have gained a velocity (3,) by themselves."""
        gain = np.concatenate([gained, np.zeros(3)])
        parent = self.hand_twist if self.parent is None else self.parent.twist_at(self.point) + gain
        return parent - self.child.twist_at(self.point) - gain


def exert(bonds: Sequence[Bond], step: float, gravity: Array) -> None:
    """Find the wrenches of bonds for the next step and push the free bodies with them.

    With x how far a parent is ahead, u how fast, K and C stiffness and damping, h the step and W the mobility,
    `F = K (x + h u') + C u'` with `u' = u - h W F` is linear in all wrenches F.

    Args:
        bonds: all there are.
        step: [s].
        gravity: (3,) [m/s^2].
    """
    if not bonds:
        return
    size = 6 * len(bonds)
    matrix, right = np.eye(size), np.empty(size)
    for i, bond in enumerate(bonds):
        rows = slice(6 * i, 6 * i + 6)
        rate = step * bond.stiffness + bond.damping
        right[rows] = bond.stiffness * bond.displacement() + rate * bond.lead(step * gravity)
        for j, other in enumerate(bonds):
            W = _mobility(bond, other)
            if W is not None:
                matrix[rows, 6 * j : 6 * j + 6] += step * rate[:, None] * W
    wrenches = np.asarray(np.linalg.solve(matrix, right), dtype=np.float64).reshape(-1, 6)
    for bond, wrench in zip(bonds, wrenches, strict=True):
        bond.wrench = wrench
        bond.child.push(wrench, bond.point)
        if bond.parent is not None:
            bond.parent.push(-wrench, bond.point)


def _mobility(one: Bond, other: Bond) -> Array | None:
    """Return (6, 6): how the lead of one bond is lost under the wrench of another; None: not at all."""
    total = None
    for body, sign in ((one.child, 1.0), (one.parent, -1.0)):
        for pushed, push in ((other.child, 1.0), (other.parent, -1.0)):
            if body is not None and body is pushed:
                W = sign * push * body.mobility(one.point, other.point)
                total = W if total is None else total + W
    return total


class Endurance:
    """Remembers for how long a hold has been over its limit."""

    def __init__(self, settings: EnduranceSettings) -> None:
        self._settings, self._over = settings, 0.0

    def lets_go(self, load: float, period: float) -> bool:
        """Tell whether a hold that was asked for `load` times its limit during a period [s] lets go."""
        self._over = self._over + period if load > 1.0 else 0.0
        return load > self._settings.burst or self._over > self._settings.grace


class FingerHold:
    """Two fingers of one hand on the tool."""

    def __init__(
        self,
        planned: Grip,
        tool: FreeBody,
        T_world_tcp: Transform,
        T_flange_tcp: Transform,
        scene: SuctionToolScene,
        settings: ToolSimulationSettings,
    ) -> None:
        """Close them on the tool as it is."""
        self.arm, self._width = planned.arm, planned.width
        self.T_flange_tcp = T_flange_tcp
        self.bond = Bond(tool, None, T_world_tcp, settings.fingers)
        assert planned.squeeze is not None
        self.limit = settings.truth.grip_strength * planned.squeeze
        """With which the fingers squeeze, as the plan commands it [N]."""
        self._mu = settings.truth.grip_friction * scene.friction.grip
        self._endurance = Endurance(settings.endurance)

    @property
    def squeeze(self) -> float:
        """The least squeeze with which the fingers do what they do now [N]."""
        return float(least_squeeze(self.bond.wrench_in_parent()[None], self._width, self._mu, SOFT_FINGER_EPS)[0])

    def lets_go(self, squeeze: float, period: float) -> str | None:
        """Say why the fingers lose the tool after a period [s] of needing a squeeze [N]; None while they do not."""
        if not self._endurance.lets_go(squeeze / self.limit, period):
            return None
        return (
            f"the tool slipped in the {self.arm} hand: {squeeze:.0f} N of squeeze were needed, the fingers "
            f"squeeze with {self.limit:.0f} N"
        )


@dataclass(frozen=True)
class CupLoad:
    """What a cup is asked for."""

    pull: float
    """Outward along its axis [N]."""
    share: float
    """Of what it bears, by the limit that is nearest [1]."""
    limit: SuctionLimit


class CupHold:
    """The cup on an object."""

    def __init__(self, tool: FreeBody, item: FreeBody, cup: CupData, settings: ToolSimulationSettings) -> None:
        """Hold the object as it is; its lip gives way within its cones, and bears any pressure."""
        self.name = item.name
        self.bond = Bond(item, tool, tool.T_world_body, settings.cup)
        strength = settings.truth.cup_strength
        self._cup = replace(cup, max_force=strength * cup.max_force, kappa=strength * cup.kappa)
        self._endurance = Endurance(settings.endurance)

    @property
    def load(self) -> CupLoad:
        """What the cup bears now."""
        wrench = self.bond.wrench_in_parent()
        pull = float(wrench[2])
        wrench[2] = max(0.0, pull)
        margins = suction_margins(wrench, self._cup)
        weakest = int(np.argmin(margins))
        return CupLoad(pull, 1.0 - float(margins[weakest]), tuple(SuctionLimit)[weakest])

    def lets_go(self, load: CupLoad, period: float) -> str | None:
        """Say why the cup loses the object after a period [s] under a load; None while it does not."""
        if not self._endurance.lets_go(load.share, period):
            return None
        return f"{self.name} came off the cup at {load.share:.2f} times what it bears. {load.limit.value}"


def misses_tool(planned: Grip, T_world_tcp: Transform, tool: FreeBody, taking: TakingSettings) -> str | None:
    """Say how fingers that close now miss the tool; None: they get it."""
    T_planned = tool.T_world_body @ planned.T_body_tcp
    distance = float(np.linalg.norm(T_planned[:3, 3] - T_world_tcp[:3, 3]))
    angle = rotation_angle(T_planned[:3, :3], T_world_tcp[:3, :3])
    if distance <= taking.finger_distance and angle <= taking.finger_angle:
        return None
    return f"the fingers of the {planned.arm} hand closed {1e3 * distance:.0f} mm beside the tool"


def leaves_behind(T_tool_item: Transform, tool: FreeBody, item: FreeBody, taking: TakingSettings) -> str | None:
    """Say why a vacuum that comes on now does not hold an object planned to be there; None: it seals."""
    T_found = inverse(tool.T_world_body) @ item.T_world_body @ inverse(T_tool_item)
    offset, gap = float(np.hypot(*T_found[:2, 3])), abs(float(T_found[2, 3]))
    angle = float(np.arccos(np.clip(T_found[2, 2], -1.0, 1.0)))
    if gap <= taking.cup_gap and offset <= taking.cup_offset and angle <= taking.cup_angle:
        return None
    return (
        f"the cup did not seal on {item.name}: it was {1e3 * gap:.0f} mm away, {1e3 * offset:.0f} mm beside its "
        f"place and {np.degrees(angle):.0f} degrees askew"
    )
