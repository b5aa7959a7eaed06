"""`make demo`: starts the service, posts a task over HTTP, follows its job, and says what came of it.

Talks to the service as any client would, with the standard library alone.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import Request, urlopen

from app.progress_bar import ProgressBar
from app.summary import summarise

STARTUP_SECONDS = 900.0
"""The first start compiles the kernels [s]."""
TASK = Path("assets/tasks/ab1.json")


def main() -> int:
    """Run the demo; 0 only if the plan is solved and certified."""
    parser = argparse.ArgumentParser(prog="make demo", description=__doc__)
    parser.add_argument("--once", action="store_true", help="stop after the result")
    parser.add_argument("--task", type=Path, default=TASK, metavar="FILE")
    parser.add_argument(
        "--scan", type=Path, metavar="DIR", help="what cameras saw, with the task of its objects, instead of a task"
    )
    parser.add_argument("--data-dir", type=Path, default=Path("data"), metavar="DIR")
    given = parser.parse_args()
    with _service(given.data_dir) as (service, address):
        posted = _post(address, given.task) if given.scan is None else post_scan(address, given.scan)
        plan = _follow(address, posted)
        certified = _tell(address, plan)
        if not given.once:
            print(f"\nserving on {address} until Ctrl-C")
            _wait_for_interrupt(service)
    return 0 if certified else 1


@contextmanager
def _service(data_dir: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """Run the service on a free port of this machine."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    address = f"http://127.0.0.1:{port}"
    command = [sys.executable, "-m", "app.cli", "serve", "--port", str(port), "--data-dir", str(data_dir)]
    service = subprocess.Popen(command)
    try:
        _wait_until_ready(service, address)
        yield service, address
    finally:
        service.send_signal(signal.SIGTERM)
        service.wait()


def _wait_until_ready(service: subprocess.Popen[bytes], address: str) -> None:
    deadline = time.monotonic() + STARTUP_SECONDS
    while time.monotonic() < deadline:
        if service.poll() is not None:
            sys.exit(f"the service ended with exit code {service.returncode}")
        try:
            with urlopen(f"{address}/readyz"):
                return
        except URLError:
            time.sleep(0.2)
    sys.exit(f"the service was not ready within {STARTUP_SECONDS:g} s")


def _post(address: str, task: Path) -> dict[str, Any]:
    headers = {"Content-Type": "application/json"}
    with urlopen(Request(f"{address}/v1/plans", task.read_bytes(), headers)) as answer:
        plan = json.load(answer)
    print(f"posted {task} to {address}/v1/plans: plan {plan['id']}")
    return plan


def post_scan(address: str, folder: Path) -> dict[str, Any]:
    """Post the scan in a folder, then the task beside it with the scene that the scan became; return the plan."""
    parts = [(path.stem, path.read_bytes()) for path in sorted(folder.iterdir()) if path.stem != "task"]
    boundary = hashlib.sha256(b"".join(content for _, content in parts)).hexdigest()
    form = b"".join(
        f'--{boundary}\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n'.encode() + content + b"\r\n"
        for name, content in parts
    )
    headers = {"Content-Type": f"multipart/form-data; boundary={boundary}"}
    with urlopen(Request(f"{address}/v1/scenes", form + f"--{boundary}--\r\n".encode(), headers)) as answer:
        scene = json.load(answer)
    names = ", ".join(each["name"] for each in scene["scene"]["objects"])
    print(f"posted {folder} to {address}/v1/scenes: {names}; picture: {address}{scene['links']['preview']}")
    task = json.loads((folder / "task.json").read_text()) | {"scene_id": scene["id"]}
    headers = {"Content-Type": "application/json"}
    with urlopen(Request(f"{address}/v1/plans", json.dumps(task).encode(), headers)) as answer:
        plan = json.load(answer)
    print(f"posted the task of the scene to {address}/v1/plans: plan {plan['id']}")
    return plan


def _follow(address: str, plan: dict[str, Any]) -> dict[str, Any]:
    """Show the job's events until it has ended, and return the plan as it is then."""
    with urlopen(address + plan["links"]["events"]) as stream, ProgressBar() as bar:
        for kind, data in _events(stream):
            if kind == "finished":
                bar.show("done", data["progress"]["fraction"])
                return data
            bar.show(data["stage"], data["fraction"])
    sys.exit("the service closed the event stream before the job ended")


def _events(stream: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    kind = ""
    for line in stream:
        name, _, value = line.decode().rstrip("\r\n").partition(": ")
        if name == "event":
            kind = value
        elif name == "data":
            yield kind, json.loads(value)


def _tell(address: str, plan: dict[str, Any]) -> bool:
    """Print the outcome; return whether there is a certified plan."""
    if plan["state"] != "succeeded":
        print(f"the job {plan['state']}: {(plan['error'] or {}).get('detail', '')}")
        return False
    where = address + plan["links"]["document"]
    with urlopen(where) as answer:
        document = json.load(answer)
    viewer = address + plan["links"]["view"]
    print(f"\n{summarise(document)}\n{'document:':<16}{where}\n{'viewer:':<16}{viewer}")
    return document["outcome"] == "solved" and document["certificate"]["passed"]


def _wait_for_interrupt(service: subprocess.Popen[bytes]) -> None:
    try:
        service.wait()
    except KeyboardInterrupt:
        print("stopping")


if __name__ == "__main__":
    sys.exit(main())
