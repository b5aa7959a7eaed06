"""`liftwright scene FILE…`: what a scan shows, found on this machine or by a service."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from app.cli.output import BAD_INPUT, refuse, written_whole
from app.cli.service_client import ServiceClient, ServiceRefused
from planners.cell.cell import known_cells, load_cell
from planners.contract.problems import problems_of
from planners.contract.scan_spec import NotAScan, read_scan
from planners.contract.scene_document import ObjectPart, SceneDocument
from planners.contract.strict_json import NotJson, parse_json
from planners.errors import LiftwrightError, SceneError
from planners.perception.perceive import PARTS, perceive
from planners.perception.scan_files import ScanRefused

PERCEIVED = 0
DESCRIPTION = "scan"
DESCRIPTION_FILE = "scan.json"
"""What messages call it, whatever its own name."""
SUFFIXES = frozenset({".json", ".png", ".jpg", ".jpeg", ".npy", ".ply", ".pcd"})


def perceive_files(named: Sequence[str], service: str | None, out: Path | None, preview: Path | None) -> int:
    """Perceive the scan in some files, print what was found, and return the exit code.

    Args:
        named: files or a folder, as `read_scan_files` takes them.
        service: address of the service that is to perceive and keep the scene; None: this machine, keeping nothing.
        out: where the SceneDocument goes.
        preview: where the picture goes.

    Raises:
        KeyMissing, ServiceAway, ServiceRefused: The service cannot do it, and not because of the scan.
        OSError: A file cannot be read or written.
    """
    try:
        scan = read_scan_files(named)
        with written_whole(out) as file:
            document, picture, told = _perceive(scan) if service is None else _post(scan, ServiceClient(service))
            if preview is not None:
                preview.write_bytes(picture)
            if file is not None:
                file.write(document.model_dump_json())
    except SceneError as error:
        return refuse(problems_of(error), DESCRIPTION_FILE)
    except NotAScan as error:
        return refuse(error.problems, DESCRIPTION_FILE)
    except ServiceRefused as error:
        if not error.is_about_the_input:
            raise
        return refuse(error.problems, DESCRIPTION_FILE)
    except (NotScanFiles, NotJson, ScanRefused) as error:
        sys.stderr.write(f"liftwright: {error}\n")
        return BAD_INPUT
    sys.stdout.write(describe(document) + told)
    return PERCEIVED


def describe(document: SceneDocument) -> str:
    """Return a line for each thing that was found, with what 19 of 20 errors are within, and for each that was not."""
    lines = [_object_line(part) for part in document.objects] or ["no object was found\n"]
    lines += [f"{'not recognised':<16}{part.reason}\n" for part in document.unrecognised]
    if document.tool is not None:
        x, y, z = (1e3 * value for value in document.tool.pose[:3])
        off = 2e3 * document.tool.uncertainty.position
        lines.append(f"{document.tool.name:<16}tool, its cup at {x:.1f}, {y:.1f}, {z:.1f} ± {off:.1f} mm\n")
    return "".join([*lines, *(f"{'note':<16}{note}\n" for note in document.notes)])


def _object_line(part: ObjectPart) -> str:
    shape, off = part.shape, part.uncertainty
    box = shape.type == "box"
    size = " x ".join(f"{1e3 * side:.1f}" for side in shape.size) if box else (
        f"diameter {2e3 * shape.radius:.1f}, height {1e3 * shape.height:.1f}"
    )  # fmt: skip
    x, y, z = (1e3 * value for value in part.pose[:3])
    yaw = f", yaw ± {math.degrees(2.0 * off.yaw):.1f}°" if box else ""
    return (
        f"{part.name:<16}{shape.type}, {size} ± {2e3 * max(off.size):.1f} mm, "
        f"centre {x:.1f}, {y:.1f}, {z:.1f} ± {2e3 * max(off.position):.1f} mm{yaw}, on {part.supported_by}\n"
    )


def _perceive(scan: ScanFiles) -> tuple[SceneDocument, bytes, str]:
    described = read_scan(parse_json(scan.description, DESCRIPTION_FILE))
    if described.cell not in known_cells():
        raise SceneError("/cell", f"there is no cell {described.cell}", list(known_cells()))
    found = perceive(described, scan.files, load_cell(described.cell))
    return found.document, found.preview, ""


def _post(scan: ScanFiles, client: ServiceClient) -> tuple[SceneDocument, bytes, str]:
    scene = client.post_scene(scan.description, scan.files)
    told = f"{'scene_id':<16}{scene.id}\n{'viewer':<16}{client.address}{scene.links.view}\n"
    return scene.scene, client.read(scene.links.preview), told


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
    if not path.exists():
        raise NotScanFiles(f"{name}: there is no such file or folder")
    if path.stem not in known:
        raise NotScanFiles(f"{name}: a file is called like its part, {', '.join(known)}, or given as depth={name}")
    return [(path.stem, path)]
