"""Grasps of tools, with python-fcl as the authority on what touches."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from planners.cell.hand import Gripper
from planners.contract.shapes import Box, Cylinder
from planners.geometry.pose import inverse, rotation_x, rotation_y, transform
from planners.regrasp.grasps import pad_contacts
from planners.regrasp.grasps import tool_grasps as module
from planners.regrasp.grasps.pad_contacts import PadContacts, PadContactSettings
from planners.regrasp.grasps.tool_grasps import Fingertips, ToolGraspSettings, tool_grasps
from planners.scene.solid import solid_of
from tests.regrasp.hand_oracle import NEAR, hand_slack, tool_of

SETTINGS = ToolGraspSettings()


def block(*size: float):
    return solid_of(Box(type="box", size=size))


def rod(radius: float, height: float):
    return solid_of(Cylinder(type="cylinder", radius=radius, height=height))


def at(*position: float, rotation: np.ndarray | None = None) -> np.ndarray:
    return transform(rotation, list(position))


TOOLS = {
    "a rod": ((rod(0.012, 0.18), at(0, 0, 0.09)),),
    "a shaft with a slanted handle": (
        (block(0.02, 0.02, 0.12), at(0, 0, 0.06)),
        (block(0.015, 0.02, 0.10), at(0.03, 0, 0.13, rotation=rotation_y(0.6))),
    ),
}


@pytest.fixture(params=[*TOOLS, "long", "short"])
def tool(request, long_tool, short_tool):
    shipped = {"long": long_tool, "short": short_tool}
    return shipped[request.param] if request.param in shipped else tool_of(*TOOLS[request.param])


@pytest.fixture
def grasps(tool, gripper):
    return tool_grasps(tool, gripper, SETTINGS)


@pytest.mark.parametrize("most", [1, 70])
@pytest.mark.parametrize("fingertips", [None, Fingertips()])
def test_no_more_grasps_are_kept_than_asked_for_where_contacts_close_along_many_axes(
    most: int, fingertips: Fingertips | None, gripper: Gripper, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Contacts that close along different axes are kept however far apart contacts have to be."""
    spacings = []

    def spread(contacts: PadContacts, settings: PadContactSettings) -> PadContacts:
        spacings.append(settings.spacing)
        return pad_contacts.spread(contacts, settings) if len(spacings) < 100 else pytest.fail("contacts move for ever")

    monkeypatch.setattr(module, "spread", spread)
    cubes = (at(0, 0, 0.15, rotation=rotation_y(0.3)), at(0, 0, 0.22, rotation=rotation_x(0.8)))
    tool, settings = tool_of(*((block(0.04, 0.04, 0.04), T) for T in cubes)), replace(SETTINGS, fingertips=fingertips)
    found = tool_grasps(tool, gripper, replace(settings, most=most))
    apart = tool_grasps(tool, gripper, replace(settings, most=10**6, contacts=replace(settings.contacts, spacing=1.0)))
    assert len(found) <= most < len(apart)
    among = {np.ascontiguousarray(T).tobytes() for T in apart.T_tool_tcp}
    assert all(np.ascontiguousarray(T).tobytes() in among for T in found.T_tool_tcp)
    assert most == 1 or len(found)


def test_the_pads_of_every_grasp_lie_on_the_tool(tool, grasps):
    vertices, faces = tool.body.solid.surface()
    ends = [T[:3, 3] + side * 0.5 * width * T[:3, 1] for T, width in zip(grasps.T_tool_tcp, grasps.widths, strict=True)
            for side in (1.0, -1.0)]  # fmt: skip
    assert len(ends) > 50
    for end in np.unique(np.array(ends).round(7), axis=0):
        nearest = trimesh.triangles.closest_point(vertices[faces], np.tile(end, (len(faces), 1)))
        assert np.linalg.norm(nearest - end, axis=1).min() <= SETTINGS.contacts.compliance + 1e-6


