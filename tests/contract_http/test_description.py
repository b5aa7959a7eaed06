"""The description is what the service does: compared, fuzzed, and never less than it was."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from app.access.caller import Scope
from app.cli.keys_command import issue_key
from app.create_app import create_app
from app.settings import ServiceSettings
from planners.contract.scan_spec import scan_schema
from planners.contract.scene_document import SceneDocument
from planners.contract.task_spec import task_schema
from planners.plan.plan import plan_schema
from tests.support.service import FAKE_EXAMINER, FAKE_SOLVER, ROOT
from tests.support.serving import served

HERE = Path(__file__).parent
CHECKED_IN = ROOT / "docs" / "openapi.json"
FIRST_VERSION = HERE / "openapi-0.1.json"
"""As the first clients know it: never to be changed."""
RENAMED = {
    "Simulation": "LiftSimulation",
    "ContactStateDocument": "ContactState",
    "GripDocument": "Grip",
    "HoldDocument": "Hold",
    "PushDocument": "Push",
}
"""Schemas of the first version that have another name now; names of schemas are in no message."""
EXAMPLES = 3
SCHEMATHESIS = "import sys; sys.setswitchinterval(10); from schemathesis.cli import schemathesis; schemathesis()"
"""Python 3.11 counts the depth of a syntax tree wrongly if another thread gets its turn meanwhile (gh-106905)."""


@cache
def described() -> dict[str, Any]:
    return create_app(ServiceSettings(), with_worker=False).openapi()


def test_the_description_that_is_checked_in_is_the_services_own() -> None:
    assert json.loads(CHECKED_IN.read_text()) == json.loads(json.dumps(described())), "run `make openapi`"


def test_every_operation_says_who_may_call_and_how_errors_are_told() -> None:
    for path, operations in described()["paths"].items():
        for method, operation in operations.items():
            answers = operation["responses"]
            where = f"{method} {path}"
            assert bool(operation["security"]) == ("401" in answers), where
            assert operation["summary"], where
            for status, answer in answers.items():
                assert (status < "400") or list(answer["content"]) == ["application/problem+json"], where


@pytest.mark.parametrize("schema", [plan_schema, task_schema, scan_schema, SceneDocument.model_json_schema])
def test_no_two_schemas_of_the_description_have_one_name(schema: Callable[[], dict[str, Any]]) -> None:
    told = described()["components"]["schemas"]
    for name, part in schema()["$defs"].items():
        assert set(part.get("properties", {})) == set(told[name].get("properties", {})), name


def required_parameters(operation: dict[str, Any]) -> set[str]:
    return {parameter["name"] for parameter in operation.get("parameters", []) if parameter.get("required")}


def test_whatever_a_client_of_the_first_version_knows_is_still_there() -> None:
    """Operations and their successes stay, nothing new is required of requests, no member of an answer is dropped."""
    first, now = json.loads(FIRST_VERSION.read_text()), described()
    for path, operations in first["paths"].items():
        for method, before in operations.items():
            after = now["paths"][path][method]
            assert required_parameters(after) <= required_parameters(before), (method, path)
            kept = {status for status in before["responses"] if status < "400"}
            assert kept <= set(after["responses"]), (method, path)
    asked = parts_of("TaskSpec", now)
    for name, before in first["components"]["schemas"].items():
        if name in ("HTTPValidationError", "ValidationError"):
            continue  # Described by the framework, never sent.
        after = now["components"]["schemas"][RENAMED.get(name, name)]
        assert set(before.get("properties", {})) <= set(after.get("properties", {})), name
        answered = name not in asked
        required = set(before.get("required", [])), set(after.get("required", []))
        assert required[0] <= required[1] if answered else required[1] <= required[0], name


def parts_of(name: str, description: dict[str, Any]) -> set[str]:
    """Return the names of all schemas that one is made of."""
    found: set[str] = set()
    left = {name}
    while left:
        one = left.pop()
        found.add(one)
        pieces = json.dumps(description["components"]["schemas"][one]).split("#/components/schemas/")[1:]
        left |= {piece.split('"')[0] for piece in pieces} - found
    return found


@pytest.fixture
def guarded(tmp_path: Path) -> Any:
    settings = ServiceSettings.model_validate(
        {
            "data_dir": tmp_path,
            # A document that is made up would not be as described.
            "solver_command": (*FAKE_SOLVER, "fail"),
            "study_command": FAKE_EXAMINER,
            "worker_slots": 1,
            "requests_per_second": 10_000,
            "request_burst": 10_000,
            "max_queued": 100_000,
        }
    )
    key = issue_key(settings, "mes", Scope.ADMIN, None)
    with served(settings) as address:
        yield address, key


@pytest.mark.slow
def test_schemathesis_finds_no_answer_that_the_description_does_not_allow(guarded: tuple[str, str]) -> None:
    """All checks on all operations of the running service."""
    address, key = guarded
    command = [sys.executable, "-c", SCHEMATHESIS, "--config-file", HERE / "schemathesis.toml", "run"]
    options = [
        "--checks",
        "all",
        "--max-examples",
        str(EXAMPLES),
        "--workers",
        "4",
        "--seed",
        "1",
        "--continue-on-failure",
    ]
    run = subprocess.run(
        [*command, f"{address}/openapi.json", *options, "-H", f"Authorization: Bearer {key}", "--warnings", "off"],
        cwd=ROOT,
        env={**os.environ, "NO_COLOR": "1"},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stdout[-5000:]
