"""The base of every model of the contract."""

from __future__ import annotations

from typing import Any, Self

from pydantic import BaseModel, ConfigDict, model_validator
from pydantic_core import PydanticCustomError

MAX_MEMBERS = 100
"""No object of the contract has more members; a body of a million unknown ones is not worth listing."""


class StrictModel(BaseModel):
    """An immutable object that refuses members it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    @model_validator(mode="before")
    @classmethod
    def _has_a_sane_number_of_members(cls, data: Any) -> Any:
        if isinstance(data, dict) and len(data) > MAX_MEMBERS:
            raise PydanticCustomError(
                "too_many_members",
                "has {count} members, at most {most} are allowed",
                {"count": len(data), "most": MAX_MEMBERS},
            )
        return data

    def __copy__(self) -> Self:
        """Copy the members only: what was derived from them need not hold for a copy in which some are changed."""
        copied = super().__copy__()
        values = vars(copied)
        for name in values.keys() - type(self).model_fields.keys():
            del values[name]
        return copied