def test_a_hand_keeps_off_the_tool_in_a_grasp_and_on_its_way_exactly_when_the_grasp_is_kept(tool, grasps, gripper):
    rng = np.random.default_rng(5)
    verdicts = Counter()
    kept = [(grasps.T_tool_tcp[k], float(grasps.widths[k]), True) for k in rng.permutation(len(grasps))[:8]]
    fallen = [(each.T_tool_tcp, each.width, False) for each in rng.permutation(np.array(grasps.fallen))[:8]]
    for T_tool_tcp, width, free in kept + fallen:
        T_tool_flange = T_tool_tcp @ inverse(gripper.T_flange_tcp(width))
        closed = gripper.bodies("hand", width)
        opened = gripper.bodies("hand", min(gripper.width_max, width + 2 * SETTINGS.finger_gap))
        # Pads that hold are no matter of distances.
        slack = hand_slack(tool, closed, T_tool_flange, SETTINGS.margin, -np.inf)
        for back in SETTINGS.way():
            T = T_tool_flange @ at(0, 0, -back)
            slack = min(slack, hand_slack(tool, opened, T, SETTINGS.margin, SETTINGS.margin))
        if abs(slack) < NEAR:
            continue
        verdicts[free] += 1
        if free:
            assert slack > 0.0
        elif slack > 0.0:
            # What falls although nothing else touches has a pad in the tool.
            assert hand_slack(tool, closed, T_tool_flange, SETTINGS.margin, 0.0) <= 0.0
    assert verdicts[True] > 5
    assert verdicts[False] > 5


def test_between_the_checked_places_of_its_way_a_hand_touches_nothing_either(tool, grasps, gripper):
    for k in np.random.default_rng(6).permutation(len(grasps))[:5]:
        T_tool_flange = grasps.T_tool_tcp[k] @ inverse(gripper.T_flange_tcp(float(grasps.widths[k])))
        opened = gripper.bodies("hand", float(grasps.open_widths[k]))
        for back in np.arange(0.0, SETTINGS.approach, 0.001):
            assert hand_slack(tool, opened, T_tool_flange @ at(0, 0, -back), 0.0, 0.0) > 0.0


def test_each_pair_of_contacts_is_tried_with_all_rolls_and_both_flips(grasps):
    tried = [*grasps.T_tool_tcp, *(each.T_tool_tcp for each in grasps.fallen)]
    alike = defaultdict(list)
    for T in tried:
        alike[*T[:3, 3].round(6), *T[:3, 1].round(6)].append(T[:3, 2])
    # Of each place and closing axis, with its sense: directions to approach from, evenly all round.
    expected = np.cos(2 * np.pi * np.arange(SETTINGS.rolls) / SETTINGS.rolls)
    for (*place, x, y, z), approaches in alike.items():
        assert sorted(np.array(approaches) @ approaches[0]) == pytest.approx(sorted(expected), abs=1e-9)
        assert any(np.allclose(other, (*place, -x, -y, -z), atol=2e-6) for other in alike)


def test_every_hand_pose_is_rigid_and_no_grasp_is_wider_than_the_gripper_opens(grasps, gripper):
    R = grasps.T_tool_tcp[:, :3, :3]
    assert R @ R.transpose(0, 2, 1) == pytest.approx(np.broadcast_to(np.eye(3), R.shape), abs=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert (grasps.open_widths <= gripper.width_max).all()
    assert (grasps.open_widths >= grasps.widths + 2 * SETTINGS.least_gap).all()


def test_nothing_is_gripped_at_the_cup(tool, grasps):
    tips = grasps.T_tool_tcp[:, 2, 3] - 0.5 * grasps.widths * np.abs(grasps.T_tool_tcp[:, 2, 1])
    assert tips.min() >= SETTINGS.lip_clearance


def test_the_same_question_has_the_same_answer(tool, grasps, gripper):
    again = tool_grasps(tool, gripper, SETTINGS)
    assert np.array_equal(again.T_tool_tcp, grasps.T_tool_tcp)
    assert np.array_equal(again.widths, grasps.widths)


def test_a_limit_of_grasps_moves_them_apart_and_keeps_them_all_over_the_tool(long_tool, long_grasps, gripper):
    few = tool_grasps(long_tool, gripper, replace(SETTINGS, most=120))
    assert 60 < len(few) <= 120
    heights, all_heights = few.T_tool_tcp[:, 2, 3], long_grasps.T_tool_tcp[:, 2, 3]
    assert np.ptp(heights) > 0.6 * np.ptp(all_heights)


def test_a_tool_too_thick_for_the_fingers_has_no_grasp(gripper):
    tool = tool_of((block(0.09, 0.10, 0.12), at(0, 0, 0.06)))
    assert len(tool_grasps(tool, gripper, SETTINGS)) == 0


def test_of_64_grasps_about_a_place_in_the_middle_of_the_shaft_28_to_40_are_left(long_grasps):
    """Two closing axes, two flips, 16 rolls: 28 to 40 of 64 were measured, 364 in all, on places 16 mm apart."""
    heights = Counter(long_grasps.T_tool_tcp[:, 2, 3].round(3))
    middle = [count for height, count in heights.items() if 0.10 < height < 0.19]
    assert len(middle) >= 5
    assert all(28 <= count <= 40 for count in middle)
    assert len(long_grasps) == pytest.approx(364, rel=0.2)
