"""The base of every model of the contract."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from itertools import pairwise
from typing import Any, Self, TypeVar

from pydantic import BaseModel, ConfigDict, GetJsonSchemaHandler, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError

T = TypeVar("T")
MOST_DISTURBED = 20
"""How often a source is parsed in vain before what is said of it is believed."""
MAX_MEMBERS = 100
"""No object of the contract has more members; a body of a million unknown ones is not worth listing."""


class DescribedModel(BaseModel):
    """An immutable object in whose JSON schema each member is described by the string below it.

    That is read out of the source when a schema is asked for. Pydantic's `use_attribute_docstrings` does so whenever a
    model is imported, which takes longer than all else about it.
    """

    model_config = ConfigDict(frozen=True)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Describe each member by the string below it."""
        described = handler(schema)
        members = handler.resolve_ref_schema(described).get("properties", {})
        for name, field in cls.model_fields.items():
            member = members.get(field.alias or name)
            documented = next((_descriptions(each)[name] for each in cls.__mro__ if name in _descriptions(each)), None)
            if member is not None and documented is not None:
                member.setdefault("description", documented)
        return described


class StrictModel(DescribedModel):
    """An immutable object that refuses members it does not know."""

    model_config = ConfigDict(extra="forbid")

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


def parsed(parse: Callable[[], T]) -> T:
    """Return what something that parses Python makes of it, whatever other threads do meanwhile.

    Python 3.11 counts the depth of a syntax tree wrongly where another thread gets its turn (gh-106905), and says so as
    a SystemError; asked again, it seldom does.
    """
    for _ in range(MOST_DISTURBED):
        with suppress(SystemError):
            return parse()
    return parse()


@cache
def _descriptions(model: type) -> dict[str, str]:
    """Return the strings below the annotated members of a class's own source, by member."""
    if not issubclass(model, DescribedModel):
        return {}
    try:
        source = parsed(lambda: inspect.getsource(model))
    except OSError:
        # Installed without its sources: a schema that describes less is better than none.
        return {}
    (definition,) = parsed(lambda: ast.parse(textwrap.dedent(source))).body
    assert isinstance(definition, ast.ClassDef)
    return {
        member.target.id: inspect.cleandoc(below.value.value)
        for member, below in pairwise(definition.body)
        if isinstance(member, ast.AnnAssign)
        and isinstance(member.target, ast.Name)
        and isinstance(below, ast.Expr)
        and isinstance(below.value, ast.Constant)
        and isinstance(below.value.value, str)
    }
