"""What a plan says of its cell and its bodies: all that is needed to draw, replay and check it."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Literal

from pydantic import Field

from planners.contract.arrays import ArmName, OneOf, PoseRow, Positive, Real, Rows, SixJoints, Vector
from planners.contract.shapes import Box, Cylinder, InlineMesh, Prism
from planners.contract.strict_model import StrictModel
from planners.contract.task_spec import ToolCup
from planners.geometry.pose import Array, Transform, from_pose7

ARMS: tuple[ArmName, ArmName] = ("left", "right")
JOINTS = (
    *("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"),
    *("wrist_1_joint", "wrist_2_joint", "wrist_3_joint"),
)
"""Joints of one arm from base to flange."""
JOINT_NAMES = tuple(f"{arm}_{joint}" for arm in ARMS for joint in JOINTS)
"""The order of joints in every array of twelve."""


class LinkDocument(StrictModel):
    """A link that moves, in the frame after its joint."""

    mass: Positive
    """[kg]"""
    com: Vector
    """Centre of mass [m]."""


class ArmDocument(StrictModel):
    """One arm: `T_world_flange = base · Π Rz(q + theta0) Tz(d) Tx(a) Rx(alpha)`."""

    base: PoseRow
    dh: Annotated[Array, Rows(4, digits=None, count=6)]
    """Rows [a, alpha, d, theta0]."""
    position_min: SixJoints
    position_max: SixJoints
    velocity_max: SixJoints
    acceleration_max: SixJoints
    torque_max: SixJoints | None = None
    """Largest torque of each joint [Nm]; documents of 0.1.0 have none of this, nor of masses and centres of mass."""
    links: Annotated[tuple[LinkDocument, ...], Field(min_length=6, max_length=6)] | None = None
    """Of the six joints, from shoulder to wrist 3."""
    payload: Positive | None = None
    """Largest mass at the flange, the hand included [kg]; the first documents state neither this nor hands' masses."""

    @cached_property
    def T_world_base(self) -> Transform:
        """Where the arm is bolted on."""
        return from_pose7(self.base)


class GripperDocument(StrictModel):
    """A gripper; its TCP lies between the pads' centres, z the approach, y the opening axis."""

    kind: Literal["gripper"]
    mass: Positive | None = None
    """Of all that is mounted on the flange [kg]."""
    com: Vector | None = None
    """Its centre of mass, in the flange frame [m]."""
    tcp: Annotated[Array, Rows(2, digits=None)]
    """Rows [width, z from the flange]."""
    force_range: tuple[Real, Real] | None = None
    """Least and largest force with which it squeezes [N]."""


class StickDocument(StrictModel):
    """A stick; its TCP is the centre of the tip's hemisphere, in the flange frame."""

    kind: Literal["stick"]
    mass: Positive | None = None
    """Of all that is mounted on the flange [kg]."""
    com: Vector | None = None
    """Its centre of mass, in the flange frame [m]."""
    tcp: PoseRow
    tip_radius: Positive

    @cached_property
    def T_flange_tip(self) -> Transform:
        """Where the centre of the tip's hemisphere is."""
        return from_pose7(self.tcp)


HandDocument = GripperDocument | StickDocument


class ToolPartDocument(StrictModel):
    """One shape of a tool."""

    shape: Annotated[Box | Cylinder | Prism | InlineMesh, Field(discriminator="type")]
    pose: PoseRow
    """Shape frame in the tool frame."""


class ToolDocument(StrictModel):
    """A suction tool that a cell brings; its origin is the centre of the cup's lip, +z runs up the shaft."""

    shapes: tuple[ToolPartDocument, ...]
    mass: Positive
    """[kg]"""
    com: Vector
    """Centre of mass in the tool frame [m]."""
    cup: ToolCup


class CellDocument(StrictModel):
    """What is needed of the cell to replay and check a plan."""

    name: str
    hash: str
    gravity: Vector
    arms: dict[ArmName, ArmDocument]
    hands: dict[ArmName, Annotated[HandDocument, Field(discriminator="kind")]]
    tools: dict[str, ToolDocument] | None = None
    """By name, the suction tools that the cell brings beside the shipped ones; left out where it brings none."""


class BodyDocument(StrictModel):
    """A body at the start."""

    role: Annotated[str, OneOf("plate", "object", "tool", "support", "obstacle", "table", "frame", "cup", "cable")]
    shape: Annotated[Box | Cylinder | Prism | InlineMesh, Field(discriminator="type")]
    mass: Positive | None
    com: Vector
    pose: PoseRow
    static: bool

    @cached_property
    def T_world_start(self) -> Transform:
        """Where it is at the start."""
        return from_pose7(self.pose)
