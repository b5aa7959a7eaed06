"""Every error the service answers with, as problem+json (RFC 9457)."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from http import HTTPStatus
from itertools import chain

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from pydantic import ValidationError
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection
from starlette.responses import Response
from starlette.routing import compile_path

from planners.contract.problems import NotValid, Problem, problem_of, problems_of
from planners.contract.scan_spec import NotAScan
from planners.contract.strict_json import NotJson
from planners.errors import AssetError, LiftwrightError, SceneError, nearest
from planners.geometry.mesh_file import MeshRefused
from planners.perception.scan_files import ScanRefused
from planners.study.study import NotAStudy
from workers.stores.database_loss import DATABASE_GONE, said_by
from workers.webhooks.target import TargetRefused

MEDIA_TYPE = "application/problem+json"
log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class ErrorKind:
    """How one kind of error is answered."""

    status: HTTPStatus
    title: str


class ServiceError(LiftwrightError):
    """Something about a request that cannot be served; the message is a sentence for a person."""

    answer: ErrorKind
    headers: Mapping[str, str] = {}

    def __init_subclass__(cls, *, status: HTTPStatus, title: str) -> None:
        """Each kind has an answer of its own."""
        cls.answer = ErrorKind(status, title)


class KeyNeeded(ServiceError, status=HTTPStatus.UNAUTHORIZED, title="No valid key"):
    """A request shows no key, or one that opens nothing."""

    def __init__(self, *, shown: bool) -> None:
        super().__init__("this key opens nothing" if shown else "show a key: Authorization: Bearer …")
        error = ', error="invalid_token"' if shown else ""
        self.headers = {"WWW-Authenticate": f'Bearer realm="liftwright"{error}'}


class ScopeNeeded(ServiceError, status=HTTPStatus.FORBIDDEN, title="Not allowed"):
    """A key is good, but not for this."""

    def __init__(self, scope: str) -> None:
        super().__init__(f"this needs a key with the scope {scope!r}")


class ForeignPage(ServiceError, status=HTTPStatus.FORBIDDEN, title="Not allowed"):
    """A page of somebody else asks for something."""

    def __init__(self) -> None:
        super().__init__("only pages of this service may ask for that")


class WrongHost(ServiceError, status=HTTPStatus.MISDIRECTED_REQUEST, title="Not this service"):
    """A service is called by a name that is none of its own."""

    def __init__(self, host: str, allowed: Sequence[str]) -> None:
        """`allowed` are the names it answers to; none: those of its own machine."""
        names = ", ".join(allowed) or "localhost only"
        super().__init__(f"this service answers to {names}, not to {host[:100]!r} (LIFTWRIGHT_ALLOWED_HOSTS)")


class TwoLengths(ServiceError, status=HTTPStatus.BAD_REQUEST, title="A body of two lengths"):
    """A request tells in two ways where its body ends."""

    headers = {"Connection": "close"}  # noqa: RUF012 - read only

    def __init__(self) -> None:
        super().__init__("a request has a Content-Length or a Transfer-Encoding, not both")


class TooManyRequests(ServiceError, status=HTTPStatus.TOO_MANY_REQUESTS, title="Too many requests"):
    """A key is used too often, or too many wrong ones are tried."""

    def __init__(self, seconds: float, limit: str) -> None:
        """`limit` says how many there may be, of what."""
        super().__init__(f"too many requests in too short a time: {limit}, at each process of the service")
        self.headers = {"Retry-After": str(math.ceil(seconds))}


class BodyStalled(ServiceError, status=HTTPStatus.REQUEST_TIMEOUT, title="The body does not come"):
    """A body does not come."""

    def __init__(self, seconds: float) -> None:
        super().__init__(f"nothing of the body came for {seconds:g} s, or all of it took too long")
        self.headers = {"Connection": "close"}


class PlanNotFound(ServiceError, status=HTTPStatus.NOT_FOUND, title="No such plan"):
    """No plan has that id."""

    def __init__(self, plan_id: str) -> None:
        super().__init__(f"there is no plan {plan_id[:100]!r}")


class StudyNotFound(ServiceError, status=HTTPStatus.NOT_FOUND, title="No such study"):
    """No study has that id."""

    def __init__(self, study_id: str) -> None:
        super().__init__(f"there is no study {study_id[:100]!r}")


class PointNotFound(ServiceError, status=HTTPStatus.NOT_FOUND, title="No such point"):
    """A study has no point of that number, or none that could be planned."""


class TooManyStudies(ServiceError, status=HTTPStatus.TOO_MANY_REQUESTS, title="Too many studies"):
    """There are too many unfinished studies, or too many of one owner."""

    def __init__(self, limit: int, *, own: bool = False) -> None:
        what = "of your studies" if own else "studies"
        super().__init__(f"{limit} {what} are under way already; 0 to {limit} may be")
        self.headers = {"Retry-After": "30"}


class WebhookNotFound(ServiceError, status=HTTPStatus.NOT_FOUND, title="No such webhook"):
    """No webhook has that id."""

    def __init__(self, webhook_id: str) -> None:
        super().__init__(f"there is no webhook {webhook_id[:100]!r}")


class WebhookUnusable(ServiceError, status=HTTPStatus.UNPROCESSABLE_ENTITY, title="The webhook cannot be used"):
    """A plan names a webhook that is not there, or that nothing is sent to."""

    def __init__(self, webhook_id: str) -> None:
        super().__init__(f"webhook={webhook_id[:100]}: there is no such webhook, or it is disabled")


class TooManyWebhooks(ServiceError, status=HTTPStatus.CONFLICT, title="Too many webhooks"):
    """An owner has as many webhooks as one may have."""

    def __init__(self, most: int) -> None:
        super().__init__(f"an owner has at most {most} webhooks; delete one that is not needed any more")


class DocumentNotReady(ServiceError, status=HTTPStatus.NOT_FOUND, title="No document"):
    """A plan has no document, or not yet."""

    def __init__(self, state: str, *, done: bool) -> None:
        why = f"the job is {state}, so there is no document" + ("" if done else " yet")
        super().__init__(why)
        self.headers = {} if done else {"Retry-After": "1"}


class NoProgram(ServiceError, status=HTTPStatus.CONFLICT, title="No program"):
    """A plan must not become a program."""


class AlreadyFinished(ServiceError, status=HTTPStatus.CONFLICT, title="Already finished"):
    """A finished job cannot be cancelled."""

    def __init__(self, state: str) -> None:
        super().__init__(f"the job has already {state}" if state != "cancelled" else "the job is already cancelled")


class NotFinished(ServiceError, status=HTTPStatus.CONFLICT, title="Not finished"):
    """A plan whose job still runs cannot be deleted."""

    def __init__(self, state: str) -> None:
        super().__init__(f"the job is {state}; cancel it first")


class BodyTooLarge(ServiceError, status=HTTPStatus.REQUEST_ENTITY_TOO_LARGE, title="The body is too large"):
    """A body is larger than what is read."""

    def __init__(self, limit: int) -> None:
        super().__init__(f"the body has more than {limit} bytes")
        self.headers = {"Connection": "close"}


class NotJsonMedia(ServiceError, status=HTTPStatus.UNSUPPORTED_MEDIA_TYPE, title="Not a JSON body"):
    """A body is declared as something else than JSON."""

    def __init__(self, given: str | None) -> None:
        was = "missing" if given is None else f"{given[:100]!r}"
        super().__init__(f"the Content-Type is {was}; it must be application/json")
        self.headers = {"Accept-Post": "application/json"}


def _type_words(given: str | None, known: Sequence[str], file: str) -> str:
    """Say which type was declared, of a file of that name if it has one, and which ones there are."""
    called = f" {file[:100]!r}" if file else ""
    was = "missing" if given is None else f"{given[:100]!r}"
    return f"the type of the file{called} is {was}; it must be one of {', '.join(known)}"


class NotMeshMedia(ServiceError, status=HTTPStatus.UNSUPPORTED_MEDIA_TYPE, title="Not a mesh"):
    """A body is declared as something else than a mesh."""

    def __init__(self, given: str | None, known: Sequence[str], file: str = "") -> None:
        super().__init__(_type_words(given, known, file))
        self.headers = {"Accept-Post": ", ".join(name for name in known if "/" in name)}


class BadUpload(ServiceError, status=HTTPStatus.UNPROCESSABLE_ENTITY, title="The upload cannot be used"):
    """A form does not hold the file that it should."""


class NotCellMedia(ServiceError, status=HTTPStatus.UNSUPPORTED_MEDIA_TYPE, title="Not a cell"):
    """A body is declared as something else than a cell."""

    def __init__(self, given: str | None, known: Sequence[str], file: str = "") -> None:
        super().__init__(_type_words(given, known, file))
        self.headers = {"Accept-Post": ", ".join(name for name in known if "/" in name)}


class CellNotFound(ServiceError, status=HTTPStatus.NOT_FOUND, title="No such cell"):
    """No cell has that id or name."""

    def __init__(self, cell_id: str, known: Iterable[str] = (), *, shipped: bool = False) -> None:
        """Name what is asked for, the names that there are, and whether it is one that is shipped, and no caller's."""
        called = cell_id[:100]
        if shipped:
            super().__init__(f"no cell of your own is called {called!r}: it is shipped, to be shown and planned in")
            return
        listed = "GET /v1/cells, or `liftwright cell list`, has those there are"
        super().__init__(f"there is no cell {called!r}; {listed}{nearest(called, known)}")


