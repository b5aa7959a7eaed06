"""What a worker and its solver process say to each other: JSON lines, and one block of bytes at the end.

Parent to child, on stdin: one request `{"id", "task", "meshes", "cell_folders"}`. Stdin then stays open; that it closes
means the parent died.
Child to parent, on stdout: `{"ready": true}`, any number of `{"progress": [stage, done, total, object]}`, then either
`{"document": [outcome, sha256, size, stages, physics]}` followed by `size` bytes of gzip, or `{"fault": "a sentence"}`.
Then the child is ready for the next request, and says so, or it ends. What is certified, and still to be simulated or
to be given remedies, is sent in between, as a document is, but as `{"certified": …}`; or at the end, if the request
says `until_certified`. A request may bring it back as `certified`: then what it lacks is added, and nothing is planned.

A process that examines points of studies is asked `{"study", "points", "meshes", "cell_folders"}`, answers with
`{"point": …}` for each, then with `{"examined": true}`, and waits for the next request. One that keeps the graph of a
lift is asked `{"lift", "meshes", "cell_folders"}`, and answers with `{"feasibility": [kept, why]}`, or `[]`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal, NamedTuple, Self

from planners.progress import Report

if TYPE_CHECKING:
    from planners.geometry.solid_mesh import MeshDocument
    from planners.plan.simulation import Physics
    from planners.scene.shape_source import Uploads

MAX_LINE = 2**24
"""Longest line that is read [bytes]. A request is the longest: a body of at most some megabytes."""


REJECTED_VARIABLE = "LIFTWRIGHT_REJECTED_DIR"
"""Names the directory for documents that failed their certificate, to find out why."""
HANDOVERS_VARIABLE = "LIFTWRIGHT_HANDOVERS_DIR"
"""Names the directory where handover databases are kept; without it each process computes its own."""


class Line:
    """What is sent as one line: an object of the members that are something."""

    def line(self) -> bytes:
        """Return it as it is sent."""
        return json.dumps({name: value for name, value in vars(self).items() if value is not None}).encode() + b"\n"

    @classmethod
    def read(cls, line: bytes) -> Self:
        """Return what `line` wrote.

        Raises:
            ValueError, TypeError: It wrote something else.
        """
        return cls(**json.loads(line))


@dataclass(frozen=True)
class SolverRequest(Line):
    """What is to be solved."""

    id: str
    task: dict[str, object]
    meshes: Mapping[str, MeshDocument] | None = None
    """The uploads that the task names, by id."""
    certified: str | None = None
    """What an earlier attempt has certified, and lacks a simulation or remedies: its document, as gzip in base64."""
    until_certified: bool = False
    """Whether that is enough for now, so that another task gets its answer."""
    cell_folders: Mapping[str, str] | None = None
    """Where the files of the task's cell are unpacked, unless that is a shipped one."""


@dataclass(frozen=True)
class StudyRequest(Line):
    """Which points are to be examined."""

    study: dict[str, object]
    """As accepted."""
    points: list[int]
    """Numbers of its points, in the order in which they are wanted."""
    meshes: Mapping[str, MeshDocument] | None = None
    cell_folders: Mapping[str, str] | None = None


@dataclass(frozen=True)
class FeasibilityRequest(Line):
    """Of which lift it is asked whether a way is left."""

    lift: dict[str, object]
    """A task, as accepted."""
    meshes: Mapping[str, MeshDocument] | None = None
    cell_folders: Mapping[str, str] | None = None


AnyRequest = SolverRequest | StudyRequest | FeasibilityRequest


def uploads_of(request: AnyRequest) -> Uploads:
    """Return how the scene finds the meshes that came with a request."""
    # A process that solves nothing itself, as those of tests, is ready without all that works on meshes.
    from planners.geometry.solid_mesh import SolidMesh

    documents = request.meshes or {}

    @cache
    def mesh_of(upload: str) -> SolidMesh | None:
        """Return one and the same for all changed tasks too, which find its parts once."""
        return SolidMesh.from_document(documents[upload]) if upload in documents else None

    return mesh_of


_Outcome = Literal["solved", "infeasible", "not_found"]
"""As in the document."""


@dataclass(frozen=True)
class Answer:
    """What a request is answered with."""

    outcome: _Outcome
    document: bytes
    """The plan, as it is stored and sent."""
    stages: tuple[tuple[str, float], ...] = ()
    """Name and seconds of each, without names of objects: one that several objects go through is there for each."""
    physics: Physics | None = None
    """How the plan fared when it was simulated; None: it was not, or not yet."""


class DocumentHeader(NamedTuple):
    """Announces the bytes of a document."""

    outcome: _Outcome
    sha256: str
    size: int
    """Of what follows [bytes]."""
    stages: Sequence[tuple[str, float]]
    """As in the answer."""
    physics: Physics | None = None


@dataclass(frozen=True)
class Message(Line):
    """A line from the child: exactly one of its members."""

    ready: bool | None = None
    progress: Report | None = None
    certified: DocumentHeader | None = None
    document: DocumentHeader | None = None
    point: dict[str, object] | None = None
    examined: bool | None = None
    feasibility: tuple[float | None, str | None] | tuple[()] | None = None
    """Members of a `Feasibility`; none of them where nothing is known."""
    fault: str | None = None

    def __post_init__(self) -> None:
        """Read what JSON has as arrays."""
        for name, kind in (("progress", Report), ("certified", DocumentHeader), ("document", DocumentHeader)):
            if isinstance(value := getattr(self, name), list):
                object.__setattr__(self, name, kind(*value))
