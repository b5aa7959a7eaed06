"""What a moving body's inertia asks of whoever holds it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planners.geometry.pose import Array


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Mass, centre and tensor of inertia of a rigid body, in the body frame."""

    mass: float
    """[kg]"""
    com: Array
    """(3,) [m]."""
    tensor: Array
    """(3, 3) about the centre of mass [kg m^2]."""

    @classmethod
    def homogeneous(cls, mass: float, com: Array, vertices: Array, faces: NDArray[np.int64]) -> MassProperties:
        """Take the tensor of an evenly filled closed surface with (k, 3) outward faces, about a stated centre.

        Nothing but mass and centre is known of a body; the second moments of the tetrahedra between the centre and
        each face are added up, signed.
        """
        a, b, c = (vertices[faces[:, k]] - com for k in range(3))
        volumes = np.einsum("ni,ni->n", a, np.cross(b, c)) / 6.0
        corners = np.stack([a, b, c, a + b + c], axis=1)
        second = np.einsum("n,nki,nkj->ij", volumes, corners, corners) / 20.0 * (mass / volumes.sum())
        return cls(mass, np.asarray(com, dtype=float), np.trace(second) * np.eye(3) - second)

    @cached_property
    def gyration(self) -> float:
        """The largest radius of gyration about the centre of mass [m]."""
        return float(np.sqrt(np.linalg.norm(self.tensor, 2) / self.mass))

    def centres(self, poses: Array) -> Array:
        """Return the centre of mass in the world at poses (n, 4, 4): (n, 3) [m]."""
        return poses[:, :3, :3] @ self.com + poses[:, :3, 3]

    def inertial_wrenches(self, time: Array, poses: Array) -> Array:
        """Return what d'Alembert adds to the weight at every sample of a motion.

        Rates are taken over the two steps about a sample; the first and last sample have those of their neighbours.

        Args:
            time: (n,) [s].
            poses: (n, 4, 4) `T_world_body`.

        Returns:
            (n, 6), minus the rates of change of momentum, world axes, about the centre of mass.
        """
        if len(time) < 3 or np.ptp(poses, axis=0).max() == 0.0:
            return np.zeros((len(time), 6))
        steps = np.diff(time)[:, None]
        rates = np.diff(self.momenta(time, poses), axis=0) / (0.5 * (steps[:-1] + steps[1:]))
        return -np.concatenate([rates[:1], rates, rates[-1:]])

    def momenta(self, time: Array, poses: Array) -> Array:
        """Return the momenta midway between samples (n,) [s] at poses (n, 4, 4) `T_world_body`.

        Returns:
            (n - 1, 6) linear and about the centre of mass, world axes [Ns, Nms].
        """
        steps = np.diff(time)[:, None]
        velocity = np.diff(self.centres(poses), axis=0) / steps
        return np.hstack([self.mass * velocity, self._spins(poses, steps)])

    def _spins(self, poses: Array, steps: Array) -> Array:
        """Return the angular momentum midway between samples: (n - 1, 3), world axes."""
        before, after = poses[:-1, :3, :3], poses[1:, :3, :3]
        turn = np.swapaxes(before, 1, 2) @ after
        # Twice the sine of the angle times the axis, in the axes of the body; steps are small.
        axis = 0.5 * np.stack(
            [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
        )
        sine = np.linalg.norm(axis, axis=1, keepdims=True)
        angle = np.arctan2(sine, 0.5 * (np.trace(turn, axis1=1, axis2=2)[:, None] - 1.0))
        rate = axis * np.where(sine > 1e-12, angle / np.where(sine > 1e-12, sine, 1.0), 1.0) / steps
        # The rate, a turn about a fixed axis, is the same in the axes of the body at both ends of the step.
        spin = (rate @ self.tensor)[:, :, None]
        return 0.5 * (before @ spin + after @ spin)[:, :, 0]
