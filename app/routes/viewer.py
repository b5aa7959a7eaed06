"""/viewer/: the page, its files, and the two connections of whoever watches."""

from __future__ import annotations

from functools import cache, partial
from http import HTTPStatus
from pathlib import Path, PurePath
from typing import Annotated

import viser
from fastapi import APIRouter, Depends, Header, HTTPException, Request, WebSocket
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.responses import FileResponse, HTMLResponse, RedirectResponse, Response

from app.access.access_control import admit
from app.resources.recordings import Recordings
from app.resources.schemas import PROBLEM
from app.routes.dependencies import Plans, Scenes, Studies, caller_of
from app.routes.headers import unless_known
from app.routes.pages import PageResponse
from app.viewer.page import LIVE_FILES, MEDIA_TYPES, compare_page, live_page, static_text
from app.viewer.scene_servers import SceneServers
from app.viewer.watch import POLICY_VIOLATION, TRY_AGAIN_LATER, Visible, relay_scene, watch
from app.work.wanted import NobodyWaits, left

DRAWN_POLICY = (
    "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'; connect-src 'self' ws: wss: data: blob:; "
    "object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
"""What viser's page may load, and a recording, which has everything inside: nothing from other places."""
router = APIRouter(tags=["viewer"])


def _scene_servers(request: Request) -> SceneServers:
    return request.app.state.scene_servers


def _recordings(request: Request) -> Recordings:
    return request.app.state.recordings


@router.get(
    "/v1/plans/{plan_id}/view",
    status_code=307,
    response_class=RedirectResponse,
    summary="Watch a plan",
    responses={307: {"description": "`Location` is the viewer with this plan loaded"}, 404: PROBLEM},
)
def view_plan(plan_id: str, plans: Plans) -> Response:
    """Go to the viewer with this plan loaded; if its job still runs, the viewer waits for it."""
    return RedirectResponse(f"/viewer/?plan={plans.plan(plan_id).id}")


@router.get(
    "/v1/scenes/{scene_id}/view",
    status_code=307,
    response_class=RedirectResponse,
    summary="Look at a perceived scene",
    responses={307: {"description": "`Location` is the viewer with this scene loaded"}, 404: PROBLEM},
)
def view_scene(scene_id: str, scenes: Scenes) -> Response:
    """Go to the viewer with this scene loaded: what was measured, and the models that were fitted to it."""
    return RedirectResponse(f"/viewer/?scene={scenes.scene(scene_id).id}")


@router.get(
    "/v1/studies/{study_id}/view",
    status_code=307,
    response_class=RedirectResponse,
    summary="Look at a study",
    responses={307: {"description": "`Location` is the page of this study"}, 404: PROBLEM},
)
def view_study(study_id: str, studies: Studies) -> Response:
    """Go to the page of a study: its map, painted onto the plate where places of the cup are varied."""
    return RedirectResponse(f"/viewer/study?study={studies.study(study_id).id}")


@router.get(
    "/v1/plans/{plan_id}/recording.html",
    response_class=HTMLResponse,
    summary="Fetch a recording",
    responses={
        304: {"description": "As `If-None-Match` says"},
        404: PROBLEM,
        429: {**PROBLEM, "description": "Too many recordings wait to be made"},
    },
)
async def get_recording(
    request: Request,
    plan_id: str,
    plans: Plans,
    recordings: Annotated[Recordings, Depends(_recordings)],
    if_none_match: Annotated[str | None, Header()] = None,
) -> Response:
    """Return one page that plays the plan with its curves, offline; it takes some seconds to make, once."""
    document = await run_in_threadpool(plans.document, plan_id)
    headers = {
        "Content-Disposition": f'inline; filename="liftwright-{plan_id}.html"',
        "Content-Security-Policy": DRAWN_POLICY,
        "ETag": f'"{recordings.tag(document)}"',
    }
    known = unless_known(Response(headers=headers), if_none_match)
    if known.status_code == HTTPStatus.NOT_MODIFIED:
        return known
    try:
        page = await recordings.get(document, partial(left, request))
    except NobodyWaits:
        raise ClientDisconnect from None
    return HTMLResponse(page, headers=headers)


@router.get("/viewer", include_in_schema=False)
def to_viewer() -> Response:
    """Go to the page; its files are beside it."""
    return RedirectResponse("/viewer/")


@router.get("/viewer/", response_class=HTMLResponse, summary="Watch plans")
def get_viewer() -> Response:
    """Return the viewer's page."""
    return PageResponse(live_page())


@router.get("/viewer/compare", response_class=HTMLResponse, summary="Watch two plans side by side")
def get_comparison() -> Response:
    """Return the page with two plans, one clock and their differences; `?plans=ID,ID` are the plans."""
    return PageResponse(compare_page())


@router.get("/viewer/study", response_class=HTMLResponse, summary="Look at studies")
def get_study_page() -> Response:
    """Return the page of studies."""
    return PageResponse(static_text("study.html"))


@router.get("/viewer/cells", response_class=HTMLResponse, summary="Look at cells")
def get_cells_page() -> Response:
    """Return the page of cells: what they can do, and where one's own are added; `?cell=ID` is shown first."""
    return PageResponse(static_text("cells.html"))


@router.get("/viewer/scene/{key}/", include_in_schema=False)
def get_scene_page(key: str, servers: Annotated[SceneServers, Depends(_scene_servers)]) -> Response:
    """Return viser's own page, which draws the scene of a watcher."""
    if servers.address(key) is None:
        raise HTTPException(404, "this scene is closed")
    headers = {"Cache-Control": "max-age=86400", "Content-Security-Policy": DRAWN_POLICY}
    return FileResponse(_viser_page(), media_type="text/html", headers=headers)


@router.get("/viewer/{name}", include_in_schema=False)
def get_file(name: str) -> Response:
    """Return a style or script of the page."""
    if name not in LIVE_FILES:
        raise HTTPException(404)
    return Response(static_text(name), media_type=MEDIA_TYPES[PurePath(name).suffix])


@router.websocket("/viewer/watch")
async def watch_plans(socket: WebSocket) -> None:
    """Open a scene for as long as the page is open."""
    await watch(socket, socket.app.state.scene_servers, caller_of(socket).owner, partial(visible_now, socket))


@router.websocket("/viewer/scene/{key}")
async def watch_scene(socket: WebSocket, key: str) -> None:
    """Relay the scene of a watcher."""
    servers: SceneServers = socket.app.state.scene_servers
    address = servers.address(key)
    if address is None:
        await socket.close(POLICY_VIOLATION, "this scene is closed")
        return
    with servers.relay(key) as admitted:
        await (relay_scene(socket, address) if admitted else socket.close(TRY_AGAIN_LATER, "too many see this scene"))


async def visible_now(socket: WebSocket) -> Visible:
    """Return what the watcher may see now: the key of a page that is open may have been revoked since."""
    caller = await admit(socket)
    assert caller is not None, "the viewer's websockets are not public"
    state = socket.app.state
    cells = state.cells.seen_by(caller).with_deleted()
    return Visible(state.plans.seen_by(caller), state.scenes.seen_by(caller), state.studies.seen_by(caller), cells)


@cache
def _viser_page() -> Path:
    return Path(viser.__file__).parent / "client" / "build" / "index.html"
