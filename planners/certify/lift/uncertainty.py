"""Whether every plate within the tolerances of its task is held at every contact set, not the stated one alone."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.lift.load_program import LARGEST_FACTOR, ContactBounds, LoadProgram, stated_factors
from planners.certify.lift.rim import Rim
from planners.certify.motion.segment_motion import BodyContacts, added_up
from planners.certify.plan_view import PlanView
from planners.geometry.pose import Array
from planners.plan.verdicts import Check


@dataclass(frozen=True)
class Tolerances:
    """What a task leaves open of its plate's weight."""

    mass: float
    """Share of the mass by which it may be more or less [1]."""
    com: float
    """Distance along each of the body's axes by which the centre of mass may be off [m]."""


def uncertainty_check(evidence: Evidence, tolerances: Tolerances, bounds: ContactBounds, rim: Rim) -> Check:
    """Check that contacts bear the heaviest plate with its centre of mass at every corner of its box.

    Then they bear every plate within the tolerances: wrenches that can be borne are a convex set that contains zero,
    and gravity's is linear in mass and mass times centre. The margin is the least part by which any of these plates
    could weigh more. The tightest contact set is asked of the program as printed in the paper, too.
    """
    plan, settings, finding = evidence.plan, evidence.settings, Finding("uncertainty", "1")
    known: dict[bytes, float] = {}
    tightest: tuple[float, BodyContacts] | None = None
    for contact_set in evidence.contacts:
        beyond = rim.normals(contact_set)
        key = _key(contact_set, beyond)
        if key not in known:
            program = LoadProgram(contact_set.bearing, _centre(plan, contact_set), bounds, beyond)
            loads = _loads(plan, contact_set, tolerances)
            known[key] = float(np.min([program.factor(load) for load in loads]))
        finding.note(known[key] - 1.0 + settings.stated_bound, contact_set.where)
        if tightest is None or known[key] < tightest[0]:
            tightest = known[key], contact_set
    if tightest is not None:
        factor, contact_set = tightest
        loads = _loads(plan, contact_set, tolerances)
        beyond = rim.normals(contact_set)
        factors = stated_factors(contact_set.bearing, _centre(plan, contact_set), bounds, loads, beyond)
        second = float(np.min(factors))
        if not abs(second - factor) <= settings.second_opinion * LARGEST_FACTOR:
            complaint = f"the paper's program as printed bears {second:.6g} times the load, not {factor:.6g}"
            finding.require(False, contact_set.where, complaint)
    return finding.check()


def _centre(plan: PlanView, contact_set: BodyContacts) -> Array:
    T = contact_set.T_world_body
    return T[:3, :3] @ plan.bodies[contact_set.body].com + T[:3, 3]


def _loads(plan: PlanView, contact_set: BodyContacts, tolerances: Tolerances) -> list[Array]:
    """Return gravity's wrenches (6,) on the heaviest plates, about the stated centre of mass, each once.

    Stated inertia acts where gravity does, and is as much larger.
    """
    heavier, weight = 1.0 + tolerances.mass, (plan.bodies[contact_set.body].mass or 0.0) * plan.cell.gravity
    force, torque = added_up(contact_set.inertia, weight, _centre(plan, contact_set))
    loads: dict[tuple[float, ...], Array] = {}
    for signs in itertools.product((-1.0, 1.0), repeat=3):
        corner = contact_set.T_world_body[:3, :3] @ (tolerances.com * np.array(signs))
        load = heavier * np.concatenate([force, torque + np.cross(corner, force)])
        loads.setdefault(tuple(np.round(load, 9).tolist()), load)
    return list(loads.values())


def _key(contact_set: BodyContacts, beyond: Iterable[int]) -> bytes:
    """Tell contact sets apart by what matters to balance: tilt and contacts, not height and place; and inertia.

    `beyond`: numbers of the contacts at a rim.
    """
    R, p = contact_set.T_world_body[:3, :3], contact_set.T_world_body[:3, 3]
    bearing, loads = contact_set.bearing, contact_set.inertia
    numbers = [R[2], *(np.concatenate([R.T @ (c.point - p), R.T @ c.normal]) for c in bearing)]
    numbers += [np.concatenate([R.T @ (c.point - p), R.T @ c.force, R.T @ c.torque]) for c in loads]
    kinds = [*(f"{c.by} {c.kind} {getattr(c, 'squeeze', None)}" for c in bearing), *map(str, beyond)]
    return ",".join(kinds).encode() + np.round(np.concatenate(numbers), 9).tobytes()
