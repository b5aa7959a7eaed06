"""The command `liftwright`."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from app.cli.output import BAD_INPUT, BadInput
from app.example_tasks import example_tasks
from app.settings import ServiceSettings
from planners.errors import LiftwrightError
from workers.settings import WorkerSettings

FAILED = 1
SCOPES = ("read", "write", "admin")
EXAMPLES = """\
examples:
  liftwright plan assets/tasks/ab1.json --out plan.json     one task, no server: both arms lift a plate
  liftwright plan assets/tasks/domino_pile.json             a suction tool piles up three dominoes
  liftwright scene assets/scans/tissue_boxes                what cameras saw: the tool, and boxes to be moved
  liftwright serve                                          the service on http://127.0.0.1:8040
  liftwright keys issue --owner mes --scope write           a key, once others are to reach it
  curl -d @assets/tasks/ab1.json -H 'Content-Type: application/json' http://127.0.0.1:8040/v1/plans

Every option of serve, api and worker can also be given as an environment variable, LIFTWRIGHT_PORT=8041.
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
SCENE_EXAMPLES = """\
examples:
  liftwright scene assets/scans/tissue_boxes --preview seen.png --out scene.json
  liftwright plan assets/scans/tissue_boxes/task.json --scene scene.json      a task with the objects of that scene
  liftwright scene scan=mine.json depth=frame_0017.npy                        files of any name
  liftwright scene assets/scans/tissue_boxes --service http://127.0.0.1:8040  kept there; prints its scene_id
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code."""
    parsed = _parser().parse_args(arguments)
    try:
        return parsed.run(parsed)
    except LiftwrightError as error:
        print(f"liftwright: {error}", file=sys.stderr)
        return BAD_INPUT if isinstance(error, BadInput) else FAILED
    except OSError as error:
        print(f"liftwright: {error}", file=sys.stderr)
        return BAD_INPUT if parsed.command in ("plan", "scene") else FAILED
    except ValidationError as error:
        for fault in error.errors():
            print(
                f"liftwright: --{'-'.join(map(str, fault['loc']))}: {fault['msg']}".replace("_", "-"), file=sys.stderr
            )
        return BAD_INPUT
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
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
            help="plan one task, without a server or by one",
            description="Plan one task. Exit code 0: solved; 2: no plan, and why; 3: bad input, and where.",
            epilog=_plan_epilog(),
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
        description="For a container's health check: asks the database, not the process.",
    )
    check.add_argument("--worker-name", metavar="NAME", help="default: the host's name")
    _add_storage(check)
    check.set_defaults(run=_check_worker)

    warm = commands.add_parser("warmup", help="compile the kernels now instead of at the first start")
    warm.set_defaults(run=_warm_up)
    return parser


def _add_plan(command: argparse.ArgumentParser) -> None:
    command.add_argument("file", type=Path, metavar="FILE", help="a task as JSON; assets/tasks has examples")
    command.add_argument("--out", type=Path, metavar="FILE", help="where the plan document goes; without it, nowhere")
    where = command.add_mutually_exclusive_group()
    where.add_argument(
        "--scene",
        type=Path,
        metavar="FILE",
        help="the task's objects are those of this scene, which `liftwright scene --out FILE` wrote",
    )
    _add_service(where, "plans it; needed for a task with the `scene_id` of a scene that it keeps")
    command.add_argument(
        "--data-dir",
        type=Path,
        metavar="DIR",
        help="where handovers are kept, as `serve` and `worker` keep them; default LIFTWRIGHT_DATA_DIR, else ./data if "
        "there is one; without, they are computed anew each time, in some seconds",
    )
    command.set_defaults(run=_plan)


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


def _add_service(command: argparse.ArgumentParser | argparse._MutuallyExclusiveGroup, what: str) -> None:
    command.add_argument(
        "--service",
        metavar="URL",
        help=f"the service at this address {what}; a key, where it asks "
        "for one, is taken from the environment variable LIFTWRIGHT_KEY",
    )


def _plan_epilog() -> str:
    examples = "\n".join(f"  {kind:<13} {', '.join(names)}" for kind, names in example_tasks().items())
    return f"kinds of tasks, and examples of each, files assets/tasks/NAME.json:\n{examples}\n"


def _add_keys(command: argparse.ArgumentParser) -> None:
    actions = command.add_subparsers(dest="action", required=True, metavar="action")
    issue = actions.add_parser("issue", help="make a key; it is printed once and stored nowhere")
    issue.add_argument("--owner", required=True, type=_owner, metavar="NAME", help="to whom belongs what it makes")
    issue.add_argument("--scope", choices=SCOPES, default="write", help="each allows all before it; default write")
    issue.add_argument("--days", type=float, metavar="N", help="how long it is good; default: until it is revoked")
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


def _add_storage(command: argparse.ArgumentParser) -> None:
    command.add_argument("--data-dir", type=Path, metavar="DIR", help="where plans are kept; default ./data")
    command.add_argument("--database-url", metavar="URL", help="postgresql://…; default: SQLite in the data directory")


def _options(parsed: argparse.Namespace) -> dict[str, Any]:
    names = ("host", "port", "data_dir", "database_url", "worker_name")
    return {name: value for name in names if (value := getattr(parsed, name, None)) is not None}


# Each command loads what it needs when it runs: the planners take a second, which `--help` has no use for.


def _plan(parsed: argparse.Namespace) -> int:
    from app.cli.plan_command import plan_file, post_file

    if parsed.service is not None:
        return post_file(parsed.file, parsed.out, parsed.service)
    return plan_file(parsed.file, parsed.out, ServiceSettings(**_options(parsed)), parsed.scene)


def _scene(parsed: argparse.Namespace) -> int:
    from app.cli.scene_command import perceive_files

    return perceive_files(parsed.files, parsed.service, parsed.out, parsed.preview)


def _serve(parsed: argparse.Namespace, *, with_worker: bool) -> int:
    from app.serve import serve

    serve(ServiceSettings(**_options(parsed)), with_worker=with_worker)
    return 0


def _work(parsed: argparse.Namespace) -> int:
    from app.serve import work

    work(ServiceSettings(**_options(parsed)))
    return 0


def _issue_key(parsed: argparse.Namespace) -> int:
    from app.access.caller import Scope
    from app.cli.keys_command import issue_key

    print(issue_key(WorkerSettings(**_options(parsed)), parsed.owner, Scope(parsed.scope), parsed.days))
    print("liftwright: keep it, it cannot be shown again; a service that runs without keys: restart", file=sys.stderr)
    return 0


def _list_keys(parsed: argparse.Namespace) -> int:
    from app.cli.keys_command import list_keys

    print(list_keys(WorkerSettings(**_options(parsed))))
    return 0


def _revoke_key(parsed: argparse.Namespace) -> int:
    from app.cli.keys_command import revoke_key

    revoke_key(WorkerSettings(**_options(parsed)), parsed.key_id)
    return 0


def _check_worker(parsed: argparse.Namespace) -> int:
    from workers.engine.executor_lock import worker_lives

    return 0 if worker_lives(ServiceSettings(**_options(parsed))) else FAILED


def _warm_up(_: argparse.Namespace) -> int:
    from app.logs import set_up_logs
    from workers.solver.warm_up import warm_up

    set_up_logs()
    warm_up(ServiceSettings())
    return 0


if __name__ == "__main__":
    sys.exit(main())
