"""Tools that lie on the table are taken up from it, or the millimetres that are missing are told."""

from __future__ import annotations

import numpy as np
import pytest

from planners.geometry.pose import Transform, rotation_z, to_pose7, transform
from planners.plan.verdicts import PlanningOutcome
from planners.progress import silent
from planners.regrasp.grasps.handovers import HandoverDatabase
from planners.regrasp.grasps.tool_grasps import Fingertips, ToolGrasps, tool_grasps
from planners.regrasp.planner import SuctionToolPlanner
from planners.regrasp.tool_plan import ToolPlan
from planners.regrasp.tool_settings import ToolPlannerSettings
from planners.scene.rest import Footing, LevelFace, find_footing
from planners.scene.suction_tool import SuctionTool
from planners.scene.tool_scene import SuctionToolScene
from tests.cell.cell_probe import gripper_hulls
from tests.regrasp.tool_tasks import TABLE, box, scene_of
from tests.support.plan_shelf import PlanShelf
from tests.support.samples import among

STANDING = ToolPlannerSettings()
LYING = STANDING.with_fingertips()
NAMES = {"long": "long_symmetric", "short": "short_asymmetric"}
FLOOR = LevelFace("table", 0.0, np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]))
OBJECT = box("a", [0.45, 0.2], [0.45, -0.2], (0.07, 0.06, 0.04))


def resting(tool: SuctionTool) -> list[Transform]:
    """Return how a tool lies on a floor at z = 0, its centre of mass over the origin: once for each face."""
    poses = []
    for face in tool.body.solid.flat_faces():
        down = -face.normal
        across = np.cross(down, [0.0, 0.0, 1.0])
        if np.linalg.norm(across) < 0.5:
            continue  # It would stand.
        across /= np.linalg.norm(across)
        R = np.vstack([across, np.cross(down, across), down])
        T = transform(R, [*-(R @ tool.com)[:2], -float((face.corners @ R[2]).max())])
        if isinstance(find_footing(tool.body.solid, T, tool.com, [FLOOR]), Footing):
            poses.append(T)
    return poses


def lying(tool: SuctionTool, number: int, x: float, y: float, yaw: float) -> list[float]:
    return to_pose7(transform(rotation_z(yaw), [x, y, TABLE]) @ resting(tool)[number])


@pytest.fixture(scope="module", params=NAMES)
def which(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def tool(which, long_tool, short_tool) -> SuctionTool:
    return {"long": long_tool, "short": short_tool}[which]


@pytest.fixture(scope="module")
def handovers(shelf: PlanShelf, cell, tool) -> HandoverDatabase:
    return shelf.handovers(cell, tool, LYING.handovers)


@pytest.fixture(scope="module")
def grasps(handovers) -> ToolGrasps:
    return handovers.grasps


def planned(scene: SuctionToolScene, handovers: HandoverDatabase, settings: ToolPlannerSettings = LYING) -> ToolPlan:
    return SuctionToolPlanner(scene, settings, handovers, silent).plan()


@pytest.mark.parametrize("number", among(range(4), [0]))
@pytest.mark.parametrize(("x", "y", "yaw"), among([(0.38, -0.25, 1.6), (0.3, 0.33, 2.5)], [(0.38, -0.25, 1.6)]))
def test_a_tool_that_lies_is_taken_up_and_used(number, x, y, yaw, which, tool, handovers):
    scene = scene_of(OBJECT, tool=NAMES[which], tool_pose=lying(tool, number, x, y, yaw))
    plan = planned(scene, handovers)
    assert plan.outcome is PlanningOutcome.SOLVED, plan.causes


def test_settings_are_those_of_how_the_tool_starts(tool):
    assert STANDING.starting_at(np.eye(4)) == STANDING
    assert all(STANDING.starting_at(T) == LYING for T in resting(tool))


def test_at_the_fingertips_less_of_the_pads_is_past_the_tool_and_half_of_them_on_it(tool, gripper, grasps):
    """What is behind the pads' middle along the approach bears them; what is before it they reach past."""
    central = tool_grasps(tool, gripper, STANDING.handovers.grasps)
    vertices = tool.body.solid.surface()[0]

    def past(some: ToolGrasps) -> np.ndarray:
        """(n,) how far the pads' ends are past all of the tool [m]."""
        tips = some.T_tool_tcp[:, :3, 3] + 0.5 * gripper.pad_size[2] * some.T_tool_tcp[:, :3, 2]
        along = np.einsum("nj,kj->nk", some.T_tool_tcp[:, :3, 2], vertices).max(axis=1)
        return np.einsum("ni,ni->n", tips, some.T_tool_tcp[:, :3, 2]) - along

    tips = Fingertips()
    assert past(grasps).min() <= past(central).min() - tips.least
    # The middle of each pad is still on the tool.
    for T, width in zip(grasps.T_tool_tcp, grasps.widths, strict=True):
        for side in (1.0, -1.0):
            contact = T[:3, 3] + side * 0.5 * width * T[:3, 1]
            assert abs(tool.body.solid.depth(contact)) <= STANDING.handovers.grasps.contacts.compliance + 1e-5


@pytest.mark.slow
def test_without_fingertips_the_missing_millimetres_are_told(which, tool, gripper, cell, request):
    """The margin over the table that hands keep is 3 mm: the best grasp of a tool on its side leaves less."""
    standing = request.getfixturevalue(f"{which}_handovers")
    sideways = int(np.argmin([abs(T[2, 0]) for T in resting(tool)]))
    scene = scene_of(OBJECT, tool=NAMES[which], tool_pose=lying(tool, sideways, 0.38, -0.25, 1.6))
    plan = planned(scene, standing, STANDING)
    assert plan.outcome is PlanningOutcome.NOT_FOUND
    (cause,) = plan.causes
    assert (cause.where, cause.unit, cause.needed) == ("/tool_pose", "m", STANDING.handovers.clearance.margin)
    heights = [
        min(float((T[:3, :3] @ v.T)[2].min() + T[2, 3]) for v in gripper_hulls(gripper, width).values())
        for T, width in zip(
            scene.tool.T_world_tool @ standing.grasps.T_tool_flange(gripper), standing.grasps.widths, strict=True
        )
    ]
    # Hulls are drawn at most a fraction of a millimetre larger than they are.
    assert cause.available == pytest.approx(max(heights) - TABLE, abs=1e-3)
    assert "table" in plan.summary
    assert "cup" not in plan.summary


def test_a_tool_out_of_reach_is_told_as_such(tool, which, handovers):
    scene = scene_of(OBJECT, tool=NAMES[which], tool_pose=lying(tool, 0, 0.7, -0.7, 1.6))
    plan = planned(scene, handovers)
    assert plan.outcome is PlanningOutcome.NOT_FOUND
    assert "neither arm reaches" in plan.summary
    assert "does not reach" in plan.causes[0].reason
    assert all(cause.where == "/tool_pose" for cause in plan.causes)
