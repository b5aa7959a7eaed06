"""Wrenches and twists: six numbers each, the linear part first.

A wrench is `[f; tau]` (N, Nm), a twist `[v; omega]` (m/s, rad/s); both are written in named axes about a
named point, and their inner product is power.
"""

from __future__ import annotations

import numpy as np

from planners.geometry.pose import Array, Transform, skew


def grasp_map(T_object_contact: Transform) -> Array:
    """Return the (6, 6) that takes a wrench from a contact frame to the object frame.

    Paper B, eq. (2): `[[R, 0], [S(p) R, R]]`, force first. Its transpose takes a twist the other way.
    """
    R = T_object_contact[:3, :3]
    G = np.zeros((6, 6))
    G[:3, :3] = R
    G[3:, 3:] = R
    G[3:, :3] = skew(T_object_contact[:3, 3]) @ R
    return G


def rotated(R_a_b: Array, sixes_b: Array) -> Array:
    """Write wrenches or twists (..., 6), given in the axes of b, in the axes of a; the point stays."""
    return (sixes_b.reshape(*sixes_b.shape[:-1], 2, 3) @ R_a_b.T).reshape(sixes_b.shape)


def wrench_about(wrench: Array, point: Array, about: Array) -> Array:
    """Move a wrench (..., 6) given about `point` to the point `about`; all in the same axes [m]."""
    moved = wrench.copy()
    lever = point - about
    for i in range(3):  # np.cross takes ten times as long for few
        j, k = (i + 1) % 3, (i + 2) % 3
        moved[..., 3 + i] += lever[..., j] * wrench[..., k] - lever[..., k] * wrench[..., j]
    return moved


def in_axes(poses: Array, wrenches: Array) -> Array:
    """Write wrenches (n, 6), given in world axes, in the axes of frames (n, 4, 4); the point stays."""
    return np.einsum("nji,nkj->nki", poses[:, :3, :3], wrenches.reshape(-1, 2, 3)).reshape(-1, 6)
