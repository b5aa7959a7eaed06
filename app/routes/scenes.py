"""/v1/scenes: post what cameras saw, get the tool and the objects, which tasks then name."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response

from app.resources.queries import read_page_token, write_page_token
from app.resources.schemas import PROBLEM, SceneList, SceneResource, scene_resource, scene_summary
from app.routes.dependencies import Bench, Cells, Scenes, Settings
from app.uploads.form import FORM
from app.uploads.uploads import DESCRIPTION, UploadLimits, read_scan_form
from app.work.wanted import StillWanted, while_waited_for
from planners.perception.perceive import PARTS, perceive
from workers.stores.scene_store import StoredScene

NOT_FOUND: dict[int | str, dict[str, Any]] = {404: {**PROBLEM, "description": "No such scene"}}
BAD_TOKEN: dict[int | str, dict[str, Any]] = {400: {**PROBLEM, "description": "A token that is none of ours"}}
FORM_SCHEMA = {
    "type": "object",
    "required": [DESCRIPTION],
    "properties": {
        DESCRIPTION: {"$ref": "#/components/schemas/ScanSpec"},
        **{part: {"type": "string", "format": "binary"} for part in PARTS},
    },
}

router = APIRouter(prefix="/v1/scenes", tags=["scenes"])


def _scan_limits(request: Request) -> UploadLimits:
    return request.app.state.scan_limits


ScanLimits = Annotated[UploadLimits, Depends(_scan_limits)]


@router.post(
    "",
    status_code=201,
    response_model=SceneResource,
    summary="Perceive a scene",
    openapi_extra={"requestBody": {"required": True, "content": {FORM: {"schema": FORM_SCHEMA}}}},
    responses={
        400: {**PROBLEM, "description": "The part `scan` is not JSON"},
        413: {**PROBLEM, "description": "Too large"},
        415: {**PROBLEM, "description": "Not declared as a form"},
        422: {
            **PROBLEM,
            "description": "Files that cannot be read, show no table or take too much memory, with the reason",
        },
    },
)
async def post_scene(
    request: Request,
    response: Response,
    scenes: Scenes,
    cells: Cells,
    settings: Settings,
    bench: Bench,
    limits: ScanLimits,
) -> SceneResource:
    """Find the tool and the objects in pictures, depth images or clouds. The same scan again gives the same scene."""
    # Whole scans are held in memory: only so many are let in, and of these only so many worked on.
    async with limits.held:
        description, files = await read_scan_form(request, settings.max_scan_bytes, settings)

        def perceived(wanted: StillWanted) -> StoredScene:
            return scenes.perceive(description, files, cells, partial(bench.do, wanted, perceive))

        scene = await while_waited_for(request, perceived, limits.worked)
    resource = scene_resource(scene)
    response.headers["Location"] = resource.links.self
    return resource


@router.get("", response_model=SceneList, summary="List scenes, newest first", responses=BAD_TOKEN)
def list_scenes(
    scenes: Scenes, page_size: Annotated[int, Query(ge=1, le=200)] = 50, page_token: str | None = None
) -> SceneList:
    """Return one page of scenes."""
    shown, next_page = scenes.page(page_size, read_page_token(page_token))
    return SceneList(scenes=[scene_summary(scene) for scene in shown], next_page_token=write_page_token(next_page))


@router.get("/{scene_id}", summary="One perceived scene", responses=NOT_FOUND)
def get_scene(scene_id: str, scenes: Scenes) -> SceneResource:
    """Return what was perceived."""
    return scene_resource(scenes.scene(scene_id))


@router.get(
    "/{scene_id}/preview.png",
    summary="A picture of a perceived scene",
    response_class=Response,
    responses={**NOT_FOUND, 200: {"content": {"image/png": {}}, "description": "A picture with everything drawn in"}},
)
def get_preview(scene_id: str, scenes: Scenes) -> Response:
    """Return the cameras' pictures with everything that was found drawn in."""
    headers = {"Cache-Control": "private, max-age=86400"}
    return Response(scenes.preview(scene_id), media_type="image/png", headers=headers)


@router.delete(
    "/{scene_id}",
    status_code=204,
    summary="Delete a scene",
    responses={**NOT_FOUND, 409: {**PROBLEM, "description": "A job of a task that names it has not ended"}},
)
def delete_scene(scene_id: str, scenes: Scenes) -> None:
    """Remove a scene with its picture and points; plans that came of it stay."""
    scenes.delete(scene_id)
