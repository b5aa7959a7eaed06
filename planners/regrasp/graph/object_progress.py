"""Which part of planning one object is being done: the columns of paper A's Table I."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from planners.progress import Progress, Report


class ObjectStage(Enum):
    """A part of planning one object; the value is the stage that is reported."""

    FIRST_REGRASP = "first regrasp"
    """Grasps of the tool where it is, and with its cup on the object."""
    SECOND_REGRASP = "second regrasp"
    """Grasps of the tool with the object at its goals."""
    GRAPH = "regrasp graph"
    """The one graph of both rounds: building and searching it."""
    FIRST_MOTION = "first motion"
    SECOND_MOTION = "second motion"

    @classmethod
    def motion(cls, number: int) -> ObjectStage:
        """Return the motion of round 0 or 1."""
        return (cls.FIRST_MOTION, cls.SECOND_MOTION)[number]


Tell = Callable[[ObjectStage], None]
"""Called with what is done from now on."""


@dataclass
class ObjectProgress:
    """Reports what is done for one object."""

    report: Progress
    name: str
    suction_poses: int
    """That may be tried."""
    tried: int = 0
    """Of them."""

    def __call__(self, stage: ObjectStage) -> None:
        """Report what is done from now on."""
        self.report(Report(stage.value, self.tried, self.suction_poses, self.name))