class CellIsShipped(ServiceError, status=HTTPStatus.CONFLICT, title="A shipped cell"):
    """A shipped cell is neither replaced nor deleted."""

    def __init__(self, name: str) -> None:
        super().__init__(f"{name[:100]!r} is shipped with the service; give a cell of your own another name")


class MeshNotFound(ServiceError, status=HTTPStatus.NOT_FOUND, title="No such mesh"):
    """No uploaded mesh has that id."""

    def __init__(self, mesh_id: str) -> None:
        super().__init__(f"there is no mesh {mesh_id[:100]!r}")


class NotScanMedia(ServiceError, status=HTTPStatus.UNSUPPORTED_MEDIA_TYPE, title="Not a scan"):
    """A body is declared as something else than a form."""

    def __init__(self, given: str | None) -> None:
        was = "missing" if given is None else f"{given[:100]!r}"
        super().__init__(f"the Content-Type is {was}; it must be multipart/form-data")
        self.headers = {"Accept-Post": "multipart/form-data"}


class BadScan(ServiceError, status=HTTPStatus.UNPROCESSABLE_ENTITY, title="The scan cannot be used"):
    """A form does not hold the parts of a scan."""


class SceneNotFound(ServiceError, status=HTTPStatus.NOT_FOUND, title="No such scene"):
    """No perceived scene has that id."""

    def __init__(self, scene_id: str) -> None:
        super().__init__(f"there is no scene {scene_id[:100]!r}")


