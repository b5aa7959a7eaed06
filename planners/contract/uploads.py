"""Which uploads a task names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


def named_uploads(task: object) -> frozenset[str]:
    """Return the ids of all uploaded meshes in a task as JSON data, as accepted."""
    if isinstance(task, Mapping):
        upload = task.get("upload") if task.get("type") == "mesh" else None
        own = frozenset() if upload is None else frozenset({str(upload)})
        return own.union(*map(named_uploads, task.values()))
    if isinstance(task, Sequence) and not isinstance(task, str):
        return frozenset().union(*map(named_uploads, task))
    return frozenset()
