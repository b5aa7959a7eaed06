"""Every request and every websocket passes here first, so that no route can forget to ask who calls."""

from __future__ import annotations

from ipaddress import ip_address
from urllib.parse import quote, urlsplit

import structlog
from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Send
from starlette.types import Scope as Connection
from starlette.websockets import WebSocketClose

from app.access.authenticator import Authenticator, Credentials
from app.access.caller import Caller, Scope
from app.errors import ANSWERED, ForeignPage, KeyNeeded, ProblemPage, ScopeNeeded, WrongHost, error_response, navigates
from app.settings import ServiceSettings

LOGIN = "/viewer/login"
HEALTH = frozenset({"/livez", "/readyz"})
PUBLIC = HEALTH | {LOGIN, "/viewer/style.css", "/viewer/login.js"}
"""What a machine that has no key may ask for: whether the service lives, and how to show a key."""
METRICS = "/metrics"
ADMIN = frozenset({"/v1/audit"})
SAFE = frozenset({"GET", "HEAD", "OPTIONS", "TRACE"})
ASKING = frozenset({"/v1/tasks/check"})
"""What changes nothing though it is posted: the question is too long for an address."""
LOGOUT = "/viewer/logout"
OWN = frozenset({LOGOUT})
"""What changes nothing but the caller's own session: whoever has one may end it."""
KEPT = "kept"
"""Member of a request's state: whether what it did is in the audit log already, in the transaction that did it."""
POLICY_VIOLATION = 1008
"""Close code of RFC 6455."""
log = structlog.get_logger(__name__)


def needed_scope(method: str, path: str) -> Scope | None:
    """Return what a request needs; None: nothing at all."""
    if path in PUBLIC:
        return None
    if path in ADMIN:
        return Scope.ADMIN
    return Scope.WRITE if changes_something(method, path) and path not in OWN else Scope.READ


def changes_something(method: str, path: str) -> bool:
    """Tell whether a request does more than look, and so is kept in the audit log."""
    return method not in SAFE and path not in ASKING


