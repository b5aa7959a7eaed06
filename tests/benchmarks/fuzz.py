"""Bad input, much of it made up by hypothesis: the service answers, stays small, and touches nothing else.

Tasks, meshes, cells and scans are posted; plan documents are asked for what may become a program.
"""

from __future__ import annotations

import copy
import itertools
import json
import os
import signal
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import httpx
from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings
from hypothesis import strategies as st

from planners import read_task, solve
from planners.cell.cell import load_cell
from planners.program import NotExportable, exportable
from tests.benchmarks.tasks import Note, task_body
from tests.support import mesh_bombs
from tests.support.audited_service import NOTES
from tests.support.own_cell import furnished, furnished_files, station, station_files, zipped
from tests.support.scan_frames import shipped as shipped_scan
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
JSON = "application/json"
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
    """Bodies that were posted."""
    documents: int = 0
    """Plan documents that were to become programs."""
    exported: int = 0
    """... of which were: something in them was changed that moves nothing."""
    statuses: Counter[int] = field(default_factory=Counter)
    peak_mib: float = 0.0
    faults: list[str] = field(default_factory=list)
    """Promises that were broken."""

    def __add__(self, other: FuzzFigures) -> FuzzFigures:
        return FuzzFigures(
            cases=self.cases + other.cases,
            documents=self.documents + other.documents,
            exported=self.exported + other.exported,
            statuses=self.statuses + other.statuses,
            peak_mib=max(self.peak_mib, other.peak_mib),
            faults=self.faults + other.faults,
        )


@st.composite
def changed(draw: st.DrawFn, bases: Sequence[Any]) -> Any:
    """Draw one of several JSON values in which up to three members were replaced, removed, repeated or added.

    What is drawn is copied: later changes would be seen by the next draw.
    """
    document = copy.deepcopy(draw(st.sampled_from(bases)))
    for _ in range(draw(st.integers(1, 3))):
        holder: Any = document
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
    return document


@st.composite
def damaged(draw: st.DrawFn, files: Sequence[bytes]) -> bytes:
    """Draw one of several files that is cut off, or has some bytes in it replaced, inserted or left out."""
    content = draw(st.sampled_from(files))
    if draw(st.booleans()):
        return content[: draw(st.integers(0, len(content)))]
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(content)))
        content = content[:at] + draw(st.binary(max_size=20)) + content[at + draw(st.integers(0, 20)) :]
    return content


@cache
def begun_bombs() -> list[tuple[str, bytes]]:
    """Return how meshes begin that must be refused, with their media types."""
    return [(media_type, content[:100_000]) for media_type, content in mesh_bombs.meshes()]


@st.composite
def near_meshes(draw: st.DrawFn) -> tuple[str, bytes]:
    """Draw something that begins or looks like a mesh file, and what it is said to be."""
    if draw(st.booleans()):
        media_type, content = draw(st.sampled_from(begun_bombs()))
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
                target = Target(service, client, notes)
                send_cell(target, station())
                send_scan(target, (shipped_scan().description, shipped_scan().files))
                assert service.process is not None
                service.process.send_signal(signal.SIGUSR1)
                yield target
    finally:
        del os.environ[NOTES]


@dataclass(frozen=True)
class Kind:
    """A kind of bad input: what is drawn, and what is done with it."""

    share: float
    """Of all cases [1]."""
    drawn: st.SearchStrategy[Any]
    send: Callable[[Target, Any], None]


def send_task(target: Target, task: Any) -> None:
    """Post a task."""
    target.send("/v1/plans", json.dumps(task).encode(), JSON)


def send_mesh(target: Target, mesh: tuple[str, bytes]) -> None:
    """Post a mesh, given what it is said to be."""
    target.send("/v1/meshes", mesh[1], mesh[0])


def send_cell(target: Target, cell: Any) -> None:
    """Post a cell, as a document or, given bytes, as a zip."""
    if isinstance(cell, bytes):
        target.send("/v1/cells", cell, "application/zip")
    else:
        target.send("/v1/cells", json.dumps(cell).encode(), JSON)


