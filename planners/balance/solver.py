"""Solve the balance program (5) of paper B for one plate and lifter, at any pose and with any hands."""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple, Self

import numpy as np
from numba import njit

from planners.balance.balanced import Balanced, Unbalanced, UnbalanceProof, UnbalanceReason
from planners.balance.capacity import LiftCapacity, largest_environment_normal, lift_capacity
from planners.balance.contacts import Cup, Friction, GripContacts, HandForceLimit, PushContact, contact_axes
from planners.balance.lifter import LifterModel, lifter_of
from planners.balance.support import environment_power, grip_power, point_velocity, push_power
from planners.balance.template import TORQUE_LENGTH, Columns, Structure, Template
from planners.errors import LiftwrightError
from planners.geometry.pose import Array, transform
from planners.geometry.wrench import grasp_map

GRAVITY = 9.81
"""[m/s^2], along world -z."""
MAX_RESIDUAL = 1e-9
"""Largest residual of (5b) accepted, relative to the weight (moments at 0.1 m)."""
PROOF_MARGIN = 1e-7
"""A twist proves something when it loses more than this times the weight [m/s]: rounding is 1e-13 of it."""

_DAMPING = 1e-13
"""Of the normal equations that close the balance, relative to their trace."""


class Balance:
    """The balance program of one plate with its cup. Keeps compiled programs: not for two threads at once."""

    def __init__(
        self,
        plate_mass: float,
        plate_com: Array,
        cup: Cup,
        friction: Friction | None = None,
        limits: HandForceLimit | None = None,
        lifter_model: LifterModel = "paper",
        gravity: float = GRAVITY,
    ) -> None:
        """State the plate.

        Args:
            plate_mass: [kg].
            plate_com: (3,), centre of mass in the plate frame [m].
            cup: The lifter's cup.
            friction: Coefficients of all contacts.
            limits: What one hand may do.
            lifter_model: Which forces the lifter can exert.
            gravity: [m/s^2], along world -z.

        Raises:
            LiftwrightError: the mass is not positive, or there is no such lifter model.
        """
        if not plate_mass > 0.0:
            raise LiftwrightError(f"the plate's mass must be positive, but is {plate_mass}")
        self.com = np.array(plate_com, dtype=float)
        self.weight = plate_mass * gravity
        self.cup = cup
        self.friction = friction if friction is not None else Friction()
        self.limits = limits if limits is not None else HandForceLimit()
        self.lifter = lifter_of(lifter_model, cup)
        self.environment_bound = largest_environment_normal(self.weight, self.lifter, self.friction, self.limits)
        self._templates: dict[Structure, Template] = {}
        self._hand_maps: dict[GripContacts | PushContact, Array] = {}
        self._last_rest: tuple[tuple[bytes, bytes], Array] = ((b"", b""), np.empty((6, 0)))
        self._cup_map = grasp_map(transform(cup.T_plate_cup[:3, :3], cup.T_plate_cup[:3, 3] - self.com))

    def solve(
        self,
        rotation_world_plate: Array,
        environment_points: Array,
        grip: GripContacts | None = None,
        push: PushContact | None = None,
    ) -> Balanced | Unbalanced:
        """Find least-effort wrenches, or prove that there are none.

        Args:
            rotation_world_plate: (3, 3), orientation of the plate.
            environment_points: (k, 3), where the plate stands on the table or support, plate frame; k may be 0.
            grip: The gripper's contacts, if it holds the plate.
            push: The stick's contact, if it touches the plate.
        """
        contacts = _Contacts.of(rotation_world_plate, environment_points, grip, push)
        contact_map = self._contact_map(contacts)
        answer = self._attempt(contacts, contact_map, careful=False)
        if isinstance(answer, Unbalanced) and answer.proof is None:
            answer = self._attempt(contacts, contact_map, careful=True)
        return answer

    def _attempt(self, contacts: _Contacts, contact_map: Array, *, careful: bool) -> Balanced | Unbalanced:
        """Solve once. The solver's verdict only says what to check first; the checks decide."""
        template = self._template(Structure(len(contacts.points), contacts.grip is not None, contacts.push is not None))
        gravity = np.zeros(6)
        gravity[:3] = -self.weight * contacts.up
        infeasible, x, z = template.solve(contact_map, gravity, careful=careful)
        proofs = []
        if not infeasible:
            residual = _close_balance(x, contact_map, gravity)
            hands = template.columns.hand_normals
            if hands:
                x[template.columns.hand_effort] = max(x[normal] for normal in hands)
            slack = template.least_slack(x)
            if slack >= 0.0 and np.abs(residual).max() <= MAX_RESIDUAL * self.weight:
                return self._balanced(template, contacts, contact_map, x, residual, slack)
            # What no forces at all can close is square to them: a proof where the solver breaks down.
            proofs.append(_proof_from_dual(residual, np.zeros(3)))
        proofs.append(_proof_from_dual(z[:6], template.net_multiplier(z)))
        return self._unbalanced(contacts, proofs)

    def power_bound(
        self,
        proof: UnbalanceProof,
        rotation_world_plate: Array,
        environment_points: Array,
        grip: GripContacts | None = None,
        push: PushContact | None = None,
    ) -> float:
        """Return the most power of all contacts and the weight along the proof's twist [W].

        Negative proves that this plate, at this pose and held so, cannot be balanced.
        """
        return self._power(proof, _Contacts.of(rotation_world_plate, environment_points, grip, push))

    def capacity(self, max_tilt: float) -> LiftCapacity:
        """Compare the weight with all that can carry the plate off the table, tilted by at most `max_tilt` [rad]."""
        return lift_capacity(self.weight, self.lifter, self.friction, self.limits, max_tilt)

    def _template(self, structure: Structure) -> Template:
        template = self._templates.get(structure)
        if template is None:
            template = Template(structure, self.lifter, self.friction, self.limits)
            self._templates[structure] = template
        return template

    def _contact_map(self, contacts: _Contacts) -> Array:
        """Assemble G of (5b), from the template's variables to wrenches in plate axes about the centre of mass."""
        blocks = []
        if contacts.grip is not None:
            blocks.append(self._hand_map(contacts.grip))
        if contacts.push is not None:
            blocks.append(self._hand_map(contacts.push))
        blocks.append(self._rest_map(contacts))
        return np.concatenate(blocks, axis=1)

    def _rest_map(self, contacts: _Contacts) -> Array:
        """Return the part of G that does not depend on the hands; the last pose's is kept, as holds are many."""
        key = (contacts.up.tobytes(), contacts.points.tobytes())
        if self._last_rest[0] != key:
            blocks = [self._cup_map @ self.lifter.contact_map(contacts.up)]
            if len(contacts.points):
                blocks.insert(0, _force_maps(contact_axes(contacts.up), contacts.points - self.com))
            self._last_rest = (key, np.concatenate(blocks, axis=1))
        return self._last_rest[1]

    def _hand_map(self, hand: GripContacts | PushContact) -> Array:
        known = self._hand_maps.get(hand)
        if known is not None:
            return known
        if isinstance(hand, PushContact):
            block = grasp_map(transform(hand.rotation, hand.point - self.com))[:, :3]
        else:
            fingers = zip(hand.rotations, hand.points - self.com, strict=True)
            scale = np.array([1.0, 1.0, 1.0, self.friction.eps])
            block = np.concatenate([grasp_map(transform(R, p))[:, [0, 1, 2, 5]] * scale for R, p in fingers], axis=1)
        self._hand_maps[hand] = block
        return block

    def _balanced(
        self, template: Template, contacts: _Contacts, contact_map: Array, x: Array, residual: Array, least_slack: float
    ) -> Balanced:
        columns = template.columns
        pull = float(x[columns.pull])
        return Balanced(
            contacts=columns.names,
            frames=partial(contacts.frames, self.cup),
            exerted=partial(self._wrenches, columns, contacts, x),
            hand_wrenches=_hand_wrenches(columns, contact_map, x),
            rotation_world_plate=contacts.rotation_world_plate,
            objective=float(template.cost @ x),
            f_plus_gp=0.0 if columns.hand_effort is None else float(x[columns.hand_effort]),
            f_plus_s=pull,
            suction_force=pull,
            residual_force=math.hypot(*residual[:3]),
            residual_moment=math.hypot(*residual[3:]) * TORQUE_LENGTH,
            least_slack=least_slack,
        )

    def _wrenches(self, columns: Columns, contacts: _Contacts, x: Array) -> Array:
        """Return the wrench of each contact in its own frame, (m, 6)."""
        wrenches = np.zeros((len(columns.names), 6))
        points = [*([columns.push] if columns.push else []), *columns.environment]
        for row, finger in enumerate(columns.fingers):
            wrenches[row, [0, 1, 2, 5]] = x[finger] * [1.0, 1.0, 1.0, self.friction.eps]
        for row, point in enumerate(points, start=len(columns.fingers)):
            wrenches[row, :3] = x[point]
        wrenches[-1] = self.lifter.contact_map(contacts.up) @ x[columns.lifter]
        return wrenches

    def _unbalanced(self, contacts: _Contacts, proofs: list[UnbalanceProof]) -> Unbalanced:
        proof, power = min(((proof, self._power(proof, contacts)) for proof in proofs), key=lambda pair: pair[1])
        if power >= -PROOF_MARGIN * self.weight:
            return Unbalanced(UnbalanceReason.WITHIN_TOLERANCE, proof=None, power=0.0, shortage=None)
        # An upward force F at the centre of mass adds F times this speed.
        rising = float(proof.twist[:3] @ contacts.up)
        shortage = -power / rising if rising > 1e-6 else None
        return Unbalanced(UnbalanceReason.PROVEN, proof=proof, power=power, shortage=shortage)

    def _power(self, proof: UnbalanceProof, contacts: _Contacts) -> float:
        twist, up = proof.twist, contacts.up
        levers = contacts.points - self.com
        cup = point_velocity(twist, self.cup.T_plate_cup[:3, 3] - self.com)
        power = -self.weight * float(twist[:3] @ up)
        power += float(environment_power(twist, levers, up, self.friction, self.environment_bound))
        power += float(self.lifter.largest_power(cup, twist[3:], up))
        if contacts.grip is not None:
            levers, normals = contacts.grip.points - self.com, contacts.grip.normals
            power += float(grip_power(twist, levers, normals, self.friction, self.limits, proof.net_multiplier))
        if contacts.push is not None:
            lever, normal = contacts.push.point - self.com, contacts.push.normal
            power += float(push_power(twist, lever, normal, self.friction, self.limits))
        return power


