"""Segments: stretches of motion of one kind, with what is held, what rides on what, and what bears what."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import StrEnum
from functools import cached_property
from typing import Annotated, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from planners.contract.arrays import ArmName, OneOf, PoseRow, Poses, Real, Rows, Samples, UnitVector, Vector
from planners.contract.strict_model import StrictModel
from planners.geometry.pose import Array, Transform, from_pose7, from_pose7s
from planners.plan.contacts import Contact


class SegmentKind(StrEnum):
    """What happens in a segment."""

    TRANSIT = "transit"
    """A free hand moves while the body rests."""
    TRANSFER = "transfer"
    """The body moves, the hold is kept."""
    HANDOVER = "handover"
    """Both hands hold the body, and nothing moves."""
    APPROACH = "approach"
    RETREAT = "retreat"
    GRIP = "grip"
    """The fingers close."""
    RELEASE = "release"
    """The fingers open."""
    ATTACH = "attach"
    """The vacuum goes on."""
    DETACH = "detach"
    """The vacuum goes off."""


class ContactState(StrictModel):
    """Which element of a body touches its environment between a segment's first and last sample."""

    element: Annotated[str, OneOf("face", "edge", "vertex", "none")]
    index: int | None
    with_: Annotated[str | None, Field(alias="with")]
    vertices: Annotated[Array, Rows(3, digits=None)]
    """(k, 3) in the body frame [m]."""

    @model_validator(mode="after")
    def _vertices_make_the_element(self) -> Self:
        least, most = {"face": (3, 999), "edge": (2, 2), "vertex": (1, 1), "none": (0, 0)}[self.element]
        if not least <= len(self.vertices) <= most:
            raise PydanticCustomError(
                "element",
                "{count} vertices do not make the element {element}",
                {"count": len(self.vertices), "element": self.element},
            )
        if self.element != "none" and self.with_ is None:
            raise PydanticCustomError("element", "names nothing that the {element} touches", {"element": self.element})
        return self


class Grip(StrictModel):
    """A grasp."""

    arm: ArmName
    body: str
    pose: PoseRow
    """`T_body_tcp`"""
    width: Real
    squeeze: Real | None = None
    """The commanded force of the fingers, from grip to release: what each pad presses with while nothing pulls [N]."""

    @cached_property
    def T_body_tcp(self) -> Transform:
        """Where the gripper is on the body."""
        return from_pose7(self.pose)


class Push(StrictModel):
    """A point contact with the stick."""

    arm: ArmName
    body: str
    point: Vector
    """In the body frame."""
    normal: UnitVector
    """Into the body, in the body frame."""


class Hold(StrictModel):
    """What the hands have on a body."""

    grip: Grip | None
    push: Push | None
    second_grip: Grip | None = None
    """Of the other gripper, while a body is passed from hand to hand; `grip` is the one that is taken or given up."""

    @model_validator(mode="after")
    def _grips_are_of_two_hands(self) -> Self:
        if self.second_grip is not None and (self.grip is None or self.grip.arm == self.second_grip.arm):
            raise PydanticCustomError("second_grip", "second_grip is not that of the other hand")
        return self


class Attachment(StrictModel):
    """A body rides on an arm's flange or on another body, at a constant pose."""

    to: str
    pose: PoseRow
    """`T_to_body`"""

    @cached_property
    def T_to_body(self) -> Transform:
        """Where the body is on what it rides on."""
        return from_pose7(self.pose)


class Segment(StrictModel):
    """A stretch of motion of one kind, with one set of attachments."""

    kind: SegmentKind
    movers: list[ArmName]
    """Arms whose joints change."""
    time: Samples
    """(n,) from the plan's begin [s]."""
    positions: Annotated[Array, Rows(12)]
    """(n, 12) [rad], here and below in the order of `JOINT_NAMES`."""
    velocities: Annotated[Array, Rows(12, digits=10)]
    """[rad/s]"""
    accelerations: Annotated[Array, Rows(12, digits=9)]
    """[rad/s²]"""
    gripper_width: dict[ArmName, Samples]
    """Inner distance of each gripper's pads [m]."""
    contact_state: ContactState | None
    hold: Hold | None
    attached: dict[str, list[Attachment]]
    body_poses: dict[str, Poses]
    """Of the bodies that move here."""
    contacts: list[Contact]
    reserve: Annotated[Array, Rows(None, gaps=True)] | None = None
    """By sample: the largest share of every limit that could be missing with the forces still borne [1]; null where
    nothing is held."""

    @model_validator(mode="after")
    def _arrays_fit_the_samples(self) -> Self:
        n = len(self.time)
        if n < 2:
            raise PydanticCustomError("samples", "a segment has at least two samples")
        for name, array in self._sampled():
            if len(array) != n:
                raise PydanticCustomError("samples", "{name} has not {n} samples", {"name": name, "n": n})
        if any(contact.sample >= n for contact in self.contacts):
            raise PydanticCustomError("samples", "a contact names a sample that the segment does not have")
        return self

    def _sampled(self) -> Iterator[tuple[str, Array]]:
        """Yield name and array of everything that is sampled."""
        yield "positions", self.positions
        yield "velocities", self.velocities
        yield "accelerations", self.accelerations
        if self.reserve is not None:
            yield "reserve", self.reserve
        for arm, widths in self.gripper_width.items():
            yield f"gripper_width/{arm}", widths
        for body, poses in self.body_poses.items():
            yield f"body_poses/{body}", poses

    @property
    def end(self) -> float:
        """When it ends [s]."""
        return float(self.time[-1])

    @property
    def grips(self) -> tuple[Grip, ...]:
        """The grips there are, that of the hand that acts first."""
        hold = self.hold
        return () if hold is None else tuple(grip for grip in (hold.grip, hold.second_grip) if grip is not None)

    @property
    def grip(self) -> Grip | None:
        """The grip of the hand that acts first, if there is any."""
        return None if self.hold is None else self.hold.grip

    @property
    def push(self) -> Push | None:
        """The push there is."""
        return None if self.hold is None else self.hold.push

    @property
    def rides(self) -> list[tuple[str, Attachment]]:
        """Every attachment with the body that is attached."""
        return [(body, each) for body, attachments in self.attached.items() for each in attachments]

    @cached_property
    def transforms(self) -> dict[str, Array]:
        """`T_world_body` (n, 4, 4) of every body that moves here."""
        return {name: from_pose7s(poses) for name, poses in self.body_poses.items()}


def riding_on(carrier: str, segments: Sequence[Segment], index: int) -> tuple[str, Attachment] | None:
    """Return the first body that rides on a carrier in a segment, and how; None where there is none.

    While a body is attached or detached nothing rides yet, or any more: these segments have what their neighbour has.
    """
    beside = index + {SegmentKind.ATTACH: 1, SegmentKind.DETACH: -1}.get(segments[index].kind, 0)
    if not 0 <= beside < len(segments):
        return None
    return next((ride for ride in segments[beside].rides if ride[1].to == carrier), None)
