"""A client of the service for commands and the demo: what any client would do."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http import HTTPStatus
from types import TracebackType
from typing import Any, Self
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

from planners.errors import LiftwrightError

KEY_VARIABLE = "LIFTWRIGHT_KEY"
"""Environment variable with the key that a service asks for: not an argument, which others on the machine can see."""


class ProgressBar:
    """Shows one job; nothing but its end is left on a screen that is no terminal."""

    def __init__(self) -> None:
        columns = (TextColumn("{task.description:<12}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
        self._bar = Progress(*columns, console=Console(stderr=True))
        self._job = self._bar.add_task("waiting", total=1.0)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def show(self, stage: str, fraction: float) -> None:
        """Show the stage and how much of the whole is done, 0 … 1."""
        self._bar.update(self._job, description=stage, completed=fraction)

    def say(self, sentence: str) -> None:
        """Print a line over the bar, on any screen."""
        self._bar.console.print(sentence, markup=False, highlight=False, soft_wrap=True)


class ServiceRefused(LiftwrightError):
    """The service answered with a problem."""

    def __init__(self, status: int, problem: Mapping[str, Any]) -> None:
        self.status = status
        detail = problem.get("detail") or problem.get("title") or "no reason given"
        self.problems = problem.get("errors") or [{"pointer": "", "detail": detail}]
        super().__init__(f"the service answered {status}: {detail}")

    @property
    def is_about_the_input(self) -> bool:
        """Whether what was sent is to blame."""
        return self.status in (400, 413, 415, 422)


class KeyNeeded(LiftwrightError):
    """The service asks for a key, and none was given."""

    def __init__(self, address: str) -> None:
        super().__init__(f"the service at {address} asks for a key: set the environment variable {KEY_VARIABLE}")


class ServiceAway(LiftwrightError):
    """Nobody answers at an address."""

    def __init__(self, address: str, why: object) -> None:
        super().__init__(f"no service answers at {address}: {why}")


class ServiceClient:
    """Talks to the service at one address."""

    def __init__(self, address: str, key: str | None = None) -> None:
        """Take an address, "http://127.0.0.1:8040", and a key; by default that of `KEY_VARIABLE`."""
        if urlsplit(address).scheme not in ("http", "https"):
            raise ServiceAway(address, "an address begins with http:// or https://")
        self.address = address.rstrip("/")
        self._key = key or os.environ.get(KEY_VARIABLE)

    def get(self, path: str) -> dict[str, Any]:
        """Return the JSON at a path.

        Raises:
            KeyNeeded, ServiceRefused, ServiceAway: There is none.
        """
        return json.loads(self.read(path))

    def read(self, path: str) -> bytes:
        """Return the bytes at a path.

        Raises:
            KeyNeeded, ServiceRefused, ServiceAway: There are none.
        """
        with self._open(path) as answer:
            return answer.read()

    def post_plan(self, task: bytes) -> dict[str, Any]:
        """Post a task and return its plan.

        Raises:
            KeyNeeded, ServiceRefused, ServiceAway: It was not accepted.
        """
        with self._open("/v1/plans", task, "application/json") as answer:
            return json.load(answer)

    def post_scene(self, description: bytes, files: Mapping[str, bytes]) -> dict[str, Any]:
        """Post a scan, its description and its files by their parts, and return the scene it became.

        Raises:
            KeyNeeded, ServiceRefused, ServiceAway: It was not accepted.
        """
        parts = {"scan": description, **files}
        boundary = hashlib.sha256(b"".join(parts.values())).hexdigest()
        form = b"".join(
            f'--{boundary}\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n'.encode() + content + b"\r\n"
            for name, content in parts.items()
        )
        body = form + f"--{boundary}--\r\n".encode()
        with self._open("/v1/scenes", body, f"multipart/form-data; boundary={boundary}") as answer:
            return json.load(answer)

    def follow(self, plan: Mapping[str, Any]) -> dict[str, Any]:
        """Show a job's progress until it has ended, and return the plan as it is then.

        Raises:
            KeyNeeded, ServiceRefused, ServiceAway: Its events cannot be had, or break off.
        """
        with self._open(plan["links"]["events"]) as stream, ProgressBar() as bar:
            for kind, data in _events(stream):
                if kind == "finished":
                    bar.show("done", data["progress"]["fraction"])
                    return data
                bar.show(data["stage"], data["fraction"])
        raise ServiceAway(self.address, "it closed the event stream before the job ended")

    @contextmanager
    def _open(self, path: str, body: bytes | None = None, media_type: str | None = None) -> Iterator[Any]:
        headers = {} if media_type is None else {"Content-Type": media_type}
        if self._key is not None:
            headers["Authorization"] = f"Bearer {self._key}"
        try:
            answer = urlopen(Request(self.address + path, body, headers))
        except HTTPError as error:
            with error:
                if error.code == HTTPStatus.UNAUTHORIZED and self._key is None:
                    raise KeyNeeded(self.address) from error
                raise ServiceRefused(error.code, _problem(error.read())) from error
        except URLError as error:
            raise ServiceAway(self.address, error.reason) from error
        with answer:
            yield answer


def _problem(content: bytes) -> Mapping[str, Any]:
    try:
        problem = json.loads(content)
    except ValueError:
        return {}
    return problem if isinstance(problem, dict) else {}


def _events(stream: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    kind = ""
    for line in stream:
        name, _, value = line.decode().rstrip("\r\n").partition(": ")
        if name == "event":
            kind = value
        elif name == "data":
            yield kind, json.loads(value)
