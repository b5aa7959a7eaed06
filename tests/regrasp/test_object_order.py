"""Which object is moved first."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planners.contract.task_spec import SuctionToolTask, read_task
from planners.geometry.pose import rotation_z
from planners.regrasp.pile import object_order
from planners.regrasp.pile.object_order import ObjectOrder
from planners.scene.rest import REST_GAP
from planners.scene.tool_scene import build_tool_scene

SIZE = [0.1, 0.06, 0.04]
LOW, HIGH = 1.094 + 0.02, 1.094 + 0.06
MIDDLE = np.array([0.4, 0.0, 0.0])


def order_of(
    turned: float = 0.0, size: list[float] = SIZE, /, **places: tuple[list[float], list[float]]
) -> ObjectOrder:
    """Return the order of boxes that go from place to place, all of it turned by an angle about `MIDDLE` [rad]."""
    R = rotation_z(turned)

    def pose(place: list[float]) -> list[float]:
        at = MIDDLE + R @ (np.array(place) - MIDDLE) if turned else place
        return [*at, math.cos(0.5 * turned), 0, 0, math.sin(0.5 * turned)]

    objects = [
        {
            "name": name,
            "shape": {"type": "box", "size": size},
            "mass": 0.1,
            "pose": pose(start),
            "goal_pose": pose(goal),
        }
        for name, (start, goal) in places.items()
    ]
    task = read_task({"kind": "suction_tool", "objects": objects})
    assert isinstance(task, SuctionToolTask)
    return ObjectOrder.of(build_tool_scene(task).objects)


def test_the_object_nearest_to_its_goal_comes_first() -> None:
    order = order_of(
        far=([0.3, 0.35, LOW], [0.4, -0.2, LOW]),
        near=([0.3, -0.3, LOW], [0.4, -0.35, LOW]),
    )
    assert order.next(frozenset()) == ("near", "far")


def test_a_support_comes_before_what_lies_on_it_however_far_it_is() -> None:
    order = order_of(
        top=([0.45, 0.15, LOW], [0.4, 0.0, HIGH]),
        base=([0.3, -0.4, LOW], [0.4, 0.0, LOW]),
    )
    assert order.next(frozenset()) == ("base",)
    assert order.next(frozenset({"base"})) == ("top",)


@pytest.mark.parametrize("thickness", [2e-4, 5e-4, 7e-4, 2e-3])
def test_of_two_thin_sheets_the_lower_one_carries_the_upper_one_and_not_both_each_other(thickness: float) -> None:
    """Although the upper one's top is not a millimetre above the lower one's bottom."""
    low, high = 1.094 + 0.5 * thickness, 1.094 + 1.5 * thickness
    order = order_of(
        0.0,
        [0.1, 0.06, thickness],
        lower=([0.4, 0.2, low], [0.4, 0.0, low]),
        upper=([0.4, 0.2, high], [0.4, 0.0, high]),
    )
    assert order.carried == {"lower": frozenset(), "upper": {"lower"}}
    assert order.lying_on_it == {"lower": {"upper"}, "upper": frozenset()}


def test_what_stands_in_the_way_of_a_goal_comes_first() -> None:
    order = order_of(
        mover=([0.4, 0.3, LOW], [0.4, 0.2, LOW]),
        standing=([0.4, 0.16, LOW], [0.3, -0.35, LOW]),
    )
    assert order.next(frozenset()) == ("standing",)


@pytest.mark.parametrize("degrees", [30.0, 0.0, 45.0, -70.0])
def test_to_touch_a_goal_is_not_to_stand_in_its_way_however_all_of_it_is_turned(degrees: float) -> None:
    for into, first in ((0.0, "mover"), (1e-4, "standing")):
        order = order_of(
            math.radians(degrees),
            mover=([0.4, 0.2, LOW], [0.4, SIZE[1] - into, LOW]),
            standing=([0.4, 0.0, LOW], [0.4, -0.25, LOW]),
        )
        assert order.next(frozenset())[0] == first


def test_objects_that_wait_for_one_another_cannot_be_moved() -> None:
    order = order_of(
        one=([0.4, 0.3, LOW], [0.4, -0.2, LOW]),
        other=([0.4, -0.2, LOW], [0.4, 0.3, LOW]),
    )
    assert order.next(frozenset()) == ()
    assert set(order.next_aside(frozenset())) == {"one", "other"}
    assert {cause.where for cause in order.deadlock(frozenset())} == {"one", "other"}


def test_what_holds_another_up_is_put_aside_before_what_does_not() -> None:
    order = order_of(
        base=([0.3, 0.3, LOW], [0.4, 0.0, LOW]),
        top=([0.4, 0.05, LOW], [0.4, 0.0, HIGH]),
        near=([0.3, -0.35, LOW], [0.3, -0.3, LOW]),
    )
    assert order.next(frozenset({"near"})) == ()
    assert order.next_aside(frozenset())[0] == "top"


@pytest.mark.parametrize("seed", range(8))
def test_what_is_far_off_is_left_out_and_nothing_that_rests_on_another(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(seed)

    def towers(towards: float) -> list[list[float]]:
        # Side by side without touching, and one on the other with gaps that still count as touching.
        pitch = [side + REST_GAP for side in SIZE]
        columns = [[0.3 + pitch[0] * i, towards * (0.15 + pitch[1] * j)] for i in range(2) for j in range(3)]
        return [[*at, LOW + k * (SIZE[2] + 0.9 * REST_GAP)] for at in columns for k in range(int(rng.integers(0, 3)))]

    starts, goals = towers(1.0), towers(-1.0)
    places = {f"box_{i}": pair for i, pair in enumerate(zip(starts, goals, strict=False))}
    found = order_of(**places)
    monkeypatch.setattr(object_order, "_may_rest_on", lambda *_: True)
    assert found == order_of(**places)
