"""Holds: which grip and which push have the plate at once (the paper's robot configurations, R-Conf, Table III)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from planners.errors import LiftwrightError
from planners.manipulation.grips import (
    CupFootprint,
    Grip,
    GripSampling,
    Jaw,
    generate_grips,
    grips_from_data,
)
from planners.manipulation.pushes import Push, PushSampling, generate_pushes, pushes_from_data

__all__ = [
    "CupFootprint",
    "Grip",
    "GripSampling",
    "Hold",
    "HoldList",
    "Jaw",
    "Push",
    "PushSampling",
    "generate_grips",
    "generate_pushes",
    "grips_from_data",
    "pushes_from_data",
]


@dataclass(frozen=True)
class Hold:
    """A grip, a push, both or neither, by their numbers. `a <= b`: every contact of a is one of b."""

    grip: int | None = None
    push: int | None = None

    def __le__(self, other: Hold) -> bool:
        return self.grip in (None, other.grip) and self.push in (None, other.push)

    def __lt__(self, other: Hold) -> bool:
        return self != other and self <= other


@dataclass(frozen=True)
class HoldList:
    """Every grip, then every push, then every pair of them (pushes running fastest). No hold at all is not listed."""

    grip_count: int
    push_count: int

    def __len__(self) -> int:
        return self.grip_count + self.push_count + self.grip_count * self.push_count

    def __getitem__(self, number: int) -> Hold:
        if not 0 <= number < len(self):
            raise IndexError(number)
        if number < self.grip_count:
            return Hold(grip=number)
        number -= self.grip_count
        if number < self.push_count:
            return Hold(push=number)
        grip, push = divmod(number - self.push_count, self.push_count)
        return Hold(grip, push)

    def __iter__(self) -> Iterator[Hold]:
        return (self[number] for number in range(len(self)))

    def number(self, hold: Hold) -> int:
        """Return the place of a hold in the list.

        Raises:
            LiftwrightError: if the hold is empty or has a grip or push that the list does not know.
        """
        grip, push = hold.grip, hold.push
        known = (grip is None or 0 <= grip < self.grip_count) and (push is None or 0 <= push < self.push_count)
        if not known or (grip is None and push is None):
            raise LiftwrightError(
                f"{hold} is not among the holds of {self.grip_count} grips and {self.push_count} pushes"
            )
        if push is None:
            return grip if grip is not None else 0
        if grip is None:
            return self.grip_count + push
        return self.grip_count + self.push_count + grip * self.push_count + push
