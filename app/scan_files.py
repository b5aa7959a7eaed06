"""Files of a scan on disk: its description and what the cameras wrote, each named by its part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from planners.errors import LiftwrightError
from planners.perception.perceive import PARTS

DESCRIPTION = "scan"
DESCRIPTION_FILE = "scan.json"
"""What messages call it, whatever its own name."""
SUFFIXES = frozenset({".json", ".png", ".jpg", ".jpeg", ".npy", ".ply", ".pcd"})


class NotScanFiles(LiftwrightError):
    """The files that were named are no scan."""


@dataclass(frozen=True, eq=False)
class ScanFiles:
    """A scan as it is posted."""

    description: bytes
    files: dict[str, bytes]
    """By part."""


def read_scan_files(named: Sequence[str]) -> ScanFiles:
    """Read a scan: a folder, or files that are called like their parts (depth.png), or PART=FILE.

    Raises:
        NotScanFiles: They are not the parts of one scan.
        OSError: One of them cannot be read.
    """
    paths: dict[str, Path] = {}
    for part, path in [pair for name in named for pair in _parts(name)]:
        if part in paths:
            raise NotScanFiles(f"the part {part} is given twice: {paths[part]}, {path}")
        paths[part] = path
    if DESCRIPTION not in paths:
        raise NotScanFiles(f"there is no {DESCRIPTION_FILE}, which says what cameras the files come from")
    contents = {part: path.read_bytes() for part, path in paths.items()}
    return ScanFiles(contents.pop(DESCRIPTION), contents)


def _parts(name: str) -> list[tuple[str, Path]]:
    known = (DESCRIPTION, *PARTS)
    part, equals, rest = name.partition("=")
    if equals and part in known:
        return [(part, Path(rest))]
    path = Path(name)
    if path.is_dir():
        return [(each.stem, each) for each in sorted(path.iterdir()) if each.stem in known and each.suffix in SUFFIXES]
    if path.stem not in known:
        raise NotScanFiles(f"{name}: a file is called like its part, {', '.join(known)}, or given as depth={name}")
    return [(path.stem, path)]
