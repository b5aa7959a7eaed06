"""Whether cup and fingers bear what they carry at rest, wherever the tool is turned (compiled).

The same laws as `suction_hold` and `finger_forces`, asked as yes or no, so that a motion can be asked at every step
while it is searched.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.cell.arm import Arm
from planners.geometry.pose import Array, Transform
from planners.kinematics.forward import link_frames
from planners.kinematics.inverse import multiply
from planners.regrasp.grasps.tool_grasps import ToolGrasps
from planners.regrasp.statics.finger_forces import least_squeeze
from planners.regrasp.tool_segment import SuckedObject
from planners.scene.body import Body
from planners.scene.tool_scene import SuctionToolScene

_SQRT2, _SQRT3 = math.sqrt(2.0), math.sqrt(3.0)
LEAST_PUSH = 5e-6
"""Push on the cup that is none [N]: rounding, half of what is forgiven in the document."""


class CarriedLoad(NamedTuple):
    """What hangs on the tool, for compiled code; points are in the tool frame."""

    gravity: Array
    """(3,) in the world [m/s^2]."""
    masses: Array
    """(2,) of the tool, and of the object on the cup; 0 for none [kg]."""
    centres: Array
    """(2, 3) of mass [m]."""
    cup: Array
    """(4,) largest force [N], friction, lip radius [m], and the bending torque at which it peels [Nm]."""
    fingers: Array
    """(4,) squeeze, largest normal force [N], friction, and torsional friction [m]."""


@dataclass(frozen=True, eq=False)
class StaticHold:
    """Cup, fingers, payloads and weights of one scene."""

    scene: SuctionToolScene
    reserve: float
    """Part of the fingers' friction that is kept for inertia."""

    def load(self, sucked: SuckedObject | None) -> CarriedLoad:
        """Return what hangs on the tool: itself, and an object if one is sucked."""
        tool, cup = self.scene.tool, self.scene.tool.cup
        centres, masses = np.zeros((2, 3)), np.array([tool.mass, 0.0])
        centres[0] = tool.com
        if sucked is not None:
            body = self._body(sucked.name)
            assert body.mass is not None
            masses[1] = body.mass
            centres[1] = sucked.T_tool_object[:3, :3] @ body.com + sucked.T_tool_object[:3, 3]
        mu = (1.0 - self.reserve) * self.scene.friction.grip
        return CarriedLoad(
            gravity=np.asarray(self.scene.cell.gravity, dtype=float),
            masses=masses,
            centres=centres,
            cup=np.array([cup.max_force, cup.mu, cup.radius, math.pi * cup.radius * cup.kappa]),
            fingers=np.array([self.scene.squeeze, self.scene.grip_force_limit, mu, self.scene.friction.eps]),
        )

    def hanging(self, load: CarriedLoad, T_world_tools: Array) -> NDArray[np.bool_]:
        """Say at which poses of the tool (n, 4, 4) the cup bears its load."""
        return _hanging(load, np.ascontiguousarray(T_world_tools))

    def borne(self, load: CarriedLoad, grasps: ToolGrasps, T_world_tools: Array) -> NDArray[np.bool_]:
        """Say at which poses of the tool (m, 4, 4) the fingers bear the load in which grasp: (m, n)."""
        return _borne(load, grasps.T_tool_tcp, grasps.widths, np.ascontiguousarray(T_world_tools))

    def least_squeezes(self, load: CarriedLoad, grasps: ToolGrasps, T_world_tool: Transform) -> Array:
        """Return the least squeeze with which fingers bear the load at a pose of the tool, in each grasp: (n,) [N].

        What a finger may press with is not asked for.
        """
        supports = -load.masses[:, None] * (T_world_tool[:3, :3].T @ load.gravity)
        force, torque = supports.sum(axis=0), np.cross(load.centres, supports).sum(axis=0)
        R, p = grasps.T_tool_tcp[:, :3, :3], grasps.T_tool_tcp[:, :3, 3]
        # About each TCP, in its axes.
        exerted = np.concatenate([force @ R, np.einsum("nji,nj->ni", R, torque - np.cross(p, force))], axis=1)
        mu, eps = float(load.fingers[2]), float(load.fingers[3])
        return np.array(
            [
                least_squeeze(wrench[None], float(width), mu, eps)[0]
                for wrench, width in zip(exerted, grasps.widths, strict=True)
            ]
        )

    def carried(self, load: CarriedLoad) -> dict[str, bool]:
        """Say by arm whether one hand may carry the load at rest: its net force is the weight, however it is turned."""
        weight = float(load.masses.sum() * np.linalg.norm(load.gravity))
        return {arm: weight <= limit for arm, limit in self.scene.carry_force_limits.items()}

    def _body(self, name: str) -> Body:
        return next(moved.body for moved in self.scene.objects if moved.name == name)


@njit(cache=True, nogil=True)
def _hanging(load: CarriedLoad, T_world_tools: Array) -> NDArray[np.bool_]:
    result = np.empty(T_world_tools.shape[0], np.bool_)
    for k in range(T_world_tools.shape[0]):
        result[k] = cup_bears(load, T_world_tools[k])
    return result


