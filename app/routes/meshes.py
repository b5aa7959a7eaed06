"""/v1/meshes: upload a mesh, which tasks then name by its id."""

from __future__ import annotations

import hashlib
from typing import Annotated

from anyio import to_thread
from fastapi import APIRouter, Depends, Request, Response

from app.errors import MeshNotFound
from app.resources.schemas import PROBLEM, MeshLinks, MeshResource
from app.routes.dependencies import Settings
from app.uploads.form import FORM
from app.uploads.uploads import FIELD, MEDIA_TYPES, UploadLimits, read_mesh
from planners.geometry.mesh_file import MeshFormat
from planners.geometry.solid_mesh import SolidMesh, take_mesh
from planners.scene.shape_source import LONGEST_MESH, MILLIMETRE
from workers.stores.mesh_store import MeshStore

BINARY = {"type": "string", "format": "binary"}
FORM_SCHEMA = {"type": "object", "required": [FIELD], "properties": {FIELD: BINARY}}

router = APIRouter(prefix="/v1/meshes", tags=["meshes"])


def _store(request: Request) -> MeshStore:
    return request.app.state.meshes


def _limits(request: Request) -> UploadLimits:
    return request.app.state.mesh_limits


Store = Annotated[MeshStore, Depends(_store)]
MeshLimits = Annotated[UploadLimits, Depends(_limits)]


@router.post(
    "",
    status_code=201,
    response_model=MeshResource,
    summary="Upload a mesh",
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {
                FORM: {"schema": FORM_SCHEMA},
                **{media_type: {"schema": BINARY} for media_type in MEDIA_TYPES},
            },
        }
    },
    responses={
        413: {**PROBLEM, "description": "Too large"},
        415: {**PROBLEM, "description": "Not declared as a mesh"},
        422: {**PROBLEM, "description": "A mesh that encloses no one solid, with the reason"},
    },
)
async def post_mesh(
    request: Request, response: Response, store: Store, settings: Settings, limits: MeshLimits
) -> MeshResource:
    """Take a mesh in: STL, OBJ, PLY or GLB. The same file again gives the same id."""
    async with limits.held:
        content, file_format = await read_mesh(request, settings.max_mesh_bytes, settings)
        resource = await to_thread.run_sync(_accept, content, file_format, store, limiter=limits.worked)
    response.headers["Location"] = resource.links.self
    return resource


@router.get(
    "/{mesh_id}",
    summary="One uploaded mesh",
    responses={404: {**PROBLEM, "description": "No such mesh"}},
)
def get_mesh(mesh_id: str, store: Store) -> MeshResource:
    """Return what is known of an uploaded mesh."""
    mesh = store.get(mesh_id)
    if mesh is None:
        raise MeshNotFound(mesh_id)
    return _resource(mesh_id, mesh)


def _accept(content: bytes, file_format: MeshFormat, store: MeshStore) -> MeshResource:
    mesh_id = hashlib.sha256(file_format.encode() + b"\0" + content).hexdigest()
    mesh = store.get(mesh_id)
    if mesh is None:
        mesh = take_mesh(content, file_format)
        store.add(mesh_id, mesh)
    return _resource(mesh_id, mesh)


def _resource(mesh_id: str, mesh: SolidMesh) -> MeshResource:
    x, y, z = mesh.size.tolist()
    center_x, center_y, center_z = mesh.centroid.tolist()
    too_long = max(x, y, z) > LONGEST_MESH
    hint = f"if the unit of the file is the millimetre, name the mesh with scale {MILLIMETRE:g}" if too_long else None
    return MeshResource(
        id=mesh_id,
        triangles=len(mesh.faces),
        size=(x, y, z),
        centroid=(center_x, center_y, center_z),
        convex_parts=len(mesh.parts),
        excess=mesh.excess,
        hint=hint,
        links=MeshLinks(self=f"/v1/meshes/{mesh_id}"),
    )
