"""Bad input, much of it made up by hypothesis: the service answers, stays small, and touches nothing else."""

from __future__ import annotations

import copy
import itertools
import json
import os
import signal
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings
from hypothesis import strategies as st

from tests.benchmarks.tasks import Note
from tests.support import mesh_bombs
from tests.support.audited_service import NOTES
from tests.support.service import TASKS, ServiceProcess, running_service

MOST_MIB = 1500.0
"""Of the service's process, at its largest [MiB]. Half of it are libraries and compiled kernels."""
NOTED = 1000
"""Cases between two notes of how far it has come."""
UNUSUAL = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=40), st.sampled_from(mesh_bombs.PATHS),
    st.sampled_from([2**63, -(2**63), 1e308, -0.0, 5e-324, "", [], {}, [[[]]]]),
    st.recursive(st.integers(), lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner)),
)  # fmt: skip
"""What a member may be replaced by."""
BASES = [json.loads(path.read_text()) for path in sorted(TASKS.glob("*.json"))]
MEDIA_TYPES = ("model/stl", "model/obj", "model/ply", "model/gltf-binary")
WORDS = [
    b"solid ", b"facet", b"endloop", b"v 0 0 0\n", b"f 1 2 3\n", b"f 1/1/1 -1 99\n", b"ply\n", b"format ascii 1.0\n",
    b"element vertex 3\n", b"element face 1\n", b"property list uchar int vertex_indices\n", b"end_header\n",
    b"glTF\x02\0\0\0", b"JSON", b"BIN\0", b"nan ", b"1e999 ", b"\0" * 80, b"PK\x03\x04",
]  # fmt: skip


@dataclass
class FuzzFigures:
    """What was sent and what came of it."""

    cases: int = 0
    statuses: Counter[int] = field(default_factory=Counter)
    peak_mib: float = 0.0
    faults: list[str] = field(default_factory=list)
    """Promises that were broken."""


@st.composite
def changed_tasks(draw: st.DrawFn) -> Any:
    """Draw a shipped task in which up to three members were replaced, removed, repeated or added.

    What is drawn is copied: later changes would be seen by the next draw.
    """
    task = copy.deepcopy(draw(st.sampled_from(BASES)))
    for _ in range(draw(st.integers(1, 3))):
        holder: Any = task
        for _ in range(draw(st.integers(0, 4))):
            inner = [each for each in _members(holder) if isinstance(holder[each], dict | list) and holder[each]]
            if not inner:
                break
            holder = holder[draw(st.sampled_from(inner))]
        key = draw(st.sampled_from(_members(holder)))
        match draw(st.sampled_from(["replace", "replace", "remove", "add", "repeat"])):
            case "replace":
                holder[key] = copy.deepcopy(draw(UNUSUAL))
            case "remove" if len(holder) > 1:
                del holder[key]
            case "add" if isinstance(holder, dict):
                holder[draw(st.text(max_size=10))] = copy.deepcopy(draw(UNUSUAL))
            case "repeat" if isinstance(holder, list):
                holder += [holder[key]] * draw(st.integers(1, 200))
    return task


@st.composite
def near_meshes(draw: st.DrawFn) -> tuple[str, bytes]:
    """Draw something that begins or looks like a mesh file, and what it is said to be."""
    if draw(st.booleans()):
        media_type, content = draw(st.sampled_from(list(mesh_bombs.meshes())))
        content = content[:100_000]
        cut = draw(st.integers(0, len(content)))
        return media_type, content[:cut] + draw(st.binary(max_size=40)) + content[cut + draw(st.integers(0, 8)) :]
    pieces = draw(st.lists(st.one_of(st.sampled_from(WORDS), st.binary(max_size=60)), max_size=40))
    return draw(st.sampled_from(MEDIA_TYPES)), b"".join(pieces)


class Target:
    """A service that is watched while bad input is sent to it."""

    def __init__(self, service: ServiceProcess, client: httpx.Client, notes: Path) -> None:
        self._service, self._client, self._notes = service, client, notes
        self.figures = FuzzFigures()

    def send(self, path: str, content: bytes, media_type: str, *, refused: bool = False) -> None:
        """Send one body, and judge the answer; `refused`: it must be a 4xx."""
        answer = self._client.post(path, content=content, headers={"Content-Type": media_type})
        self.figures.cases += 1
        self.figures.statuses[answer.status_code] += 1
        wanted = answer.is_client_error or (answer.is_success and not refused)
        described = answer.is_success or answer.headers.get("content-type") == "application/problem+json"
        if not (wanted and described):
            begin = content[:200]
            self.figures.faults.append(f"{path} answered {answer.status_code} to {media_type} {begin!r}")

    def conclude(self) -> FuzzFigures:
        """Look at what the process has become and has done."""
        assert self._service.process is not None
        status = Path(f"/proc/{self._service.process.pid}/status").read_text()
        self.figures.peak_mib = int(status.partition("VmHWM:")[2].split()[0]) / 1024.0
        if self.figures.peak_mib > MOST_MIB:
            self.figures.faults.append(f"the service took {self.figures.peak_mib:.0f} MiB")
        self.figures.faults += self._notes.read_text().splitlines()
        return self.figures


@contextmanager
def watched_service(folder: Path) -> Iterator[Target]:
    """Run an API whose doings are noted, without anybody who would work on what it accepts."""
    notes = folder / "notes"
    os.environ[NOTES] = str(notes)
    try:
        limits = {"max_queued": 1_000_000, "requests_per_second": 1e6, "request_burst": 1_000_000}
        with running_service(
            folder / "data", None, command="api", module="tests.support.audited_service", **limits
        ) as service:
            with service.client() as client:
                # What is loaded at first use is loaded now.
                client.post("/v1/plans", json=BASES[0])
                client.post("/v1/meshes", content=b"solid", headers={"Content-Type": "model/stl"})
                assert service.process is not None
                service.process.send_signal(signal.SIGUSR1)
                yield Target(service, client, notes)
    finally:
        del os.environ[NOTES]


def fuzz(target: Target, cases: int, number: int = 0, note: Note | None = None) -> None:
    """Send every bomb, and then so many made-up cases, half tasks and half meshes."""
    sent = itertools.count(1)

    def tell() -> None:
        if (count := next(sent)) % NOTED == 0 and note is not None:
            note(f"fuzz: {count} of {cases} cases")

    for body in mesh_bombs.bodies():
        target.send("/v1/plans", body, "application/json", refused=True)
    for media_type, content in mesh_bombs.meshes():
        target.send("/v1/meshes", content, media_type)

    @given(changed_tasks())
    def send_task(task: Any) -> None:
        target.send("/v1/plans", json.dumps(task).encode(), "application/json")
        tell()

    @given(near_meshes())
    def send_mesh(mesh: tuple[str, bytes]) -> None:
        target.send("/v1/meshes", mesh[1], mesh[0])
        tell()

    for send in (send_task, send_mesh):
        effort = settings(
            max_examples=cases // 2, deadline=None, database=None, phases=[Phase.generate], print_blob=False,
            suppress_health_check=list(HealthCheck), verbosity=Verbosity.quiet,
        )  # fmt: skip
        seed(number)(effort(send))()


def _members(holder: Any) -> list[Any]:
    return list(holder) if isinstance(holder, dict) else list(range(len(holder)))
