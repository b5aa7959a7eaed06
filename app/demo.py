"""`make demo`: starts the service, has a lift planned over HTTP, then what cameras saw perceived and piled up."""

from __future__ import annotations

import argparse
import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import httpx

from app.cli.scene_command import read_scan_files
from app.cli.service_client import JobWithoutDocument, PlanJob, ServiceClient
from app.summary import is_certified, summarise

STARTUP_SECONDS = 900.0
"""The first start compiles the kernels [s]."""
TASK = Path("assets/tasks/ab1.json")
SCAN = Path("assets/scans/tissue_boxes")
LOG = "service.log"
"""File of the data directory that the service logs to."""
SCANS_TASK = "task.json"
"""File beside a scan that says what is to become of its objects."""


def main() -> int:
    """Run the demo; 0 only if every plan is solved and certified."""
    parser = argparse.ArgumentParser(prog="make demo", description=__doc__)
    parser.add_argument("--once", action="store_true", help="stop after the results")
    parser.add_argument("--task", type=Path, metavar="FILE", help="plan this task alone")
    parser.add_argument("--scan", type=Path, metavar="DIR", help="plan the task of the objects in this scan alone")
    parser.add_argument("--data-dir", type=Path, default=Path("data"), metavar="DIR")
    parsed = parser.parse_args()
    alone = parsed.task is not None or parsed.scan is not None
    with _service(parsed.data_dir) as (service, address):
        client, certified = ServiceClient(address), []
        if parsed.task is not None or not alone:
            certified.append(show_task(client, parsed.task or TASK))
        if parsed.scan is not None or not alone:
            certified.append(show_scan(client, parsed.scan or SCAN))
        if not parsed.once:
            print(f"\nserving on {address} until Ctrl-C")
            _wait_for_interrupt(service)
    return 0 if all(certified) else 1


def show_task(client: ServiceClient, path: Path) -> bool:
    """Have a task planned, and tell of it; return whether there is a certified plan."""
    print(f"\n--- {path}\n", flush=True)
    return _tell(client, client.follow(_post(client, path.read_bytes())))


def show_scan(client: ServiceClient, folder: Path) -> bool:
    """Have a scan perceived, and the task beside it planned; tell of both; return whether there is a certified plan."""
    print(f"\n--- {folder}\n", flush=True)
    return _tell(client, client.follow(post_scan(client, folder)))


def post_scan(client: ServiceClient, folder: Path) -> PlanJob:
    """Post a scan, tell what was perceived, post the task beside it with that scene, and return the plan."""
    scan = read_scan_files([str(folder)])
    scene = client.post_scene(scan.description, scan.files)
    seen = scene.scene
    found = [f"{each.name} ({each.shape.type})" for each in seen.objects]
    tool = [f"the tool {seen.tool.name}"] if seen.tool is not None else []
    _tell_line("perceived", ", ".join([*found, *tool]))
    _tell_line("picture", client.address + scene.links.preview)
    _tell_line("viewer", client.address + scene.links.view)
    task = json.loads((folder / SCANS_TASK).read_text()) | {"scene_id": scene.id}
    return _post(client, json.dumps(task).encode())


def _post(client: ServiceClient, task: bytes) -> PlanJob:
    plan = client.post_task(task)
    _tell_line("posted", f"{client.address}{plan.links.self}")
    return plan


def _tell(client: ServiceClient, job: PlanJob) -> bool:
    """Print the outcome; return whether there is a certified plan."""
    if job.state != "succeeded":
        print(JobWithoutDocument(job))
        return False
    plan = client.plan(job.links.document)
    print(summarise(plan))
    _tell_line("document", client.address + job.links.document)
    _tell_line("viewer", client.address + job.links.view)
    return is_certified(plan)


def _tell_line(name: str, text: str) -> None:
    print(f"{name + ':':<16}{text}", flush=True)


@contextmanager
def _service(data_dir: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """Run the service on a free port of this machine."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    address = f"http://127.0.0.1:{port}"
    command = [sys.executable, "-m", "app.cli.main", "serve", "--port", str(port), "--data-dir", str(data_dir)]
    data_dir.mkdir(parents=True, exist_ok=True)
    log = data_dir / LOG
    _tell_line("service", f"{address}, which logs to {log}")
    # Not onto the screen, where it would break the progress of what is planned.
    with log.open("wb") as stream:
        service = subprocess.Popen(command, stderr=stream)
    try:
        _wait_until_ready(service, address, log)
        yield service, address
    finally:
        service.send_signal(signal.SIGTERM)
        service.wait()


def _wait_until_ready(service: subprocess.Popen[bytes], address: str, log: Path) -> None:
    """Wait, and print what is waited for whenever that changes."""
    deadline, told = time.monotonic() + STARTUP_SECONDS, ""
    with httpx.Client(base_url=address) as client:
        while time.monotonic() < deadline:
            if service.poll() is not None:
                sys.stderr.write(log.read_text(errors="replace"))
                sys.exit(f"the service ended with exit code {service.returncode}")
            with suppress(httpx.TransportError):
                answer = client.get("/readyz")
                if answer.is_success:
                    return
                if (detail := answer.json()["detail"]) != told:
                    _tell_line("waiting", told := detail)
            time.sleep(0.2)
    sys.exit(f"the service was not ready within {STARTUP_SECONDS:g} s; its log is {log}")


def _wait_for_interrupt(service: subprocess.Popen[bytes]) -> None:
    try:
        service.wait()
    except KeyboardInterrupt:
        print("stopping")


if __name__ == "__main__":
    sys.exit(main())
