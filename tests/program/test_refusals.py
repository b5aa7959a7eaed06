"""What is no plan, a changed plan or a plan of elsewhere is exported to no target, and not executed."""

from __future__ import annotations

import json
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.cli import execute_command
from app.cli.main import main
from planners.cell.cell import Cell, known_cells, load_cell
from planners.contract.strict_json import NotJson, parse_json
from planners.plan.plan import Plan, digest_of
from planners.plan.verdicts import Certificate
from planners.program import NotExportable, ProgramTarget, exportable, guard, write_program
from tests.support.samples import sample
from tests.support.service import task

CASES = 210
NOT_TOLD = ("id", "statistics")
"""What the digest leaves out: nothing of it moves anything."""
Random = np.random.Generator


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Yield everything in JSON data with the way there."""
    if path[:1] and path[0] in NOT_TOLD:
        return
    yield path, value
    members = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, each in members:
        yield from places(each, (*path, name))


def pick(data: Any, rng: Random, wanted: Callable[[Any], bool]) -> tuple[Any, Any]:
    """Return what holds a value that is wanted, and its name or place there; all such values are as likely."""
    found = [path for path, value in places(data) if path and wanted(value)]
    path = found[rng.integers(len(found))]
    holder = data
    for name in path[:-1]:
        holder = holder[name]
    return holder, path[-1]


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


# ---- malformed: bytes that nobody should make sense of ----


def truncated(data: Any, rng: Random) -> bytes:
    text = json.dumps(data).encode()
    return text[: rng.integers(len(text))]


def overwritten(data: Any, rng: Random) -> bytes:
    text = bytearray(json.dumps(data).encode())
    begin = text.index(b'"task"')
    while True:
        changed = bytearray(text)
        changed[rng.integers(begin, text.index(b'"statistics"'))] = rng.integers(256)
        if _says_something_else(bytes(changed), data):
            return bytes(changed)


def said_twice(data: Any, rng: Random) -> bytes:
    name = [*data][rng.integers(len(data))]
    return json.dumps(data)[:-1].encode() + f", {json.dumps(name)}: {json.dumps(data[name])}}}".encode()


def no_number(data: Any, rng: Random) -> bytes:
    holder, name = pick(data, rng, is_number)
    holder[name] = float(rng.choice([np.nan, np.inf, -np.inf]))
    return json.dumps(data).encode()


def otherwise_encoded(data: Any, rng: Random) -> bytes:
    return json.dumps(data).encode(str(rng.choice(["utf-16", "utf-32"])))


def with_more_behind(data: Any, rng: Random) -> bytes:
    return json.dumps(data).encode() + bytes(rng.integers(33, 127, size=3).tolist())


def wrapped(data: Any, rng: Random) -> bytes:
    return json.dumps([[data], {"plan": data}, {}, 7, None, "plan"][rng.integers(6)]).encode()


# ---- tampered: the digest is that of the plan before ----


def nudged(data: Any, rng: Random) -> bytes:
    holder, name = pick(data, rng, is_number)
    holder[name] = float(np.nextafter(holder[name], np.inf)) if rng.integers(2) else holder[name] + 1
    return json.dumps(data).encode()


def renamed(data: Any, rng: Random) -> bytes:
    holder, name = pick(data, rng, lambda value: isinstance(value, str))
    holder[name] += "x"
    return json.dumps(data).encode()


def turned_round(data: Any, rng: Random) -> bytes:
    holder, name = pick(data, rng, lambda value: isinstance(value, bool))
    holder[name] = not holder[name]
    return json.dumps(data).encode()


def left_out(data: Any, rng: Random) -> bytes:
    holder, name = pick(data, rng, lambda value: True)
    del holder[name]
    return json.dumps(data).encode()


def added(data: Any, rng: Random) -> bytes:
    holder, name = pick(data, rng, lambda value: isinstance(value, dict | list) and bool(value))
    inner = holder[name]
    if isinstance(inner, dict):
        inner["more"] = 1
    else:
        inner.append(deepcopy(inner[rng.integers(len(inner))]))
    return json.dumps(data).encode()


def exchanged(data: Any, rng: Random) -> bytes:
    holder, name = pick(data, rng, lambda value: isinstance(value, list) and len({json.dumps(x) for x in value}) > 1)
    inner = holder[name]
    while True:
        i, j = rng.integers(len(inner), size=2)
        if inner[i] != inner[j]:
            inner[i], inner[j] = inner[j], inner[i]
            return json.dumps(data).encode()


# ---- sealed again: the digest is right, and the document is not ----


def sealed_again(data: Any, rng: Random) -> bytes:
    changes: list[Callable[[], Any]] = [
        lambda: data.update(outcome="not_found"),
        lambda: data.update(certificate=None),
        lambda: data["certificate"].update(passed=False),
        lambda: data["cell"].update(hash=rng.bytes(32).hex()),
        lambda: data["cell"].update(name="elsewhere"),
        lambda: data["joint_names"].reverse(),
        lambda: data["segments"][0]["time"].pop(),
        lambda: data["segments"][0]["positions"][1].pop(),
        lambda: data["segments"][0].update(gripper_width={}),
        lambda: data["segments"][0].update(movers=["middle"]),
        lambda: data["segments"][0].update(body_poses={"ghost": 3 * [[0, 0, 0, 1, 0, 0, 0]]}),
        lambda: data["cell"]["arms"].pop("left"),
        lambda: data.update(schema_version="2.0"),
        lambda: data.update(more=True),
    ]
    changes[rng.integers(len(changes))]()
    return json.dumps({**data, "digest": digest_of(data)}).encode()


def without_seal(data: Any, rng: Random) -> bytes:
    if rng.integers(2):
        del data["digest"]
    else:
        data["digest"] = rng.bytes(32).hex()
    return json.dumps(data).encode()


# ---- foreign: something else, or a plan of elsewhere ----


def another_thing(data: Any, rng: Random) -> bytes:
    things = [
        json.dumps(data["task"]).encode(),
        json.dumps(data["certificate"]).encode(),
        json.dumps(task("ab1.json")).encode(),
        b"def liftwright_left():\n  movej([0, 0, 0, 0, 0, 0])\nend\n",
        b"time,step\n0.0,1\n",
        b'<?xml version="1.0"?><robot name="cell"/>',
        b"PK\x03\x04",
        b"\x89MCAP0\r\n",
    ]
    return things[rng.integers(len(things))]


MUTATIONS = (
    *(truncated, overwritten, said_twice, no_number, otherwise_encoded, with_more_behind, wrapped),
    *(nudged, renamed, turned_round, left_out, added, exchanged),
    *(sealed_again, without_seal, another_thing),
)


def _says_something_else(changed: bytes, data: Any) -> bool:
    try:
        return parse_json(changed) != data
    except NotJson:
        return True


@pytest.fixture
def believing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a certificate that believes everything, so that what refuses is all that stands before it."""
    monkeypatch.setattr(guard, "certificate_of", lambda document, cell: Certificate(passed=True, checks=[]))


