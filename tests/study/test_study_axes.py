"""Which tasks a study stands for, and which studies there cannot be."""

from __future__ import annotations

import json
import math
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planners.contract.task_spec import PlateLiftTask
from planners.errors import SceneError
from planners.geometry.pose import from_pose7
from planners.study.study import NotAStudy, Study

AB1 = json.loads((Path(__file__).parents[2] / "assets" / "tasks" / "ab1.json").read_text())
X = {"pointer": "/cup/position/0", "min": -0.12, "max": 0.12, "count": 5}


def study(*axes: dict[str, Any], **more: Any) -> Study:
    return Study.read({"task": AB1, "axes": list(axes), **more})


def test_a_range_of_whole_numbers_stays_one() -> None:
    varied = study({"pointer": "/seed", "min": 0, "max": 4, "count": 3})
    assert [varied.task_at(index).seed for index in range(varied.count)] == [0, 2, 4]


def test_points_are_all_combinations_and_the_last_axis_varies_fastest() -> None:
    forces = [15, 20, 25.5]
    varied = study(X, {"pointer": "/cup/max_force", "values": forces})
    wanted = list(product(np.linspace(-0.12, 0.12, 5), forces))
    tasks = [varied.task_at(index) for index in range(varied.count)]
    assert all(isinstance(task, PlateLiftTask) for task in tasks)
    found = [(task.cup.position[0], task.cup.max_force) for task in tasks if isinstance(task, PlateLiftTask)]
    assert np.allclose(found, wanted)


def test_a_point_differs_from_the_task_in_what_is_varied_only() -> None:
    varied = study({"pointer": "/lifter_model", "values": ["paper", "cable", "dexnet"]})
    for index in range(varied.count):
        at = varied.document_at(index)
        assert at.pop("lifter_model") == varied.axes[0].places[index]
        assert at == {name: value for name, value in varied.spec.task.items() if name != "lifter_model"}


def test_a_yaw_turns_a_pose_about_the_vertical_where_it_is() -> None:
    varied = study({"pointer": "/plate_pose", "part": "yaw", "min": 0.0, "max": 0.5 * math.pi, "count": 3})
    before = from_pose7(np.array(AB1["plate_pose"]))
    for index, angle in enumerate((0.0, 0.25 * math.pi, 0.5 * math.pi)):
        after = from_pose7(np.array(varied.document_at(index)["plate_pose"]))
        c, s = math.cos(angle), math.sin(angle)
        assert np.allclose(after[:3, :3], np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ before[:3, :3])
        assert np.allclose(after[:3, 3], before[:3, 3])


@pytest.mark.parametrize(
    "axes",
    [
        (
            {"pointer": "/plate_pose/0", "values": [0.3, 0.4]},
            {"pointer": "/plate_pose", "part": "yaw", "values": [0, 1]},
        ),
        (
            {"pointer": "/plate_pose", "values": [[x, 0.1, 1.114, 1, 0, 0, 0] for x in (0.3, 0.4)]},
            {"pointer": "/plate_pose", "part": "yaw", "values": [0, 1]},
        ),
        (
            {"pointer": "/cup", "values": [{"radius": radius, "max_force": 20} for radius in (0.01, 0.02)]},
            {"pointer": "/cup/max_force", "values": [15, 20]},
        ),
    ],
    ids=["a place and a yaw", "a pose and a yaw", "a member and one in it"],
)
def test_no_axis_undoes_what_the_other_does_whichever_comes_first(axes: tuple[dict[str, Any], ...]) -> None:
    one, other = study(*axes), study(*reversed(axes))
    found = {index: one.document_at(index) for index in range(one.count)}
    assert all(found[i] != found[k] for i in found for k in found if i < k)
    for index in range(other.count):
        second, first = other.at(index)
        assert other.document_at(index) == found[first * other.shape[0] + second]


