"""Numbers of a plan: arrays inside, lists of numbers in JSON. SI units, world frame, finite."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Annotated, Any

import numpy as np
from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler, WithJsonSchema
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from planners.geometry.pose import Array

SAMPLE_DIGITS = 12
"""Decimals of everything sampled: 1e-12 rad, m or N."""
SIGNIFICANT = 9
"""Digits of what contacts state: as many as the contract asks for."""
LARGEST = 1e9
"""No number of a plan is larger, whatever its unit."""
UNIT_TOLERANCE = 1e-6
"""How far the length of a direction or a quaternion may be from 1."""

_NUMBER = WithJsonSchema({"type": "number"})
Finite = Annotated[float, Field(allow_inf_nan=False)]
Real = Annotated[float, Field(gt=-LARGEST, lt=LARGEST, allow_inf_nan=False), _NUMBER]
Positive = Annotated[float, Field(gt=0.0, lt=LARGEST, allow_inf_nan=False), _NUMBER]


class OneOf:
    """Annotation of a text that is one of a few names."""

    def __init__(self, *names: str) -> None:
        self.names = names

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Take these names only."""
        return core_schema.literal_schema(list(self.names))


ArmName = Annotated[str, OneOf("left", "right")]


@dataclass(frozen=True)
class Rows:
    """Annotation of an array: rows of equally many numbers, or single numbers."""

    columns: int | None
    """Numbers in a row; None: the array is (n,), a number a sample."""
    digits: int | None = SAMPLE_DIGITS
    """Decimals that are written; None: all there are."""
    count: int | None = None
    """Number of rows; None: any."""
    gaps: bool = False
    """Whether numbers may be missing: null in JSON, NaN in the array."""
    poses: bool = False
    """Whether rows are `[x, y, z, w, x, y, z]` with a unit quaternion."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Read lists and arrays, write lists."""
        written = core_schema.plain_serializer_function_ser_schema(self.write)
        return core_schema.no_info_plain_validator_function(self.read, serialization=written)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """State the shape in the JSON schema."""
        number: JsonSchemaValue = {"type": "number"}
        if self.gaps:
            number = {"anyOf": [number, {"type": "null"}]}
        if self.columns is not None:
            number = {"items": number, "maxItems": self.columns, "minItems": self.columns, "type": "array"}
        counted = {} if self.count is None else {"minItems": self.count, "maxItems": self.count}
        return {"items": number, "type": "array", **counted}

    def read(self, value: Any) -> Array:
        """Return the array, which nobody may write to."""
        rows = value if isinstance(value, np.ndarray) else self._of_lists(value)
        wanted = f"{self.count or 'n'}" + ("" if self.columns is None else f" x {self.columns}")
        if rows.ndim != (1 if self.columns is None else 2) or (self.columns or rows.shape[-1]) != rows.shape[-1]:
            raise PydanticCustomError("rows", "must be {wanted} numbers", {"wanted": wanted})
        if self.count is not None and len(rows) != self.count:
            raise PydanticCustomError("rows", "must be {wanted} numbers", {"wanted": wanted})
        bad = ~(np.abs(rows) < LARGEST) & ~(np.isnan(rows) if self.gaps else False)
        if bad.any():
            at = "".join(f"/{index}" for index in np.argwhere(bad)[0])
            raise PydanticCustomError("finite", "must be a finite number of sensible size", {"at": at})
        if self.poses:
            askew = np.flatnonzero(np.abs(np.linalg.norm(rows[:, 3:], axis=1) - 1.0) > UNIT_TOLERANCE)
            if askew.size:
                at = {"at": f"/{askew[0]}"}
                raise PydanticCustomError("unit", "has a quaternion that is not unit to 1e-6", at)
        rows = rows.view()
        rows.flags.writeable = False
        return rows

    def _of_lists(self, value: Any) -> Array:
        if not isinstance(value, (list, tuple)):
            raise PydanticCustomError("rows", "must be an array")
        flat: Iterable[Any] = value
        if self.columns is not None:
            for index, row in enumerate(value):
                if not isinstance(row, (list, tuple)) or len(row) != self.columns:
                    at = {"columns": self.columns, "at": f"/{index}"}
                    raise PydanticCustomError("rows", "must hold {columns} numbers", at)
            flat = chain.from_iterable(value)
        known = {int, float, *({type(None)} if self.gaps else ())}
        # The types of thousands of numbers are looked at together; one by one only to name the wrong one.
        if not set(map(type, flat)) <= known:
            raise PydanticCustomError("rows", "must be a number", {"at": self._stranger(value, known)})
        try:
            rows = np.array(value, dtype=float)
        except OverflowError:
            raise PydanticCustomError("finite", "must hold finite numbers of sensible size") from None
        return rows if self.columns is None else rows.reshape(len(value), self.columns)

    def _stranger(self, value: Sequence[Any], known: set[type]) -> str:
        """Return the place of the first that is no number."""
        if self.columns is None:
            return f"/{next(i for i, number in enumerate(value) if type(number) not in known)}"
        places = ((i, j) for i, row in enumerate(value) for j, number in enumerate(row) if type(number) not in known)
        return "/" + "/".join(map(str, next(places)))

    def write(self, rows: Array) -> list[Any]:
        """Return lists of numbers, without digits that mean nothing."""
        written = (rows if self.digits is None else rounded(rows, self.digits)).tolist()
        return [None if number != number else number for number in written] if self.gaps else written


