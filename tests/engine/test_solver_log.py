"""What a solver writes into the log of its worker is an event like the worker's own."""

from __future__ import annotations

import json
import subprocess
import sys

from tests.support.service import ROOT

PROGRAM = """
from workers.solver.process import Channel, ReportedFaults
with ReportedFaults(Channel()):
    raise ValueError("out of order")
"""


def test_a_solvers_error_is_one_json_line_and_a_fault() -> None:
    command = [sys.executable, "-c", PROGRAM]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    (line,) = ended.stderr.splitlines()
    told = json.loads(line)
    assert (told["level"], told["event"]) == ("error", "a solver met an error")
    assert "ValueError: out of order" in told["exception"]
    assert "fault" in json.loads(ended.stdout)
