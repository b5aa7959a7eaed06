"""`liftwright study`: what is typed, what is printed, what is written."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest

from app.cli.main import main
from app.cli.output import BAD_INPUT
from app.cli.study_command import read_axis
from app.settings import ServiceSettings
from planners.study.study_map import StudyMap
from tests.support.service import FAKE_EXAMINER, FAKE_SOLVER, TASKS
from tests.support.serving import served

WEAK = str(TASKS / "pb1_weak_cup.json")


@pytest.mark.parametrize(
    ("text", "axis"),
    [
        ("/cup/position/0=-0.12:0.12:12", {"pointer": "/cup/position/0", "min": -0.12, "max": 0.12, "count": 12}),
        ("/lifter_model=paper,cable", {"pointer": "/lifter_model", "values": ["paper", "cable"]}),
        ("/cup/max_force=10,20.5", {"pointer": "/cup/max_force", "values": [10, 20.5]}),
        ("/cup/position=[0.1,0],[0,0.1]", {"pointer": "/cup/position", "values": [[0.1, 0], [0, 0.1]]}),
        ("/plate_pose@yaw=0:1.5:4", {"pointer": "/plate_pose", "part": "yaw", "min": 0.0, "max": 1.5, "count": 4}),
        ("/options/remedies=true", {"pointer": "/options/remedies", "values": [True]}),
    ],
)
def test_an_axis_is_read_as_it_is_typed(text: str, axis: dict) -> None:
    assert read_axis(text).document() == axis


@pytest.mark.parametrize(
    "text",
    ["/cup/max_force", "/cup/max_force=", "cup=1,2", "/cup/max_force=1:2:x", "/a=1:y:3", "/a=0:0.1", "/a=0:1:2:3"],
)
def test_what_is_no_axis_is_told_with_how_to_write_one(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["study", WEAK, "--axis", text])
    assert "MIN:MAX:COUNT" in capsys.readouterr().err


def test_a_member_that_is_not_there_is_told_with_those_that_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", WEAK, "--axis", "/cup/force=1,2"]) == BAD_INPUT
    told = capsys.readouterr().err
    assert "--axis /cup/force" in told
    assert "/cup/max_force" in told


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("/cup/max_force=1:2:1", "--axis /cup/max_force: COUNT must be"),
        ("/cup/max_force=1:2e6:3", "--axis /cup/max_force: MAX must be"),
        ("/plate_pose@roll=0:1:2", "--axis /plate_pose: what stands after @ is"),
        ("/cup/max_force=-1:2:3", "--axis /cup/max_force: -1.0 is not valid there"),
    ],
)
def test_a_bound_of_an_axis_is_not_told_as_one_of_its_member(
    text: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study", WEAK, "--axis", text]) == BAD_INPUT
    assert says in capsys.readouterr().err


@pytest.mark.slow
def test_a_map_is_printed_written_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, png = tmp_path / "map.json", tmp_path / "map.png"
    axes = ["--axis", "/plate/mass=6.5,7,7.5", "--axis", "/cup/max_force=10,12"]
    # What is too heavy is proven so at once.
    assert main(["study", WEAK, *axes, "--out", str(out), "--png", str(png), "--processes", "1"]) == 2
    found = StudyMap.model_validate_json(out.read_bytes())
    assert found.outcomes["infeasible"] == found.count == found.done == 6
    assert [axis.values for axis in found.axes] == [[6.5, 7, 7.5], [10, 12]]
    assert cv2.imread(str(png)) is not None
    printed = capsys.readouterr().out
    assert printed.count("××") == 6 + 1
    assert "No point is solved." in printed


@pytest.mark.slow
def test_a_service_finds_the_same_kind_of_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = {"data_dir": tmp_path / "data", "solver_command": FAKE_SOLVER, "study_command": FAKE_EXAMINER}
    out = tmp_path / "map.json"
    with served(ServiceSettings.model_validate(settings)) as address:
        axis = ["--axis", "/cup/max_force=10:30:5"]
        assert main(["study", WEAK, *axis, "--service", address, "--out", str(out)]) == 0
        printed = capsys.readouterr().out
        assert f"{address}/v1/studies/" in printed
        assert f"{address}/v1/plans/" in printed
        assert main(["study", WEAK, "--axis", "/cup/force=1,2", "--service", address]) == BAD_INPUT
        assert "--axis /cup/force: " in capsys.readouterr().err
        refused = ["study", WEAK, "--axis", "/cup/force=1,2", "--service", address, "--out", str(out)]
        assert main(refused) == BAD_INPUT
    # What was written before is not lost for it.
    found = json.loads(out.read_text())
    assert (found["done"], found["best"]["values"]) == (5, [30.0])