def send_scan(target: Target, scan: tuple[Any, Mapping[str, bytes]]) -> None:
    """Post a scan: its description, and its pictures by name."""
    described, pictures = scan
    form = {"scan": ("scan.json", json.dumps(described).encode(), JSON)}
    form |= {name: (name, content, "image/png") for name, content in pictures.items()}
    encoded = httpx.Request("POST", "http://localhost/", files=form)
    target.send("/v1/scenes", encoded.read(), encoded.headers["Content-Type"])


class Programs:
    """What becomes of plan documents that are to become programs."""

    def __init__(self) -> None:
        """Plan a lift, whose document is changed."""
        body = task_body("pb1", simulate=False)
        self.plan = solve(read_task(body))
        self.document, self._cell = self.plan.write(), load_cell(body.get("cell", "dual_ur3e_lift"))

    def read(self, target: Target, document: bytes) -> None:
        """Ask for a program: of a changed plan there is none, and the reason is told."""
        figures = target.figures
        figures.documents += 1
        try:
            plan = exportable(document, self._cell)
        except NotExportable as why:
            if not str(why):
                figures.faults.append("a document was refused without a reason")
        except Exception as error:  # noqa: BLE001 - whatever it is, nobody expects it
            figures.faults.append(f"a changed document ended in {error!r:.200}")
        else:
            figures.exported += 1
            if plan.digest != self.plan.digest:
                figures.faults.append("a changed plan was exported")


def kinds() -> dict[str, Kind]:
    """Return all kinds of bad input, by name."""
    scan, programs = shipped_scan(), Programs()
    stations, zips = [station(), furnished()], [zipped(station_files()), zipped(station_files(), zipfile.ZIP_STORED)]
    own = furnished_files()
    # A file within the archive is damaged: of one that is damaged itself, nothing within is ever read.
    inside = [st.tuples(st.just(name), damaged([content])) for name, content in own.items()]
    archives = st.one_of(inside).map(lambda each: zipped({**own, each[0]: each[1]}))
    described_zips = changed([furnished()]).map(lambda each: zipped({**own, "cell.yaml": json.dumps(each).encode()}))
    pictures = {name: damaged([content]) for name, content in scan.files.items()}
    described = changed([scan.description])
    scans = st.one_of(
        st.tuples(described, st.just(scan.files)),
        st.tuples(st.just(scan.description), st.fixed_dictionaries(pictures)),
    )
    documents = st.one_of(
        changed([json.loads(programs.document)]).map(lambda each: json.dumps(each).encode()),
        damaged([programs.document]),
    )
    return {
        "tasks": Kind(0.5, changed(BASES), send_task),
        "meshes": Kind(0.3, near_meshes(), send_mesh),
        "cells": Kind(0.12, st.one_of(changed(stations), damaged(zips), archives, described_zips), send_cell),
        "scans": Kind(0.05, scans, send_scan),
        "plan documents": Kind(0.03, documents, programs.read),
    }


def fuzz(target: Target, cases: int, number: int = 0, note: Note | None = None) -> None:
    """Send every bomb, and then so many made-up cases of all kinds."""
    for body in mesh_bombs.bodies():
        target.send("/v1/plans", body, JSON, refused=True)
    for media_type, content in mesh_bombs.meshes():
        target.send("/v1/meshes", content, media_type)
    sent = itertools.count(1)

    def tell() -> None:
        if (count := next(sent)) % NOTED == 0 and note is not None:
            note(f"fuzz: {count} of {cases} cases")

    for kind in kinds().values():
        effort = settings(
            max_examples=round(kind.share * cases), deadline=None, database=None, phases=[Phase.generate],
            print_blob=False, suppress_health_check=list(HealthCheck), verbosity=Verbosity.quiet,
        )  # fmt: skip
        seed(number)(effort(_sending(kind, target, tell)))()


def _sending(kind: Kind, target: Target, tell: Callable[[], None]) -> Callable[[], None]:
    @given(kind.drawn)
    def send(drawn: Any) -> None:
        kind.send(target, drawn)
        tell()

    return send


def _members(holder: Any) -> list[Any]:
    return list(holder) if isinstance(holder, dict) else list(range(len(holder)))