class SceneInUse(ServiceError, status=HTTPStatus.CONFLICT, title="Scene in use"):
    """A scene that a task under way names cannot be deleted."""

    def __init__(self, plan_id: str) -> None:
        super().__init__(f"the plan {plan_id} names this scene and has not ended; cancel it first")


class EncodedBody(ServiceError, status=HTTPStatus.UNSUPPORTED_MEDIA_TYPE, title="An encoded body"):
    """A body is declared as compressed."""

    def __init__(self, coding: str) -> None:
        super().__init__(f"the Content-Encoding is {coding[:100]!r}; bodies are taken as they are")
        self.headers = {"Accept-Encoding": "identity"}


class BadHeader(ServiceError, status=HTTPStatus.BAD_REQUEST, title="A header or parameter cannot be followed"):
    """A header or query parameter says something that cannot be followed."""


class KeyUsedForAnotherTask(ServiceError, status=HTTPStatus.UNPROCESSABLE_ENTITY, title="Idempotency key used twice"):
    """An Idempotency-Key came again with another body."""

    def __init__(self) -> None:
        super().__init__("this Idempotency-Key was used for another task")


class QueueFull(ServiceError, status=HTTPStatus.TOO_MANY_REQUESTS, title="Too many jobs"):
    """There are too many unfinished jobs."""

    def __init__(self, limit: int) -> None:
        super().__init__(f"{limit} jobs are waiting already")
        self.headers = {"Retry-After": "10"}