def test_a_value_that_leaves_no_member_for_the_other_axis_is_refused_at_its_points() -> None:
    board = {"shape": {"type": "box", "size": [0.3, 0.3, 0.05]}, "pose": [0.3, 0, 1.119, 1, 0, 0, 0]}
    task = {**AB1, "support": board, "plate_pose": [0.3, 0, 1.164, 1, 0, 0, 0]}
    inners = (
        {"pointer": "/support/pose/2", "values": [1.119]},
        {"pointer": "/support/pose", "part": "yaw", "values": [0]},
    )
    for inner in inners:
        varied = Study.read({"task": task, "axes": [{"pointer": "/support", "values": [board, None]}, inner]})
        assert isinstance(varied.task_at(0), PlateLiftTask)
        with pytest.raises(SceneError) as refused:
            varied.task_at(1)
        assert refused.value.pointers == (inner["pointer"],)


def test_a_study_that_was_accepted_is_read_again_as_it_was() -> None:
    varied = study(X, {"pointer": "/plate_pose", "part": "yaw", "values": [0, 0.3]}, certify=True, external_id="mine")
    again = Study.of_document(json.loads(json.dumps(varied.document())))
    assert again.document() == varied.document()
    assert [again.document_at(index) for index in range(again.count)] == [
        varied.document_at(index) for index in range(varied.count)
    ]


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "no axis": ({"axes": []}, "/axes"),
    "three axes": ({"axes": [X, X, X]}, "/axes"),
    "the same member twice": ({"axes": [X, {**X, "min": -0.1}]}, "/axes/1"),
    "an axis of nothing": ({"axes": [{"pointer": "/cup/position/0"}]}, "/axes/0"),
    "a range and a list": ({"axes": [{**X, "values": [1]}]}, "/axes/0"),
    "half a range": ({"axes": [{"pointer": "/cup/position/0", "min": 0.0, "count": 3}]}, "/axes/0"),
    "a range backwards": ({"axes": [{**X, "min": 0.2}]}, "/axes/0"),
    "one value of a range": ({"axes": [{**X, "count": 1}]}, "/axes/0/count"),
    "a pointer without a slash": ({"axes": [{**X, "pointer": "cup"}]}, "/axes/0/pointer"),
    "a member that is not there": ({"axes": [{**X, "pointer": "/cup/place"}]}, "/axes/0/pointer"),
    "an item that is not there": ({"axes": [{**X, "pointer": "/cup/position/2"}]}, "/axes/0/pointer"),
    "a choice that is none": (
        {"axes": [{"pointer": "/lifter_model", "values": ["paper", "balloon"]}]},
        "/axes/0/values/1",
    ),
    "a force below nothing": ({"axes": [{"pointer": "/cup/max_force", "min": -5, "max": 5, "count": 3}]}, "/axes/0"),
    "a yaw of a number": ({"axes": [{"pointer": "/cup/radius", "part": "yaw", "values": [0.1]}]}, "/axes/0/pointer"),
    "a yaw of a word": ({"axes": [{"pointer": "/plate_pose", "part": "yaw", "values": ["x"]}]}, "/axes/0/values"),
    "a task that is none": ({"task": {"kind": "plate_lift"}, "axes": [X]}, "/task/plate"),
    "an unknown member": ({"axes": [X], "colour": 1}, "/colour"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_study_is_refused_where_it_is_wrong(what: str) -> None:
    body, pointer = REFUSED[what]
    with pytest.raises(NotAStudy) as refused:
        Study.read({"task": AB1, **body})
    assert pointer in [problem.pointer for problem in refused.value.problems]


def test_too_many_points_are_refused_with_how_many_there_may_be() -> None:
    axes = [X, {**X, "pointer": "/cup/position/1"}]
    assert Study.read({"task": AB1, "axes": axes}, most=25).count == 25
    with pytest.raises(NotAStudy, match="25 points; 1 to 24 are allowed"):
        Study.read({"task": AB1, "axes": axes}, most=24)


def test_a_member_that_is_not_there_is_answered_with_those_that_are() -> None:
    with pytest.raises(NotAStudy) as refused:
        study({**X, "pointer": "/cup/place"})
    assert "/cup/position" in (refused.value.problems[0].allowed or [])
