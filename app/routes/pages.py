"""Pages for people beside the viewer: where to begin, and the reference of the interface, which needs no other host."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import PurePath

from fastapi import APIRouter, HTTPException
from starlette.requests import HTTPConnection
from starlette.responses import HTMLResponse, Response

from app.access.access_control import login_address
from app.errors import ProblemResponse
from app.viewer.page import MEDIA_TYPES, problem_page, static_text

POLICY = (
    "default-src 'self'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'self'"
)
"""What our pages may load: nothing from elsewhere, and no script that does not come as a file of its own."""
SWAGGER_UI = ("swagger-ui-bundle.js", "swagger-ui.css")
"""Files that `fastapi-offline` brings."""

router = APIRouter(include_in_schema=False)


class PageResponse(HTMLResponse):
    """A page of ours, which the browser keeps to what `POLICY` allows."""

    def init_headers(self, headers: Mapping[str, str] | None = None) -> None:
        """Add what every page has."""
        super().init_headers({"Content-Security-Policy": POLICY, **(headers or {})})


def problem_for_a_person(request: HTTPConnection, problem: ProblemResponse) -> Response:
    """Return an error as a page; what its headers say is kept. Where keys are asked for, another one may open more."""
    kept = {name: value for name, value in problem.headers.items() if name not in ("content-type", "content-length")}
    sign_in = None if request.app.state.authenticator.open else login_address(request)
    page = problem_page(problem.answer.title, problem.detail, sign_in)
    return PageResponse(page, problem.status_code, {**kept, "Vary": "Accept"})


@router.get("/")
def get_start() -> Response:
    """Return what a person finds who types the host's name."""
    return PageResponse(static_text("start.html"))


@router.get("/docs")
def get_reference() -> Response:
    """Return the reference of the interface."""
    return PageResponse(static_text("reference.html"))


@router.get("/docs/{name}")
def get_reference_file(name: str) -> Response:
    """Return a style or script of the reference."""
    if name not in SWAGGER_UI:
        raise HTTPException(404)
    headers = {"Cache-Control": "max-age=86400"}
    return Response(_swagger_ui(name), media_type=MEDIA_TYPES[PurePath(name).suffix], headers=headers)


@cache
def _swagger_ui(name: str) -> bytes:
    return resources.files("fastapi_offline").joinpath("static", name).read_bytes()
