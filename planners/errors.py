"""What can be wrong with a request to the planners. One root; errors are made from facts and name valid choices.

A plan that cannot be found is not an error: it is a result with reasons (`planners.graph.rejections`).
"""

from __future__ import annotations

from collections.abc import Iterable


class LiftwrightError(Exception):
    """Anything the planners refuse; the message is a sentence for a person."""


class PlanningCancelled(LiftwrightError):
    """The caller asked for the work to stop."""


class PlanningFaultError(LiftwrightError):
    """A fault of the planner itself: it would go on for ever, or contradict itself."""


class AssetError(LiftwrightError):
    """A file of the assets folder is missing, unreadable or says something impossible."""


class SceneError(LiftwrightError):
    """The things a task names cannot stand as it says.

    `pointer` is the RFC 6901 path of the offending member in the TaskSpec, `allowed` its valid choices, if any;
    `pointers` are all of them where several members do not go together.
    """

    def __init__(
        self, pointer: str, detail: str, allowed: list[str] | None = None, *, others: Iterable[str] = ()
    ) -> None:
        self.pointer, self.detail, self.allowed = pointer, detail, allowed
        self.pointers = (pointer, *others)
        super().__init__(f"{pointer or '/'}: {detail}")
