"""What holds the tool, and the object on it: compliant in all six directions, until it gives way.

All bonds of a chain hand, tool, object are solved together and implicitly, as of the end of the step. So a hold may be
as stiff as rubber is, and what it holds as light as it likes, without the step having to be shorter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from planners.cell.cell_size import pad_stiffness
from planners.cell.hand import Gripper
from planners.contract.quantities import SOFT_FINGER_EPS
from planners.geometry.linear import solve
from planners.geometry.pose import Array, Transform, inverse, rotation_angle
from planners.plan.segment import Grip
from planners.regrasp.statics.finger_forces import least_squeeze
from planners.regrasp.suction.suction_hold import SuctionLimit, suction_margins
from planners.scene.suction_tool import CupData
from planners.scene.tool_scene import SuctionToolScene
from workers.simulation.settings import (
    LIP_RADIUS,
    PAD_LENGTH,
    BondStiffness,
    EnduranceSettings,
    TakingSettings,
    ToolSimulationSettings,
)
from workers.simulation.world import FreeBody

_HAND = -1
"""Stands for a parent that is no free body."""


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
        self.T_center_parent: Transform = child.T_center_body @ inverse(child.T_world_body) @ T_world_parent
        """Where the parent is in the frame of the child's centre of mass while nothing gives way."""

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


class Chain:
    """Bonds that act on one another through the bodies that they share; for as long as it is the same ones."""

    def __init__(self, bonds: Sequence[Bond]) -> None:
        """Gather what stays the same from step to step."""
        self.bonds = list(bonds)
        pairs = [(bond.child, bond.parent) for bond in self.bonds]
        self._bodies = list(dict.fromkeys(body for pair in pairs for body in pair if body is not None))
        number: dict[FreeBody | None, int] = {None: _HAND, **{body: i for i, body in enumerate(self._bodies)}}
        self._ties = np.array([[number[child], number[parent]] for child, parent in pairs]).reshape(-1, 2)
        self._give = np.array([[bond.stiffness, bond.damping] for bond in self.bonds])
        self._rests = np.array([bond.T_center_parent for bond in self.bonds])
        self._inertias = np.array([[body.mass, *body.moments] for body in self._bodies])
        count = len(self.bonds)
        self._places, self._twists = np.zeros((count, 4, 4)), np.zeros((count, 6))
        self._states = np.zeros((len(self._bodies), 6, 3))

    def exert(self, step: float, gravity: Array) -> None:
        """Find the wrenches of all bonds for the next step and push the free bodies with them.

        With x how far a parent is ahead, u how fast, K and C stiffness and damping, h the step and W the mobility,
        `F = K (x + h u') + C u'` with `u' = u - h W F` is linear in all wrenches F.

        Args:
            step: [s].
            gravity: (3,) [m/s^2].
        """
        if not self.bonds:
            return
        for i, bond in enumerate(self.bonds):
            self._places[i], self._twists[i] = bond.T_world_parent, bond.hand_twist
        for i, body in enumerate(self._bodies):
            self._states[i] = body.motion
        chain = self._ties, self._give, self._rests, self._inertias
        solved = _wrenches(chain, self._states, self._places, self._twists, step, step * gravity)
        wrenches = np.asarray(solved, dtype=np.float64)
        for bond, wrench in zip(self.bonds, wrenches, strict=True):
            bond.wrench = wrench
            bond.child.push(wrench, bond.point)
            if bond.parent is not None:
                bond.parent.push(-wrench, bond.point)


