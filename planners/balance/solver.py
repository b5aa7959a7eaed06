"""Solve the balance program (5) of paper B for one plate and lifter, at any pose and with any hands."""

from __future__ import annotations

from copy import copy
from functools import partial
from typing import NamedTuple

import numpy as np

from planners.balance.balanced import Balanced, HeldPlate, Unbalanced, UnbalanceProof, UnbalanceReason
from planners.balance.capacity import LiftCapacity, largest_environment_normal, lift_capacity
from planners.balance.cone_program import (
    TORQUE_LENGTH,
    Columns,
    ConeProgram,
    Fingers,
    Manner,
    ProgramAnswer,
    Structure,
    Template,
    move_to_balance,
)
from planners.balance.contact_power import environment_power, grip_power, point_velocity, push_power
from planners.balance.contacts import (
    Cup,
    Friction,
    GripContacts,
    HandLimits,
    PushContact,
    StandingCones,
    contact_axes,
    standing_cones,
)
from planners.balance.lifter import lifter_of
from planners.balance.uncertainty import Uncertainty
from planners.contract.task_spec import LifterModel
from planners.errors import LiftwrightError
from planners.geometry.pose import Array, transform
from planners.geometry.wrench import grasp_map

GRAVITY = 9.81
"""[m/s^2], along world -z."""
MAX_RESIDUAL = 1e-9
"""Largest residual of (5b) accepted, relative to the weight (moments at 0.1 m)."""
PROOF_MARGIN = 1e-7
"""A twist proves something when it loses more than this times the weight [m/s]: rounding is 1e-13 of it."""

_LENGTHS = np.repeat([1.0, TORQUE_LENGTH], 3)
"""From torques over `TORQUE_LENGTH` to torques, in wrenches."""
_PER_LENGTH = np.diag(1.0 / _LENGTHS)