def significant(values: Array) -> Array:
    """Round to nine significant digits, and to no more decimals than samples have."""
    exponents = np.floor(np.log10(np.maximum(np.abs(values), 10.0**-SAMPLE_DIGITS)))
    scales = 10.0 ** np.minimum(SIGNIFICANT - 1 - exponents, SAMPLE_DIGITS)
    return np.round(values * scales) / scales + 0.0


@dataclass(frozen=True)
class Numbers:
    """Annotation of a short array of a known length: a vector, a wrench, a pose."""

    length: int
    digits: int | None = None
    """Decimals that are written; None: all there are."""
    unit: int | None = None
    """From this entry on it is a unit vector or quaternion."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Read lists and arrays, write lists."""
        written = core_schema.plain_serializer_function_ser_schema(self.write)
        return core_schema.no_info_plain_validator_function(self.read, serialization=written)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """State the length in the JSON schema."""
        numbers = [{"type": "number"}] * self.length
        return {"maxItems": self.length, "minItems": self.length, "prefixItems": numbers, "type": "array"}

    def read(self, value: Any) -> Array:
        """Return the array, which nobody may write to."""
        # There are thousands of these in a plan: plain comparisons take less time than NumPy's for so few numbers.
        numbers = value.tolist() if isinstance(value, np.ndarray) else value
        if not isinstance(numbers, (list, tuple)) or len(numbers) != self.length:
            raise PydanticCustomError("numbers", "must hold {length} numbers", {"length": self.length})
        for index, number in enumerate(numbers):
            if type(number) not in _NUMBERS:
                raise PydanticCustomError("numbers", "must be a number", {"at": f"/{index}"})
            if not -LARGEST < number < LARGEST:
                raise PydanticCustomError("finite", "must be a finite number of sensible size", {"at": f"/{index}"})
        if self.unit is not None and abs(math.hypot(*numbers[self.unit :]) - 1.0) > UNIT_TOLERANCE:
            what = "quaternion" if self.unit else "vector"
            raise PydanticCustomError("unit", "has a {what} that is not unit to 1e-6", {"what": what})
        array = np.array(numbers, dtype=float)
        array.flags.writeable = False
        return array

    def write(self, array: Array) -> list[float]:
        """Return a list of numbers."""
        numbers = array.tolist()
        if self.digits is None:
            return numbers
        # As `rounded` does; NumPy takes longer for so few numbers.
        scale = 10.0**self.digits
        return [round(number * scale) / scale for number in numbers]


def rounded(values: Array, digits: int = SAMPLE_DIGITS) -> Array:
    """Round sampled numbers to digits that mean something."""
    # Adding zero turns -0.0 into 0.0.
    return np.round(values, digits) + 0.0


_NUMBERS = (float, int)
Vector = Annotated[Array, Numbers(3)]
UnitVector = Annotated[Array, Numbers(3, unit=0)]
"""Of length 1."""
PoseRow = Annotated[Array, Numbers(7, unit=3)]
"""(7,) [x, y, z, w, x, y, z], the quaternion unit to 1e-6."""
SixJoints = Annotated[Array, Numbers(6)]
SampledVector = Annotated[Array, Numbers(3, SAMPLE_DIGITS)]
SampledDirection = Annotated[Array, Numbers(3, SAMPLE_DIGITS, unit=0)]
SampledPose = Annotated[Array, Numbers(7, SAMPLE_DIGITS, unit=3)]
SampledWrench = Annotated[Array, Numbers(6, SAMPLE_DIGITS)]
"""[fx, fy, fz, tx, ty, tz] in world axes, the torque about the stated point."""
Samples = Annotated[Array, Rows(None)]
"""(n,) a number a sample."""
Poses = Annotated[Array, Rows(7, poses=True)]
"""(n, 7) poses as rows `[x, y, z, w, x, y, z]`."""