@njit(cache=True, nogil=True)
def _borne(load: CarriedLoad, T_tool_tcp: Array, widths: Array, T_world_tools: Array) -> NDArray[np.bool_]:
    result = np.empty((T_world_tools.shape[0], widths.shape[0]), np.bool_)
    for k in range(T_world_tools.shape[0]):
        for grasp in range(widths.shape[0]):
            result[k, grasp] = fingers_bear(load, T_world_tools[k], T_tool_tcp[grasp], widths[grasp])
    return result


@njit(cache=True, nogil=True)
def cup_bears(load: CarriedLoad, T_world_tool: Transform) -> bool:
    """Say whether the cup alone bears the object at rest with the tool at a pose."""
    if load.masses[1] == 0.0:
        return True
    force, torque = np.zeros(3), np.zeros(3)
    _add_support(load, 1, T_world_tool, force, torque)
    strength, mu, radius, peel = load.cup[0], load.cup[1], load.cup[2], load.cup[3]
    pressed = strength - force[2]
    return (
        force[2] >= -LEAST_PUSH
        and pressed >= 0.0
        and _SQRT3 * math.hypot(force[0], force[1]) <= mu * pressed
        and _SQRT3 * abs(torque[2]) <= radius * mu * pressed
        and _SQRT2 * math.hypot(torque[0], torque[1]) <= peel
    )


@njit(cache=True, nogil=True)
def fingers_bear(load: CarriedLoad, T_world_tool: Transform, T_tool_tcp: Transform, width: float) -> bool:
    """Say whether two fingers bear tool and object at rest with their squeeze, within their largest normal force.

    Each finger has friction left for a torque about the closing axis; both together must reach what is asked for. See
    `finger_forces` for normals and shears.
    """
    force, torque = np.zeros(3), np.zeros(3)
    _add_support(load, 0, T_world_tool, force, torque)
    _add_support(load, 1, T_world_tool, force, torque)
    squeeze, limit, mu, eps = load.fingers[0], load.fingers[1], load.fingers[2], load.fingers[3]
    # About the TCP, then in its axes.
    p = T_tool_tcp[:3, 3]
    about = np.empty(3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        about[i] = torque[i] - (p[j] * force[k] - p[k] * force[j])
    f, m = np.zeros(3), np.zeros(3)
    for i in range(3):
        for j in range(3):
            f[i] += T_tool_tcp[j, i] * force[j]
            m[i] += T_tool_tcp[j, i] * about[j]
    x, z = m[2] / width, m[0] / width
    first = math.hypot(0.5 * f[0] + x, 0.5 * f[2] - z)
    second = math.hypot(0.5 * f[0] - x, 0.5 * f[2] + z)
    n0, n1 = squeeze + 0.5 * f[1], squeeze - 0.5 * f[1]
    if min(n0, n1) < 0.0 or max(n0, n1) > limit or first > mu * n0 or second > mu * n1:
        return False
    room = math.sqrt((mu * n0) ** 2 - first * first) + math.sqrt((mu * n1) ** 2 - second * second)
    return abs(m[1]) / eps <= room


@njit(cache=True, nogil=True)
def _add_support(load, body, T_world_tool, force, torque):
    """Add what bears a body's weight, about the lip's centre and in tool axes."""
    mass, centre = load.masses[body], load.centres[body]
    support = np.zeros(3)
    for i in range(3):
        for j in range(3):
            support[i] -= mass * T_world_tool[j, i] * load.gravity[j]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        force[i] += support[i]
        torque[i] += centre[j] * support[k] - centre[k] * support[j]


@dataclass(frozen=True, eq=False)
class CarryingHand:
    """An arm that carries the tool in one grasp, for asking along edges of its joints."""

    arm: Arm
    T_flange_tool: Transform
    T_tool_tcp: Transform
    width: float
    load: CarriedLoad

    def bears(self, q_from: Array, q_to: Array, step: float, least_cosine: float) -> bool:
        """Say whether cup and fingers bear all along a straight joint motion, tilted by no more than asked.

        Args:
            q_from: (6,) [rad].
            q_to: (6,) [rad].
            step: largest joint step between the places that are looked at [rad].
            least_cosine: of the angle between the tool's axis and the vertical.
        """
        kinematics = (self.arm.dh, self.arm.T_world_base, self.T_flange_tool)
        return _borne_along(kinematics, self.T_tool_tcp, self.width, self.load, (q_from, q_to, step), least_cosine)


@njit(cache=True, nogil=True)
def _borne_along(kinematics, T_tool_tcp, width, load, edge, least_cosine):
    dh, T_world_base, T_flange_tool = kinematics
    q_from, q_to, step = edge
    longest = 0.0
    for i in range(6):
        longest = max(longest, abs(q_to[i] - q_from[i]))
    steps = 1 + math.ceil(longest / step)
    frames, T_world_tool, q = np.empty((7, 4, 4)), np.empty((4, 4)), np.empty(6)
    for k in range(steps + 1):
        for i in range(6):
            q[i] = q_from[i] + k / steps * (q_to[i] - q_from[i])
        link_frames(dh, T_world_base, q, frames)
        multiply(frames[6], T_flange_tool, T_world_tool)
        if T_world_tool[2, 2] < least_cosine or not cup_bears(load, T_world_tool):
            return False
        if not fingers_bear(load, T_world_tool, T_tool_tcp, width):
            return False
    return True
