"""The cell in PyBullet: what stands still, arms whose joints are driven at the robot's rate, and what moves freely."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numba import njit

from planners.cell.cell import Cell
from planners.geometry.pose import Array, Transform, inverse, to_pose7, transform
from planners.geometry.surface import hull_with_faces
from planners.kinematics.forward import frame_motion
from planners.lifting.lift_loop import box_inertia
from planners.regrasp.statics.mass_properties import MassProperties
from planners.scene.body import Body
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.tool_scene import SuctionToolScene
from workers.simulation.bullet import (
    LAYER,
    box_shape,
    bullet,
    convex_shape,
    hull_shape,
    quiet,
    within_layer,
    write_arm_urdf,
    write_hull,
)
from workers.simulation.settings import SimulationSettings, ToolSimulationSettings

_JOINTS = list(range(6))
_LAST_LINK = 5
"""That carries the hand."""
_SOLVER_ITERATIONS = 60
_DIAGONAL = 1e-9
"""Products of inertia, over the greatest moment, below which the body's own axes are principal axes [1]."""
Motion = Array
"""(6, 3): rows 0 to 2 a rotation, then centre of mass in the world, its velocity, and angular velocity, world axes."""


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
        self._chains = {
            name: (arm.dh, arm.T_world_base, self.positions[part], self.velocities[part])
            for (name, arm), part in zip(cell.arms.items(), self._joints.values(), strict=True)
        }
        self._dh = np.array([arm.dh for arm in cell.arms.values()])
        self._T_world_bases = np.array([arm.T_world_base for arm in cell.arms.values()])
        self._torques: Sequence[float] = [0.0] * 12
        self.bodies: dict[str, FreeBody] = {}
        """What moves freely, by name."""

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
        # PyBullet reads lists several times as fast as arrays.
        all_positions, all_velocities = positions.tolist(), velocities.tolist()
        gains, ones = self._servo_gains
        for body, part, most in self._servos:
            bullet.setJointMotorControlArray(
                body, _JOINTS, bullet.POSITION_CONTROL, all_positions[part], all_velocities[part], most, gains, ones,
                self.client,
            )  # fmt: skip

    def push_hand(self, arm: str, wrench: Array, place: Array) -> None:
        """Exert a (6,) wrench on an arm's hand during the next step: world axes, about a point (3,) of the world."""
        _push(self._arms[arm], _LAST_LINK, wrench, place, self.client)

    def add(self, body: Body, mass: float, moments: Array | None = None) -> FreeBody:
        """Put a body where it is at the start, to move freely from now on.

        Args:
            body: what it is.
            mass: its true one [kg].
            moments: (3,) of inertia about its own axes [kg m^2]; None: those of the body evenly filled.
        """
        self.bodies[body.name] = added = FreeBody(body, mass, moments, self.client)
        self._surface(added.id)
        bullet.changeDynamics(added.id, -1, localInertiaDiagonal=added.moments, physicsClientId=self.client)
        return added

    def advance(self) -> None:
        """Take one step of the physics."""
        bullet.stepSimulation(self.client)
        states: list[tuple[float, float, Sequence[float], float]] = []
        for body, _, _ in self._servos:
            states += bullet.getJointStates(body, _JOINTS, self.client)
        self.positions[:], self.velocities[:], _, self._torques = zip(*states, strict=True)
        for body in self.bodies.values():
            body.forget()

    @property
    def torques(self) -> Array:
        """(12,) of the servos in the last step [Nm]."""
        return np.array(self._torques)

    def hand(self, arm: str, T_flange_hand: Transform) -> tuple[Transform, Array]:
        """Return `T_world_hand` and its (6,) twist about its origin, world axes."""
        T_world_hand, twist = np.empty((4, 4)), np.empty(6)
        _move_frame(*self._chains[arm], T_flange_hand, T_world_hand, twist)
        return T_world_hand, twist

    def hands(self, T_flange_hands: Array) -> tuple[Array, Array]:
        """Return what `hand` does for every arm: `T_world_hand` (n, 4, 4) and twists (n, 6) of frames (n, 4, 4)."""
        T_world_hands, twists = np.empty((len(self._dh), 4, 4)), np.empty((len(self._dh), 6))
        _move_frames(
            self._dh, self._T_world_bases, self.positions, self.velocities, T_flange_hands, T_world_hands, twists
        )
        return T_world_hands, twists

    def _surface(self, body: int) -> None:
        """Give a body the surface that all bodies have."""
        bullet.changeDynamics(
            body, -1, lateralFriction=self._friction, restitution=0.0, rollingFriction=0.0, spinningFriction=0.0,
            linearDamping=0.0, angularDamping=0.0, collisionMargin=LAYER, physicsClientId=self.client,
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
        for mesh in self.cell.meshes:
            for part in mesh.mesh.drawn.parts:
                self._static(hull_shape(part.vertices, client), to_pose7(mesh.T_world_mesh))
        for body in still:
            for part in body.solid.convex_parts:
                self._static(hull_shape(part.vertices, client), to_pose7(body.T_world_body))
        self._arms = _load_arms(self.cell, client)
        self._joints = {name: slice(6 * i, 6 * i + 6) for i, name in enumerate(self._arms)}
        self._servos = [
            (self._arms[name], part, self.cell.arms[name].torque_max.tolist()) for name, part in self._joints.items()
        ]
        self._servo_gains = [self._servo_gain] * 6, [1.0] * 6
        for name, part in self._joints.items():
            for joint, position in enumerate(start_positions[part]):
                bullet.resetJointState(self._arms[name], joint, position, physicsClientId=client)

    def _static(self, shape: int, pose: list[float]) -> None:
        body = bullet.createMultiBody(
            0.0, shape, basePosition=pose[:3], baseOrientation=[*pose[4:], pose[3]], physicsClientId=self.client
        )
        self._surface(body)


def _force(contact: Sequence[Any]) -> Array:
    """Return the (3,) force on the first body of a contact as PyBullet tells of it [N]."""
    total = np.zeros(3)
    # The normal points from the second body to the first; friction is told as it acts on the second.
    for size, axis in ((contact[9], contact[7]), (-contact[10], contact[11]), (-contact[12], contact[13])):
        total += size * np.array(axis)
    return total


@njit(cache=True, nogil=True)
def _move_frame(dh, T_world_base, q, velocities, T_flange_frame, T_world_frame, twist):
    """Write what `frame_motion` returns: arrays that are returned cost more than that."""
    T, moved = frame_motion(dh, T_world_base, T_flange_frame, q, velocities)
    T_world_frame[:], twist[:] = T, moved


@njit(cache=True, nogil=True)
def _move_frames(dh, T_world_bases, q, velocities, T_flange_frames, T_world_frames, twists):
    """Write what `frame_motion` returns for each arm; `q` and `velocities` are those of all joints."""
    for i in range(len(dh)):
        joints = slice(6 * i, 6 * i + 6)
        T, moved = frame_motion(dh[i], T_world_bases[i], T_flange_frames[i], q[joints], velocities[joints])
        T_world_frames[i], twists[i] = T, moved


class LiftWorld(CellWorld):
    """The plate is a free rigid body; the support stands still.

    Hands and cup touch the plate only through the forces that it and `push_hand` are given; everything else collides.
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
        mass = scene.plate.mass or 1.0
        self.plate = self.add(scene.plate, mass, box_inertia(np.ptp(scene.plate.solid.convex.vertices, axis=0), mass))

    def resting_force(self) -> Array:
        """Return the (3,) force of everything that stands still on the plate in the last step [N]."""
        arms, plate = set(self._arms.values()), self.plate.id
        touching = bullet.getContactPoints(bodyA=plate, physicsClientId=self.client)
        return sum((_force(each) for each in touching if each[2] not in arms), np.zeros(3))

    def knock(self, arm: str) -> Array | None:
        """Return the wrench on the plate of an arm's hand in the last step, but for pads and tip; None: it is clear.

        (6,), about the plate's centre of mass, world axes [N, Nm].
        """
        touching = bullet.getContactPoints(
            bodyA=self.plate.id, bodyB=self._arms[arm], linkIndexB=_LAST_LINK, physicsClientId=self.client
        )
        if not touching:
            return None
        center = self.plate.motion[3]
        forces = [(_force(each), np.array(each[5]) - center) for each in touching]
        return sum((np.concatenate([force, np.cross(place, force)]) for force, place in forces), np.zeros(6))


class ToolWorld(CellWorld):
    """Tool and objects are free rigid bodies that collide with everything but fingers."""

    def __init__(self, scene: SuctionToolScene, settings: ToolSimulationSettings) -> None:
        """Build the scene at its start."""
        super().__init__(
            scene.cell,
            scene.obstacles,
            scene.start_positions,
            step=settings.step,
            servo_gain=settings.servo_gain,
            friction=scene.friction.environment,
        )
        self.tool = self.add(scene.tool.body, scene.tool.mass)
        for moved in scene.objects:
            self.add(moved.body, settings.truth.object_mass * (moved.body.mass or 1.0))
        for body in self.bodies.values():
            bullet.changeDynamics(body.id, -1, contactProcessingThreshold=0.0, physicsClientId=self.client)


class FreeBody:
    """A body with mass; PyBullet's frame of it is in its centre of mass, along its principal axes."""

    def __init__(self, body: Body, mass: float, moments: Array | None, client: int) -> None:
        """Put a body where it is at the start; see `CellWorld.add`."""
        self.name, self._client = body.name, client
        axes = np.eye(3)
        if moments is None:
            axes, moments = _principal(MassProperties.homogeneous(mass, body.com, *body.solid.surface()).tensor)
        self.moments = moments
        """(3,) principal ones [kg m^2]."""
        self.mass = mass
        """[kg]"""
        self.T_center_body = inverse(transform(axes, body.com))
        """From its own frame to that of its principal axes in its centre of mass."""
        self.id = _create(body, self.T_center_body, mass, moments, client)
        pose = to_pose7(body.T_world_body @ inverse(self.T_center_body))
        bullet.resetBasePositionAndOrientation(self.id, pose[:3], [*pose[4:], pose[3]], physicsClientId=client)
        self._T_world_center = np.eye(4)
        self._motion: Motion | None = None
        self._T_world_body: Transform | None = None
        """Found out once a step where they are asked for."""

    def forget(self) -> None:
        """Forget where it was: the physics has moved it."""
        self._motion = self._T_world_body = None

    @property
    def motion(self) -> Motion:
        """Orientation of its principal axes, centre of mass, its velocity, and spin."""
        if self._motion is None:
            position, xyzw = bullet.getBasePositionAndOrientation(self.id, self._client)
            matrix = bullet.getMatrixFromQuaternion(xyzw)
            linear, angular = bullet.getBaseVelocity(self.id, self._client)
            self._motion = np.array(matrix + position + linear + angular).reshape(6, 3)
        return self._motion

    @property
    def center(self) -> Array:
        """(3,) centre of mass, in the world [m]."""
        return self.motion[3]

    @property
    def T_world_body(self) -> Transform:
        """Where the body's own frame is."""
        if self._T_world_body is None:
            self._T_world_center[:3, :3], self._T_world_center[:3, 3] = self.motion[:3], self.motion[3]
            self._T_world_body = self._T_world_center @ self.T_center_body
        return self._T_world_body

    def push(self, wrench: Array, point: Array) -> None:
        """Exert a (6,) wrench about a point (3,) of the world during the next step, world axes."""
        _push(self.id, -1, wrench, point, self._client)

    def let_touch(self, other: FreeBody, *, touches: bool) -> None:
        """Let two bodies collide, or pass through one another."""
        bullet.setCollisionFilterPair(self.id, other.id, -1, -1, int(touches), physicsClientId=self._client)


def _push(body: int, link: int, wrench: Array, place: Array, client: int) -> None:
    """Exert a (6,) wrench on a link during the next step: world axes, about a point (3,) of the world."""
    # PyBullet reads lists several times as fast as arrays.
    values = wrench.tolist()
    bullet.applyExternalForce(body, link, values[:3], place.tolist(), bullet.WORLD_FRAME, client)
    bullet.applyExternalTorque(body, link, values[3:], bullet.WORLD_FRAME, client)


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
            write_hull(hull_with_faces(within_layer(part.vertices)), T_center_body, Path(folder) / f"part_{i}.obj")
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