@njit(cache=True, nogil=True)
def _wrenches(chain, states, places, twists, step, gained):
    """Return the (n, 6) wrenches of a chain's bonds, see `Chain.exert`.

    Args:
        chain: (n, 2) child and parent of each bond, (n, 2, 6) stiffness and damping, (n, 4, 4) the parent in the frame
            of the child's centre, and (m, 4) mass and principal moments of each body.
        states: (m, 6, 3) of the bodies.
        places: (n, 4, 4) `T_world_parent`.
        twists: (n, 6) of hands.
        step: [s].
        gained: (3,) velocity that free bodies gain in a step by themselves [m/s].
    """
    ties, give, rests, inertias = chain
    count = len(ties)
    matrix, right = np.eye(6 * count), np.empty(6 * count)
    ahead, child, parent = np.empty(6), np.empty(6), np.empty(6)
    for i in range(count):
        _ahead(states[ties[i, 0]], rests[i], places[i], ahead)
        _twist_at(states[ties[i, 0]], places[i], gained, child)
        parent[:] = twists[i]
        if ties[i, 1] != _HAND:
            _twist_at(states[ties[i, 1]], places[i], gained, parent)
        for k in range(6):
            rate = step * give[i, 0, k] + give[i, 1, k]
            right[6 * i + k] = give[i, 0, k] * ahead[k] + rate * (parent[k] - child[k])
        for j in range(count):
            block = matrix[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]
            for one in range(2):
                for other in range(2):
                    body = ties[i, one]
                    if body != _HAND and body == ties[j, other]:
                        sign = step if one == other else -step
                        _add_mobility(states[body], inertias[body], places[i], places[j], sign, give[i], step, block)
    return solve(matrix, right).reshape(count, 6)


@njit(cache=True, nogil=True)
def _ahead(state, rest, place, out):
    """Write how far (6,) a parent is ahead of a child, world axes [m, rad]."""
    # The child's idea of where the parent is.
    R = np.empty((3, 3))
    for i in range(3):
        x, y, z = state[i]
        for j in range(3):
            R[i, j] = x * rest[0, j] + y * rest[1, j] + z * rest[2, j]
        out[i] = place[i, 3] - (x * rest[0, 3] + y * rest[1, 3] + z * rest[2, 3] + state[3, i])
    # The sine of the angle times the axis: holds give way by few degrees.
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        turn = 0.0
        for m in range(3):
            turn += place[k, m] * R[j, m] - place[j, m] * R[k, m]
        out[3 + i] = 0.5 * turn


@njit(cache=True, nogil=True)
def _twist_at(state, place, gained, out):
    """Write the twist (6,) of a free body at a place at the end of a step in which nothing holds it, world axes."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        turning = state[5, j] * (place[k, 3] - state[3, k]) - state[5, k] * (place[j, 3] - state[3, j])
        out[i] = state[4, i] + turning + gained[i]
        out[3 + i] = state[5, i]


@njit(cache=True, nogil=True)
def _add_mobility(state, inertia, one, other, sign, give, step, out):  # noqa: PLR0913 - one compiled pass
    """Add how a bond's force changes by another's wrench: rate x mobility of the body that both act on."""
    # The inverse inertia J, and the matrices of the cross products with both levers.
    J, a, b, aJ = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for m in range(3):
                J[i, j] += state[i, m] / inertia[1 + m] * state[j, m]
        j, k = (i + 1) % 3, (i + 2) % 3
        a[j, k], a[k, j] = state[3, i] - one[i, 3], one[i, 3] - state[3, i]
        b[j, k], b[k, j] = state[3, i] - other[i, 3], other[i, 3] - state[3, i]
    for i in range(3):
        for j in range(3):
            for m in range(3):
                aJ[i, j] += a[i, m] * J[m, j]
    for i in range(3):
        linear, angular = sign * (step * give[0, i] + give[1, i]), sign * (step * give[0, 3 + i] + give[1, 3 + i])
        out[i, i] += linear / inertia[0]
        for j in range(3):
            out[i, 3 + j] -= linear * aJ[i, j]
            out[3 + i, 3 + j] += angular * J[i, j]
            for m in range(3):
                out[i, j] -= linear * aJ[i, m] * b[m, j]
                out[3 + i, j] += angular * J[i, m] * b[m, j]


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
        self.T_flange_tcp = T_flange_tcp.copy()
        hand = scene.cell.arms[planned.arm].hand
        assert isinstance(hand, Gripper)
        give = settings.fingers.of_other_rubber(pad_stiffness(hand.pad_size), hand.pad_size[2] / PAD_LENGTH)
        self.bond = Bond(tool, None, T_world_tcp, give)
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
        # The same lip has as many springs for its length.
        wider = cup.radius / LIP_RADIUS
        give = settings.cup.of_other_rubber(wider, wider)
        self.bond = Bond(item, tool, tool.T_world_body, give)
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