class Balance:
    """The balance program of one plate with its cup. Keeps what programs share: not for two threads at once."""

    def __init__(
        self,
        plate_mass: float,
        plate_com: Array,
        cup: Cup,
        friction: Friction | None = None,
        limits: HandLimits | None = None,
        lifter_model: LifterModel = "paper",
        gravity: float = GRAVITY,
    ) -> None:
        """State the plate, known exactly, with nothing kept back.

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
        self._mass = plate_mass
        self.cup = cup
        self.friction = friction if friction is not None else Friction()
        self.limits = limits if limits is not None else HandLimits()
        self.lifter = lifter_of(lifter_model, cup)
        self.environment_bound = largest_environment_normal(self.weight, self.lifter, self.friction, self.limits)
        self.uncertainty = Uncertainty()
        self._gravity, self._rim = gravity, np.zeros((0, 2))
        self._lifter_model: LifterModel = lifter_model
        self._fingers = Fingers.of(self.limits.squeeze)
        self._templates: dict[Structure, Template] = {}
        self._hand_maps: dict[GripContacts | PushContact, tuple[Array, Array]] = {}
        self._rest_maps: dict[tuple[bytes, bytes], Array] = {}
        self._cup_map = grasp_map(transform(cup.T_plate_cup[:3, :3], cup.T_plate_cup[:3, 3] - self.com))

    def keeping_back(self, reserve: float) -> Balance:
        """Return the program with that share of every limit kept back: friction, hands and cup [1]."""
        return self.with_limits(
            self.cup.keeping_back(reserve), self.friction.keeping_back(reserve), self.limits.keeping_back(reserve)
        )

    def with_limits(
        self, cup: Cup | None = None, friction: Friction | None = None, limits: HandLimits | None = None
    ) -> Balance:
        """Return the program of the same plate with other limits; those that are left out stay."""
        program = Balance(
            self._mass,
            self.com,
            cup or self.cup,
            friction or self.friction,
            limits or self.limits,
            self._lifter_model,
            self._gravity,
        )
        program._rim = self._rim
        if program.limits.squeeze == self.limits.squeeze and program.friction.eps == self.friction.eps:
            program._hand_maps = self._hand_maps
        same_cup = np.array_equal(program.cup.T_plate_cup, self.cup.T_plate_cup)
        # At a rim the axes of a point's force hold its friction.
        same_axes = not len(self._rim) or program.friction.environment == self.friction.environment
        if same_cup and same_axes and program.cup.radius == self.cup.radius:
            program._rest_maps = self._rest_maps
        return program.for_all(self.uncertainty)

    def with_rim(self, rim: Array) -> Balance:
        """Return the program of the plate where points of its bottom face (m, 2) stand at a rim [m, plate axes]."""
        program = copy(self)
        program._rim, program._rest_maps = rim, {}
        return program

    def for_all(self, uncertainty: Uncertainty) -> Balance:
        """Return the program whose proofs and `refusal` are about all plates within the tolerances."""
        program = copy(self)
        program.uncertainty = uncertainty
        program.environment_bound = largest_environment_normal(
            (1.0 + uncertainty.mass) * self.weight, self.lifter, self.friction, self.limits
        )
        return program

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
            environment_points: (k, 3), where the plate stands on table or support, in the plate frame [m]; k may be 0.
            grip: The gripper's contacts, if it holds the plate.
            push: The stick's contact, if it touches the plate.
        """
        contacts = self._contacts(rotation_world_plate, environment_points, grip, push)
        return self._answer(contacts, *self._contact_map(contacts))

    def program(
        self,
        rotation_world_plate: Array,
        environment_points: Array,
        grip: GripContacts | None = None,
        push: PushContact | None = None,
    ) -> ConeProgram:
        """Return (5b)-(5j) in numbers, for whoever changes them; the arguments are those of `solve`."""
        contacts = self._contacts(rotation_world_plate, environment_points, grip, push)
        contact_map, squeezed = self._contact_map(contacts)
        return self._template(contacts.structure).stated(contact_map, contacts.load(squeezed), squeezed)

    def refusal(
        self,
        rotation_world_plate: Array,
        environment_points: Array,
        grip: GripContacts | None = None,
        push: PushContact | None = None,
    ) -> Unbalanced | None:
        """Say why not every plate within the tolerances can be held, or None if all can; see `Uncertainty`.

        The arguments are those of `solve`.
        """
        if self.uncertainty.is_none:
            answer = self.solve(rotation_world_plate, environment_points, grip, push)
            return answer if isinstance(answer, Unbalanced) else None
        stated = self._contacts(rotation_world_plate, environment_points, grip, push)
        contact_map, squeezed = self._contact_map(stated)
        heaviest = (1.0 + self.uncertainty.mass) * stated.gravity
        middle = self._middle(stated._replace(gravity=heaviest), contact_map, squeezed)
        for corner in self.uncertainty.corners(stated.up):
            x, y, z = corner
            fx, fy, fz = heaviest[:3]
            gravity = np.array([fx, fy, fz, y * fz - z * fy, z * fx - x * fz, x * fy - y * fx])
            contacts = stated._replace(gravity=gravity)
            if middle is not None and self._holds(contacts, contact_map, squeezed, middle):
                continue
            answer = self._answer(contacts, contact_map, squeezed)
            if isinstance(answer, Unbalanced):
                return answer
        return None

    def _middle(self, contacts: _Contacts, contact_map: Array, squeezed: Array) -> tuple[Array, Array] | None:
        """Return forces (k,) far from all limits and how far each may move (k,) [N]; None if there are none."""
        template = self._template(contacts.structure)
        answer = template.solve(contact_map, contacts.load(squeezed), squeezed, Manner.CENTRAL)
        return None if answer.infeasible else (answer.x, template.room(answer.x))

    def _holds(self, contacts: _Contacts, contact_map: Array, squeezed: Array, near: tuple[Array, Array]) -> bool:
        """Tell whether forces that hold a similar plate keep within their limits when moved to hold this one."""
        x, load = near[0].copy(), contacts.load(squeezed)
        move_to_balance(x, contact_map, load, near[1])
        residual, slack, _ = self._template(contacts.structure).closed(x, contact_map, load, squeezed)
        return slack >= 0.0 and float(np.abs(residual).max()) <= MAX_RESIDUAL * self.weight

    def _answer(self, contacts: _Contacts, contact_map: Array, squeezed: Array) -> Balanced | Unbalanced:
        answer = self._attempt(contacts, contact_map, squeezed, Manner.QUICK)
        if isinstance(answer, Unbalanced) and answer.proof is None:
            answer = self._attempt(contacts, contact_map, squeezed, Manner.CAREFUL)
        return answer

    def _contacts(
        self, rotation: Array, points: Array, grip: GripContacts | None, push: PushContact | None
    ) -> _Contacts:
        """Take the arguments of `solve`."""
        rotation = np.asarray(rotation, dtype=float)
        up, gravity = rotation[2].copy(), np.zeros(6)
        gravity[:3] = -self.weight * up
        return _Contacts(rotation, np.asarray(points, dtype=float).reshape(-1, 3), grip, push, up, gravity)

    def cones(self, points: Array, ups: Array) -> StandingCones:
        """Return the cones of what the plate stands on at points (..., k, 3) of it [m], with `ups` (..., 3)."""
        return standing_cones(points, ups, self._rim, self.friction.environment, self.environment_bound)

    def _axes(self, contacts: _Contacts) -> Array:
        """Return columns (k, 3, 3) that take what a template has of the environment contacts to forces, plate axes.

        At a rim they make the cone narrower: the template's is that of the friction everywhere.
        """
        if not len(self._rim):
            return np.broadcast_to(contact_axes(contacts.up), (len(contacts.points), 3, 3))
        cones, axes = self.cones(contacts.points, contacts.up), np.zeros((len(contacts.points), 3, 3))
        shares = np.asarray(cones.mu) / self.friction.environment
        for point in np.flatnonzero(cones.normals.any(axis=1)):
            axes[point] = contact_axes(cones.normals[point]) * [shares[point], shares[point], 1.0]
        return axes

    def _attempt(
        self, contacts: _Contacts, contact_map: Array, squeezed: Array, manner: Manner
    ) -> Balanced | Unbalanced:
        """Solve once. The solver's verdict only says what to check first; the checks decide."""
        template = self._template(contacts.structure)
        answer = template.solve(contact_map, contacts.load(squeezed), squeezed, manner)
        held = answer.slack >= 0.0 and np.abs(answer.residual).max() <= MAX_RESIDUAL * self.weight
        if held and not answer.infeasible:
            return self._balanced(template, contacts, answer)
        proofs = [_proof_from_dual(answer.z[:6], template.net_multiplier(answer.z))]
        if not len(contacts.points):
            proofs.append(UnbalanceProof(np.concatenate([contacts.up, np.zeros(3)]), contacts.up))
        refused = self._unbalanced(contacts, proofs)
        if refused.proof is None:
            # What no forces at all can close is square to them: where the contacts cannot exert every wrench.
            refused = self._unbalanced(contacts, [_proof_from_dual(-answer.residual, np.zeros(3))])
        return refused

    def capacity(self, max_tilt: float) -> LiftCapacity:
        """Compare the weight with all that can carry the plate off the table, tilted by at most `max_tilt` [rad]."""
        return lift_capacity(self.weight, self.lifter, self.friction, self.limits, max_tilt)

    def _template(self, structure: Structure) -> Template:
        template = self._templates.get(structure)
        if template is None:
            template = Template(structure, self.lifter, self.friction, self.limits)
            self._templates[structure] = template
        return template

    def _contact_map(self, contacts: _Contacts) -> tuple[Array, Array]:
        """Assemble G of (5b), from the template's variables to wrenches in plate axes about the centre of mass.

        Returns:
            G, and the wrench (6,) of the squeeze: zero where the fingers are exactly opposite; torques over
            `TORQUE_LENGTH` [N].
        """
        blocks, squeezed = [], np.zeros(6)
        for hand in (contacts.grip, contacts.push):
            if hand is not None:
                block, rest = self._hand_map(hand)
                blocks.append(block)
                squeezed += rest
        blocks.append(self._rest_map(contacts))
        return np.concatenate(blocks, axis=1), squeezed

    def _rest_map(self, contacts: _Contacts) -> Array:
        """Return the columns of G, (6, k), that do not depend on the hands; many holds share them."""
        key = (contacts.up.tobytes(), contacts.points.tobytes())
        known = self._rest_maps.get(key)
        if known is None:
            blocks = [_PER_LENGTH @ self._cup_map @ self.lifter.contact_map(contacts.up)]
            if len(contacts.points):
                blocks.insert(0, _PER_LENGTH @ _force_maps(self._axes(contacts), contacts.points - self.com))
            known = self._rest_maps[key] = np.concatenate(blocks, axis=1)
        return known

    def _hand_map(self, hand: GripContacts | PushContact) -> tuple[Array, Array]:
        """Return the map (6, k) from a hand's variables to its wrench, and its wrench (6,) where they are all zero.

        Torques are over `TORQUE_LENGTH` [N].
        """
        known = self._hand_maps.get(hand)
        if known is not None:
            return known
        if isinstance(hand, PushContact):
            result = _PER_LENGTH @ grasp_map(transform(hand.rotation, hand.point - self.com))[:, :3], np.zeros(6)
        else:
            fingers = zip(hand.rotations, hand.points - self.com, strict=True)
            scale = np.array([1.0, 1.0, 1.0, self.friction.eps])
            block = np.concatenate([grasp_map(transform(R, p))[:, [0, 1, 2, 5]] * scale for R, p in fingers], axis=1)
            block = _PER_LENGTH @ block
            result = block @ self._fingers.basis, block @ self._fingers.rest
        self._hand_maps[hand] = result
        return result

    def _balanced(self, template: Template, contacts: _Contacts, answer: ProgramAnswer) -> Balanced:
        columns, x = template.columns, answer.x
        return Balanced(
            held=HeldPlate(contacts.rotation_world_plate, contacts.points, contacts.grip, contacts.push),
            contacts=columns.names,
            frames=partial(contacts.frames, self.cup),
            exerted=partial(self._wrenches, columns, contacts, x),
            hand_wrenches=answer.hands * _LENGTHS,
            objective=float(template.cost @ x),
            f_plus_gp=0.0 if columns.hand_effort is None else float(x[columns.hand_effort]),
            suction_force=float(x[columns.pull]),
            least_slack=answer.slack,
        )

    def _wrenches(self, columns: Columns, contacts: _Contacts, x: Array) -> Array:
        """Return the wrench of each contact in its own frame, (m, 6)."""
        wrenches = np.zeros((len(columns.names), 6))
        fingers = 0 if columns.grip is None else 2
        if fingers:
            wrenches[:2, [0, 1, 2, 5]] = columns.of_fingers(x) * [1.0, 1.0, 1.0, self.friction.eps]
        points = [*([columns.push] if columns.push else []), *columns.environment]
        for row, point in enumerate(points, start=fingers):
            wrenches[row, :3] = x[point]
        if len(self._rim) and len(contacts.points):
            standing = np.array([x[point] for point in columns.environment])
            forces = np.einsum("kij,kj->ki", self._axes(contacts), standing)
            wrenches[-1 - len(standing) : -1, :3] = forces @ contact_axes(contacts.up)
        wrenches[-1] = self.lifter.contact_map(contacts.up) @ x[columns.lifter]
        return wrenches

    def _unbalanced(self, contacts: _Contacts, proofs: list[UnbalanceProof]) -> Unbalanced:
        powers = [power if np.isfinite(power) else np.inf for power in (self._power(each, contacts) for each in proofs)]
        proof, power = min(zip(proofs, powers, strict=True), key=lambda pair: pair[1])
        if power >= -PROOF_MARGIN * self.weight:
            return Unbalanced(UnbalanceReason.WITHIN_TOLERANCE, proof=None, power=0.0)
        return Unbalanced(UnbalanceReason.PROVEN, proof=proof, power=power)

    def _power(self, proof: UnbalanceProof, contacts: _Contacts) -> float:
        twist, up = proof.twist, contacts.up
        levers = contacts.points - self.com
        cup = point_velocity(twist, self.cup.T_plate_cup[:3, 3] - self.com)
        power = float(twist @ contacts.gravity)
        power += float(environment_power(twist, levers, self.cones(contacts.points, up)))
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
    gravity: Array
    """(6,) Omega_g of (5b), plate axes, about the stated centre of mass."""

    def load(self, squeezed: Array) -> Array:
        """Return what variables have to balance beside a squeeze, (6,), torques over `TORQUE_LENGTH` [N]."""
        return -self.gravity / _LENGTHS - squeezed

    @property
    def structure(self) -> Structure:
        """Which contacts there are."""
        return Structure(len(self.points), self.grip is not None, self.push is not None)

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


def _proof_from_dual(balance_dual: Array, net_dual: Array) -> UnbalanceProof:
    """Turn a Farkas dual of (5b) round into a twist, and scale it to size 1; to be checked before use."""
    largest = np.abs(balance_dual).max()
    if not 0.0 < largest < np.inf:
        return UnbalanceProof(np.zeros(6), np.zeros(3))
    twist = -np.concatenate([balance_dual[:3], balance_dual[3:] / TORQUE_LENGTH]) / largest
    size = max(np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:]) * TORQUE_LENGTH)
    return UnbalanceProof(twist / size, -net_dual / largest / size)


def _force_maps(axes: Array, levers: Array) -> Array:
    """Return the (6, 3k) that takes the forces of k point contacts with axes (k, 3, 3) to wrenches."""
    x, y, z = levers[:, 0], levers[:, 1], levers[:, 2]
    zero = np.zeros(len(levers))
    S = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]])
    torques = np.einsum("ijk,kjl->ikl", S, axes).reshape(3, -1)
    return np.concatenate([axes.transpose(1, 0, 2).reshape(3, -1), torques])
