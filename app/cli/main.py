"""The command `liftwright`."""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Never

from pydantic import ValidationError

from app.cli.output import BAD_INPUT, BadInput, said_of
from app.example_tasks import example_tasks
from planners.errors import LiftwrightError
from workers.processor import unset_empty_names

if TYPE_CHECKING:
    from app.cli.cell_command import CellKeeper
    from app.cli.study_command import Axis
    from app.settings import ServiceSettings
    from workers.settings import WorkerSettings

FAILED = 1
READING = ("plan", "study", "scene", "cell", "export", "execute", "replay")
"""Commands that are given files: what cannot be read is bad input."""
SCOPES = ("read", "write", "admin")
EXAMPLES = """\
examples:
  liftwright plan assets/tasks/ab1.json --out plan.json     one task, no server: both arms lift a plate
  liftwright plan assets/tasks/domino_pile.json             a suction tool piles up three dominoes
  liftwright plan assets/tasks/*.json --out plans           all of them, with a line for each
  liftwright study assets/tasks/ab1.json --axis /lifter_model=paper,cable,dexnet    the same task, varied
  liftwright scene assets/scans/tissue_boxes                what cameras saw: the tool, and boxes to be moved
  liftwright cell check mine --png mine.png                 a cell of your own: what is wrong with it, or what it can do
  liftwright export plan.json --target ur                   a plan as programs of the two arms' controllers
  liftwright execute plan.json --left HOST --right HOST     what executing it would be; --run moves the arms
  liftwright serve                                          the service on http://127.0.0.1:8040
  liftwright keys issue --owner mes --scope write           a key, once others are to reach it
  curl -d @assets/tasks/ab1.json -H 'Content-Type: application/json' http://127.0.0.1:8040/v1/plans

Every option of serve, api and worker can also be given as an environment variable, LIFTWRIGHT_PORT=8041.
"""


PLAN_DESCRIPTION = """\
Plan tasks, one after the other; of several each is told in a line.
Exit code 0: solved; 2: no plan, and why; 3: bad input, and where; 1: a fault of ours, or of the service.
Of several tasks it is that of the worst, in this order.
"""
STUDY_DESCRIPTION = """\
Examine a task at many values of one or two of its members, on all cores, and show where it is solved, how much of every
limit is kept back there, and which point is best. Points are searched with the task's own densities and not certified,
unless --certify is given. Exit code 0: a point is solved; 2: none is; 3: bad input, and where.

an axis:
  /cup/position/0=-0.12:0.12:12      a range: 12 values from -0.12 to 0.12, both among them, in the member's own unit
  /lifter_model=paper,cable,dexnet   a list of values; JSON, or words
  /plate_pose@yaw=-1.57:1.57:7       a pose, turned about the vertical through its origin [rad]
The part before = is a JSON pointer into the task (RFC 6901): names and places of items, each after a slash.
docs/task.md lists the members; an item of a list is named by its place from 0, as in /objects/0/pose/1.
"""
STUDY_EXAMPLES = """\
examples:
  liftwright study assets/tasks/ab1.json --axis /cup/position/0=-0.12:0.12:12 --axis /cup/position/1=-0.12:0.12:12
  liftwright study assets/tasks/ab2.json --axis /cup/max_force=10:30:9 --png force.png
  liftwright study assets/tasks/ab1.json --axis /plate_pose@yaw=-1.57:1.57:7 --certify --out map.json
"""


