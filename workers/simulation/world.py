"""The cell and the plate in PyBullet: bodies, joints driven at the robot's rate, forces from outside."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from planners.geometry.convex import ConvexShape
from planners.geometry.pose import Array, Transform, to_pose7
from planners.kinematics.forward import flange_pose, jacobian
from planners.scene.body import Body
from planners.scene.cell import Cell
from planners.scene.scene import PlateLiftScene
from workers.simulation.arm_urdf import write_arm_urdf
from workers.simulation.settings import SimulationSettings
from workers.simulation.touch import PlateMotion


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep the greeting of PyBullet's C code to itself: stdout may carry a protocol, stderr a progress bar."""
    sys.stdout.flush()
    sys.stderr.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    kept = [(stream, os.dup(stream)) for stream in (1, 2)]
    for stream, _ in kept:
        os.dup2(nowhere, stream)
    os.close(nowhere)
    try:
        yield
    finally:
        # C keeps a buffer of its own.
        ctypes.CDLL(None).fflush(None)
        for stream, copy in kept:
            os.dup2(copy, stream)
            os.close(copy)


with _quiet():
    import pybullet as bullet


_LAST_LINK = 5
"""That carries the hand."""


class World:
    """One physics server of its own; use as a context.

    The plate is a free rigid body; table, support, platform and obstacles stand still; both arms are chains of rigid
    links whose joints a velocity servo drives within their torques. Hands touch the plate only through the forces that
    are given to `push_plate` and `push_hand`; everything else collides.
    """

    def __init__(self, scene: PlateLiftScene, settings: SimulationSettings) -> None:
        """Build the scene at its start."""
        self._scene, self._step = scene, settings.step
        self._servo_gain = settings.hand.servo_gain
        self._friction = settings.contact.friction_factor * scene.friction.environment
        with _quiet():
            self._id = bullet.connect(bullet.DIRECT)
            self._build()
        self.positions = scene.start_positions.copy()
        """(12,) of all joints [rad]."""
        self.velocities = np.zeros(12)
        """[rad/s]"""
        self.torque_use = np.zeros(12)
        """(12,) torque of each joint's servo over its limit [1]."""

    def __enter__(self) -> Self:
        """Enter."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Shut the physics server down."""
        bullet.disconnect(self._id)

    def drive(self, positions: Array, velocities: Array) -> None:
        """Set the (12,) targets of all joints for the next step [rad, rad/s]."""
        for i, arm in enumerate(self._arms.values()):
            part = slice(6 * i, 6 * i + 6)
            bullet.setJointMotorControlArray(
                arm,
                range(6),
                bullet.POSITION_CONTROL,
                targetPositions=positions[part],
                targetVelocities=velocities[part],
                forces=self._torque_max[part],
                positionGains=[self._servo_gain] * 6,
                velocityGains=[1.0] * 6,
                physicsClientId=self._id,
            )

    def push_plate(self, wrench: Array) -> None:
        """Exert a (6,) wrench on the plate during the next step: world axes, about its centre of mass."""
        self._push(self._plate, -1, wrench, self.plate_motion()[1])

    def push_hand(self, arm: str, wrench: Array, place: Array) -> None:
        """Exert a (6,) wrench on an arm's hand during the next step: world axes, about a point (3,) of the world."""
        self._push(self._arms[arm], _LAST_LINK, wrench, place)

    def advance(self) -> None:
        """Take one step of the physics."""
        bullet.stepSimulation(physicsClientId=self._id)
        for i, arm in enumerate(self._arms.values()):
            part = slice(6 * i, 6 * i + 6)
            states = bullet.getJointStates(arm, range(6), physicsClientId=self._id)
            self.positions[part] = [state[0] for state in states]
            self.velocities[part] = [state[1] for state in states]
            self.torque_use[part] = [state[3] for state in states]
            self.torque_use[part] /= self._torque_max[part]
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

    def hand(self, arm: str, T_flange_hand: Transform) -> tuple[Transform, Array]:
        """Return `T_world_hand` and its (6,) twist about its origin, world axes."""
        i = list(self._arms).index(arm)
        part = slice(6 * i, 6 * i + 6)
        body = self._scene.cell.arms[arm]
        q = np.ascontiguousarray(self.positions[part])
        T = flange_pose(body.dh, body.T_world_base, q) @ T_flange_hand
        J = jacobian(body.dh, body.T_world_base, q, np.ascontiguousarray(T[:3, 3]))
        return T, J @ self.velocities[part]

    def resting_force(self) -> Array:
        """Return the (3,) force of everything that stands still on the plate in the last step [N]."""
        total = np.zeros(3)
        for contact in bullet.getContactPoints(bodyA=self._plate, physicsClientId=self._id):
            # The normal points from B to A, the plate; friction is told as it acts on B.
            for size, axis in ((contact[9], contact[7]), (-contact[10], contact[11]), (-contact[12], contact[13])):
                total += size * np.array(axis)
        return total

    def _push(self, body: int, link: int, wrench: Array, place: Array) -> None:
        bullet.applyExternalForce(body, link, wrench[:3], place, bullet.WORLD_FRAME, physicsClientId=self._id)
        bullet.applyExternalTorque(body, link, wrench[3:], bullet.WORLD_FRAME, physicsClientId=self._id)

    def _build(self) -> None:
        scene, client = self._scene, self._id
        bullet.setTimeStep(self._step, physicsClientId=client)
        bullet.setPhysicsEngineParameter(
            numSolverIterations=60, deterministicOverlappingPairs=1, physicsClientId=client
        )
        bullet.setGravity(*scene.cell.gravity, physicsClientId=client)
        for static in scene.cell.boxes:
            self._static(_box(static.size, client), [*static.center, 1.0, 0.0, 0.0, 0.0])
        for body in (scene.support, *scene.obstacles):
            if body is not None:
                for part in body.solid.convex_parts:
                    self._static(_hull(part, np.zeros(3), client), to_pose7(body.T_world_body))
        self._plate = self._free_plate()
        self._arms = _load_arms(scene.cell, client)
        self._torque_max = np.concatenate([arm.torque_max for arm in scene.cell.arms.values()])
        for i, arm in enumerate(self._arms.values()):
            for joint in range(6):
                position = scene.start_positions[6 * i + joint]
                bullet.resetJointState(arm, joint, position, physicsClientId=client)
        self._motion = self._read_plate()

    def _static(self, shape: int, pose: list[float]) -> None:
        body = bullet.createMultiBody(
            0.0, shape, basePosition=pose[:3], baseOrientation=[*pose[4:], pose[3]], physicsClientId=self._id
        )
        self._surface(body, self._friction)

    def _surface(self, body: int, friction: float) -> None:
        # PyBullet multiplies the coefficients of two bodies: the plate has 1, what stands has the pair's.
        bullet.changeDynamics(
            body, -1, lateralFriction=friction, restitution=0.0, rollingFriction=0.0, spinningFriction=0.0,
            linearDamping=0.0, angularDamping=0.0, physicsClientId=self._id,
        )  # fmt: skip

    def _free_plate(self) -> int:
        plate, client = self._scene.plate, self._id
        T = plate.T_world_body
        pose = to_pose7(T)
        center = T[:3, :3] @ plate.com + T[:3, 3]
        # The body's frame is put into its centre of mass, so that nobody has to tell the two apart.
        body = bullet.createMultiBody(
            plate.mass or 1.0, _shape(plate, -plate.com, client), basePosition=center,
            baseOrientation=[*pose[4:], pose[3]], physicsClientId=client,
        )  # fmt: skip
        x, y, z = np.ptp(plate.solid.convex.vertices, axis=0)
        inertia = (plate.mass or 1.0) / 12.0 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
        self._surface(body, 1.0)
        bullet.changeDynamics(body, -1, localInertiaDiagonal=inertia, physicsClientId=client)
        return body

    def _read_plate(self) -> PlateMotion:
        position, xyzw = bullet.getBasePositionAndOrientation(self._plate, physicsClientId=self._id)
        linear, angular = bullet.getBaseVelocity(self._plate, physicsClientId=self._id)
        R = np.array(bullet.getMatrixFromQuaternion(xyzw)).reshape(3, 3)
        return R, np.array(position), np.array(linear), np.array(angular)


