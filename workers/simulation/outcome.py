"""How a simulated lift ends."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class SimulationOutcome(Enum):
    """How it ended; the value is its name in the plan document."""

    LIFTED = "lifted"
    SLIPPED = "slipped"
    CUP_LOST = "cup_lost"
    OVERLOAD = "overload"


@dataclass(frozen=True)
class Failure:
    """What gave way."""

    outcome: SimulationOutcome
    time: float
    """[s]"""
    cause: str
    """As a sentence for a person."""
