"""What the task of a plate lift says, as far as the certificate compares the plan with it; and its bodies compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.certify.common.cones import ContactLimits, StatedCup
from planners.certify.common.reserve import payload_limits
from planners.certify.common.scene import StatedBody, stated_obstacles, stated_shape, task_bodies
from planners.certify.evidence import CellReference, Evidence
from planners.certify.finding import Finding
from planners.certify.lift.load_program import ContactBounds
from planners.certify.lift.uncertainty import Tolerances
from planners.certify.plan_view import MalformedDocument, PlanView
from planners.contract.task_spec import PlateLiftTask
from planners.geometry.pose import from_pose7, inverse
from planners.plan.verdicts import Check


@dataclass(frozen=True, eq=False)
class LiftTask:
    """A plate lift as the task states it; where a task of 0.1.0 says nothing, what was meant then."""

    stated: PlateLiftTask
    bodies: tuple[StatedBody, ...]
    """Plate, support if there is one, obstacles."""
    cup: StatedCup
    contact_model: str
    """"squeeze" or "paper"."""
    tolerances: Tolerances

    @classmethod
    def of(cls, task: PlateLiftTask, reference: CellReference | None) -> LiftTask:
        """Take from a task what is compared.

        Raises:
            MalformedDocument: a member of the task is missing.
        """
        plate, cup = task.plate, task.cup
        if cup.position is None:
            raise MalformedDocument("task/cup/position", "is missing")
        said = plate.model_fields_set
        return cls(
            stated=task,
            bodies=_stated_bodies(task, reference),
            cup=StatedCup(cup.radius, cup.max_force, cup.mu, cup.kappa),
            contact_model=task.contact_model if "contact_model" in task.model_fields_set else "paper",
            tolerances=Tolerances(
                plate.mass_tolerance if "mass_tolerance" in said else 0.0,
                plate.com_tolerance if "com_tolerance" in said else 0.0,
            ),
        )

    @property
    def plate(self) -> StatedBody:
        """The plate."""
        return self.bodies[0]

    def hand_limits(self, plan: PlanView) -> dict[str, float]:
        """Return the net force that each hand may exert on the plate [N].

        A gripper that squeezes bears its load as a whole: the limit of a normal force is one of its net force.
        """
        limit = self.stated.hand_force_limit
        most = {name: min(force, limit.net) for name, force in payload_limits(plan).items()}
        squeezing = plan.grippers if self.contact_model == "squeeze" else ()
        return most | {arm: min(most[arm], limit.normal) for arm in squeezing}

    def limits(self, plan: PlanView) -> ContactLimits:
        """Return what its contacts can bear."""
        stated, hands = self.stated.friction, self.hand_limits(plan)
        friction = {"soft_finger": stated.grip, "point": stated.push, "environment": stated.environment}
        normal = self.stated.hand_force_limit.normal
        if self.contact_model != "paper":
            normal = min([normal, *(hands[arm] for arm in plan.sticks)])
        return ContactLimits(friction, stated.eps, normal, hands, self.cup, self.stated.lifter_model)

    def bounds(self, plan: PlanView) -> ContactBounds:
        """Return what a program over its contacts has to keep besides what these state."""
        return ContactBounds(self.hand_limits(plan), self.stated.lifter_model)


def _stated_bodies(task: PlateLiftTask, reference: CellReference | None) -> tuple[StatedBody, ...]:
    plate = task.plate
    if plate.com is None:
        raise MalformedDocument("/task/plate/com", "is missing")
    shape, T_world_plate = stated_shape(plate.shape, "/task/plate/shape", reference), from_pose7(task.plate_pose)
    bodies = [StatedBody("plate", shape, T_world_plate, plate.mass, np.array(plate.com), settled=True)]
    if task.support is not None:
        shape = stated_shape(task.support.shape, "/task/support/shape", reference)
        bodies.append(StatedBody("support", shape, from_pose7(task.support.pose), settled=True))
    return (*bodies, *stated_obstacles(task, reference))


def lift_bodies_check(evidence: Evidence, task: LiftTask) -> Check:
    """Check the bodies against the task, and the lifter's cup and cable."""
    roles = {"plate": "plate", "support": "support", "cup": "cup", "cable": "cable"}
    roles |= {stated.name: "obstacle" for stated in task.bodies if stated.name not in roles}
    finding, bodies = task_bodies(evidence, task.bodies, roles), evidence.plan.bodies
    for name in ("cup", "cable", evidence.plan.support):
        finding.require(name in bodies, f"body {name}", "is missing")
    if {"cup", "cable"} <= set(bodies):
        _lifter(evidence, task, finding)
    return finding.check()


def _lifter(evidence: Evidence, task: LiftTask, finding: Finding) -> None:
    """The cup stands on the plate where the task says and is as wide; the cable stands on the cup.

    How high both are, and how thick the cable, is known of the cell.
    """
    settings, bodies = evidence.settings, evidence.plan.bodies
    plate, cup, cable = (bodies[name] for name in ("plate", "cup", "cable"))
    T_plate_cup = inverse(plate.T_world_start) @ cup.T_world_start
    rim = cup.shape.vertices @ T_plate_cup[:3, :3].T + T_plate_cup[:3, 3]
    middle = (rim.min(axis=0) + rim.max(axis=0)) / 2
    seat = np.array([*task.stated.cup.place, plate.shape.vertices[:, 2].max()])
    off = np.linalg.norm(seat - [middle[0], middle[1], rim[:, 2].min()])
    finding.note(settings.attachment_distance - float(off), "body cup: place on the plate")
    narrower = task.cup.radius - float(np.linalg.norm(rim[:, :2] - middle[:2], axis=1).max())
    finding.note(settings.join - narrower, "body cup: radius")
    low, high = cable.shape.vertices[:, 2].min(), cable.shape.vertices[:, 2].max()
    if evidence.reference is not None:
        lifter = evidence.reference.lifter
        short = lifter.cable_length - float(high - low)
        finding.note(settings.join - short, "body cable: height")
        thinner = lifter.cable_radius - float(np.linalg.norm(cable.shape.vertices[:, :2], axis=1).max())
        finding.note(settings.join - thinner, "body cable: radius")
        lower = lifter.cup_height - float(np.ptp(rim[:, 2]))
        finding.note(settings.join - lower, "body cup: height")
    foot = cable.T_world_start[:3, :3] @ [0.0, 0.0, low] + cable.T_world_start[:3, 3]
    T = plate.T_world_start
    anchor = T[:3, :3] @ [middle[0], middle[1], rim[:, 2].max()] + T[:3, 3]
    finding.note(settings.attachment_distance - float(np.linalg.norm(foot - anchor)), "body cable: place on the cup")
