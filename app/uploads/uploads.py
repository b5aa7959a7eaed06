"""Uploads of meshes, cells and scans: from a request to the bytes of its files, so many at a time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath
from types import MappingProxyType

from anyio import CapacityLimiter, to_thread
from starlette.requests import Request

from app.errors import BadScan, BadUpload, NotCellMedia, NotMeshMedia, NotScanMedia
from app.uploads.body import Patience, read_limited
from app.uploads.form import FORM, ContentType, FormPart, form_parts
from planners.geometry.mesh_file import MeshFormat
from planners.perception.perceive import PARTS

MEDIA_TYPES: Mapping[str, MeshFormat] = MappingProxyType(
    {"model/stl": "stl", "model/obj": "obj", "model/ply": "ply", "model/gltf-binary": "glb"}
)
SUFFIXES: Mapping[str, MeshFormat] = MappingProxyType({".stl": "stl", ".obj": "obj", ".ply": "ply", ".glb": "glb"})
CELL_TYPES: Mapping[str, str] = MappingProxyType(
    {
        "application/zip": ".zip",
        "application/x-zip-compressed": ".zip",
        "application/yaml": ".yaml",
        "application/x-yaml": ".yaml",
        "text/yaml": ".yaml",
        "application/json": ".json",
    }
)
"""Suffixes of files that describe cells, by media type."""
FIELD = "file"
DESCRIPTION = "scan"


class UploadLimits:
    """Two limits: a sender who is slow takes up memory, but never the place of one whose upload is there."""

    def __init__(self, most_held: int, most_worked: int) -> None:
        self.held = CapacityLimiter(most_held)
        """From the first byte that is read to the end of the work."""
        self.worked = CapacityLimiter(most_worked)
        """While something is made of it, on a thread."""


async def read_mesh(request: Request, limit: int, patience: Patience) -> tuple[bytes, MeshFormat]:
    """Return a mesh file and its format.

    Raises:
        NotMeshMedia: It is declared as something else than a mesh, or a form.
        BadUpload: The form does not hold one file named `file`.
        EncodedBody: It is declared as compressed.
        BodyTooLarge: It has more than `limit` bytes.
    """
    declared = request.headers.get("content-type")
    header = ContentType.of(declared)
    if header.media_type not in (FORM, *MEDIA_TYPES):
        raise NotMeshMedia(declared, (*MEDIA_TYPES, FORM))
    content = await read_limited(request, limit, patience)
    if header.media_type == FORM:
        part = await to_thread.run_sync(_file_of_form, content, header.boundary)
        return part.content, _format_of(part)
    return content, MEDIA_TYPES[header.media_type]


async def read_cell(request: Request, limit: int, patience: Patience) -> tuple[bytes, str]:
    """Return a file that describes a cell, and its suffix: ".zip", ".yaml" or ".json".

    Raises:
        NotCellMedia: It is declared as something else, or a form.
        BadUpload: The form does not hold one file named `file`.
        EncodedBody, BodyTooLarge, BodyStalled: As of `read_mesh`.
    """
    declared = request.headers.get("content-type")
    header = ContentType.of(declared)
    if header.media_type not in (FORM, *CELL_TYPES):
        raise NotCellMedia(declared, (*CELL_TYPES, FORM))
    content = await read_limited(request, limit, patience)
    if header.media_type != FORM:
        return content, CELL_TYPES[header.media_type]
    part = await to_thread.run_sync(_file_of_form, content, header.boundary)
    suffix = CELL_TYPES.get(part.media_type) or PurePosixPath(part.filename.lower()).suffix.replace(".yml", ".yaml")
    if suffix not in CELL_TYPES.values():
        raise NotCellMedia(part.media_type or None, (*CELL_TYPES, ".zip", ".yaml"), part.filename)
    return part.content, suffix


def _file_of_form(content: bytes, boundary: bytes) -> FormPart:
    """Return the one part of a form that is named `file`."""
    files = [part for part in form_parts(content, boundary) if part.name == FIELD]
    if len(files) != 1:
        raise BadUpload(f"the form holds {len(files)} parts named {FIELD}; one is needed")
    return files[0]


def _format_of(part: FormPart) -> MeshFormat:
    """Tell the format of a part by its type, else by its file's name."""
    if part.media_type in MEDIA_TYPES:
        return MEDIA_TYPES[part.media_type]
    for suffix, file_format in SUFFIXES.items():
        if part.filename.lower().endswith(suffix):
            return file_format
    raise NotMeshMedia(part.media_type or None, (*MEDIA_TYPES, *SUFFIXES), part.filename)


async def read_scan_form(request: Request, limit: int, patience: Patience) -> tuple[bytes, dict[str, bytes]]:
    """Return the part `scan`, and the other parts by their names.

    Raises:
        NotScanMedia: It is declared as something else than a form.
        BadScan, BadUpload: The form does not hold one `scan` and each file once.
        EncodedBody: It is declared as compressed.
        BodyTooLarge: It has more than `limit` bytes.
        BodyStalled: Its sender is slower than `patience` allows.
    """
    declared = request.headers.get("content-type")
    header = ContentType.of(declared)
    if header.media_type != FORM:
        raise NotScanMedia(declared)
    parts = await to_thread.run_sync(form_parts, await read_limited(request, limit, patience), header.boundary)
    known = (DESCRIPTION, *PARTS)
    names = [part.name for part in parts]
    for name in names:
        if name not in known:
            raise BadScan(f"the form has a part {name[:100]!r}; it can have {', '.join(known)}")
        if names.count(name) > 1:
            raise BadScan(f"the form has the part {name} twice")
    files = {part.name: part.content for part in parts}
    if DESCRIPTION not in files:
        raise BadScan(f"the form has no part {DESCRIPTION}, which describes the others")
    return files.pop(DESCRIPTION), files