class _Contacts(NamedTuple):
    """One problem: how the plate stands and what touches it."""

    rotation_world_plate: Array
    points: Array
    grip: GripContacts | None
    push: PushContact | None

    up: Array
    """World +z in plate axes: the normal of every environment contact."""

    @classmethod
    def of(cls, rotation: Array, points: Array, grip: GripContacts | None, push: PushContact | None) -> Self:
        """Take the arguments of `Balance.solve`."""
        rotation = np.asarray(rotation, dtype=float)
        points = np.asarray(points, dtype=float).reshape(-1, 3)
        return cls(rotation, points, grip, push, np.ascontiguousarray(rotation[2]))

    def frames(self, cup: Cup) -> tuple[Array, Array]:
        """Return the origins (m, 3) and axes (m, 3, 3) of the contact frames, in the order of `Columns.names`."""
        points, rotations = [], []
        if self.grip is not None:
            points.append(self.grip.points)
            rotations.append(self.grip.rotations)
        if self.push is not None:
            points.append(self.push.point[None])
            rotations.append(self.push.rotation[None])
        points += [self.points, cup.T_plate_cup[None, :3, 3]]
        axes = np.broadcast_to(contact_axes(self.up), (len(self.points), 3, 3))
        rotations += [axes, cup.T_plate_cup[None, :3, :3]]
        return np.concatenate(points), np.concatenate(rotations)