class ShareFull(ServiceError, status=HTTPStatus.TOO_MANY_REQUESTS, title="Too many jobs of one owner"):
    """There are too many unfinished jobs of one owner."""

    def __init__(self, limit: int) -> None:
        super().__init__(f"{limit} of your jobs are waiting already, which is an owner's share of the queue")
        self.headers = {"Retry-After": "10"}


class TooManyDelayed(ServiceError, status=HTTPStatus.TOO_MANY_REQUESTS, title="Too many jobs for later"):
    """Too many jobs of one owner wait for their start."""

    def __init__(self, limit: int) -> None:
        super().__init__(f"{limit} of your jobs wait for their start_time already; cancel some, or post later")
        self.headers = {"Retry-After": "60"}


class NotReady(ServiceError, status=HTTPStatus.SERVICE_UNAVAILABLE, title="Not ready"):
    """The service cannot work right now."""

    headers = {"Retry-After": "2"}  # noqa: RUF012 - read only


class TooManyWatchers(ServiceError, status=HTTPStatus.SERVICE_UNAVAILABLE, title="Too many watchers"):
    """There are too many watchers."""

    headers = {"Retry-After": "10"}  # noqa: RUF012 - read only

    def __init__(self, limit: int, whose: str = "people are watching") -> None:
        super().__init__(f"{limit} {whose} already; close a viewer and try again")


class TooManyFollowers(ServiceError, status=HTTPStatus.TOO_MANY_REQUESTS, title="Too many followers"):
    """There are too many event streams, or too many of one owner's."""

    headers = {"Retry-After": "10"}  # noqa: RUF012 - read only

    def __init__(self, limit: int, limit_of_owner: int) -> None:
        super().__init__(
            f"too many follow plans and studies already: {limit} may, {limit_of_owner} of one owner's, at each process "
            "of the service; close a stream, or ask for the plan itself once in a while"
        )


class TooManyRecordings(ServiceError, status=HTTPStatus.TOO_MANY_REQUESTS, title="Too many recordings"):
    """Too many recordings wait to be made."""

    headers = {"Retry-After": "20"}  # noqa: RUF012 - read only

    def __init__(self, limit: int) -> None:
        super().__init__(f"{limit} recordings wait to be made already, at this process of the service")


class WorkTooLarge(ServiceError, status=HTTPStatus.UNPROCESSABLE_ENTITY, title="It takes too much memory"):
    """What was asked for takes more memory than it may."""

    def __init__(self, memory_bytes: int) -> None:
        super().__init__(f"this takes more memory than it may ({memory_bytes // 2**20} MiB, LIFTWRIGHT_WORK_MEMORY_MB)")


class WorkDied(ServiceError, status=HTTPStatus.SERVICE_UNAVAILABLE, title="The work has ended without an answer"):
    """A process that worked on what was asked for has ended."""

    headers = {"Retry-After": "10"}  # noqa: RUF012 - read only

    def __init__(self, memory_bytes: int) -> None:
        super().__init__(
            "the process that worked on this has ended without an answer: the machine is out of memory, or the work "
            f"took more than it may ({memory_bytes // 2**20} MiB, LIFTWRIGHT_WORK_MEMORY_MB)"
        )


class CellNotDrawn(ServiceError, status=HTTPStatus.NOT_FOUND, title="No drawing"):
    """A plan or scene was made in a cell that this service has no drawings of."""

    def __init__(self, name: str, known: Sequence[str]) -> None:
        super().__init__(f"this was made in the cell {name!r}; drawings exist of {', '.join(known)}")


class MapNotPainted(ServiceError, status=HTTPStatus.CONFLICT, title="Not painted"):
    """The map of a study cannot be painted onto the plate of the plan that is shown."""

    def __init__(self, why: str) -> None:
        super().__init__(f"the map of this study is not painted onto the plate: {why}")


class NotAWebhook(NotValid):
    """What was posted registers no webhook."""


