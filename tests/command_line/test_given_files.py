"""Files that are something else than a command takes: it says what they are, and what to do."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from app.cli.given_file import FileKind
from app.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
TASK = json.loads((ROOT / "assets/tasks/ab1.json").read_text())
CONTENTS = {
    FileKind.TASK: TASK,
    FileKind.PLAN: {"segments": [], "certificate": None, "task": TASK, "cell": {"name": "dual_ur3e_lift"}},
    FileKind.SCENE: {"table": None, "unrecognised": []},
    FileKind.STUDY: {"task": TASK, "axes": []},
    FileKind.MAP: {"task": TASK, "axes": [], "points": []},
    FileKind.CELL: {"name": "mine", "mount": {}, "arms": {}},
}
TAKES: dict[tuple[str, ...], FileKind] = {
    ("plan",): FileKind.TASK,
    ("study", "--axis", "/plate/mass=1:2:2"): FileKind.TASK,
    ("cell", "check"): FileKind.CELL,
    ("export", "--target", "csv"): FileKind.PLAN,
    ("execute", "--left", "a", "--right", "b"): FileKind.PLAN,
}
Said = Callable[..., str]


@pytest.fixture
def refusal(capsys: pytest.CaptureFixture[str]) -> Said:
    """Return what is said of bad input, one line."""

    def run(*arguments: object) -> str:
        assert main(list(map(str, arguments))) == 3
        (line,) = capsys.readouterr().err.splitlines()
        return line

    return run


@pytest.mark.parametrize("given", FileKind, ids=lambda kind: kind.name)
@pytest.mark.parametrize("command", TAKES, ids=lambda command: command[0])
def test_what_is_something_else_is_called_what_it_is(
    given: FileKind, command: tuple[str, ...], tmp_path: Path, refusal: Said
) -> None:
    wanted, path = TAKES[command], tmp_path / "given.json"
    path.write_text(json.dumps(CONTENTS[given]))
    if given is not wanted:
        said = f"liftwright: {path} is {given.value}, not {wanted.value}; "
        assert refusal(*command, path).startswith(said)
    else:
        assert FileKind.of(CONTENTS[given]) is given


@pytest.mark.parametrize("command", TAKES, ids=lambda command: command[0])
def test_a_name_that_is_nearly_that_of_a_file_is_answered_with_it(
    command: tuple[str, ...], tmp_path: Path, refusal: Said
) -> None:
    (tmp_path / "carton_left.json").write_text("{}")
    meant = tmp_path / "carton_left.json"
    assert refusal(*command, tmp_path / "carton_lfet.json").endswith(f"there is no such file; did you mean {meant}?")
    if TAKES[command] is not FileKind.CELL:
        assert "is a folder" in refusal(*command, tmp_path)


@pytest.mark.parametrize("action", ["show", "delete"])
def test_a_file_in_place_of_the_name_of_a_cell_is_sent_where_files_are_taken(
    action: str, tmp_path: Path, refusal: Said
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\n")
    told = refusal("cell", action, path, "--data-dir", tmp_path / "data")
    assert f"`liftwright cell check {path}`" in told
    assert f"`liftwright cell add {path}`" in told
    assert not (tmp_path / "data").exists(), "nothing is made for what is refused"


def test_the_name_of_what_is_shipped_in_place_of_a_file_is_known(refusal: Said) -> None:
    assert "`liftwright cell show dual_ur3e_lift`" in refusal("cell", "check", "dual_ur3e_lift")
    assert refusal("plan", "ab1").endswith(str(ROOT / "assets/tasks/ab1.json"))


def test_a_cell_may_be_called_as_the_folder_is_that_lies_beside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine").mkdir()
    monkeypatch.chdir(tmp_path)
    assert main(["cell", "show", "mine", "--data-dir", str(tmp_path / "data")]) != 0
    assert "there is no cell 'mine'" in capsys.readouterr().err
