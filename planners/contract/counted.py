"""Lists whose length is checked before their items."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema


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
