"""A plan document on its way from the solver to the database."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, eq=False)
class PackedDocument:
    """A plan document as the solver hands it over."""

    outcome: str
    sha256: str
    """Of the uncompressed JSON."""
    gzip: bytes
    stages: Mapping[str, float]
    """How long each stage took, by name [s]."""
