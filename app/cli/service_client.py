"""A client of the service for commands and the demo: what any client would do."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TypeVar
from urllib.parse import urlsplit

import httpx
from httpx_sse import ServerSentEvent, connect_sse
from pydantic import BaseModel, ConfigDict, ValidationError

from app.cli.output import ProgressBar, Refused
from app.cli.plan_command import Planned
from app.cli.task_file import TaskFile
from planners.contract.problems import Problem, problems_of
from planners.contract.scene_document import SceneDocument
from planners.errors import LiftwrightError
from planners.plan.plan import Plan

KEY_VARIABLE = "LIFTWRIGHT_KEY"
"""Environment variable with the key that a service asks for: not an argument, which others on the machine can see."""
PATIENCE = httpx.Timeout(None, connect=30.0)
"""Perceiving a scan takes as long as it takes, and a job may say nothing for long [s]."""


RESTART_SECONDS = 60.0
"""How long a service may be away while a job is followed, as when it is upgraded [s]."""
RETRY_SECONDS = 1.0
"""Between two tries to reach it [s]."""
STARTING = (502, 503)
"""What a service, or a proxy before it, answers while it starts."""


class ServiceAnswer(BaseModel):
    """What a service answers, as far as it is read here: one of another version may say more."""

    model_config = ConfigDict(frozen=True)


class JobError(ServiceAnswer):
    """Why a job came to nothing."""

    detail: str = ""


class PlanAddresses(ServiceAnswer):
    """Where a plan is found."""

    self: str
    document: str
    events: str
    view: str


class JobProgress(ServiceAnswer):
    """How far a job is."""

    fraction: float
    """Of the whole, 0 … 1."""


class PlanJob(ServiceAnswer):
    """A plan that was posted, and how far its job is."""

    state: str
    progress: JobProgress
    error: JobError | None
    links: PlanAddresses


class StudyAddresses(ServiceAnswer):
    """Where a study is found."""

    self: str
    map: str
    events: str


class StudyJob(ServiceAnswer):
    """A study that was posted, and how far its job is."""

    state: str
    count: int
    """Of its points."""
    error: JobError | None
    best_plan: str | None
    """Where the plan of its best point is found."""
    links: StudyAddresses


class SceneAddresses(ServiceAnswer):
    """Where a scene is found."""

    preview: str
    view: str


class KeptScene(ServiceAnswer):
    """A scan that was posted, and the scene it became."""

    id: str
    scene: SceneDocument
    links: SceneAddresses


class _Report(JobProgress):
    stage: str


class _Refusal(ServiceAnswer):
    title: str | None = None
    detail: str | None = None
    errors: tuple[Problem, ...] = ()


Wanted = TypeVar("Wanted", bound=BaseModel)


class ServiceRefused(LiftwrightError):
    """The service answered with a problem."""

    def __init__(self, status: int, content: bytes) -> None:
        try:
            problem = _Refusal.model_validate_json(content)
        except ValidationError:
            problem = _Refusal()
        self.status = status
        detail = problem.detail or problem.title or "no reason given"
        self.problems = problem.errors or (Problem("", detail),)
        super().__init__(f"the service answered {status}: {detail}")

    @property
    def is_about_the_input(self) -> bool:
        """Whether what was sent is to blame."""
        return self.status in (400, 413, 415, 422)


class KeyMissing(LiftwrightError):
    """The service asks for a key, and none was given."""

    def __init__(self, address: str) -> None:
        super().__init__(f"the service at {address} asks for a key: set the environment variable {KEY_VARIABLE}")


class ServiceAway(LiftwrightError):
    """Nobody answers at an address."""

    def __init__(self, address: str, why: object) -> None:
        super().__init__(f"no service answers at {address}: {why}")


class NotUnderstood(LiftwrightError):
    """A service sent what cannot be read."""

    def __init__(self, address: str, what: str, error: ValidationError) -> None:
        first = problems_of(error)[0]
        super().__init__(f"the {what} of {address} is of another version: {first.pointer} {first.detail}")


class JobWithoutDocument(LiftwrightError):
    """A job that a service had accepted came to no document."""

    def __init__(self, job: PlanJob) -> None:
        super().__init__(f"the job {job.state}: {job.error.detail if job.error is not None else ''}")


class ServiceClient:
    """Talks to the service at one address."""

    def __init__(self, address: str) -> None:
        """Take an address, "http://127.0.0.1:8040"; the key is that of `KEY_VARIABLE`; an empty one is none."""
        if urlsplit(address).scheme not in ("http", "https"):
            raise ServiceAway(address, "an address begins with http:// or https://")
        self.address = address.rstrip("/")
        self._key = os.environ.get(KEY_VARIABLE, "").strip() or None

    def plan(self, path: str) -> Plan:
        """Return the plan whose document is at a path.

        Raises:
            KeyMissing, ServiceRefused, ServiceAway: There is none.
            NotUnderstood: The service is of another version, whose documents have what this one does not know.
        """
        try:
            return Plan.read(self.read(path))
        except ValidationError as error:
            raise NotUnderstood(self.address, "plan document", error) from error

    def read(self, path: str) -> bytes:
        """Return the bytes at a path.

        Raises:
            KeyMissing, ServiceRefused, ServiceAway: There are none.
        """
        with self._connected() as client:
            return self._accepted(client.get(path)).content

    def post(self, path: str, content: bytes, media_type: str = "application/json") -> bytes:
        """Post a body, and return what it is answered with.

        Raises:
            KeyMissing, ServiceRefused, ServiceAway: It was not accepted.
        """
        with self._connected() as client:
            return self._accepted(client.post(path, content=content, headers={"Content-Type": media_type})).content

    def post_task(self, task: bytes) -> PlanJob:
        """Post a task, as JSON, and return its job.

        Raises:
            KeyMissing, ServiceRefused, ServiceAway: It was not accepted.
        """
        return self.understood(PlanJob, self.post("/v1/plans", task))

    def post_study(self, study: bytes) -> StudyJob:
        """Post a study, as JSON, and return its job.

        Raises:
            KeyMissing, ServiceRefused, ServiceAway: It was not accepted.
        """
        return self.understood(StudyJob, self.post("/v1/studies", study))

    def delete(self, path: str) -> None:
        """Delete what is at a path.

        Raises:
            KeyMissing, ServiceRefused, ServiceAway: It was not deleted.
        """
        with self._connected() as client:
            self._accepted(client.delete(path))

    def follow_study(self, study: StudyJob) -> StudyJob:
        """Show how many points of a study are known until it has ended, and return it as it is then.

        Raises:
            KeyMissing, ServiceRefused, ServiceAway: Its events cannot be had, or break off.
        """
        known, count = 0, study.count
        with ProgressBar() as bar:
            for event in self._events(study.links):
                if event.event == "finished":
                    return self.understood(StudyJob, event.data)
                known += 1
                bar.show(f"{known} of {count} points", known / count)
        raise AssertionError("events go on until somebody has what was wanted")

    def post_scene(self, description: bytes, files: Mapping[str, bytes]) -> KeptScene:
        """Post a scan, its description and its files by their parts, and return the scene it became.

        Raises:
            KeyMissing, ServiceRefused, ServiceAway: It was not accepted.
        """
        with self._connected() as client:
            answer = self._accepted(client.post("/v1/scenes", files={"scan": description, **files}))
        return self.understood(KeptScene, answer.content)

    def follow(self, plan: PlanJob, called: str = "") -> PlanJob:
        """Show a job's progress until it has ended, and return the plan as it is then.

        Args:
            plan: as it was posted.
            called: what the job is called, where there are several.

        Raises:
            KeyMissing, ServiceRefused, ServiceAway: Its events cannot be had, or break off.
        """
        with ProgressBar(called) as bar:
            for event in self._events(plan.links):
                if event.event == "finished":
                    job = self.understood(PlanJob, event.data)
                    bar.show("done", job.progress.fraction)
                    return job
                report = self.understood(_Report, event.data)
                bar.show(report.stage, report.fraction)
        raise AssertionError("events go on until somebody has what was wanted")

    def _events(self, links: PlanAddresses | StudyAddresses) -> Iterator[ServerSentEvent]:
        """Yield the events of a job, for ever: each once, though the service restarts meanwhile.

        Raises:
            KeyMissing, ServiceRefused, ServiceAway: They cannot be had, or the service stays away.
        """
        received, away_since = "", None
        while True:
            error: BaseException | str = "it closed the event stream"
            open_since = math.inf
            try:
                asked = {"Last-Event-ID": received} if received else {}
                with self._connected() as client, connect_sse(client, "GET", links.events, headers=asked) as source:
                    if source.response.status_code in STARTING:
                        error = f"it answers {source.response.status_code}"
                    else:
                        self._accepted(source.response)
                        open_since = time.monotonic()
                        for event in source.iter_sse():
                            received, away_since = event.id or received, None
                            yield event
            except ServiceAway as away:
                error = away.__cause__ or away
            if time.monotonic() - open_since > RETRY_SECONDS:
                # It was there: of a job that waits there is nothing to tell.
                away_since = None
            away_since = away_since or time.monotonic()
            if time.monotonic() - away_since > RESTART_SECONDS:
                why = f"{error}; if it is there again, what was posted is at {self.address}{links.self}"
                raise ServiceAway(self.address, why)
            time.sleep(RETRY_SECONDS)

    def read_as(self, kind: type[Wanted], address: str) -> Wanted:
        """Return what a service has at an address.

        Raises:
            KeyMissing, ServiceRefused, ServiceAway: It does not answer with it.
            NotUnderstood: It is something else.
        """
        return self.understood(kind, self.read(address))

    def understood(self, kind: type[Wanted], content: bytes | str) -> Wanted:
        """Return what a service has answered.

        Raises:
            NotUnderstood: It is something else.
        """
        try:
            return kind.model_validate_json(content)
        except ValidationError as error:
            raise NotUnderstood(self.address, "answer", error) from error

    @contextmanager
    def _connected(self) -> Iterator[httpx.Client]:
        headers = {} if self._key is None else {"Authorization": f"Bearer {self._key}"}
        try:
            with httpx.Client(
                base_url=self.address, headers=headers, timeout=PATIENCE, follow_redirects=True
            ) as client:
                yield client
        except (httpx.TransportError, httpx.InvalidURL) as error:
            raise ServiceAway(self.address, error) from error

    def _accepted(self, answer: httpx.Response) -> httpx.Response:
        if answer.is_success:
            return answer
        if answer.status_code == httpx.codes.UNAUTHORIZED and self._key is None:
            raise KeyMissing(self.address)
        raise ServiceRefused(answer.status_code, answer.read())


class ServicePlanner:
    """Has a service plan the tasks of files, which it may work on at the same time."""

    def __init__(self, address: str) -> None:
        self._client = ServiceClient(address)

    def begin(self, file: TaskFile) -> Callable[[], Planned]:
        """Post a task, and return what waits for its plan.

        Raises:
            Refused: The service says what is wrong with it.
            KeyMissing, ServiceAway, ServiceRefused: The service cannot do it, and not because of the task.
        """
        try:
            posted = self._client.post_task(json.dumps(file.task).encode())
        except ServiceRefused as error:
            if not error.is_about_the_input:
                raise
            raise Refused(error.problems) from error
        return lambda: self._wait(file, posted)

    def _wait(self, file: TaskFile, posted: PlanJob) -> Planned:
        job = self._client.follow(posted, file.stem)
        if job.state != "succeeded":
            raise JobWithoutDocument(job)
        return Planned(self._client.plan(job.links.document), self._client.address + job.links.view)
