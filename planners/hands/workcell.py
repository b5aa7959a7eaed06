"""Two arms among other bodies, as collision queries ask for them."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Self

from planners.cell.arm import Arm
from planners.cell.asset_files import ARM_NAMES
from planners.cell.cell import Cell
from planners.collision.model import NamePair, PairChoice
from planners.errors import LiftwrightError
from planners.geometry.convex import CollisionBody, sorted_pair
from planners.geometry.pose import Array, Transform, inverse

NEAR = 0.003
"""What parts of one arm keep from one another, and a hand from what it holds, whatever more a cell asks of others, in a
cell of size 1 [m]: they belong close together, some links of a UR3e by 18 mm in every posture."""


@dataclass(frozen=True)
class Clearance:
    """How far bodies keep apart while planning; the certificate asks for no penetration."""

    margin: float = 0.003
    """Between bodies that have nothing to do with one another [m]: at 1 mm plans were seen to touch."""
    finger_margin: float = 0.0
    """Between what is held and the parts of the fingers next to the pads that hold it, or are about to [m]."""
    executed_share: float = 0.5
    """Part of all margins that timed motion must keep at its samples: motion is planned at fewer."""
    most_near: float = field(default=NEAR, repr=False)
    """`NEAR` in the size of the cell [m]. It follows from the cell alone, so that no key of stored data needs it."""

    def __post_init__(self) -> None:
        if min(self.margin, self.finger_margin, self.executed_share) < 0.0:
            raise LiftwrightError("clearances are not negative")

    @classmethod
    def of(cls, cell: Cell) -> Self:
        """Return what a cell asks for, the defaults where it says nothing."""
        near = cell.size * NEAR
        return cls(most_near=near) if cell.margins is None else cls(margin=cell.margins.bodies, most_near=near)

    @property
    def near(self) -> float:
        """What is kept between parts of one arm, and between a hand and what it holds [m]."""
        return min(self.margin, self.most_near)

    @property
    def steps(self) -> float:
        """How many times as long as with `NEAR` steps of ways may be [1]: what is missed between two must not touch."""
        return max(1.0, self.near / NEAR)

    def within_arms(self, bodies: Iterable[CollisionBody]) -> dict[NamePair, float]:
        """Return what parts of one arm keep from one another, of these bodies, where that is not the margin [m]."""
        if self.near == self.margin:
            return {}
        moving = [body for body in bodies if body.group in ARM_NAMES]
        pairs = itertools.combinations(moving, 2)
        return {sorted_pair(a.name, b.name): self.near for a, b in pairs if a.group == b.group}


class ArmKernel(NamedTuple):
    """One arm for compiled code."""

    dh: Array
    """(6, 4), see `planners.kinematics.forward`."""
    T_base_world: Transform
    """The world in the frame of the arm's base."""
    position_min: Array
    """(6,) [rad]."""
    position_max: Array
    """(6,) [rad]."""
    first_joint: int
    """Of the arm among all twelve."""

    @classmethod
    def of(cls, arm: Arm, first_joint: int) -> ArmKernel:
        """Return what compiled code needs of an arm."""
        return cls(arm.dh, inverse(arm.T_world_base), arm.position_min, arm.position_max, first_joint)


class Workcell(ABC):
    """Two arms; what they hold and what stands about is each planner's own."""

    @property
    @abstractmethod
    def arms(self) -> Mapping[str, Arm]:
        """Both arms by name, in the order of their joints."""

    def arm(self, name: str) -> Arm:
        """Return an arm by name."""
        return self.arms[name]

    def joints(self, name: str) -> slice:
        """Return the places of an arm's joints among all twelve."""
        first = 6 * list(self.arms).index(name)
        return slice(first, first + 6)

    def other(self, name: str) -> str:
        """Return the other arm."""
        return next(each for each in self.arms if each != name)

    def with_arm(self, arm: str) -> PairChoice:
        """Choose all pairs that have a body of an arm."""
        return lambda a, b: arm in (a.group, b.group)

    def is_hand(self, body: CollisionBody, arm: str) -> bool:
        """Tell whether a body is part of the hand of an arm: on its flange, but not the last link."""
        return body.frame == f"{arm}/6" and body.name != f"{arm}_wrist_3"

    def between_arms(self, a: CollisionBody, b: CollisionBody) -> bool:
        """Choose the pairs of one arm with the other."""
        return a.group != b.group and a.group in self.arms and b.group in self.arms
