"""What the task of a plate lift says, as far as the certificate compares the plan with it; and its bodies compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from planners.certify.common.cones import ContactLimits, StatedCup
from planners.certify.common.reserve import payload_limits
from planners.certify.common.scene import StatedBody, compare_body, stated_obstacles, stated_shape, stated_start
from planners.certify.finding import Finding
from planners.certify.lift.load_program import ContactBounds
from planners.certify.lift.uncertainty import Tolerances
from planners.certify.plan_view import MalformedDocument, PlanView
from planners.certify.settings import CertifySettings
from planners.contract.task_spec import PlateLiftTask
from planners.geometry.pose import Array, from_pose7, inverse
from planners.plan.verdicts import Check

_CABLE_LENGTH = 1.1
"""Contract [m]."""


@dataclass(frozen=True)
class LifterCup(StatedCup):
    """The lifter's cup."""

    position: tuple[float, float]
    """On the plate's top face [m]."""


@dataclass(frozen=True, eq=False)
class LiftTask:
    """A plate lift as the task states it."""

    bodies: tuple[StatedBody, ...]
    """Plate, support if there is one, obstacles."""
    cup: LifterCup
    lifter_model: str
    friction: Mapping[str, float]
    """Of kinds grip, push, environment; `eps` [m]."""
    normal_limit: float
    net_limit: float
    contact_model: str
    """"squeeze" or "paper"."""
    tolerances: Tolerances
    start_positions: Array | None
    goal_height: float

    def hand_limits(self, plan: PlanView) -> dict[str, float]:
        """Return the net force that each hand may exert on the plate [N].

        A gripper that squeezes bears its load as a whole: the limit of a normal force is one of its net force.
        """
        most = {name: min(force, self.net_limit) for name, force in payload_limits(plan).items()}
        squeezing = [a for a, hand in plan.hands.items() if hand.kind == "gripper" and self.contact_model == "squeeze"]
        return most | {arm: min(most[arm], self.normal_limit) for arm in squeezing}

    def limits(self, plan: PlanView) -> ContactLimits:
        """Return what its contacts can bear."""
        stated = {"soft_finger": "grip", "point": "push", "environment": "environment"}
        friction = {kind: self.friction[name] for kind, name in stated.items()}
        eps = self.friction["eps"]
        hands = self.hand_limits(plan)
        normal = min([self.normal_limit, *(hands[arm] for arm, hand in plan.hands.items() if hand.kind == "stick")])
        if self.contact_model == "paper":
            normal = self.normal_limit
        return ContactLimits(friction, eps, normal, hands, self.cup, self.lifter_model)

    def bounds(self, plan: PlanView) -> ContactBounds:
        """Return what a program over its contacts has to keep besides what these state."""
        return ContactBounds(self.hand_limits(plan), self.lifter_model)

    @property
    def plate(self) -> StatedBody:
        """The plate."""
        return self.bodies[0]


def read_lift_task(task: PlateLiftTask) -> LiftTask:
    """Take from a task what is compared; where a task of 0.1.0 says nothing, what was meant then."""
    friction, plate, cup = task.friction, task.plate, task.cup
    x, y = cup.position
    said = plate.model_fields_set
    return LiftTask(
        bodies=_stated_bodies(task),
        cup=LifterCup(position=(x, y), radius=cup.radius, max_force=cup.max_force, mu=cup.mu, kappa=cup.kappa),
        lifter_model=task.lifter_model,
        friction=friction.model_dump(),
        normal_limit=task.hand_force_limit.normal,
        net_limit=task.hand_force_limit.net,
        contact_model=task.contact_model if "contact_model" in task.model_fields_set else "paper",
        tolerances=Tolerances(
            plate.mass_tolerance if "mass_tolerance" in said else 0.0,
            plate.com_tolerance if "com_tolerance" in said else 0.0,
        ),
        start_positions=stated_start(task),
        goal_height=task.options.goal_height,
    )


def _stated_bodies(task: PlateLiftTask) -> tuple[StatedBody, ...]:
    plate = task.plate
    if plate.com is None:
        raise MalformedDocument("/task/plate/com", "is missing")
    shape, T_world_plate = stated_shape(plate.shape, "/task/plate/shape"), from_pose7(task.plate_pose)
    bodies = [StatedBody("plate", shape, T_world_plate, plate.mass, np.array(plate.com))]
    if task.support is not None:
        shape = stated_shape(task.support.shape, "/task/support/shape")
        bodies.append(StatedBody("support", shape, from_pose7(task.support.pose)))
    return (*bodies, *stated_obstacles(task))


def lift_bodies_check(plan: PlanView, task: LiftTask, settings: CertifySettings) -> Check:
    """Check the bodies against the task, and the lifter's cup and cable."""
    finding = Finding("task_bodies", "m, kg")
    for stated in task.bodies:
        body = plan.bodies.get(stated.name)
        if body is None:
            finding.require(False, f"body {stated.name}", "is in the task, not in the document")
        else:
            compare_body(body, stated, finding, settings)
    roles = {"plate": "plate", "support": "support", "cup": "cup", "cable": "cable"}
    roles |= {stated.name: "obstacle" for stated in task.bodies if stated.name not in roles}
    for name, body in plan.bodies.items():
        where, fixed = f"body {name}", name not in ("plate", "cup", "cable")
        # Whatever the task does not state belongs to the cell.
        known = body.role == roles[name] if name in roles else body.role in ("table", "frame")
        finding.require(known, f"{where}: role", f"{body.role!r} is not what the task makes of it")
        finding.require(body.static == fixed, f"{where}: static", f"must be {fixed}")
    for name in ("cup", "cable", plan.support):
        finding.require(name in plan.bodies, f"body {name}", "is missing")
    if {"cup", "cable"} <= set(plan.bodies):
        _lifter(plan, task, finding, settings)
    return finding.check()


def _lifter(plan: PlanView, task: LiftTask, finding: Finding, settings: CertifySettings) -> None:
    """The cup stands on the plate where the task says and is as wide; the cable stands on the cup, 1.1 m high."""
    plate, cup, cable = (plan.bodies[name] for name in ("plate", "cup", "cable"))
    T_plate_cup = inverse(plate.T_world_start) @ cup.T_world_start
    rim = cup.shape.vertices @ T_plate_cup[:3, :3].T + T_plate_cup[:3, 3]
    middle = (rim.min(axis=0) + rim.max(axis=0)) / 2
    seat = np.array([*task.cup.position, plate.shape.vertices[:, 2].max()])
    off = np.linalg.norm(seat - [middle[0], middle[1], rim[:, 2].min()])
    finding.note(settings.attachment_distance - float(off), "body cup: place on the plate")
    narrower = task.cup.radius - float(np.linalg.norm(rim[:, :2] - middle[:2], axis=1).max())
    finding.note(settings.join - narrower, "body cup: radius")
    low, high = cable.shape.vertices[:, 2].min(), cable.shape.vertices[:, 2].max()
    finding.note(settings.join - (_CABLE_LENGTH - float(high - low)), "body cable: height")
    foot = cable.T_world_start[:3, :3] @ [0.0, 0.0, low] + cable.T_world_start[:3, 3]
    T = plate.T_world_start
    anchor = T[:3, :3] @ [middle[0], middle[1], rim[:, 2].max()] + T[:3, 3]
    finding.note(settings.attachment_distance - float(np.linalg.norm(foot - anchor)), "body cable: place on the cup")
