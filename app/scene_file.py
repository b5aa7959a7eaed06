"""`liftwright scene FILE…`: what a scan shows, found on this machine or by a service."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError

from app.bad_input import BAD_INPUT, refuse
from app.scan_files import DESCRIPTION_FILE, NotScanFiles, ScanFiles, read_scan_files
from app.service_client import ServiceClient, ServiceRefused
from app.whole_file import written_whole
from planners.cell.cell import known_cells, load_cell
from planners.contract.problems import problems_of
from planners.contract.scan_spec import read_scan
from planners.contract.scene_document import ObjectPart, SceneDocument
from planners.contract.strict_json import NotJson, parse_json
from planners.errors import SceneError
from planners.perception.perceive import perceive
from planners.perception.scan_files import ScanRefused

PERCEIVED = 0


def perceive_files(named: Sequence[str], service: str | None, out: Path | None, preview: Path | None) -> int:
    """Perceive the scan in some files, print what was found, and return the exit code.

    Args:
        named: files or a folder, as `read_scan_files` takes them.
        service: address of the service that is to perceive and keep the scene; None: this machine, keeping nothing.
        out: where the SceneDocument goes.
        preview: where the picture goes.

    Raises:
        KeyNeeded, ServiceAway, ServiceRefused: The service cannot do it, and not because of the scan.
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
    except (ValidationError, SceneError) as error:
        return refuse(problems_of(error), DESCRIPTION_FILE)
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
        raise SceneError("/cell", f"there is no cell {described.cell}", known_cells())
    found = perceive(described, scan.files, load_cell(described.cell))
    return found.document, found.preview, ""


def _post(scan: ScanFiles, client: ServiceClient) -> tuple[SceneDocument, bytes, str]:
    scene = client.post_scene(scan.description, scan.files)
    document = SceneDocument.model_validate_json(json.dumps(scene["scene"]))
    told = f"{'scene_id':<16}{scene['id']}\n{'viewer':<16}{client.address}{scene['links']['view']}\n"
    return document, client.read(scene["links"]["preview"]), told