FOREIGN: Mapping[type[Exception], ErrorKind] = {
    NotJson: ErrorKind(HTTPStatus.BAD_REQUEST, "The body is not JSON"),
    TargetRefused: ErrorKind(HTTPStatus.UNPROCESSABLE_ENTITY, "The webhook is not allowed"),
    ValidationError: ErrorKind(HTTPStatus.UNPROCESSABLE_ENTITY, "The task is not valid"),
    SceneError: ErrorKind(HTTPStatus.UNPROCESSABLE_ENTITY, "The task is not valid"),
    NotAStudy: ErrorKind(HTTPStatus.UNPROCESSABLE_ENTITY, "The study is not valid"),
    NotAWebhook: ErrorKind(HTTPStatus.UNPROCESSABLE_ENTITY, "The webhook is not valid"),
    MeshRefused: ErrorKind(HTTPStatus.UNPROCESSABLE_ENTITY, "The mesh cannot be used"),
    NotAScan: ErrorKind(HTTPStatus.UNPROCESSABLE_ENTITY, "The scan cannot be used"),
    ScanRefused: ErrorKind(HTTPStatus.UNPROCESSABLE_ENTITY, "The scan cannot be used"),
    AssetError: ErrorKind(HTTPStatus.UNPROCESSABLE_ENTITY, "The cell cannot be used"),
    RequestValidationError: ErrorKind(HTTPStatus.UNPROCESSABLE_ENTITY, "A parameter is not valid"),
    **dict.fromkeys(DATABASE_GONE, ErrorKind(HTTPStatus.SERVICE_UNAVAILABLE, "The database cannot be used")),
}
"""Errors of others that are answered as ours are."""
ANSWERED = (ServiceError, *FOREIGN)


class ProblemResponse(Response):
    """An error as RFC 9457 says."""

    def __init__(
        self, answer: ErrorKind, detail: str, errors: Sequence[Problem] = (), headers: Mapping[str, str] | None = None
    ) -> None:
        self.answer, self.detail = answer, detail
        slug = answer.title.lower().replace(" ", "-")
        body: dict[str, object] = {
            "type": f"urn:liftwright:problem:{slug}",
            "title": answer.title,
            "status": answer.status.value,
            "detail": detail,
        }
        if errors:
            body["errors"] = [problem.document() for problem in errors]
        super().__init__(json.dumps(body), answer.status.value, dict(headers or {}), MEDIA_TYPE)


ProblemPage = Callable[[HTTPConnection, ProblemResponse], Response]
"""Returns the page of an error for the person whose browser asked."""


def install_error_handlers(app: FastAPI, page: ProblemPage) -> None:
    """Answer every error of `ANSWERED`, what the router refuses, and whatever else happens, as problem+json.

    Args:
        app: that answers.
        page: returns the same for a person, whose browser asks for a page.
    """

    def readable(answered: Callable[[Request, Exception], ProblemResponse]) -> Callable[..., Response]:
        def answer(request: Request, error: Exception) -> Response:
            problem = answered(request, error)
            return page(request, problem) if navigates(request.method, request.headers) else problem

        return answer

    for kind in ANSWERED:
        app.add_exception_handler(kind, readable(_answer_known))
    app.add_exception_handler(RequestValidationError, readable(_answer_parameters))
    app.add_exception_handler(HTTPException, readable(_answer_router))
    app.add_exception_handler(Exception, readable(_answer_unknown))


def navigates(method: str, headers: Headers) -> bool:
    """Tell whether it is a browser that asks, for a person who reads what comes."""
    return method in ("GET", "HEAD") and "text/html" in headers.get("accept", "")


def _answer_known(_: Request, error: Exception) -> ProblemResponse:
    return error_response(error)


def _answer_parameters(request: Request, error: Exception) -> ProblemResponse:
    """Name the parameters that there are to whoever gives another."""
    assert isinstance(error, RequestValidationError)
    faults = zip(error.errors(), _problems(error), strict=True)
    return _answered(error, [_parameter_problem(request, fault["type"], problem) for fault, problem in faults])


def _parameter_problem(request: Request, kind: str, problem: Problem) -> Problem:
    """Return what is wrong with a parameter, with the choices there are where one is unknown or missing."""
    if kind == "extra_forbidden":
        return replace(problem, allowed=_query_parameters(request))
    choices = _choices(request, problem.pointer.rsplit("/", 1)[-1]) if kind == "missing" else []
    told = f"{problem.detail}: one of {', '.join(choices)}"
    return replace(problem, detail=told, allowed=choices) if choices else problem


