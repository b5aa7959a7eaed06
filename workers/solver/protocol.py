"""What a worker and its solver process say to each other: JSON lines, and one block of bytes at the end.

Parent to child, on stdin: one request `{"id", "task", "meshes"}`. Stdin then stays open; that it closes means the
parent died.
Child to parent, on stdout: `{"ready": true}`, any number of `{"progress": [stage, done, total, object]}`, then either
`{"document": {outcome, sha256, size, stages, again}}` followed by `size` bytes of gzip, or `{"fault": "a sentence"}`.
Then the child ends, unless it has said that it can be asked `again`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NotRequired, TypedDict

from planners.progress import Report

MAX_LINE = 2**24
"""Longest line that is read [bytes]. A request is the longest: a body of at most some megabytes."""


REJECTED_VARIABLE = "LIFTWRIGHT_REJECTED_DIR"
"""Names the directory for documents that failed their certificate, to find out why."""
HANDOVERS_VARIABLE = "LIFTWRIGHT_HANDOVERS_DIR"
"""Names the directory where handover databases are kept; without it each process computes its own."""


class SolverRequest(TypedDict):
    """What is to be solved."""

    id: str
    task: dict[str, object]
    meshes: NotRequired[dict[str, dict[str, object]]]
    """The uploads that the task names, by id, as `SolidMesh.document` gives them."""


@dataclass(frozen=True)
class Answer:
    """What a request is answered with."""

    outcome: Literal["solved", "infeasible", "not_found"]
    """As in the document."""
    document: bytes
    """The plan, as it is stored and sent."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """By stage [s]."""


class DocumentHeader(TypedDict):
    """Announces the bytes of a document."""

    outcome: Literal["solved", "infeasible", "not_found"]
    sha256: str
    size: int
    stages: dict[str, float]
    """How long each stage took, by name [s]."""
    again: NotRequired[bool]
    """Whether the process waits for another request."""


class Message(TypedDict):
    """A line from the child: exactly one of its members."""

    ready: NotRequired[bool]
    progress: NotRequired[Report]
    document: NotRequired[DocumentHeader]
    fault: NotRequired[str]
