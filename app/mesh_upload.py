"""From a request with a mesh file, on its own or as a form, to the file's bytes and its format."""

from __future__ import annotations

from collections.abc import Mapping
from email.message import Message
from types import MappingProxyType

from anyio import to_thread
from starlette.requests import Request

from app.errors import BadUpload, NotMeshMedia
from app.form import FORM, FormPart, content_type, form_parts
from app.intake import Patience, read_limited
from planners.geometry.mesh_file import MeshFormat

MEDIA_TYPES: Mapping[str, MeshFormat] = MappingProxyType(
    {"model/stl": "stl", "model/obj": "obj", "model/ply": "ply", "model/gltf-binary": "glb"}
)
SUFFIXES: Mapping[str, MeshFormat] = MappingProxyType({".stl": "stl", ".obj": "obj", ".ply": "ply", ".glb": "glb"})
FIELD = "file"


async def read_mesh(request: Request, limit: int, patience: Patience) -> tuple[bytes, MeshFormat]:
    """Return a mesh file and its format.

    Raises:
        NotMeshMedia: It is declared as something else than a mesh, or a form.
        BadUpload: The form does not hold one file named `file`.
        EncodedBody: It is declared as compressed.
        BodyTooLarge: It has more than `limit` bytes.
    """
    declared = request.headers.get("content-type")
    header = content_type(declared)
    media_type = header.get_content_type()
    if declared is None or media_type not in (FORM, *MEDIA_TYPES):
        raise NotMeshMedia(declared, (*MEDIA_TYPES, FORM))
    content = await read_limited(request, limit, patience)
    if media_type == FORM:
        return await to_thread.run_sync(_file_of_form, content, header)
    return content, MEDIA_TYPES[media_type]


def _file_of_form(content: bytes, header: Message) -> tuple[bytes, MeshFormat]:
    """Return the one part of a form that is named `file`."""
    files = [part for part in form_parts(content, header) if part.name == FIELD]
    if len(files) != 1:
        raise BadUpload(f"the form holds {len(files)} parts named {FIELD}; one is needed")
    return files[0].content, _format_of(files[0])


def _format_of(part: FormPart) -> MeshFormat:
    """Tell the format of a part by its type, else by its file's name."""
    if part.media_type in MEDIA_TYPES:
        return MEDIA_TYPES[part.media_type]
    for suffix, file_format in SUFFIXES.items():
        if part.filename.lower().endswith(suffix):
            return file_format
    raise NotMeshMedia(f"{part.media_type}; filename={part.filename.lower()}", (*MEDIA_TYPES, *SUFFIXES))
