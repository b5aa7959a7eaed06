"""The cell with two grippers, the shipped tools, their grasps, and one handover database."""

from __future__ import annotations

import pytest

from planners.cell.cell import Cell, load_cell
from planners.cell.hand import Gripper
from planners.regrasp.grasps.handovers import HandoverDatabase, HandoverSettings
from planners.regrasp.grasps.tool_grasps import ToolGrasps, ToolGraspSettings, tool_grasps
from planners.regrasp.tool_workcell import ToolWorkcell
from planners.scene.suction_tool import SuctionTool, load_tool
from tests.support.plan_shelf import PlanShelf


@pytest.fixture(scope="session")
def cell() -> Cell:
    return load_cell("dual_ur3e_tool")


@pytest.fixture(scope="session")
def gripper(cell: Cell) -> Gripper:
    hand = cell.arms["left"].hand
    assert isinstance(hand, Gripper)
    return hand


@pytest.fixture(scope="session")
def long_tool() -> SuctionTool:
    return load_tool("long_symmetric")


@pytest.fixture(scope="session")
def short_tool() -> SuctionTool:
    return load_tool("short_asymmetric")


@pytest.fixture(scope="session")
def long_grasps(long_tool: SuctionTool, gripper: Gripper) -> ToolGrasps:
    return tool_grasps(long_tool, gripper, ToolGraspSettings())


@pytest.fixture(scope="session")
def short_grasps(short_tool: SuctionTool, gripper: Gripper) -> ToolGrasps:
    return tool_grasps(short_tool, gripper, ToolGraspSettings())


@pytest.fixture(scope="session")
def long_workcell(cell: Cell, long_tool: SuctionTool) -> ToolWorkcell:
    return ToolWorkcell(cell, long_tool)


@pytest.fixture(scope="session")
def short_handovers(shelf: PlanShelf, cell: Cell, short_tool: SuctionTool) -> HandoverDatabase:
    return shelf.handovers(cell, short_tool, HandoverSettings())


@pytest.fixture(scope="session")
def long_handovers(shelf: PlanShelf, cell: Cell, long_tool: SuctionTool) -> HandoverDatabase:
    return shelf.handovers(cell, long_tool, HandoverSettings())
