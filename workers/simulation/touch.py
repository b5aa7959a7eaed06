"""Compliant contacts with friction between a hand and the plate: what pads and tip do, in one compiled step."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from planners.geometry.pose import Array
from workers.simulation.world import Motion


class Touch:
    """Points of one hand on the plate, each a spring and damper within its friction cone.

    A point of the hand is tied to an anchor on the plate. Along the inward normal the spring only presses; across it
    the anchor is dragged along where friction ends, so that sliding is Coulomb friction and sticking is elastic.
    """

    def __init__(
        self,
        points: Array,
        *,
        normal: float,
        tangential: float,
        damping_time: float,
        mu: float,
        radius: float = 0.0,
    ) -> None:
        """Prepare points.

        Args:
            points: (n, 3) in the hand's frame [m].
            normal: stiffness of each [N/m].
            tangential: likewise.
            damping_time: damping over stiffness [s].
            mu: friction.
            radius: of a ball about each point; it is the ball's end along the normal that touches [m].
        """
        count = len(points)
        self.points = np.ascontiguousarray(points)
        self._constants = np.array([normal, tangential, damping_time, mu, radius])
        self._prepared = self._constants[:2].copy()
        self.anchors = np.zeros((count, 3))
        self.normals = np.zeros((count, 3))
        self.preload = np.zeros(count)
        self.slips = np.zeros(count)
        """(n,) how far each point has slid on the plate since it was engaged [m]."""
        self.forces = np.zeros((count, 3))
        """(n,) that the points exert on the plate now, world axes [N]."""
        self.engaged = False
        self.force = np.zeros(3)
        """(3,) sum of the forces [N]."""
        self.pressed = False
        """Whether any point presses on the plate."""
        self.slip = 0.0
        """How far the points have slid since they were engaged, on average [m]."""
        self._tied_at = self.anchors
        self._compliance: Array | None = None

    def engage(self, T_plate_hand: Array, normals: Array) -> None:
        """Tie the points to the plate where they are, with the inward `normals` (n, 3), plate frame."""
        self.anchors = self.points @ T_plate_hand[:3, :3].T + T_plate_hand[:3, 3]
        self.engage_at(self.anchors, normals)

    def engage_at(self, anchors: Array, normals: Array) -> None:
        """Tie the points to `anchors` (n, 3) on the plate, with the inward `normals` (n, 3), plate frame."""
        self.anchors = np.ascontiguousarray(anchors, dtype=float)
        self.normals = np.ascontiguousarray(normals, dtype=float)
        self.slips[:] = self.slip = 0.0
        self.engaged = True
        self._compliance = None

    def stiffen(self, times: float) -> None:
        """Make the points, before they are engaged, so many times as stiff as they were prepared [1]."""
        self._constants[:2] = times * self._prepared

    def release(self) -> None:
        """Let go."""
        self.engaged = self.pressed = False
        self.preload[:] = self.forces[:] = self.slip = 0.0
        self.force = np.zeros(3)

    def stiffness(self) -> Array:
        """Return the (6, 6) stiffness against small motions of the hand about the hand's origin, plate axes."""
        normal, tangential = self._constants[:2]
        K = np.zeros((6, 6))
        # The points' places on the plate, about their middle.
        for arm, n in zip(self.anchors - self.anchors.mean(axis=0), self.normals, strict=True):
            k = tangential * np.eye(3) + (normal - tangential) * np.outer(n, n)
            G = np.zeros((6, 3))
            G[:3] = np.eye(3)
            G[3:] = np.array([[0.0, -arm[2], arm[1]], [arm[2], 0.0, -arm[0]], [-arm[1], arm[0], 0.0]])
            K += G @ k @ G.T
        return K

    def compliance(self) -> Array:
        """Return the (6, 6) by which the hand gives way: the inverse of `stiffness`, zero where it resists nothing."""
        # It stays as it is until a point slides.
        if self._compliance is None or not np.array_equal(self._tied_at, self.anchors):
            self._tied_at = self.anchors.copy()
            self._compliance = np.asarray(np.linalg.pinv(self.stiffness(), rcond=1e-8), dtype=float)
        return self._compliance

    def wrench(self, R_world_plate: Array) -> Array:
        """Return the (6,) wrench that it exerts on the plate about the middle of its points, world axes [N, Nm]."""
        return _wrench(R_world_plate, self.anchors, self.forces)

    def act(self, T_world_hand: Array, hand_twist: Array, plate: Motion) -> Array:
        """Compute all forces and return their (6,) total on the plate about its centre of mass, world axes.

        Args:
            T_world_hand: (4, 4).
            hand_twist: (6,) velocity of the hand's origin and angular velocity, world axes.
            plate: where the plate is and how it moves; anchors are in its axes, from the centre of mass.
        """
        total = np.zeros(6)
        if self.engaged:
            # Arrays one by one, and one to write to: tuples, and arrays that are returned, cost more than the algebra.
            self.pressed, self.slip = _act(
                T_world_hand, hand_twist, plate, self.points, self.normals, self.preload, self._constants,
                self.anchors, self.slips, self.forces, total,
            )  # fmt: skip
            self.force = total[:3]
        return total


