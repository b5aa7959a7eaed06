"""How `liftwright serve` begins: what it refuses at once, and that it tells the rest as logs do."""

from __future__ import annotations

import json
import logging
import socket
import subprocess
import sys
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
import structlog

from app import serve
from app.cli.main import main
from app.logs import set_up_logs
from app.serve import CannotListen, bind
from tests.support.service import ROOT
from workers.settings import WorkerSettings
from workers.solver import warm_up

IDLE = (sys.executable, "-c", "import sys; sys.exit(0)")
"""A solver that has nothing to compile."""


@pytest.fixture(autouse=True)
def logs_as_before() -> Iterator[None]:
    """Undo what a command sets up for its whole process."""
    root, engine = logging.getLogger(), logging.getLogger("dbos")
    handlers, level, engines, propagate = root.handlers[:], root.level, engine.handlers[:], engine.propagate
    hooks = sys.excepthook, threading.excepthook, sys.unraisablehook, warnings.showwarning
    yield
    logging.captureWarnings(capture=False)
    sys.excepthook, threading.excepthook, sys.unraisablehook, warnings.showwarning = hooks
    structlog.reset_defaults()
    root.handlers, engine.handlers, engine.propagate = handlers, engines, propagate
    root.setLevel(level)


@pytest.fixture
def taken() -> Iterator[int]:
    """Yield a port that another program listens on."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        yield other.getsockname()[1]


@pytest.mark.parametrize("command", ["serve", "api"])
def test_a_taken_port_is_told_before_any_work_and_is_1(
    command: str, taken: int, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serve, "_warm_up_once", lambda _: pytest.fail("it warmed up first"))
    assert main([command, "--port", str(taken), "--data-dir", str(tmp_path)]) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == f"liftwright: 127.0.0.1:{taken} is taken by another program; choose another with --port"


def test_a_bound_port_refuses_connections_until_it_is_listened_on() -> None:
    (bound,) = bind("127.0.0.1", 0)
    with bound:
        address = bound.getsockname()
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(address)
        bound.listen()
        socket.create_connection(address).close()


def test_all_addresses_of_a_host_have_one_port() -> None:
    sockets = bind("localhost", 0)
    assert len({each.getsockname()[1] for each in sockets}) == 1
    for each in sockets:
        each.close()


def test_an_address_that_is_not_this_machines_is_told() -> None:
    with pytest.raises(CannotListen, match=r"^192\.0\.2\.1:8040 cannot be listened on: .*--host"):
        bind("192.0.2.1", 8040)


def test_warming_up_is_told_as_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(warm_up, "forget_stale_kernels", lambda: None)
    monkeypatch.setenv("LIFTWRIGHT_DATA_DIR", str(tmp_path))
    monkeypatch.setenv("LIFTWRIGHT_SOLVER_COMMAND", json.dumps(IDLE))
    assert main(["warmup"]) == 0
    told = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert any(each.get("handovers") == str(WorkerSettings().handovers_dir) for each in told)


def test_what_nobody_caught_is_json_like_all_else() -> None:
    """In a process of its own: it ends by an error."""
    program = """
import logging, threading, warnings
from app.logs import set_up_logs
set_up_logs()
thread = threading.Thread(target=lambda: 1 / 0, name="divider")
thread.start()
thread.join()
warnings.warn("beware")
class Stubborn:
    def __del__(self):
        raise ValueError("stubborn")
Stubborn()
try:
    1 / 0
except ZeroDivisionError:
    logging.getLogger("uvicorn.error").exception("of the server")
raise ValueError("out of order")
"""
    command = [sys.executable, "-c", program]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    told = [json.loads(line) for line in ended.stderr.splitlines()]
    assert ended.returncode == 1
    assert told[0]["thread"] == "divider"
    for line, error in zip(told, ("ZeroDivision", None, "stubborn", "ZeroDivision", "out of order"), strict=True):
        assert error is None or error in line["exception"]
    assert "beware" in told[1]["event"]


def test_logs_are_json_unless_a_person_reads_them_on_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    for terminal in (False, True):
        monkeypatch.setattr(sys.stderr, "isatty", lambda terminal=terminal: terminal)
        set_up_logs()
        structlog.get_logger("ours").warning("disk is full", job_id="p1")
        logging.getLogger("theirs").warning("beware of %s", "dogs")
        try:
            raise ValueError("out of order")
        except ValueError:
            structlog.get_logger("ours").exception("background work failed")
        lines = capsys.readouterr().err.splitlines()
        if terminal:
            assert not any(line.startswith("{") for line in lines)
            assert any("disk is full" in line and "job_id=p1" in line for line in lines)
            assert any("beware of dogs" in line for line in lines)
            assert any(line.startswith("ValueError: out of order") for line in lines)
        else:
            ours, theirs, failed = map(json.loads, lines)
            assert (ours["event"], ours["job_id"], ours["level"]) == ("disk is full", "p1", "warning")
            assert (theirs["event"], theirs["logger"]) == ("beware of dogs", "theirs")
            assert "ValueError: out of order" in failed["exception"]