def _load_arms(cell: Cell, client: int) -> Mapping[str, int]:
    arms = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, arm in cell.arms.items():
            pose = to_pose7(arm.T_world_base)
            arms[name] = bullet.loadURDF(
                str(write_arm_urdf(arm, Path(folder))), basePosition=pose[:3], baseOrientation=[*pose[4:], pose[3]],
                useFixedBase=True, flags=bullet.URDF_USE_INERTIA_FROM_FILE, physicsClientId=client,
            )  # fmt: skip
    for arm in arms.values():
        for joint in range(-1, 6):
            bullet.changeDynamics(
                arm, joint, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, physicsClientId=client
            )
    return arms


def _box(size: Array, client: int, at: Array | None = None) -> int:
    return bullet.createCollisionShape(
        bullet.GEOM_BOX, halfExtents=0.5 * size, collisionFramePosition=[0.0, 0.0, 0.0] if at is None else at,
        physicsClientId=client,
    )  # fmt: skip


def _shape(body: Body, at: Array, client: int) -> int:
    """Return the collision shape of a convex body whose own frame is at `at`."""
    if body.shape.type == "box":
        return _box(np.array(body.shape.size), client, at)
    (part,) = body.solid.convex_parts
    return _hull(part, at, client)


def _hull(part: ConvexShape, at: Array, client: int) -> int:
    """Return the collision shape of a convex part whose frame is at `at`."""
    options: dict[str, Any] = {"vertices": (part.vertices + at).tolist()}
    return bullet.createCollisionShape(bullet.GEOM_MESH, physicsClientId=client, **options)