def _hand_wrenches(columns: Columns, contact_map: Array, x: Array) -> Array:
    """Sum up what each hand exerts, (2, 6), plate axes, about the centre of mass."""
    totals = np.zeros((2, 6))
    if columns.fingers:
        fingers = slice(columns.fingers[0].start, columns.fingers[-1].stop)
        totals[0] = contact_map[:, fingers] @ x[fingers]
    if columns.push is not None:
        totals[1] = contact_map[:, columns.push] @ x[columns.push]
    return totals


def _proof_from_dual(balance_dual: Array, net_dual: Array) -> UnbalanceProof:
    """Turn a Farkas dual of (5b) round into a twist, and scale it to size 1; to be checked before use."""
    largest = np.abs(balance_dual).max()
    if not 0.0 < largest < np.inf:
        return UnbalanceProof(np.zeros(6), np.zeros(3))
    twist = -np.concatenate([balance_dual[:3], balance_dual[3:] / TORQUE_LENGTH]) / largest
    size = max(np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:]) * TORQUE_LENGTH)
    return UnbalanceProof(twist / size, -net_dual / largest / size)


@njit(cache=True, nogil=True)
def _close_balance(x: Array, contact_map: Array, gravity: Array) -> Array:
    """Move x by the least it takes to meet (5b) to rounding, in place; return what is left, moments at 0.1 m."""
    if not np.all(np.isfinite(x)):
        x[:] = 0.0
    count = contact_map.shape[1]
    scaled_map, residual = contact_map.copy(), gravity.copy()
    scaled_map[3:] /= TORQUE_LENGTH
    residual[3:] /= TORQUE_LENGTH
    residual += scaled_map @ x[:count]
    # Normal equations, with a grain of damping for contacts that cannot exert every wrench; twice for the last digits.
    normal = scaled_map @ scaled_map.T
    solve = np.linalg.inv(normal + _DAMPING * np.trace(normal) * np.eye(6))
    for _ in range(2):
        correction = scaled_map.T @ (solve @ residual)
        x[:count] -= correction
        residual -= scaled_map @ correction
    return residual


def _force_maps(axes: Array, levers: Array) -> Array:
    """Return the (6, 3k) that takes the forces of k point contacts with the same axes to wrenches."""
    x, y, z = levers[:, 0], levers[:, 1], levers[:, 2]
    zero = np.zeros(len(levers))
    S = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]])
    torques = np.einsum("ijk,jl->ikl", S, axes).reshape(3, -1)
    return np.concatenate([np.tile(axes, len(levers)), torques])