@pytest.fixture
def no_robot(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Have no controllers; return the addresses that were asked for."""
    asked: list[str] = []

    def link(host: str, **_: Any) -> Any:
        asked.append(host)
        raise execute_command.NoLink(f"{host}: nobody is there")

    monkeypatch.setattr(execute_command, "ArmLink", link)
    return asked


@pytest.mark.usefixtures("believing")
def test_the_plan_that_is_changed_below_would_be_exported_and_executed(
    small: Plan, no_robot: list[str], tmp_path: Path
) -> None:
    plan = tmp_path / "plan.json"
    plan.write_bytes(small.write())
    for target in ProgramTarget:
        for mark in (b"", BOM_UTF8):
            assert write_program(mark + small.write(), load_cell(small.cell.name), target)
    assert main(["execute", str(plan), "--left", "a", "--right", "b", "--run"]) == 2
    assert no_robot == ["a"]


@pytest.mark.usefixtures("believing")
@pytest.mark.parametrize("seed", range(CASES))
def test_no_changed_plan_is_exported_or_executed(
    small: Plan, no_robot: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], seed: int
) -> None:
    mutation = MUTATIONS[seed % len(MUTATIONS)]
    original = json.loads(small.write())
    changed = mutation(deepcopy(original), np.random.default_rng(seed))
    assert _says_something_else(changed, original), mutation.__name__
    plan, out = tmp_path / "plan.json", tmp_path / "out.zip"
    plan.write_bytes(changed)
    for target in ProgramTarget:
        with pytest.raises(NotExportable):
            write_program(changed, load_cell(small.cell.name), target)
        assert main(["export", str(plan), "--target", target.value, "--out", str(out)]) in (2, 3)
    assert main(["execute", str(plan), "--left", "a", "--right", "b", "--run", "--continuous"]) in (2, 3)
    assert no_robot == []
    assert [path.name for path in tmp_path.iterdir()] == ["plan.json"]
    assert str(plan) in capsys.readouterr().err


@pytest.mark.usefixtures("believing")
@pytest.mark.parametrize("target", ProgramTarget)
def test_no_plan_is_exported_in_another_cell_or_one_that_has_changed(small: Plan, target: ProgramTarget) -> None:
    rng = np.random.default_rng(0)
    here = load_cell(small.cell.name)
    elsewhere: list[Cell] = [load_cell(name) for name in known_cells() if name != here.name]
    elsewhere += [replace(here, hash=rng.bytes(32).hex()) for _ in range(10)]
    elsewhere += [replace(each, name=here.name) for each in elsewhere[:5]]
    for cell in elsewhere:
        with pytest.raises(NotExportable, match=r"it is a plan for the cell|is not what it was planned in any more"):
            write_program(small.write(), cell, target)


# ---- sealed again, and well-formed: what is left is the certificate ----


def _moved(segment: dict[str, Any], rng: Random) -> None:
    """Have a joint of an arm elsewhere at one sample."""
    row = segment["positions"][rng.integers(1, len(segment["time"]))]
    row[rng.integers(12)] += float(rng.choice([-1, 1]) * rng.uniform(0.01, 0.5))


def _hurried(segment: dict[str, Any], rng: Random) -> None:
    """Have it done in less time."""
    begin, factor = segment["time"][0], float(rng.uniform(0.3, 0.9))
    segment["time"] = [begin + factor * (time - begin) for time in segment["time"]]


def _opened(segment: dict[str, Any], rng: Random) -> None:
    """Have fingers elsewhere."""
    arm = [*segment["gripper_width"]][rng.integers(len(segment["gripper_width"]))]
    widths = segment["gripper_width"][arm]
    segment["gripper_width"][arm] = [abs(width - float(rng.uniform(0.005, 0.02))) for width in widths]


def _faster(segment: dict[str, Any], rng: Random) -> None:
    """State other velocities than the positions have."""
    row = segment["velocities"][rng.integers(len(segment["time"]))]
    row[rng.integers(12)] += float(rng.uniform(0.2, 1.0))


@pytest.mark.parametrize("seed", range(sample(4, 40)))
def test_whoever_changes_the_motion_and_seals_it_does_not_get_past_the_certificate(
    documents: dict[str, bytes], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    data = json.loads(documents["ab1"])
    change = (_moved, _hurried, _opened, _faster)[seed % 4]
    change(data["segments"][rng.integers(len(data["segments"]))], rng)
    sealed = json.dumps({**data, "digest": digest_of(data)}).encode()
    with pytest.raises(NotExportable, match=r"this is not a plan|does not pass when it is certified again"):
        exportable(sealed, load_cell("dual_ur3e_lift"))
