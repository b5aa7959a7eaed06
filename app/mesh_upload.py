"""From a request with a mesh file, on its own or as a form, to the file's bytes and its format."""

from __future__ import annotations

from collections.abc import Mapping
from email.message import Message
from email.parser import BytesHeaderParser
from types import MappingProxyType

from starlette.requests import Request

from app.errors import BadUpload, NotMeshMedia
from app.intake import Patience, read_limited
from planners.geometry.mesh_file import MeshFormat

MEDIA_TYPES: Mapping[str, MeshFormat] = MappingProxyType(
    {"model/stl": "stl", "model/obj": "obj", "model/ply": "ply", "model/gltf-binary": "glb"}
)
SUFFIXES: Mapping[str, MeshFormat] = MappingProxyType({".stl": "stl", ".obj": "obj", ".ply": "ply", ".glb": "glb"})
FORM = "multipart/form-data"
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
    header = _header(declared)
    media_type = header.get_content_type()
    if declared is None or media_type not in (FORM, *MEDIA_TYPES):
        raise NotMeshMedia(declared, (*MEDIA_TYPES, FORM))
    content = await read_limited(request, limit, patience)
    if media_type == FORM:
        return _file_of_form(content, header)
    return content, MEDIA_TYPES[media_type]


def _header(content_type: str | None) -> Message:
    header = Message()
    header["content-type"] = content_type or ""
    return header


def _file_of_form(content: bytes, header: Message) -> tuple[bytes, MeshFormat]:
    """Return the one part of a form (RFC 7578) that is named `file`."""
    boundary = header.get_param("boundary")
    if not isinstance(boundary, str) or not boundary:
        raise BadUpload("the form has no boundary")
    # Every part lies between two lines with the boundary; what comes before the first and after the last is no part.
    pieces = (b"\r\n" + content).split(b"\r\n--" + boundary.encode())[1:]
    if not pieces or not pieces[-1].startswith(b"--"):
        raise BadUpload("the form does not end with its boundary")
    files = []
    for piece in pieces[:-1]:
        head, separator, body = piece.partition(b"\r\n\r\n")
        part = BytesHeaderParser().parsebytes(head.lstrip(b" \t\r\n") + b"\r\n\r\n")
        if separator and part.get_param("name", header="content-disposition") == FIELD:
            files.append((body, part))
    if len(files) != 1:
        raise BadUpload(f"the form holds {len(files)} parts named {FIELD}; one is needed")
    body, part = files[0]
    return body, _format_of(part)


def _format_of(part: Message) -> MeshFormat:
    """Tell the format of a part by its type, else by its file's name."""
    declared = part.get_content_type()
    if declared in MEDIA_TYPES:
        return MEDIA_TYPES[declared]
    name = (part.get_filename() or "").lower()
    for suffix, file_format in SUFFIXES.items():
        if name.endswith(suffix):
            return file_format
    raise NotMeshMedia(f"{declared}; filename={name}", (*MEDIA_TYPES, *SUFFIXES))