def _route(request: Request) -> APIRoute:
    """Return what answers a request."""
    return request.scope["route"]


def _query_parameters(request: Request) -> list[str]:
    operation = request.app.openapi()["paths"][_route(request).path][request.method.lower()]
    return [parameter["name"] for parameter in operation["parameters"] if parameter["in"] == "query"]


def _choices(request: Request, name: str) -> list[str]:
    """Return the values that a parameter of a query can have, where they can be listed."""
    fields = _route(request).dependant.query_params
    kinds = (field.field_info.annotation for field in fields if field.alias == name)
    return [str(each.value) for kind in kinds if isinstance(kind, type) and issubclass(kind, Enum) for each in kind]


def error_response(error: Exception) -> ProblemResponse:
    """Return the answer to an error of `ANSWERED`."""
    if isinstance(error, DATABASE_GONE):
        # What the database says is for the log: it holds statements and addresses.
        log.error("database cannot be used", error=said_by(error))
        detail = "the database is away, or its disk is full; what was accepted is kept, so ask again"
        return ProblemResponse(_answer_to(error), detail, headers={"Retry-After": "5"})
    return _answered(error, _problems(error))


def _answered(error: Exception, errors: Sequence[Problem]) -> ProblemResponse:
    detail = str(error) if isinstance(error, LiftwrightError) else f"{len(errors)} members are not as they must be"
    if len(errors) == 1:
        detail = f"{errors[0].place or 'the body'}: {errors[0].detail}"
    elif isinstance(error, AssetError):
        detail = f"{len(errors)} things are not as they must be"
    headers = error.headers if isinstance(error, ServiceError) else None
    return ProblemResponse(_answer_to(error), detail, errors, headers)


def _answer_to(error: Exception) -> ErrorKind:
    if isinstance(error, ServiceError):
        return error.answer
    return next(FOREIGN[kind] for kind in type(error).__mro__ if kind in FOREIGN)


def _problems(error: Exception) -> list[Problem]:
    if isinstance(error, ValidationError | SceneError):
        return problems_of(error)
    if isinstance(error, NotValid):
        return error.problems
    if isinstance(error, AssetError):
        return [Problem.of_fault(each) for each in error.faults]
    if isinstance(error, RequestValidationError):
        return [problem_of(fault) for fault in error.errors()]
    if isinstance(error, TargetRefused):
        return [Problem("/url", str(error))]
    if isinstance(error, WebhookUnusable):
        return [Problem("/query/webhook", str(error))]
    if isinstance(error, ScanRefused):
        return [Problem("" if error.part == "description" else f"/{error.part}", error.detail)]
    if isinstance(error, MeshRefused | BadUpload):
        return [Problem("", str(error))]
    return []


def _answer_router(request: Request, error: Exception) -> ProblemResponse:
    assert isinstance(error, HTTPException)
    status, detail = HTTPStatus(error.status_code), error.detail
    headers = dict(error.headers or {})
    if status is HTTPStatus.METHOD_NOT_ALLOWED:
        headers["Allow"] = ", ".join(_methods(request)) or headers["Allow"]
        detail = f"{request.method} cannot be asked here, but {headers['Allow']}"
    elif status is HTTPStatus.NOT_FOUND and detail == status.phrase:
        detail = "there is nothing at this address; /docs has all that there are, and /openapi.json for programs"
    return ProblemResponse(ErrorKind(status, status.phrase), detail, headers=headers)


def _methods(request: Request) -> list[str]:
    """Return the methods of a path; the router itself names those of the first route alone."""
    described: Mapping[str, Mapping[str, object]] = request.app.openapi()["paths"]
    path = request.url.path
    fitting = (methods for template, methods in described.items() if compile_path(template)[0].match(path))
    allowed = {method.upper() for method in chain.from_iterable(fitting)}
    return sorted(allowed | {"HEAD"} if "GET" in allowed else allowed)


def _answer_unknown(request: Request, error: Exception) -> ProblemResponse:
    log.error("request failed", path=request.url.path, error=repr(error))
    answer = ErrorKind(HTTPStatus.INTERNAL_SERVER_ERROR, "Internal error")
    return ProblemResponse(answer, "the service met an error of its own; the log has it")
