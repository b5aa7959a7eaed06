"""/viewer/: the page, its files, and the two connections of whoever watches."""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path, PurePath
from typing import Annotated

import viser
from anyio import to_thread
from fastapi import APIRouter, Depends, HTTPException, Request, WebSocket
from starlette.responses import FileResponse, HTMLResponse, RedirectResponse, Response

from app.access.access_control import admit
from app.resources.schemas import PROBLEM
from app.routes.dependencies import Plans, Scenes, Studies
from app.routes.pages import PageResponse
from app.viewer.page import LIVE_FILES, MEDIA_TYPES, compare_page, live_page, static_text
from app.viewer.scene_servers import SceneServers
from app.viewer.watch import POLICY_VIOLATION, Visible, relay_scene, watch

router = APIRouter(tags=["viewer"])


def _scene_servers(request: Request) -> SceneServers:
    return request.app.state.scene_servers


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
    responses={404: PROBLEM},
)
async def get_recording(
    plan_id: str, plans: Plans, servers: Annotated[SceneServers, Depends(_scene_servers)]
) -> Response:
    """Return one page that plays the plan with its curves, offline; it takes some seconds to make."""
    page = await to_thread.run_sync(servers.record, plans, plan_id, limiter=servers.recorders)
    name = f"liftwright-{plan_id}.html"
    return HTMLResponse(page, headers={"Content-Disposition": f'inline; filename="{name}"'})


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
    return FileResponse(_viser_page(), media_type="text/html", headers={"Cache-Control": "max-age=86400"})


@router.get("/viewer/{name}", include_in_schema=False)
def get_file(name: str) -> Response:
    """Return a style or script of the page."""
    if name not in LIVE_FILES:
        raise HTTPException(404, f"the viewer has no file {name!r}")
    return Response(static_text(name), media_type=MEDIA_TYPES[PurePath(name).suffix])


@router.websocket("/viewer/watch")
async def watch_plans(socket: WebSocket) -> None:
    """Open a scene for as long as the page is open."""
    await watch(socket, socket.app.state.scene_servers, partial(visible_now, socket))


@router.websocket("/viewer/scene/{key}")
async def watch_scene(socket: WebSocket, key: str) -> None:
    """Relay the scene of a watcher."""
    address = socket.app.state.scene_servers.address(key)
    await (socket.close(POLICY_VIOLATION, "this scene is closed") if address is None else relay_scene(socket, address))


async def visible_now(socket: WebSocket) -> Visible:
    """Return what the watcher may see now: the key of a page that is open may have been revoked since."""
    caller = await admit(socket)
    assert caller is not None, "the viewer's websockets are not public"
    return Visible(socket.app.state.plans.seen_by(caller), socket.app.state.scenes.seen_by(caller))


@cache
def _viser_page() -> Path:
    return Path(viser.__file__).parent / "client" / "build" / "index.html"
