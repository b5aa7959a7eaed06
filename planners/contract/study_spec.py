"""StudySpec: a task, and up to two of its members that are varied."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import Field, JsonValue, StringConstraints, model_validator
from pydantic_core import PydanticCustomError

from planners.contract.quantities import Counted, ExternalId
from planners.contract.strict_model import StrictModel

MOST_VALUES = 1000
"""Of one axis."""
_Bound = Annotated[float, Field(strict=True, ge=-1e6, le=1e6, allow_inf_nan=False)]


class StudyAxis(StrictModel):
    """One member of the task that is varied: over a range, evenly and with both ends, or over a list of values."""

    pointer: Annotated[str, StringConstraints(pattern=r"^(/[^/]{1,100}){1,20}$")]
    """What is varied: a JSON pointer (RFC 6901) into the task, as `/cup/position/0` or `/lifter_model`."""
    part: Literal["value", "yaw"] = "value"
    """value: what stands at the pointer is replaced. yaw: the pose that stands there is turned about the vertical
    through its origin, by so much [rad]."""
    min: _Bound | None = None
    """Where a range begins, in the member's own unit."""
    max: _Bound | None = None
    """Where it ends."""
    count: Annotated[int, Field(strict=True, ge=2, le=MOST_VALUES)] | None = None
    """How many values it has, both ends among them."""
    values: Annotated[tuple[JsonValue, ...], Counted(1, MOST_VALUES)] | None = None
    """Instead of a range: the values themselves, of whatever the member may be."""

    @model_validator(mode="after")
    def _is_a_range_or_a_list(self) -> Self:
        given = [each is not None for each in (self.min, self.max, self.count)]
        if any(given) == (self.values is not None) or (self.values is None and not all(given)):
            raise PydanticCustomError("axis", "must have either min, max and count, or values")
        if self.min is not None and self.max is not None and self.min >= self.max:
            raise PydanticCustomError("axis", "must have a min that is less than its max")
        return self

    @property
    def places(self) -> Sequence[JsonValue]:
        """The values of the member, in order."""
        if self.values is not None:
            return self.values
        assert self.min is not None
        assert self.max is not None
        assert self.count is not None
        steps = self.count - 1
        # Twelve digits: so that 0.1 is written as people do.
        return [round(self.min + (self.max - self.min) * step / steps, 12) for step in range(self.count)]


class StudySpec(StrictModel):
    """A task, and up to two of its members that are varied: it is planned at every combination of their values."""

    task: dict[str, JsonValue]
    """As for a plan; what is varied may have any valid value."""
    axes: Annotated[tuple[StudyAxis, ...], Counted(1, 2)]
    """Values of the last one vary fastest from point to point."""
    certify: Annotated[bool, Field(strict=True)] = False
    """Whether every point is planned as a plan is, with denser samplings where nothing is found, and certified. That
    takes several times as long. Otherwise points are searched, with the densities of the task, and not certified."""
    external_id: ExternalId | None = None
    """Your own name for the study; it is handed back."""
