"""/viewer/new: the page on which a task is made, and the connection of whoever makes it."""

from __future__ import annotations

from functools import partial

from fastapi import APIRouter, WebSocket
from starlette.responses import HTMLResponse, Response

from app.routes.dependencies import caller_of
from app.routes.pages import PageResponse
from app.routes.viewer import visible_now
from app.viewer.editor.editing import Workshop, edit
from app.viewer.page import editor_page

router = APIRouter(tags=["viewer"])


@router.get("/viewer/new", response_class=HTMLResponse, summary="Make or change a task")
def get_editor() -> Response:
    """Return the editor's page; it begins with `?plan=ID`, `?example=NAME`, `?scene=ID` or `?kind=…&cell=NAME`."""
    return PageResponse(editor_page())


@router.websocket("/viewer/edit")
async def edit_task(socket: WebSocket) -> None:
    """Open a scene with a draft in it for as long as the page is open."""
    state = socket.app.state
    visible = partial(visible_now, socket)
    workshop = Workshop(state.scene_servers, state.meshes.get, state.tools, visible, state.other_ways)
    await edit(socket, workshop, caller_of(socket).owner)
