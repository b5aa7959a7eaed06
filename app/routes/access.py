"""/viewer/login, where a person shows a key once, so that the browser can watch plans; /v1/audit: who changed what."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated
from urllib.parse import parse_qs, urlsplit

from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import RedirectResponse, Response

from app.access.access_control import LOGIN, LOGOUT, address_of, write_audit
from app.access.audit_log import AuditEntry
from app.access.authenticator import COOKIE, Credentials
from app.access.session_store import SESSION_SECONDS
from app.errors import KeyNeeded, TooManyRequests
from app.resources.schemas import Resource, moment
from app.routes.dependencies import Authentication, CurrentCaller, Settings
from app.routes.pages import PageResponse
from app.uploads.body import read_limited
from app.viewer.page import login_page

VIEWER = "/viewer/"
LARGEST_FORM_BYTES = 2000

router = APIRouter()


@router.get(LOGIN, include_in_schema=False)
def get_login(authenticator: Authentication, wanted: Annotated[str, Query(alias="next")] = VIEWER) -> Response:
    """Return the page that asks for a key."""
    return RedirectResponse(VIEWER, 303) if authenticator.open else PageResponse(login_page(_here(wanted)))


@router.post(LOGIN, include_in_schema=False)
async def log_in(request: Request, authenticator: Authentication, settings: Settings) -> Response:
    """Take a key, and give the browser a cookie for it that no script can read and no other site can use."""
    form = parse_qs((await read_limited(request, LARGEST_FORM_BYTES, settings)).decode(errors="replace"))
    key, wanted = form.get("key", [""])[0].strip(), _here(form.get("next", [VIEWER])[0])
    try:
        caller = await authenticator.admit(Credentials(key, None), address_of(request) or "")
    except KeyNeeded:
        return PageResponse(login_page(wanted, "This key opens nothing."), 401)
    except TooManyRequests as error:
        return PageResponse(login_page(wanted, "Too many tries; wait a little."), 429, dict(error.headers))
    response = RedirectResponse(wanted, 303)
    if caller.key_id is not None:
        token = await run_in_threadpool(authenticator.sessions.begin, caller.key_id)
        secure = request.url.scheme == "https"
        response.set_cookie(COOKIE, token, SESSION_SECONDS, path="/", secure=secure, httponly=True, samesite="lax")
        await write_audit(authenticator, caller, request, "LOGIN", response.status_code)
    return response


@router.post(LOGOUT, include_in_schema=False)
async def log_out(request: Request, authenticator: Authentication, _: CurrentCaller) -> Response:
    """Make the browser's cookie worthless."""
    token = request.cookies.get(COOKIE)
    if token is not None:
        await run_in_threadpool(authenticator.sessions.end, token)
        authenticator.forget(token)
    response = RedirectResponse(LOGIN, 303)
    response.delete_cookie(COOKIE, path="/")
    return response


class AuditItem(Resource):
    """One thing that somebody did or tried to do."""

    number: int
    at: datetime
    key_id: str | None
    """None: no keys were asked for, or it was done on the command line."""
    owner: str | None
    address: str | None
    action: str
    target: str
    status: int
    """How it was answered."""


class AuditPage(Resource):
    """One page of the log, newest first."""

    entries: list[AuditItem]
    next_before: int | None
    """Give it as `before` for the next page; None on the last one."""


@router.get("/v1/audit", tags=["access"], summary="Read the audit log")
def list_audit(
    authenticator: Authentication,
    page_size: Annotated[int, Query(ge=1, le=200)] = 50,
    before: Annotated[int | None, Query(ge=1, le=2**31 - 1)] = None,
) -> AuditPage:
    """Return who changed what. Needs the scope `admin`."""
    entries = authenticator.audit.newest(page_size + 1, before)
    shown = entries[:page_size]
    return AuditPage(
        entries=[_item(entry) for entry in shown], next_before=shown[-1].number if len(entries) > page_size else None
    )


def _here(wanted: str) -> str:
    """Return a place of this service, whatever a link asks for."""
    try:
        elsewhere = urlsplit(wanted).netloc
    except ValueError:
        return VIEWER
    stays = wanted.startswith("/") and not wanted.startswith(("//", "/\\")) and not elsewhere and wanted.isprintable()
    return wanted if stays else VIEWER


def _item(entry: AuditEntry) -> AuditItem:
    return AuditItem(
        number=entry.number,
        at=moment(entry.at_us),
        key_id=entry.key_id,
        owner=entry.owner,
        address=entry.address,
        action=entry.action,
        target=entry.target,
        status=entry.status,
    )
