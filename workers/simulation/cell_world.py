"""A cell in PyBullet: what stands still, and arms whose joints are driven at the robot's rate."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from planners.cell.cell import Cell
from planners.geometry.pose import Array, Transform, to_pose7
from planners.kinematics.forward import flange_pose, jacobian
from planners.scene.body import Body
from workers.simulation.arm_urdf import write_arm_urdf
from workers.simulation.bullet_shapes import box_shape, hull_shape
from workers.simulation.physics import bullet, quiet

_LAST_LINK = 5
"""That carries the hand."""
_SOLVER_ITERATIONS = 60


class CellWorld:
    """One physics server of its own; use as a context.

    Table, platform, tool rest and obstacles stand still; both arms are chains of rigid links whose joints a velocity
    servo drives within their torques. Fingers, pads and tips collide with nothing: what they do to what they hold is
    given to `push_hand`.
    """

    def __init__(
        self,
        cell: Cell,
        still: Iterable[Body],
        start_positions: Array,
        *,
        step: float,
        servo_gain: float,
        friction: float,
    ) -> None:
        """Build the cell.

        Args:
            cell: what it is.
            still: other bodies that never move.
            start_positions: (12,) of all joints [rad].
            step: of the physics [s].
            servo_gain: part of a joint's position error that is made good in one step [1].
            friction: between any two surfaces [1].
        """
        self.cell, self._step, self._servo_gain = cell, step, servo_gain
        # PyBullet multiplies the coefficients of two surfaces.
        self._friction = float(np.sqrt(friction))
        with quiet():
            self.client = bullet.connect(bullet.DIRECT)
            self._build(still, start_positions)
        self.positions = start_positions.copy()
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
        bullet.disconnect(self.client)

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
                physicsClientId=self.client,
            )

    def push_hand(self, arm: str, wrench: Array, place: Array) -> None:
        """Exert a (6,) wrench on an arm's hand during the next step: world axes, about a point (3,) of the world."""
        self.push_body(self._arms[arm], _LAST_LINK, wrench, place)

    def advance(self) -> None:
        """Take one step of the physics."""
        bullet.stepSimulation(physicsClientId=self.client)
        for i, arm in enumerate(self._arms.values()):
            part = slice(6 * i, 6 * i + 6)
            states = bullet.getJointStates(arm, range(6), physicsClientId=self.client)
            self.positions[part] = [state[0] for state in states]
            self.velocities[part] = [state[1] for state in states]
            self.torque_use[part] = [state[3] for state in states]
            self.torque_use[part] /= self._torque_max[part]

    def hand(self, arm: str, T_flange_hand: Transform) -> tuple[Transform, Array]:
        """Return `T_world_hand` and its (6,) twist about its origin, world axes."""
        i = list(self._arms).index(arm)
        part = slice(6 * i, 6 * i + 6)
        body = self.cell.arms[arm]
        q = np.ascontiguousarray(self.positions[part])
        T = flange_pose(body.dh, body.T_world_base, q) @ T_flange_hand
        J = jacobian(body.dh, body.T_world_base, q, np.ascontiguousarray(T[:3, 3]))
        return T, J @ self.velocities[part]

    def push_body(self, body: int, link: int, wrench: Array, place: Array) -> None:
        """Exert a (6,) wrench on a link during the next step: world axes, about a point (3,) of the world."""
        bullet.applyExternalForce(body, link, wrench[:3], place, bullet.WORLD_FRAME, physicsClientId=self.client)
        bullet.applyExternalTorque(body, link, wrench[3:], bullet.WORLD_FRAME, physicsClientId=self.client)

    def surface(self, body: int) -> None:
        """Give a body the surface that all bodies have."""
        bullet.changeDynamics(
            body, -1, lateralFriction=self._friction, restitution=0.0, rollingFriction=0.0, spinningFriction=0.0,
            linearDamping=0.0, angularDamping=0.0, physicsClientId=self.client,
        )  # fmt: skip

    def _build(self, still: Iterable[Body], start_positions: Array) -> None:
        client = self.client
        bullet.setTimeStep(self._step, physicsClientId=client)
        bullet.setPhysicsEngineParameter(
            numSolverIterations=_SOLVER_ITERATIONS, deterministicOverlappingPairs=1, physicsClientId=client
        )
        bullet.setGravity(*self.cell.gravity, physicsClientId=client)
        for static in self.cell.boxes:
            self._static(box_shape(static.size, client), [*static.center, 1.0, 0.0, 0.0, 0.0])
        for body in still:
            for part in body.solid.convex_parts:
                self._static(hull_shape(part.vertices, client), to_pose7(body.T_world_body))
        self._arms = _load_arms(self.cell, client)
        self._torque_max = np.concatenate([arm.torque_max for arm in self.cell.arms.values()])
        for i, arm in enumerate(self._arms.values()):
            for joint in range(6):
                bullet.resetJointState(arm, joint, start_positions[6 * i + joint], physicsClientId=client)

    def _static(self, shape: int, pose: list[float]) -> None:
        body = bullet.createMultiBody(
            0.0, shape, basePosition=pose[:3], baseOrientation=[*pose[4:], pose[3]], physicsClientId=self.client
        )
        self.surface(body)


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