CELL_DESCRIPTION = """\
A cell is two arms with their hands, what they stand on, the table, and what else stands there. Describe your own by a
folder (or a zip of it) with cell.yaml and what belongs to it, or by that one file; docs/cell.md has a whole example.
Exit code 0: done; 3: bad input: every fault, with its file and member.
"""
CELL_EXAMPLES = """\
examples:
  liftwright cell check mine --png mine.png    all that is wrong; else where hands reach, and what they bear
  liftwright cell add mine                     kept in ./data, for the service that runs there
  liftwright cell add mine.zip --service http://127.0.0.1:8040
  liftwright cell list
  liftwright cell show dual_ur3e_lift --png lift.png
  liftwright plan task.json --cell mine        a task in that cell, without keeping it
"""
EXPORT_DESCRIPTION = """\
Write a certified plan as a program. Before that the plan is certified once more from the file, its digest is compared,
and so is the hash of the cell: what was changed in any way since it was planned is not exported, and why is said.
Exit code 0: written; 2: must not be exported, and why; 3: bad input. docs/robot.md leads from here to a moving robot.

targets:
  ur    URScript, left.script and right.script, one for each controller
  ros2  a bag with trajectories, fingers, vacuum, joint states, frames and planning scenes; the cell as URDF and SRDF
  csv   tables of the motion and of the steps, with a page that explains their columns
"""
EXPORT_EXAMPLES = """\
examples:
  liftwright plan assets/tasks/ab1.json --out plan.json && liftwright export plan.json --target ur
  liftwright export plan.json --target ur --handshake digital    the arms wait for each other by wires, no computer
  liftwright export plan.json --target ros2                      for RViz, MoveIt and the controllers of ros2_control
  liftwright export plan.json --target csv --cell mine           a plan for a cell of your own
"""
EXECUTE_DESCRIPTION = """\
Execute a certified plan on two Universal Robots controllers, by RTDE. Without --run nothing moves: the plan is
certified once more, both controllers are asked where their arms are, and all steps are told. With --run each step is
confirmed, both arms are kept in step, and both stop on the path as soon as one deviates, feels too much force, is
stopped by its controller or cannot be reached; so they do on Ctrl-C. Then: go back along the path, go on, or write the
task that is left. This is no safety function; read docs/robot.md first.
Exit code 0: executed, or could be; 2: refused or stopped, and why; 3: bad input.
"""
EXECUTE_EXAMPLES = """\
examples:
  liftwright execute plan.json --left 192.168.1.11 --right 192.168.1.12                      would it begin?
  liftwright execute plan.json --left 192.168.1.11 --right 192.168.1.12 --run --speed 0.1    step by step, slowly
  liftwright execute plan.json --left … --right … --run --without-objects                    first: with no plate
  make demo-robot                                                                            the same without robots
"""
SCENE_DESCRIPTION = """\
Find the suction tool by its markers, and boxes and cylinders by their top facets, in what cameras saw of the table.
Exit code 0: perceived, be it an empty table; 3: a scan that cannot be read or shows no table, and why.

parts of a scan:
  scan    scan.json: what cameras the files come from, and where these were; docs/scene.md
  colour  colour.png or .jpg: a picture of the tool's markers
  depth   depth.png with 16 bits, or depth.npy: distances along the camera's z
  cloud   cloud.ply, .pcd or .npy: points, in place of depth
"""
PLAN_EXAMPLES = """\
examples:
  liftwright plan assets/tasks/ab1.json --out plan.json
  liftwright plan mine.yaml other.json --out plans                 documents plans/mine.json and plans/other.json
  liftwright plan mine.json --apply 1                              no plan? writes mine.remedy-1.json, which has one
  ./make_task | liftwright plan - --service http://127.0.0.1:8040  standard input, planned by a service
"""
SCENE_EXAMPLES = """\
examples:
  liftwright scene assets/scans/tissue_boxes --preview seen.png --out scene.json
  liftwright plan assets/scans/tissue_boxes/task.json --scene scene.json      a task with the objects of that scene
  liftwright scene scan=mine.json depth=frame_0017.npy                        files of any name
  liftwright scene assets/scans/tissue_boxes --service http://127.0.0.1:8040  kept there; prints its scene_id
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code."""
    unset_empty_names()
    parsed = _parsed(arguments)
    try:
        return parsed.run(parsed)
    except LiftwrightError as error:
        print(f"liftwright: {error}", file=sys.stderr)
        return BAD_INPUT if isinstance(error, BadInput) else FAILED
    except OSError as error:
        print(f"liftwright: {said_of(error)}", file=sys.stderr)
        return BAD_INPUT if parsed.command in READING else FAILED
    except ValidationError as error:
        for fault in error.errors():
            print(
                f"liftwright: --{'-'.join(map(str, fault['loc']))}: {fault['msg']}".replace("_", "-"), file=sys.stderr
            )
        return BAD_INPUT
    except KeyboardInterrupt:
        return 130


