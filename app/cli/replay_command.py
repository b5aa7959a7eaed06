"""`liftwright replay PLAN LOG`: a page that plays a plan and what two arms made of it, side by side in time."""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from pydantic import ValidationError

from app.cli.export_command import site_cell
from app.cli.given_file import FileKind, read_given, refuse_other
from app.cli.output import BadInput
from app.viewer.drawing.link_meshes import LinkMeshes
from app.viewer.playback import Playback
from app.viewer.scene_servers import recording_of
from planners.contract.strict_json import NotJson, parse_json
from planners.plan.plan import Plan
from workers.robot.execution_log import ExecutedMotion, NotALog


def replay_files(path: Path, log: Path, site: Path | None, out: Path | None) -> int:
    """Write a page that plays an execution beside its plan and return the exit code.

    Args:
        path: of the plan document.
        log: of `liftwright execute`.
        site: folder, zip or file of the cell that is there; None: the plan's cell is a shipped one.
        out: where the page goes; None: beside the log.

    Raises:
        BadInput: A file cannot be made sense of, or the log is of another plan.
        OSError: A file cannot be read or written.
    """
    document = read_given(str(path), FileKind.PLAN)
    try:
        plan, executed = Plan.read(document), ExecutedMotion.read(log)
    except NotJson as error:
        raise BadInput(f"{path} is not a plan document") from error
    except ValidationError as error:
        refuse_other(parse_json(document), str(path), FileKind.PLAN)
        raise BadInput(f"{path} is not a plan document") from error
    except NotALog as error:
        raise BadInput(str(error)) from error
    if executed.digest != plan.digest:
        raise BadInput(f"{log} is of the execution of another plan than {path}")
    place = out or log.with_suffix(".html")
    with site_cell(document, path, site) as cell, TemporaryDirectory(prefix="liftwright-drawings-") as drawings:
        page = recording_of(Playback(plan, executed), cell, LinkMeshes(Path(drawings)))
    place.write_text(page, encoding="utf-8")
    sys.stdout.write(f"{place}: {executed.ending}, {executed.time[-1]:.1f} s; open it in a browser\n")
    return 0
