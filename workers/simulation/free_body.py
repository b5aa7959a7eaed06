"""A rigid body in PyBullet that moves as forces say."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from planners.geometry.pose import Array, Transform, inverse, skew, to_pose7, transform
from planners.geometry.surface import hull_with_faces
from planners.regrasp.statics.mass_properties import MassProperties
from planners.scene.body import Body
from workers.simulation.arm_urdf import write_hull
from workers.simulation.bullet_shapes import convex_shape, hull_shape
from workers.simulation.cell_world import CellWorld
from workers.simulation.physics import bullet

_DIAGONAL = 1e-9
"""Products of inertia, over the greatest moment, below which the body's own axes are principal axes [1]."""


class FreeBody:
    """A body with mass; PyBullet's frame of it is in its centre of mass, along its principal axes."""

    def __init__(self, body: Body, world: CellWorld, mass: float) -> None:
        """Put a body where it is at the start.

        Args:
            body: evenly filled about its stated centre of mass.
            world: to put it into.
            mass: its true one [kg].
        """
        self.name, self.mass = body.name, mass
        properties = MassProperties.homogeneous(mass, body.com, *body.solid.surface())
        axes, moments = _principal(properties.tensor)
        self._T_center_body = inverse(transform(axes, body.com))
        self._moments = moments
        self._client = world.client
        self.id = _create(body, self._T_center_body, mass, moments, self._client)
        pose = to_pose7(body.T_world_body @ inverse(self._T_center_body))
        bullet.resetBasePositionAndOrientation(self.id, pose[:3], [*pose[4:], pose[3]], physicsClientId=self._client)
        world.surface(self.id)
        bullet.changeDynamics(
            self.id, -1, localInertiaDiagonal=moments, contactProcessingThreshold=0.0, physicsClientId=self._client
        )
        self.center, self.velocity, self.spin = np.zeros(3), np.zeros(3), np.zeros(3)
        """(3,) centre of mass [m], its velocity [m/s], angular velocity [rad/s]; world axes."""
        self._R = np.eye(3)
        self._inertia_inverse: Array | None = None
        """World axes; computed once a step where it is asked for."""
        self.read()

    def read(self) -> None:
        """Take over where the physics has moved it."""
        position, xyzw = bullet.getBasePositionAndOrientation(self.id, physicsClientId=self._client)
        linear, angular = bullet.getBaseVelocity(self.id, physicsClientId=self._client)
        self._R = np.array(bullet.getMatrixFromQuaternion(xyzw)).reshape(3, 3)
        self.center, self.velocity, self.spin = np.array(position), np.array(linear), np.array(angular)
        self._inertia_inverse = None

    @property
    def T_world_body(self) -> Transform:
        """Where the body's own frame is."""
        return transform(self._R, self.center) @ self._T_center_body

    def twist_at(self, point: Array) -> Array:
        """Return the (6,) velocity of the body at a point (3,) of the world, world axes."""
        return np.concatenate([self.velocity + skew(self.spin) @ (point - self.center), self.spin])

    def mobility(self, one: Array, other: Array) -> Array:
        """Return (6, 6): how fast the twist at a point changes under a wrench about another point, world axes."""
        if self._inertia_inverse is None:
            self._inertia_inverse = (self._R / self._moments) @ self._R.T
        inertia_inverse = self._inertia_inverse
        a, b = skew(one - self.center), skew(other - self.center)
        W = np.empty((6, 6))
        W[:3, 3:] = -a @ inertia_inverse
        W[:3, :3] = W[:3, 3:] @ b + np.eye(3) / self.mass
        W[3:, :3] = inertia_inverse @ b
        W[3:, 3:] = inertia_inverse
        return W

    def push(self, wrench: Array, point: Array) -> None:
        """Exert a (6,) wrench about a point (3,) of the world during the next step, world axes."""
        bullet.applyExternalForce(self.id, -1, wrench[:3], point, bullet.WORLD_FRAME, physicsClientId=self._client)
        bullet.applyExternalTorque(self.id, -1, wrench[3:], bullet.WORLD_FRAME, physicsClientId=self._client)

    def let_touch(self, other: FreeBody, *, touches: bool) -> None:
        """Let two bodies collide, or pass through one another."""
        bullet.setCollisionFilterPair(self.id, other.id, -1, -1, int(touches), physicsClientId=self._client)


def _principal(tensor: Array) -> tuple[Array, Array]:
    """Return the (3, 3) rotation of the principal axes, right-handed, and the (3,) moments."""
    off = np.abs(tensor - np.diag(np.diag(tensor))).max()
    if off <= _DIAGONAL * np.diag(tensor).max():
        return np.eye(3), np.diag(tensor).copy()
    moments, axes = np.linalg.eigh(tensor)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] *= -1.0
    return axes, moments


def _create(body: Body, T_center_body: Transform, mass: float, moments: Array, client: int) -> int:
    part, *others = body.solid.convex_parts
    if others:
        return _load_compound(body, T_center_body, mass, moments, client)
    if np.array_equal(T_center_body[:3, :3], np.eye(3)):
        shape = convex_shape(body, T_center_body[:3, 3], client)
    else:
        shape = hull_shape(part.vertices @ T_center_body[:3, :3].T + T_center_body[:3, 3], client)
    return bullet.createMultiBody(mass, shape, physicsClientId=client)


def _load_compound(body: Body, T_center_body: Transform, mass: float, moments: Array, client: int) -> int:
    """Load several convex parts as one body; PyBullet takes them from files only."""
    ixx, iyy, izz = moments.tolist()
    with tempfile.TemporaryDirectory() as folder:
        names = [
            write_hull(hull_with_faces(part.vertices), T_center_body, Path(folder) / f"part_{i}.obj")
            for i, part in enumerate(body.solid.convex_parts)
        ]
        shapes = "".join(f'<collision><geometry><mesh filename="{name}"/></geometry></collision>' for name in names)
        inertial = (
            f'<inertial><mass value="{mass:.9g}"/>'
            f'<inertia ixx="{ixx:.9g}" iyy="{iyy:.9g}" izz="{izz:.9g}" ixy="0" ixz="0" iyz="0"/></inertial>'
        )
        path = Path(folder) / "body.urdf"
        path.write_text(f'<robot name="body"><link name="body">{inertial}{shapes}</link></robot>\n')
        flags = bullet.URDF_USE_INERTIA_FROM_FILE
        return bullet.loadURDF(str(path), flags=flags, physicsClientId=client)
