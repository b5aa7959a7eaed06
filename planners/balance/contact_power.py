"""The most power each contact can put into the plate while the plate moves with a given twist.

These are the support functions of the bounded wrench sets of (5c)-(5j), in closed form. All points are levers
from the centre of mass and all vectors are in plate axes; leading axes broadcast.
"""

from __future__ import annotations

import numpy as np

from planners.balance.contacts import Friction, HandLimits, StandingCones
from planners.geometry.pose import Array

_RELIEF_SHARES = np.array([0.0, 0.5, 1.0])
"""Shares of the mean finger velocity tried as the multiplier of the gripper's net limit."""


def point_velocity(twists: Array, levers: Array) -> Array:
    """Return the velocities (..., 3) [m/s] of the points at `levers` (..., 3) [m] for `twists` (..., 6)."""
    v, w = twists[..., :3], twists[..., 3:]
    x, y, z = levers[..., 0], levers[..., 1], levers[..., 2]
    p, q, r = w[..., 0], w[..., 1], w[..., 2]
    return np.stack([v[..., 0] + q * z - r * y, v[..., 1] + r * x - p * z, v[..., 2] + p * y - q * x], axis=-1)


def grip_power(
    twists: Array,
    levers: Array,
    normals: Array,
    friction: Friction,
    limits: HandLimits,
    net_multiplier: Array | None = None,
) -> Array:
    """Return an upper bound (...) of a gripper's power [W], with `levers` [m] and `normals` (..., 2, 3).

    The fingers' own limits give a bound over the fingers: free ones each do their best, those of a squeeze share
    normal forces of 2 s, so that the better one may have them all. The limit on their net force relaxes it: for any
    velocity m, net |m| + (the bound with m taken off both fingers' velocities) is a bound too. A few m along the
    mean velocity are tried, and `net_multiplier` (..., 3), with which the bound is exact if m is the optimal one.
    """
    velocities = point_velocity(twists[..., None, :], levers)
    spins = friction.eps * _dot(twists[..., None, 3:], normals)
    mean = velocities.mean(axis=-2)
    multipliers = _RELIEF_SHARES[:, None] * mean[..., None, :]
    if net_multiplier is not None:
        given = np.broadcast_to(net_multiplier, mean.shape)[..., None, :]
        multipliers = np.concatenate([multipliers, given], axis=-2)
    relieved = velocities[..., None, :, :] - multipliers[..., None, :]
    powers = _cone_power(relieved, normals[..., None, :, :], friction.grip, spins[..., None, :])
    if limits.squeeze is None:
        net, fingers = limits.grip, limits.normal * np.maximum(0.0, powers).sum(axis=-1)
    else:
        net, fingers = min(limits.grip, limits.normal), 2.0 * limits.squeeze * powers.max(axis=-1)
    return (fingers + net * np.sqrt(_dot(multipliers, multipliers))).min(axis=-1)


def push_power(twists: Array, levers: Array, normals: Array, friction: Friction, limits: HandLimits) -> Array:
    """Return the most power (...) of a pushing hand [W], with `levers` [m] and `normals` (..., 3)."""
    velocities = point_velocity(twists, levers)
    outward, along = _split(velocities, normals)
    reach = min(limits.normal, limits.push)
    # The force lies in a plane figure: the cone up to `normal`, cut by a circle of radius `push`.
    edge = min(limits.normal, limits.push / np.hypot(1.0, friction.push))
    corner = min(friction.push * reach, np.sqrt(limits.push**2 - reach**2))
    corners = np.maximum(edge * (outward + friction.push * along), reach * outward + corner * along)
    speed = np.hypot(outward, along)
    on_arc = (outward * limits.push <= reach * speed) & (along <= friction.push * outward)
    return np.maximum(0.0, np.where(on_arc, limits.push * speed, corners))


def environment_power(twists: Array, levers: Array, cones: StandingCones) -> Array:
    """Return the most power (...) of what the plate stands on [W], with `levers` (..., k, 3) [m].

    Of the bounds of the normal forces of all points together the best point takes all.
    """
    if levers.shape[-2] == 0:
        return np.zeros(np.broadcast_shapes(twists.shape[:-1], cones.normals.shape[:-2]))
    velocities = point_velocity(twists[..., None, :], levers)
    powers = cones.largest * _cone_power(velocities, cones.normals, cones.mu, 0.0)
    return np.maximum(0.0, powers.max(axis=-1))


def _cone_power(velocities: Array, normals: Array, mu: Array | float, spins: Array | float) -> Array:
    """Return the most power (...) per newton of normal force in a friction cone [W/N]; negative when none helps.

    Velocities and unit normals are (..., 3), in the same axes; `spins` (...) of soft fingers are times eps [m/s].
    """
    outward, along = _split(velocities, normals)
    return outward + mu * np.sqrt(along**2 + np.square(spins))


def _split(velocities: Array, normals: Array) -> tuple[Array, Array]:
    """Return components (...) of velocities (..., 3) along unit normals, and the lengths (...) of the rest [m/s]."""
    outward = _dot(velocities, normals)
    rest = velocities - outward[..., None] * normals
    return outward, np.sqrt(_dot(rest, rest))


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...i,...i->...", a, b)