class AccessControl:
    """ASGI middleware: refuses who may not, tells the routes who calls, and keeps who changed what.

    Routes find the `Caller` in the state of the request.
    """

    def __init__(self, app: ASGIApp, page: ProblemPage) -> None:
        """`page` returns a refusal for a person, whose browser asks for a page."""
        self._app, self._page = app, page

    async def __call__(self, connection: Connection, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if connection["type"] not in ("http", "websocket"):
            await self._app(connection, receive, send)
            return
        authenticator: Authenticator = connection["app"].state.authenticator
        request = HTTPConnection(connection)
        method = connection.get("method", "GET")
        try:
            caller = await admit(request)
        except ANSWERED as error:
            await self._refuse(request, method, error, receive, send)
            return
        connection.setdefault("state", {})["caller"] = caller
        if caller is not None and changes_something(method, request.url.path):
            audited = _audited(authenticator, caller, request, method, send)
            try:
                await self._app(connection, receive, audited)
            except Exception:
                # A fault that nobody has foreseen is answered outside of this; what was done before it is done.
                if not getattr(request.state, KEPT, False):
                    await write_audit(authenticator, caller, request, method, 500)
                raise
            return
        await self._app(connection, receive, send)

    async def _refuse(
        self, request: HTTPConnection, method: str, error: Exception, receive: Receive, send: Send
    ) -> None:
        if request.scope["type"] == "websocket":
            # The server makes a 403 of it.
            await WebSocketClose(POLICY_VIOLATION)(request.scope, receive, send)
            return
        problem = error_response(error)
        response: Response = problem
        if navigates(method, request.headers):
            wants_key = isinstance(error, KeyNeeded)
            response = RedirectResponse(login_address(request), 303) if wants_key else self._page(request, problem)
        await response(request.scope, receive, send)


async def admit(request: HTTPConnection) -> Caller | None:
    """Return who calls, by what a request or websocket has shown; None where nobody is asked.

    A websocket outlives the key it was opened with: who serves one asks again whenever something is opened by it.

    Raises:
        WrongHost, ForeignPage: It was sent by a page of another site.
        KeyNeeded, ScopeNeeded: It shows no key that opens what it wants, or none that does so any more.
        TooManyRequests: The key was used too often, or too many wrong ones came from the address.
    """
    authenticator: Authenticator = request.app.state.authenticator
    method = request.scope.get("method", "GET")
    _require_host(request, authenticator)
    if (method not in SAFE or request.scope["type"] == "websocket") and not is_from_here(request.headers):
        raise ForeignPage
    needed = needed_scope(method, request.url.path)
    if needed is None or _is_for_watchers(request):
        return None
    caller = await authenticator.admit(Credentials.of(request.headers, request.cookies), address_of(request) or "")
    if not caller.scope.allows(needed):
        if changes_something(method, request.url.path):
            await write_audit(
                authenticator, caller, request, method, error_response(ScopeNeeded(needed.value)).status_code
            )
        raise ScopeNeeded(needed.value)
    return caller


def _require_host(request: HTTPConnection, authenticator: Authenticator) -> None:
    """Raise `WrongHost` unless a request calls the service by a name of its own: pages trick browsers (DNS rebinding).

    Without keys no other name than this machine's own is one, whatever is set: everybody would be let in.
    """
    settings: ServiceSettings = request.app.state.settings
    if _is_for_watchers(request):
        return
    given = request.headers.get("host", "")
    name = _name_in(given)
    allowed = () if authenticator.open else settings.allowed_hosts
    if allowed and name not in {each.lower() for each in allowed}:
        raise WrongHost(given, allowed)
    if not allowed and settings.is_loopback and not _is_loopback_name(name):
        raise WrongHost(given, ())


def _is_for_watchers(request: HTTPConnection) -> bool:
    """Whether a request is one of what watches containers: it has no key, and calls each by its address."""
    settings: ServiceSettings = request.app.state.settings
    path = request.url.path
    return path in HEALTH or (
        path == METRICS and settings.metrics_without_key and request.scope.get("method") in ("GET", "HEAD")
    )


def is_from_here(headers: Headers) -> bool:
    """Tell whether a request comes from a page of this service, or from no page at all."""
    origin = headers.get("origin")
    if origin is None:
        return True
    try:
        return urlsplit(origin).netloc == headers.get("host")
    except ValueError:
        return False


def address_of(request: HTTPConnection) -> str | None:
    """Return the address that a request comes from."""
    return None if request.client is None else request.client.host


async def write_audit(
    authenticator: Authenticator, caller: Caller, request: HTTPConnection, action: str, status: int, target: str = ""
) -> None:
    """Write into the audit log; where that fails the entry is in the log of events, and the answer is given."""
    target = target or request.url.path
    try:
        await run_in_threadpool(authenticator.audit.add, caller, address_of(request), action, target, status)
    except SQLAlchemyError as error:
        log.error("audit entry not kept", key_id=caller.key_id, action=action, target=target, error=repr(error))


def _audited(authenticator: Authenticator, caller: Caller, request: HTTPConnection, method: str, send: Send) -> Send:
    """Keep what a request did before the caller learns of it."""

    async def send_and_keep(message: Message) -> None:
        if message["type"] == "http.response.start" and not getattr(request.state, KEPT, False):
            made = Headers(raw=message["headers"]).get("location", "")
            await write_audit(authenticator, caller, request, method, message["status"], made)
            setattr(request.state, KEPT, True)
        await send(message)

    return send_and_keep


def login_address(request: HTTPConnection) -> str:
    """Return where a person can show a key, and then comes back."""
    wanted = request.url.path + (f"?{request.url.query}" if request.url.query else "")
    return f"{LOGIN}?next={quote(wanted, safe='/')}"


def _name_in(host: str) -> str:
    """Return the name in a `Host` header, without port; empty where there is none, or nothing that can be read."""
    try:
        return (urlsplit(f"//{host}").hostname or "").lower()
    except ValueError:
        return ""


def _is_loopback_name(name: str) -> bool:
    """Tell whether a host's name, without port, is this machine's own."""
    if name == "localhost":
        return True
    try:
        return ip_address(name).is_loopback
    except ValueError:
        return False
