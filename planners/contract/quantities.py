"""Numbers with a unit and a sane range, the small arrays made of them, and lists of a sane length.

Strings and booleans are not numbers, integers are; NaN and the infinities are refused. The ranges only keep out
what cannot be meant: a plate of 1e300 m gets a clear error instead of a strange plan.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import AfterValidator, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, Strict, StringConstraints
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

UNIT_TOLERANCE = 1e-3
"""How far from 1 the length of a given quaternion or direction may be; it is normalised afterwards."""
LARGEST_SEED = 2**53 - 1
"""The largest integer that every JSON reader keeps exactly."""

Length = Annotated[float, Strict(), Field(ge=1e-4, le=10.0, allow_inf_nan=False)]
"""A size [m]."""
Coordinate = Annotated[float, Strict(), Field(ge=-10.0, le=10.0, allow_inf_nan=False)]
"""One coordinate of a point [m]."""
Mass = Annotated[float, Strict(), Field(ge=1e-4, le=1000.0, allow_inf_nan=False)]
"""[kg]"""
Force = Annotated[float, Strict(), Field(ge=1e-3, le=1e5, allow_inf_nan=False)]
"""[N]"""
FrictionCoefficient = Annotated[float, Strict(), Field(ge=0.01, le=10.0, allow_inf_nan=False)]
"""Coulomb's coefficient [1]. Without any friction the cones lose their interior: at least 0.01."""
Eccentricity = Annotated[float, Strict(), Field(ge=1e-4, le=0.1, allow_inf_nan=False)]
"""Ratio of torsional to tangential friction of a soft finger [m]."""
SOFT_FINGER_EPS = 0.0075
"""That of rubber pads, as in paper B [m]; what a task may leave out."""
PeelStiffness = Annotated[float, Strict(), Field(ge=1e-6, le=1e4, allow_inf_nan=False)]
"""The suction model's kappa: it multiplies a length, so it is a force [N]."""
Factor = Annotated[float, Strict(), Field(ge=0.25, le=4.0, allow_inf_nan=False)]
"""A density relative to the default [1]."""
Reserve = Annotated[float, Strict(), Field(ge=0.0, lt=1.0, allow_inf_nan=False)]
"""The share of every force limit that is kept back [1]."""
MassTolerance = Annotated[float, Strict(), Field(ge=0.0, le=0.5, allow_inf_nan=False)]
"""The share by which a mass may be more or less than stated [1]."""
Tolerance = Annotated[float, Strict(), Field(ge=0.0, le=0.1, allow_inf_nan=False)]
"""The distance by which a place may be off what is stated [m]."""
Scale = Annotated[float, Strict(), Field(ge=1e-6, le=1e6, allow_inf_nan=False)]
"""What a mesh's coordinates are multiplied by to be metres [1]."""
Angle = Annotated[float, Strict(), Field(ge=-100.0, le=100.0, allow_inf_nan=False)]
"""A joint position [rad]."""
Seed = Annotated[int, Strict(), Field(ge=0, le=LARGEST_SEED)]

NAME_PATTERN = r"^[A-Za-z0-9_-]{1,64}$"
EXTERNAL_ID_PATTERN = r"^[^\x00-\x1f\x7f]{1,128}$"
WHAT_NAMES_ARE = "must be 1 to 64 letters from A to Z or a to z, digits, underscores and hyphens"
PATTERN_WORDS = {
    NAME_PATTERN: WHAT_NAMES_ARE,
    EXTERNAL_ID_PATTERN: "must have 1 to 128 characters, none of them a control character",
}
"""What a string must be that has a pattern, for who wrote another one."""

Name = Annotated[str, Strict(), StringConstraints(pattern=NAME_PATTERN)]
SceneId = Annotated[str, Strict(), StringConstraints(pattern=NAME_PATTERN)]
ExternalId = Annotated[str, Strict(), StringConstraints(pattern=EXTERNAL_ID_PATTERN)]
"""The caller's own name for the task: up to 128 characters, none of them a control character."""

Point2 = tuple[Coordinate, Coordinate]
"""[x, y] in metres."""
Point3 = tuple[Coordinate, Coordinate, Coordinate]
"""[x, y, z] in metres."""
Component = Annotated[float, Strict(), Field(ge=-1.0 - UNIT_TOLERANCE, le=1.0 + UNIT_TOLERANCE, allow_inf_nan=False)]
"""One component of a unit quaternion or direction."""


def _normalised(values: tuple[float, ...], what: str) -> tuple[float, ...]:
    norm = math.hypot(*values)
    if abs(norm - 1.0) > UNIT_TOLERANCE:
        raise PydanticCustomError(
            "not_unit",
            "{what} must have length 1 within {tolerance}; it has {norm}",
            {"what": what, "tolerance": UNIT_TOLERANCE, "norm": round(norm, 6)},
        )
    # One that is a unit to rounding is kept as it is, so that a document read again stays the same to the last bit.
    return values if abs(norm - 1.0) < 1e-12 else tuple(value / norm for value in values)


def _normalised_pose(pose: tuple[float, ...]) -> tuple[float, ...]:
    return (*pose[:3], *_normalised(pose[3:], "the quaternion [w, x, y, z]"))


def _normalised_direction(direction: tuple[float, ...]) -> tuple[float, ...]:
    return _normalised(direction, "a direction")


Pose = Annotated[
    tuple[Coordinate, Coordinate, Coordinate, Component, Component, Component, Component],
    AfterValidator(_normalised_pose),
]
"""[x, y, z, w, x, y, z]: position [m], then a unit quaternion with the scalar first."""
Direction = Annotated[tuple[Component, Component, Component], AfterValidator(_normalised_direction)]
"""[x, y, z] of length 1."""
JointPositions = tuple[
    Angle, Angle, Angle, Angle, Angle, Angle, Angle, Angle, Angle, Angle, Angle, Angle
]  # fmt: skip
"""Twelve joint positions, the left arm's six first [rad]."""


@dataclass(frozen=True)
class Counted:
    """Annotation of a list: one that is too long or too short is refused at once, whatever its items are."""

    least: int
    most: int

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Put the check before the list's own validation."""
        return core_schema.no_info_before_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """State the limits in the JSON schema."""
        return {**handler(schema), "minItems": self.least, "maxItems": self.most}

    def _check(self, items: Any) -> Any:
        if isinstance(items, list | tuple) and not self.least <= len(items) <= self.most:
            raise PydanticCustomError(
                "count",
                "has {count} items; between {least} and {most} are allowed",
                {"count": len(items), "least": self.least, "most": self.most},
            )
        return items