@njit(cache=True, nogil=True)
def _wrench(R, anchors, forces):
    middle, total = np.zeros(3), np.zeros(6)
    for i in range(anchors.shape[0]):
        for j in range(3):
            middle[j] += anchors[i, j] / anchors.shape[0]
    arm = np.empty(3)
    for i in range(anchors.shape[0]):
        x, y, z = anchors[i, 0] - middle[0], anchors[i, 1] - middle[1], anchors[i, 2] - middle[2]
        for j in range(3):
            arm[j] = R[j, 0] * x + R[j, 1] * y + R[j, 2] * z
        for j in range(3):
            k, m = (j + 1) % 3, (j + 2) % 3
            total[j] += forces[i, j]
            total[3 + j] += arm[k] * forces[i, m] - arm[m] * forces[i, k]
    return total


@njit(cache=True, nogil=True)
def _act(  # noqa: C901, PLR0913 - one compiled pass over all points
    T, twist, plate, points, normals, preload, constants, anchors, slips, forces, total
):
    """Return whether any point presses, and how far the points have slid; write `anchors`, `slips` and `forces`.

    The wrench is added to `total`.
    """
    R, com, velocity, spin = plate[:3], plate[3], plate[4], plate[5]
    kn, kt, time, mu, radius = constants
    pressed, slip = False, 0.0
    hand, wrist = np.empty(3), np.empty(3)
    d, v, n, a, f = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(points.shape[0]):
        for j in range(3):
            wrist[j] = T[j, 0] * points[i, 0] + T[j, 1] * points[i, 1] + T[j, 2] * points[i, 2]
            a[j] = R[j, 0] * anchors[i, 0] + R[j, 1] * anchors[i, 1] + R[j, 2] * anchors[i, 2]
            n[j] = R[j, 0] * normals[i, 0] + R[j, 1] * normals[i, 1] + R[j, 2] * normals[i, 2]
            wrist[j] += radius * n[j]
            hand[j] = wrist[j] + T[j, 3]
            d[j] = hand[j] - com[j] - a[j]
        for j in range(3):
            k, m = (j + 1) % 3, (j + 2) % 3
            v[j] = twist[j] + twist[3 + k] * wrist[m] - twist[3 + m] * wrist[k]
            v[j] -= velocity[j] + spin[k] * a[m] - spin[m] * a[k]
        depth, speed = 0.0, 0.0
        for j in range(3):
            depth += d[j] * n[j]
            speed += v[j] * n[j]
        press = max(0.0, preload[i] + kn * (depth + time * speed))
        size = 0.0
        for j in range(3):
            d[j] -= depth * n[j]
            v[j] -= speed * n[j]
            f[j] = kt * (d[j] + time * v[j])
            size += f[j] * f[j]
        size = math.sqrt(size)
        if size > mu * press:
            scale = mu * press / size
            slid = 0.0
            stretch = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
            # The spring is left as long as friction bears it; the rest of the way the anchor slides.
            keep = min(1.0, mu * press / (kt * stretch)) if stretch > 0.0 else 1.0
            for j in range(3):
                f[j] *= scale
                moved = (1.0 - keep) * d[j]
                slid += moved * moved
                for k in range(3):
                    anchors[i, k] += R[j, k] * moved
            if press > 0.0:
                slips[i] += math.sqrt(slid)
        for j in range(3):
            forces[i, j] = press * n[j] + f[j]
            pressed |= forces[i, j] != 0.0
        for j in range(3):
            k, m = (j + 1) % 3, (j + 2) % 3
            total[j] += forces[i, j]
            total[3 + j] += (hand[k] - com[k]) * forces[i, m] - (hand[m] - com[m]) * forces[i, k]
        slip += slips[i] / points.shape[0]
    return pressed, slip
