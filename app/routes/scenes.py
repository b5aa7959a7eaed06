"""/v1/scenes: post what cameras saw, get the tool and the objects, which tasks then name."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Annotated, Any

from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Depends, Request, Response
from starlette.concurrency import run_in_threadpool

from app.errors import SceneNotFound
from app.form import FORM
from app.resources import ProblemDocument, SceneLinks, SceneResource
from app.routes.given import Settings
from app.scan_upload import DESCRIPTION, read_scan_form
from planners.contract.scan_spec import read_scan
from planners.contract.strict_json import parse_json
from planners.errors import SceneError
from planners.perception.perceive import PARTS, perceive
from planners.scene.cell import Cell
from workers.scene_store import SceneStore, StoredScene
from workers.software import describe_software

PROBLEM: dict[str, Any] = {"model": ProblemDocument, "content": {"application/problem+json": {}}}
NOT_FOUND: dict[int | str, dict[str, Any]] = {404: {**PROBLEM, "description": "No such scene"}}
FORM_SCHEMA = {
    "type": "object",
    "required": [DESCRIPTION],
    "properties": {
        DESCRIPTION: {"$ref": "#/components/schemas/ScanSpec"},
        **{part: {"type": "string", "format": "binary"} for part in PARTS},
    },
}

router = APIRouter(prefix="/v1/scenes", tags=["scenes"])


def _store(request: Request) -> SceneStore:
    return request.app.state.scenes


def _perceivers(request: Request) -> CapacityLimiter:
    return request.app.state.perceivers


Store = Annotated[SceneStore, Depends(_store)]
Perceivers = Annotated[CapacityLimiter, Depends(_perceivers)]


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
        422: {**PROBLEM, "description": "Files that cannot be read or show no table, with the reason"},
    },
)
async def post_scene(
    request: Request, response: Response, store: Store, settings: Settings, perceivers: Perceivers
) -> SceneResource:
    """Find the tool and the objects in pictures, depth images or clouds. The same scan again gives the same scene."""
    # Whole scans are held in memory: no more of them at once than are worked on.
    async with perceivers:
        description, files = await read_scan_form(request, settings.max_scan_bytes, settings)
        resource = await to_thread.run_sync(_accept, description, files, store, request.app.state.cells)
    response.headers["Location"] = resource.links.self
    return resource


@router.get("/{scene_id}", summary="One perceived scene", responses=NOT_FOUND)
def get_scene(scene_id: str, store: Store) -> SceneResource:
    """Return what was perceived."""
    scene = store.get(scene_id)
    if scene is None:
        raise SceneNotFound(scene_id)
    return _resource(scene)


@router.get(
    "/{scene_id}/preview.png",
    summary="A picture of a perceived scene",
    response_class=Response,
    responses={**NOT_FOUND, 200: {"content": {"image/png": {}}, "description": "A picture with everything drawn in"}},
)
async def get_preview(scene_id: str, store: Store) -> Response:
    """Return the cameras' pictures with everything that was found drawn in."""
    picture = await run_in_threadpool(store.preview, scene_id)
    if picture is None:
        raise SceneNotFound(scene_id)
    return Response(picture, media_type="image/png", headers={"Cache-Control": "max-age=86400"})


def _accept(
    description: bytes, files: Mapping[str, bytes], store: SceneStore, cells: Mapping[str, Cell]
) -> SceneResource:
    scan = read_scan(parse_json(description))
    if scan.cell not in cells:
        raise SceneError("/cell", f"there is no cell {scan.cell}", sorted(cells))
    # Another version of the service may see more in the same scan.
    digest = hashlib.sha256(f"{describe_software()}{scan.model_dump_json()}".encode())
    for part in sorted(files):
        digest.update(f"{part} {len(files[part])} ".encode() + files[part])
    scene_id = digest.hexdigest()[:32]
    scene = store.get(scene_id)
    if scene is None:
        perceived = perceive(scan, files, cells[scan.cell])
        store.add(scene_id, perceived.document, perceived.preview)
        scene = store.get(scene_id)
        assert scene is not None
    return _resource(scene)


def _resource(scene: StoredScene) -> SceneResource:
    address = f"/v1/scenes/{scene.id}"
    return SceneResource(
        id=scene.id,
        created_at=datetime.fromtimestamp(scene.created_us / 1e6, UTC),
        scene=scene.document,
        links=SceneLinks(self=address, preview=f"{address}/preview.png"),
    )
