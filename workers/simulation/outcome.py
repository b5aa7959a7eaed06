"""How a simulation ends."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Generic, TypeVar


class SimulationOutcome(Enum):
    """How a lift ended; the value is its name in the plan document."""

    LIFTED = "lifted"
    SLIPPED = "slipped"
    CUP_LOST = "cup_lost"
    OVERLOAD = "overload"


class ToolOutcome(Enum):
    """How moving objects with a suction tool ended; the value is its name in the plan document."""

    DONE = "done"
    OBJECT_DROPPED = "object_dropped"
    TOOL_SLIPPED = "tool_slipped"
    TOPPLED = "toppled"
    OFF_GOAL = "off_goal"


Ending = TypeVar("Ending", SimulationOutcome, ToolOutcome)


@dataclass(frozen=True)
class Failure(Generic[Ending]):
    """What gave way."""

    outcome: Ending
    time: float
    """[s]"""
    cause: str
    """As a sentence for a person."""
