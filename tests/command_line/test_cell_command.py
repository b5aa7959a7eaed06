"""`liftwright cell`: what is typed, what is printed, what is kept, here and by a service."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import cv2
import pytest
import yaml

from app.cli.main import main
from app.cli.output import BAD_INPUT
from app.settings import ServiceSettings
from planners.cell.cell import known_cells
from planners.plan.plan import Plan
from tests.support.own_cell import INDUSTRIAL, station, station_files, written, zipped
from tests.support.service import FAKE_SOLVER
from tests.support.serving import served

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module")
def keeper(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[str]]:
    """Return the arguments that name a running service."""
    data_dir = tmp_path_factory.mktemp("data")
    settings = ServiceSettings.model_validate({"data_dir": data_dir, "solver_command": FAKE_SOLVER})
    with served(settings, with_worker=False) as address:
        yield ["--service", address]


@pytest.mark.slow
def test_the_example_of_the_documentation_can_be_planned_in(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = re.findall(r"```yaml\n(name: station\n.*?)```", (DOCS / "cell.md").read_text(), re.DOTALL)[0]
    assert yaml.safe_load(text) == station()
    file, picture = tmp_path / "station.yaml", tmp_path / "station.png"
    file.write_text(text)
    assert main(["cell", "check", str(file), "--png", str(picture)]) == 0
    assert "Table 1.2 × 2 m" in capsys.readouterr().out
    assert cv2.imread(str(picture)) is not None


@pytest.mark.slow
def test_the_sheet_of_the_documentation_is_lifted_by_its_industrial_arms(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (DOCS / "cell.md").read_text()
    for kind, begin, name in (
        ("yaml", "name: heavy_station", "cell.yaml"),
        ("json", '{"kind": "plate_lift", "cell": "heavy_station"', "task.json"),
    ):
        (block,) = re.findall(rf"```{kind}\n({re.escape(begin)}.*?)```", text, re.DOTALL)
        (tmp_path / name).write_text(block)
    cell, task, out = (str(tmp_path / name) for name in ("cell.yaml", "task.json", "plan.json"))
    assert main(["plan", task, "--cell", cell, "--out", out, "--data-dir", str(tmp_path)]) == 0
    plan = Plan.read(Path(out))
    assert plan.certificate is not None
    assert plan.certificate.passed
    assert plan.simulation is not None
    assert plan.simulation.outcome == "lifted"


def test_every_fault_is_told_on_a_line_with_its_file_and_member(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "wrong.json"
    file.write_bytes(written(station(gravity=[0, 0, 9.81], arms={"left": {"robot": "ur99"}})))
    assert main(["cell", "check", str(file)]) == BAD_INPUT
    told = capsys.readouterr().err.splitlines()
    assert any(line.startswith(f"{file}: /arms/left/hand: is required") for line in told)
    assert main(["cell", "check", str(tmp_path / "nowhere")]) == BAD_INPUT
    assert "nowhere" in capsys.readouterr().err


@pytest.mark.parametrize("where", ["here", "service"])
@pytest.mark.slow
def test_a_cell_is_kept_listed_shown_and_deleted(
    where: str, keeper: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    at = keeper if where == "service" else ["--data-dir", str(tmp_path / "data")]
    file, files, picture = tmp_path / "station.zip", tmp_path / "files.zip", tmp_path / "station.png"
    file.write_bytes(zipped(station_files()))
    assert main(["cell", "add", str(file), *at]) == 0
    assert '"cell": "station"' in capsys.readouterr().out
    assert main(["cell", "list", *at]) == 0
    # A service in this process writes its log there, too.
    lines = [line for line in capsys.readouterr().out.splitlines() if "request_id" not in line]
    names = [line.split()[0] for line in lines]
    assert names == ["name", *known_cells(), "station"]
    assert main(["cell", "show", "station", "--out", str(files), "--png", str(picture), *at]) == 0
    with zipfile.ZipFile(files) as archive:
        assert sorted(archive.namelist()) == sorted(station_files())
    assert cv2.imread(str(picture)) is not None
    assert main(["cell", "delete", "station", *at]) == 0
    capsys.readouterr()
    assert main(["cell", "show", "station", *at]) != 0
    assert "there is no cell 'station'" in capsys.readouterr().err


def test_a_cell_is_not_called_as_a_shipped_one_is(
    keeper: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "cell.json"
    file.write_bytes(written(station(name="dual_ur3e_lift")))
    for at in (keeper, ["--data-dir", str(tmp_path / "data")]):
        assert main(["cell", "add", str(file), *at]) != 0
        assert "give a cell of your own another name" in capsys.readouterr().err
    assert main(["cell", "check", str(file)]) == BAD_INPUT
    assert capsys.readouterr().err.startswith(f"{file}: /name: 'dual_ur3e_lift' is shipped with the service; give a")


@pytest.mark.slow
def test_what_a_service_refuses_is_told_where_it_stands_in_what_was_given(
    keeper: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is sent as files of its own, of which whoever has written one document knows nothing."""
    document = station()
    document["mount"]["arms"]["left"]["home_deg"][0] += 360
    file = tmp_path / "mine.yaml"
    for place, changed in (("/mount/arms/left/home_deg/0", document), ("/urdf", with_urdf(document))):
        file.write_bytes(written(changed))
        for arguments in (
            ["check", str(file)],
            ["add", str(file), *keeper],
            ["add", str(file), "--data-dir", str(tmp_path)],
        ):
            assert main(["cell", *arguments]) == BAD_INPUT
            assert any(line.startswith(f"{file}: ") and place in line for line in capsys.readouterr().err.splitlines())


def with_urdf(document: dict[str, Any]) -> dict[str, Any]:
    arms = {**document["arms"], "right": {**document["arms"]["right"], "robot": INDUSTRIAL}}
    return {**document, "arms": arms}


class NoPlanner(BaseHTTPRequestHandler):
    """Stands for whatever else answers at an address."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.end_headers()
        self.wfile.write(b"<html>Welcome</html>")

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing."""


def test_what_is_no_answer_of_a_service_is_told_so_and_is_no_fault_of_the_input(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with ThreadingHTTPServer(("127.0.0.1", 0), NoPlanner) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_address[1]}"
        for words in (["list"], ["show", "mine"]):
            assert main(["cell", *words, "--service", address]) == 1
            assert address in capsys.readouterr().err
        server.shutdown()
