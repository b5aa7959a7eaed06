"""What the task of a plate lift says, as far as the certificate compares the plan with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from planners.certify.cones import ContactLimits, StatedCup
from planners.certify.document_view import PlanView, read_member, read_number, read_shape, read_text, read_vector
from planners.certify.load_program import ContactBounds
from planners.certify.payload import payload_limits
from planners.certify.stated import (
    StatedBody,
    object_member,
    positive_member,
    stated_body,
    stated_obstacles,
    stated_pose,
    stated_start,
)
from planners.certify.uncertainty import Tolerances
from planners.geometry.pose import Array

LIFTER_MODELS = ("paper", "cable", "dexnet")
CONTACT_MODELS = ("squeeze", "paper")


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


def read_lift_task(task: Mapping[str, Any]) -> LiftTask:
    """Read the task of a document.

    Raises:
        MalformedDocument: A member is missing or of the wrong type, or the task is no plate lift.
    """
    at = "/task"
    read_text(read_member(task, "kind", at), "/task/kind", ("plate_lift",))
    friction = object_member(task, "friction", at)
    limits = object_member(task, "hand_force_limit", at)
    return LiftTask(
        bodies=_bodies(task),
        cup=_cup(task),
        lifter_model=read_text(read_member(task, "lifter_model", at), "/task/lifter_model", LIFTER_MODELS),
        friction={
            key: read_number(read_member(friction, key, "/task/friction"), f"/task/friction/{key}")
            for key in ("grip", "push", "environment", "eps")
        },
        normal_limit=positive_member(limits, "normal", "/task/hand_force_limit"),
        net_limit=positive_member(limits, "net", "/task/hand_force_limit"),
        contact_model=read_text(task.get("contact_model", "paper"), "/task/contact_model", CONTACT_MODELS),
        tolerances=_tolerances(object_member(task, "plate", at)),
        start_positions=stated_start(task),
        goal_height=positive_member(object_member(task, "options", at), "goal_height", "/task/options"),
    )


def _tolerances(plate: Mapping[str, Any]) -> Tolerances:
    """Read the plate's tolerances; tasks of 0.1.0 have none."""
    read = {
        name: read_number(plate.get(name, 0.0), f"/task/plate/{name}") for name in ("mass_tolerance", "com_tolerance")
    }
    return Tolerances(read["mass_tolerance"], read["com_tolerance"])


def _cup(task: Mapping[str, Any]) -> LifterCup:
    cup, at = object_member(task, "cup", "/task"), "/task/cup"
    x, y = read_vector(read_member(cup, "position", at), "/task/cup/position", 2).tolist()
    return LifterCup(
        position=(x, y),
        radius=positive_member(cup, "radius", at),
        max_force=positive_member(cup, "max_force", at),
        mu=positive_member(cup, "mu", at),
        kappa=read_number(read_member(cup, "kappa", at), "/task/cup/kappa"),
    )


def _bodies(task: Mapping[str, Any]) -> tuple[StatedBody, ...]:
    plate, at = object_member(task, "plate", "/task"), "/task/plate"
    shape = object_member(plate, "shape", at)
    read_text(read_member(shape, "type", "/task/plate/shape"), "/task/plate/shape/type", ("box", "prism"))
    bodies = [
        StatedBody(
            name="plate",
            shape=read_shape(shape, "/task/plate/shape"),
            T_world_body=stated_pose(read_member(task, "plate_pose", "/task"), "/task/plate_pose"),
            mass=positive_member(plate, "mass", at),
            com=read_vector(read_member(plate, "com", at), "/task/plate/com", 3),
        )
    ]
    if task.get("support") is not None:
        bodies.append(stated_body("support", object_member(task, "support", "/task"), "/task/support"))
    return (*bodies, *stated_obstacles(task))