class _Parser(argparse.ArgumentParser):
    """Ends with the exit code of bad input where a command is not one: argparse's own says that there is no plan."""

    def error(self, message: str) -> Never:
        self.print_usage(sys.stderr)
        self.exit(BAD_INPUT, f"{self.prog}: {message}\n")


def _parsed(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return what was asked for; what is no option of a command is said with that command's usage."""
    parser = _parser()
    parsed, unknown = parser.parse_known_args(arguments)
    if unknown:
        parsed.parser.error(f"there is no option {' '.join(unknown)}; --help lists them")
    return parsed


def _number_from_1(text: str) -> int:
    if not re.fullmatch(r"0*[1-9][0-9]{0,8}", text):
        raise argparse.ArgumentTypeError(f"must be a whole number from 1 on, not {text}")
    return int(text)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="liftwright",
        description="Plans how a dual-arm robot lifts heavy plates together with a vacuum lifter, and how it moves "
        "objects with a suction tool that its hands take up and pass on.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"liftwright {version('liftwright')}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="command")

    _add_plan(
        commands.add_parser(
            "plan",
            help="plan tasks, without a server or by one",
            description=PLAN_DESCRIPTION,
            epilog=_plan_epilog(),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
    )
    _add_study(
        commands.add_parser(
            "study",
            help="where may the cup sit: examine a task at many values of up to two of its members",
            description=STUDY_DESCRIPTION,
            epilog=STUDY_EXAMPLES,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
    )
    _add_scene(
        commands.add_parser(
            "scene",
            help="find the tool and the objects in what cameras saw, without a server or by one",
            description=SCENE_DESCRIPTION,
            epilog=SCENE_EXAMPLES,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
    )

    _add_cell(
        commands.add_parser(
            "cell",
            help="a cell of your own: check it, see what it can do, keep it for tasks",
            description=CELL_DESCRIPTION,
            epilog=CELL_EXAMPLES,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
    )

    _add_export(
        commands.add_parser(
            "export",
            help="a certified plan as a program for the robot's controllers",
            description=EXPORT_DESCRIPTION,
            epilog=EXPORT_EXAMPLES,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
    )

    _add_execute(
        commands.add_parser(
            "execute",
            help="a certified plan on two controllers, under your eyes; a look at what it would be without --run",
            description=EXECUTE_DESCRIPTION,
            epilog=EXECUTE_EXAMPLES,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
    )

    replay = commands.add_parser(
        "replay",
        help="a page that plays an execution beside its plan",
        description="Write a page that plays a plan, and what `liftwright execute` logged of it, without any server.",
    )
    replay.add_argument("plan", type=Path, metavar="PLAN", help="the plan document that was executed")
    replay.add_argument("log", type=Path, metavar="LOG", help="the log of the execution")
    replay.add_argument("--cell", type=Path, metavar="PATH", help="the cell, unless it is shipped")
    replay.add_argument("--out", type=Path, metavar="FILE", help="where the page goes; default: beside the log")
    replay.set_defaults(run=_replay)

    one = commands.add_parser("serve", help="the service with a worker in the same process")
    _add_listening(one)
    _add_storage(one)
    one.set_defaults(run=lambda parsed: _serve(parsed, with_worker=True))

    api = commands.add_parser("api", help="the service alone; workers run elsewhere on the same database")
    _add_listening(api)
    _add_storage(api)
    api.set_defaults(run=lambda parsed: _serve(parsed, with_worker=False))

    worker = commands.add_parser("worker", help="a worker alone")
    worker.add_argument("--worker-name", metavar="NAME", help="unique and stable; default: the host's name")
    _add_storage(worker)
    worker.set_defaults(run=_work)

    _add_keys(commands.add_parser("keys", help="issue, list and revoke the keys that the service asks for"))

    check = commands.add_parser(
        "check-worker",
        help="exit code 0 if a worker of this name is alive and can prove it",
        description="For a container's health check: asks the database, not the process, unless --alive is given.",
    )
    check.add_argument("--worker-name", metavar="NAME", help="default: the host's name")
    check.add_argument(
        "--alive",
        action="store_true",
        help="ask the process alone, on its own machine: for what ends a worker that does not get on; one that waits "
        "for its database does",
    )
    _add_storage(check)
    check.set_defaults(run=_check_worker)

    warm = commands.add_parser("warmup", help="compile the kernels now instead of at the first start")
    warm.set_defaults(run=_warm_up)
    for command in commands.choices.values():
        command.set_defaults(parser=command)
    return parser


def _add_plan(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "files",
        nargs="+",
        metavar="FILE",
        help="a task as JSON, or as YAML in a file named *.yaml; -: standard input; assets/tasks has examples",
    )
    command.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="where the plan document goes; of several tasks a folder, with NAME.json for each; without it, nowhere",
    )
    command.add_argument(
        "--check",
        action="store_true",
        help="plan nothing: say what is wrong with the tasks, in a second or two; without --service, --apply, --out",
    )
    command.add_argument(
        "--apply",
        type=_number_from_1,
        metavar="N",
        help="if there is no plan, write the task with the N-th change that helps beside it, as NAME.remedy-N.json",
    )
    where = command.add_mutually_exclusive_group()
    where.add_argument(
        "--scene",
        type=Path,
        metavar="FILE",
        help="the task's objects are those of this scene, which `liftwright scene --out FILE` wrote",
    )
    _add_service(where, "plans it; needed for a task with the `scene_id` of a scene that it keeps")
    command.add_argument(
        "--cell",
        type=Path,
        metavar="PATH",
        help="a cell of your own, a folder, zip or file: tasks that name it, or name none, are planned in it",
    )
    command.add_argument(
        "--data-dir",
        type=Path,
        metavar="DIR",
        help="where handovers are kept, as `serve` and `worker` keep them; default LIFTWRIGHT_DATA_DIR, else ./data if "
        "there is one; without, they are computed anew each time, in some seconds",
    )
    command.set_defaults(run=_plan)


def _add_study(command: argparse.ArgumentParser) -> None:
    command.add_argument("file", type=Path, metavar="FILE", help="a task, as of `liftwright plan`")
    command.add_argument(
        "--axis",
        action="append",
        required=True,
        type=_axis,
        metavar="/POINTER=VALUES",
        help="what is varied; once or twice: the first goes to the right in the map, the second upwards",
    )
    command.add_argument("--certify", action="store_true", help="plan and certify every point; several times as long")
    command.add_argument("--out", type=Path, metavar="FILE", help="where the map goes, as JSON")
    command.add_argument("--png", type=Path, metavar="FILE", help="where a picture of the map goes")
    where = command.add_mutually_exclusive_group()
    _add_service(where, "examines it, and plans the best point")
    where.add_argument(
        "--processes",
        type=_number_from_1,
        metavar="N",
        help="so many points at the same time; default: all cores",
    )
    command.add_argument(
        "--data-dir", type=Path, metavar="DIR", help="where handovers are kept; as for `liftwright plan`"
    )
    command.set_defaults(run=_study)


def _axis(text: str) -> Axis:
    from app.cli.study_command import read_axis

    try:
        return read_axis(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _add_scene(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "files", nargs="+", metavar="FILE", help="a folder, files named like their parts, or PART=FILE"
    )
    command.add_argument("--out", type=Path, metavar="FILE", help="where the scene goes, as JSON")
    command.add_argument(
        "--preview", type=Path, metavar="FILE", help="where a PNG picture with all that was found goes"
    )
    _add_service(command, "perceives and keeps it, so that tasks can name its `scene_id`")
    command.set_defaults(run=_scene)


def _add_cell(command: argparse.ArgumentParser) -> None:
    actions = command.add_subparsers(dest="action", required=True, metavar="action")
    check = actions.add_parser("check", help="say everything that is wrong with it, or what it can do; keep nothing")
    check.add_argument("path", type=Path, metavar="PATH", help="a folder, a zip, or one YAML or JSON file")
    check.add_argument("--png", type=Path, metavar="FILE", help="where maps of its table go")
    check.set_defaults(run=_check_cell)
    add = actions.add_parser("add", help="keep it, as the next version of its name")
    add.add_argument("path", type=Path, metavar="PATH", help="a folder, a zip, or one YAML or JSON file")
    listing = actions.add_parser("list", help="the shipped cells, and those that are kept")
    show = actions.add_parser("show", help="what it can do")
    show.add_argument("name", metavar="NAME", help="its name or id")
    show.add_argument("--png", type=Path, metavar="FILE", help="where maps of its table go")
    show.add_argument("--out", type=Path, metavar="FILE", help="where a zip of its files goes, unless it is shipped")
    delete = actions.add_parser("delete", help="have it for no more tasks; plans that are in it keep it")
    delete.add_argument("name", metavar="NAME", help="its name or id")
    for action, run in ((add, _add_own_cell), (listing, _list_cells), (show, _show_cell), (delete, _delete_cell)):
        _add_service(action, "keeps cells, not this machine")
        _add_storage(action)
        action.set_defaults(run=run)


def _add_export(command: argparse.ArgumentParser) -> None:
    command.add_argument("plan", type=Path, metavar="PLAN", help="a plan document, as `liftwright plan --out` wrote it")
    command.add_argument("--target", required=True, choices=("csv", "ros2", "ur"), help="what it becomes, see above")
    command.add_argument(
        "--handshake",
        choices=("registers", "digital"),
        default="registers",
        help="of ur: how the two controllers wait for each other before every step; registers are passed on by a "
        "computer, which confirms steps and without which nothing moves; digital needs a crossed pair of wires",
    )
    command.add_argument(
        "--cell", type=Path, metavar="PATH", help="the cell that is there, unless it is shipped: a folder, zip or file"
    )
    command.add_argument("--out", type=Path, metavar="FILE", help="where the zip goes; default: beside the plan")
    command.set_defaults(run=_export)


def _add_execute(command: argparse.ArgumentParser) -> None:
    command.add_argument("plan", type=Path, metavar="PLAN", help="a plan document, as `liftwright plan --out` wrote it")
    for arm in ("left", "right"):
        command.add_argument(f"--{arm}", required=True, metavar="HOST", help=f"address of the {arm} arm's controller")
    command.add_argument("--run", dest="moves", action="store_true", help="move the arms; without it, only look")
    command.add_argument("--continuous", action="store_true", help="do not ask before each step")
    command.add_argument(
        "--without-objects",
        action="store_true",
        help="the plate, or what a pile is made of, is not there: hands press on nothing, and no lift follows",
    )
    command.add_argument(
        "--speed",
        type=_speed,
        default=0.1,
        metavar="SHARE",
        help="of the planned speed, of both arms; steps in which a stop from it may lose what is carried are slower, "
        "as far as they must be; default: 0.1",
    )
    command.add_argument(
        "--stops-may-drop",
        action="store_true",
        help="execute such steps at --speed, too: a stop may lose what is carried",
    )
    command.add_argument(
        "--cell", type=Path, metavar="PATH", help="the cell that is there, unless it is shipped: a folder, zip or file"
    )
    command.add_argument(
        "--functions",
        type=Path,
        metavar="FILE",
        help="URScript of site_fingers and site_vacuum for what is mounted; default: as they are exported",
    )
    command.add_argument(
        "--log",
        type=Path,
        metavar="FILE",
        help="what happens, as JSON lines; default: beside the plan, named by the time",
    )
    command.set_defaults(run=_execute)


def _speed(given: str) -> float:
    return _number_up_to(1.0, given)


def _days(given: str) -> float:
    return _number_up_to(36500.0, given)


def _number_up_to(most: float, given: str) -> float:
    try:
        number = float(given)
    except ValueError:
        number = math.nan
    if not 0.0 < number <= most:
        raise argparse.ArgumentTypeError(f"must be a number above 0 and at most {most:g}, not {given}")
    return number


def _add_service(command: argparse.ArgumentParser | argparse._MutuallyExclusiveGroup, what: str) -> None:
    command.add_argument(
        "--service",
        metavar="URL",
        help=f"the service at this address {what}; a key, where it asks "
        "for one, is taken from the environment variable LIFTWRIGHT_KEY",
    )


def _plan_epilog() -> str:
    examples = "\n".join(f"  {kind:<13} {', '.join(names)}" for kind, names in example_tasks().items())
    return f"{PLAN_EXAMPLES}\nkinds of tasks, and examples of each, files assets/tasks/NAME.json:\n{examples}\n"


def _add_keys(command: argparse.ArgumentParser) -> None:
    actions = command.add_subparsers(dest="action", required=True, metavar="action")
    issue = actions.add_parser("issue", help="make a key; it is printed once and stored nowhere")
    issue.add_argument("--owner", required=True, type=_owner, metavar="NAME", help="to whom belongs what it makes")
    issue.add_argument("--scope", choices=SCOPES, default="write", help="each allows all before it; default write")
    issue.add_argument("--days", type=_days, metavar="N", help="how long it is good; default: until it is revoked")
    _add_storage(issue)
    issue.set_defaults(run=_issue_key)
    listing = actions.add_parser("list", help="show all keys, without their secrets")
    _add_storage(listing)
    listing.set_defaults(run=_list_keys)
    revoke = actions.add_parser("revoke", help="make a key worthless")
    revoke.add_argument("key_id", metavar="ID", help="as `list` shows it")
    _add_storage(revoke)
    revoke.set_defaults(run=_revoke_key)


def _owner(text: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_.-]{1,64}", text):
        raise argparse.ArgumentTypeError("1 to 64 letters, digits, dots, dashes or underscores")
    return text


def _add_listening(command: argparse.ArgumentParser) -> None:
    command.add_argument("--host", help="address to listen on; default 127.0.0.1; another needs keys")
    command.add_argument("--port", type=int, help="default 8040; 0: any free one")
    command.add_argument("--api-processes", type=int, metavar="N", help="that answer requests there; default 1")


def _add_storage(command: argparse.ArgumentParser) -> None:
    command.add_argument("--data-dir", type=Path, metavar="DIR", help="where plans are kept; default ./data")
    command.add_argument("--database-url", metavar="URL", help="postgresql://…; default: SQLite in the data directory")


def _options(parsed: argparse.Namespace) -> dict[str, Any]:
    names = ("host", "port", "api_processes", "data_dir", "database_url", "worker_name")
    return {name: value for name in names if (value := getattr(parsed, name, None)) is not None}


# Each command loads what it needs when it runs: the planners take a second, which neither `--help` has a use for nor a
# task that is refused.


def _service_settings(parsed: argparse.Namespace) -> ServiceSettings:
    from app.settings import ServiceSettings

    return ServiceSettings(**_options(parsed))


def _worker_settings(parsed: argparse.Namespace) -> WorkerSettings:
    from workers.settings import WorkerSettings

    return WorkerSettings(**_options(parsed))


def _plan(parsed: argparse.Namespace) -> int:
    from workers.loading import loading

    with loading():
        from app.cli.plan_command import TaskPlanner, plan_files

    def here() -> TaskPlanner:
        with loading():
            from app.cli.local_planner import LocalPlanner

        return LocalPlanner(_worker_settings(parsed), parsed.scene, parsed.cell)

    def by_service() -> TaskPlanner:
        from app.cli.service_client import ServicePlanner

        return ServicePlanner(parsed.service)

    # A scene may complete the tasks, and a service may be of a newer version, which knows tasks that this one does not.
    check = parsed.scene is None and parsed.service is None and parsed.cell is None
    planner = here if parsed.service is None else by_service
    if parsed.check and not (parsed.service is None and parsed.apply is None and parsed.out is None):
        parsed.parser.error("--check plans nothing: it goes without --service, --apply and --out")
    return plan_files(parsed.files, parsed.out, planner, check=check, apply=parsed.apply, plans=not parsed.check)


def _export(parsed: argparse.Namespace) -> int:
    from app.cli.export_command import export_file
    from planners.program import ProgramTarget
    from planners.program.urscript import Handshake

    return export_file(parsed.plan, ProgramTarget(parsed.target), Handshake(parsed.handshake), parsed.cell, parsed.out)


def _execute(parsed: argparse.Namespace) -> int:
    from app.cli.execute_command import ExecuteRequest, execute_file

    return execute_file(
        ExecuteRequest(
            plan=parsed.plan,
            hosts={"left": parsed.left, "right": parsed.right},
            site=parsed.cell,
            moves=parsed.moves,
            continuous=parsed.continuous,
            speed=parsed.speed,
            stops_may_drop=parsed.stops_may_drop,
            # None of an earlier run is lost.
            log=parsed.log or parsed.plan.with_suffix(f".{datetime.now():%Y%m%d-%H%M%S}.log.jsonl"),
            functions=parsed.functions,
            without_objects=parsed.without_objects,
        )
    )


def _replay(parsed: argparse.Namespace) -> int:
    from app.cli.replay_command import replay_files

    return replay_files(parsed.plan, parsed.log, parsed.cell, parsed.out)


def _check_cell(parsed: argparse.Namespace) -> int:
    from app.cli.cell_command import check_cell_files

    return check_cell_files(parsed.path, parsed.png)


def _add_own_cell(parsed: argparse.Namespace) -> int:
    from app.cli.cell_command import add_cell

    with _cell_keeper(parsed) as keeper:
        return add_cell(parsed.path, keeper)


def _list_cells(parsed: argparse.Namespace) -> int:
    from app.cli.cell_command import list_cells

    with _cell_keeper(parsed) as keeper:
        return list_cells(keeper)


def _show_cell(parsed: argparse.Namespace) -> int:
    from app.cli.cell_command import refuse_file_as_name, show_cell

    refuse_file_as_name(parsed.name)
    with _cell_keeper(parsed) as keeper:
        return show_cell(parsed.name, keeper, parsed.png, parsed.out)


def _delete_cell(parsed: argparse.Namespace) -> int:
    from app.cli.cell_command import refuse_file_as_name

    refuse_file_as_name(parsed.name)
    with _cell_keeper(parsed) as keeper:
        keeper.delete(parsed.name)
    return 0


def _cell_keeper(parsed: argparse.Namespace) -> AbstractContextManager[CellKeeper]:
    from app.cli.cell_command import ServiceCells, local_cells

    if parsed.service is not None:
        return nullcontext(ServiceCells(parsed.service))
    return local_cells(_worker_settings(parsed))


def _study(parsed: argparse.Namespace) -> int:
    from app.cli.study_command import post_study, study_file

    outputs = parsed.out, parsed.png
    if parsed.service is not None:
        return post_study(parsed.file, parsed.axis, outputs, parsed.service, certify=parsed.certify)
    settings = _worker_settings(parsed)
    return study_file(parsed.file, parsed.axis, outputs, settings, certify=parsed.certify, processes=parsed.processes)


def _scene(parsed: argparse.Namespace) -> int:
    from app.cli.scene_command import perceive_files

    return perceive_files(parsed.files, parsed.service, parsed.out, parsed.preview)


def _serve(parsed: argparse.Namespace, *, with_worker: bool) -> int:
    from workers.loading import loading

    with loading():
        from app.serve import serve

    serve(_service_settings(parsed), with_worker=with_worker)
    return 0


def _work(parsed: argparse.Namespace) -> int:
    from app.serve import work

    work(_service_settings(parsed))
    return 0


def _issue_key(parsed: argparse.Namespace) -> int:
    from app.access.caller import Scope
    from app.cli.keys_command import issue_key

    print(issue_key(_worker_settings(parsed), parsed.owner, Scope(parsed.scope), parsed.days))
    print("liftwright: keep it, it cannot be shown again; a service that runs without keys: restart", file=sys.stderr)
    return 0


def _list_keys(parsed: argparse.Namespace) -> int:
    from app.cli.keys_command import list_keys

    print(list_keys(_worker_settings(parsed)))
    return 0


def _revoke_key(parsed: argparse.Namespace) -> int:
    from app.cli.keys_command import revoke_key

    revoke_key(_worker_settings(parsed), parsed.key_id)
    return 0


def _check_worker(parsed: argparse.Namespace) -> int:
    settings = _service_settings(parsed)
    if parsed.alive and not settings.embedded:
        from workers.engine.sign_of_life import shows_life

        return 0 if shows_life(settings) else FAILED
    from workers.engine.executor_lock import worker_lives

    return 0 if worker_lives(settings) else FAILED


def _warm_up(parsed: argparse.Namespace) -> int:
    from app.logs import set_up_logs
    from workers.solver.warm_up import warm_up

    set_up_logs()
    warm_up(_service_settings(parsed))
    return 0


if __name__ == "__main__":
    sys.exit(main())
