"""A change of a task's document, as a JSON Patch (RFC 6902)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

import jsonpatch
import jsonpointer
from pydantic import JsonValue

from planners.contract.strict_model import StrictModel
from planners.errors import LiftwrightError


class PatchOperation(StrictModel):
    """One step of a JSON Patch (RFC 6902, 4). `add` also replaces a member of an object that is there."""

    op: Literal["add", "remove", "replace"]
    path: str
    """What it changes: a JSON pointer (RFC 6901) into the task."""
    value: JsonValue = None
    """What is put there; nothing where it is removed."""

    def written(self) -> dict[str, Any]:
        """Return the operation as JSON data."""
        return self.model_dump(mode="json", exclude={"value"} if self.op == "remove" else set())


class CannotBeChanged(LiftwrightError):
    """A patch does not fit the task: a member that it names is not there."""


def changed(task: Any, patch: Iterable[PatchOperation]) -> Any:
    """Return a task's document with a patch applied; the document itself stays as it is.

    Args:
        task: JSON data of a task, as posted or with every default filled in.
        patch: its operations, applied in order.

    Raises:
        CannotBeChanged: the patch does not fit.
    """
    try:
        return jsonpatch.apply_patch(task, [operation.written() for operation in patch])
    except (jsonpatch.JsonPatchException, jsonpointer.JsonPointerException) as refused:
        raise CannotBeChanged(str(refused)) from refused
