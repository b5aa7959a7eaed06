"""The cell with a plate in PyBullet."""

from __future__ import annotations

import numpy as np

from planners.geometry.pose import Array, Transform, to_pose7
from planners.lifting.lift_loop import box_inertia
from planners.scene.lift_scene import PlateLiftScene
from workers.simulation.bullet_shapes import convex_shape
from workers.simulation.cell_world import CellWorld
from workers.simulation.physics import bullet
from workers.simulation.settings import SimulationSettings
from workers.simulation.touch import PlateMotion


class World(CellWorld):
    """The plate is a free rigid body; the support stands still.

    Hands touch the plate only through the forces that are given to `push_plate` and `push_hand`; everything else
    collides.
    """

    def __init__(self, scene: PlateLiftScene, settings: SimulationSettings) -> None:
        """Build the scene at its start."""
        super().__init__(
            scene.cell,
            [body for body in (scene.support, *scene.obstacles) if body is not None],
            scene.start_positions,
            step=settings.step,
            servo_gain=settings.hand.servo_gain,
            friction=settings.contact.friction_factor * scene.friction.environment,
        )
        self._scene = scene
        self._plate = self._free_plate()
        self._motion = self._read_plate()

    def push_plate(self, wrench: Array) -> None:
        """Exert a (6,) wrench on the plate during the next step: world axes, about its centre of mass."""
        self.push_body(self._plate, -1, wrench, self.plate_motion()[1])

    def advance(self) -> None:
        """Take one step of the physics."""
        super().advance()
        self._motion = self._read_plate()

    def plate_motion(self) -> PlateMotion:
        """Return orientation, centre of mass, its velocity and the spin of the plate."""
        return self._motion

    def plate_pose(self) -> Transform:
        """Return `T_world_plate`, of the plate's own frame."""
        R, com, _, _ = self._motion
        T = np.eye(4)
        T[:3, :3] = R
        T[:3, 3] = com - R @ self._scene.plate.com
        return T

    def resting_force(self) -> Array:
        """Return the (3,) force of everything that stands still on the plate in the last step [N]."""
        total = np.zeros(3)
        for contact in bullet.getContactPoints(bodyA=self._plate, physicsClientId=self.client):
            # The normal points from B to A, the plate; friction is told as it acts on B.
            for size, axis in ((contact[9], contact[7]), (-contact[10], contact[11]), (-contact[12], contact[13])):
                total += size * np.array(axis)
        return total

    def _free_plate(self) -> int:
        plate, client = self._scene.plate, self.client
        T = plate.T_world_body
        pose = to_pose7(T)
        center = T[:3, :3] @ plate.com + T[:3, 3]
        # The body's frame is put into its centre of mass, so that nobody has to tell the two apart.
        body = bullet.createMultiBody(
            plate.mass or 1.0, convex_shape(plate, -plate.com, client), basePosition=center,
            baseOrientation=[*pose[4:], pose[3]], physicsClientId=client,
        )  # fmt: skip
        inertia = box_inertia(np.ptp(plate.solid.convex.vertices, axis=0), plate.mass or 1.0)
        self.surface(body)
        bullet.changeDynamics(body, -1, localInertiaDiagonal=inertia, physicsClientId=client)
        return body

    def _read_plate(self) -> PlateMotion:
        position, xyzw = bullet.getBasePositionAndOrientation(self._plate, physicsClientId=self.client)
        linear, angular = bullet.getBaseVelocity(self._plate, physicsClientId=self.client)
        R = np.array(bullet.getMatrixFromQuaternion(xyzw)).reshape(3, 3)
        return R, np.array(position), np.array(linear), np.array(angular)
