"""Contacts of a plan: what bears on what at a sample, and what limits it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, field_validator
from pydantic_core import PydanticCustomError

from planners.contract.arrays import Real, SampledDirection, SampledVector, SampledWrench
from planners.contract.strict_model import StrictModel
from planners.geometry.pose import Array


class _Wrenched(StrictModel):
    """What states a wrench, each kind at its own place among its members."""

    if TYPE_CHECKING:
        wrench: SampledWrench

    @property
    def force(self) -> Array:
        """(3,) of the wrench [N]."""
        return self.wrench[:3]

    @property
    def torque(self) -> Array:
        """(3,) of the wrench, about `point` [Nm]."""
        return self.wrench[3:]


class _Contact(_Wrenched):
    sample: Annotated[int, Field(strict=True, ge=0)]
    body: str
    finger: Literal[0, 1] | None
    """0 is at the TCP's -y; None where the contact is no finger's."""
    point: SampledVector
    normal: SampledDirection
    """Into the body."""
    wrench: SampledWrench
    """That `by` exerts on `body`, about `point`."""
    by: str


class SoftFingerContact(_Contact):
    """A pad: friction of a soft finger, its torque about the normal only."""

    kind: Literal["soft_finger"]
    mu: Real
    eps: Real
    limit: Real | None
    """Largest normal force there can be: the squeeze, and half of what the hand may bear in all [N]."""
    squeeze: Real | None = None
    """As of the grip: the normal forces of both fingers add up to twice as much [N]."""

    @field_validator("finger")
    @classmethod
    def _is_a_finger(cls, finger: int | None) -> int:
        if finger is None:
            raise PydanticCustomError("finger", "must be 0 or 1 for a soft finger")
        return finger


class PointContact(_Contact):
    """A stick's tip: friction, no torque."""

    kind: Literal["point"]
    mu: Real
    limit: Real | None


class EnvironmentContact(_Contact):
    """One corner of the contact with a resting surface: friction, no torque."""

    kind: Literal["environment"]
    mu: Real
    limit: Real | None


class SuctionContact(_Contact):
    """A suction pad; x = body x projected on the pad, y = z cross x, pull outward positive."""

    kind: Literal["suction"]
    mu: Real
    radius: Real
    kappa: Real
    limit: Real
    suction_force: Real
    x_axis: SampledDirection


class InertiaEntry(_Wrenched):
    """The inertial wrench that was counted in a set, about `point`, the centre of mass."""

    kind: Literal["inertia"]
    sample: Annotated[int, Field(strict=True, ge=0)]
    body: str
    by: str | None = None
    finger: None = None
    point: SampledVector
    normal: SampledVector | None = None
    wrench: SampledWrench


BearingContact = SoftFingerContact | PointContact | EnvironmentContact | SuctionContact
Contact = Annotated[BearingContact | InertiaEntry, Field(discriminator="kind")]
