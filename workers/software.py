"""Which software made a document."""

from __future__ import annotations

import os
import re
from importlib.metadata import version
from pathlib import Path

from planners.plan.verdicts import Software

NAME = "liftwright"
COMMIT_VARIABLE = "LIFTWRIGHT_COMMIT"
"""Set by an image that has no git directory."""


def describe_software() -> Software:
    """Return name, version and commit; the commit is None when it is not known."""
    return Software(name=NAME, version=version(NAME), commit=_commit())


def _commit() -> str | None:
    given = os.environ.get(COMMIT_VARIABLE)
    if given:
        return given
    git = Path(__file__).resolve().parents[1] / ".git"
    if not (git / "HEAD").is_file():
        return None
    head = (git / "HEAD").read_text().strip()
    if head.startswith("ref: "):
        reference = git / head.removeprefix("ref: ")
        head = reference.read_text().strip() if reference.is_file() else ""
    return head if re.fullmatch(r"[0-9a-f]{40}", head) else None
