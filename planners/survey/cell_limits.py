"""What tasks in a cell must keep within: where its table is, what its arms reach and bear."""

from __future__ import annotations

from typing import Self

import numpy as np

from planners.cell.arm import Arm
from planners.cell.arm_span import ArmSpan
from planners.cell.cell import Cell
from planners.cell.hand import Gripper
from planners.contract.strict_model import DescribedModel


class TableLimits(DescribedModel):
    """What tasks may put things on, in world axes [m]."""

    x: tuple[float, float]
    """Its near and its far edge."""
    y: tuple[float, float]
    """Its edges at the right and at the left arm."""
    top: float
    """Height of its top above the floor."""


class ArmLimits(DescribedModel):
    """What one arm of a cell can do."""

    robot: str
    hand: str
    payload: float
    """Largest mass at the flange, hand included [kg]."""
    spare_payload: float
    """What of it is left beside the hand: the hand never bears more than its weight [kg]."""
    shoulder: tuple[float, float, float]
    """Where the reach is counted from, in the world [m]."""
    reach: float
    """Nothing farther from the shoulder is touched by the hand, in whatever posture; much that is nearer is not
    reached either [m]."""
    stroke: tuple[float, float] | None
    """Least and largest opening of a gripper [m]; null: the hand is a stick."""


class CellLimits(DescribedModel):
    """Where a cell's tasks are, and with what they are done."""

    table: TableLimits
    arms: dict[str, ArmLimits]
    tools: tuple[str, ...] = ()
    """Suction tools that the cell brings; tasks in it may name them as they name shipped ones."""

    @classmethod
    def of(cls, cell: Cell) -> Self:
        """Return what a cell's files say."""
        # By definition of a cell its first box is the table.
        center, half = cell.boxes[0].center, 0.5 * cell.boxes[0].size
        low, high = np.round(center - half, 4).tolist(), np.round(center + half, 4).tolist()
        table = TableLimits(x=(low[0], high[0]), y=(low[1], high[1]), top=high[2])
        arms = {name: _arm_limits(arm) for name, arm in cell.arms.items()}
        return cls(table=table, arms=arms, tools=tuple(sorted(cell.tools)))


def _arm_limits(arm: Arm) -> ArmLimits:
    span, hand = ArmSpan.of(arm), arm.hand
    x, y, z = (round(float(value), 4) for value in span.center)
    return ArmLimits(
        robot=arm.robot.name,
        hand=hand.name,
        payload=arm.robot.payload,
        spare_payload=round(arm.spare_payload, 4),
        shoulder=(x, y, z),
        reach=round(span.radius, 4),
        stroke=(0.0, hand.width_max) if isinstance(hand, Gripper) else None,
    )
