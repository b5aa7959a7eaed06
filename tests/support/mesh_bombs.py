"""Files and bodies made to hurt whoever reads them: enormous promises, endless nesting, ways out of the directory."""

from __future__ import annotations

import gzip
import io
import json
import struct
import zipfile
from collections.abc import Iterator

import numpy as np

BILLION = 1_000_000_000
PATHS = (
    "../../etc/passwd",
    "/etc/passwd",
    "file:///etc/passwd",
    "http://127.0.0.1:9/x",
    "..\\..\\x",
    "\0",
    "a/../../b",
)


def meshes() -> Iterator[tuple[str, bytes]]:
    """Yield media types and contents; every one must be refused."""
    yield "model/stl", bytes(80) + struct.pack("<I", BILLION) + bytes(50)
    yield "model/stl", bytes(80) + struct.pack("<I", 0xFFFFFFFF)
    yield "model/stl", b"solid " + b"facet normal 0 0 0\n" * 50_000
    counts = f"element vertex {BILLION}\nproperty float x\nproperty float y\nproperty float z\nelement face {BILLION}\n"
    for kind in ("ascii", "binary_little_endian", "binary_big_endian"):
        head = f"ply\nformat {kind} 1.0\n{counts}property list uchar int vertex_indices\nend_header\n"
        yield "model/ply", head.encode() + bytes(100)
    yield "model/obj", b"f 1 2 1000000000\nv 0 0 0\n"
    yield "model/obj", b"\n" * 1_000_000
    yield "model/obj", b"\n \t" * 300_000 + b"f"
    yield "model/obj", grouped_obj(20_001)
    for spread in (0.0, 1e-7, 1e-6):
        yield "model/stl", heaped_stl(19_999, spread)
    yield "model/stl", solids_stl(20_001)
    yield "model/ply", ply_of_properties(500)
    yield "model/ply", ply_with_rows_behind(1_000_000)
    yield "model/gltf-binary", glb_of_accessors(1000, bytes(2_000_000))
    yield "model/gltf-binary", glb_of_views(1000, bytes(2_000_000))
    yield "model/gltf-binary", glb_of_parts(20_000)
    for count in (-BILLION, 1.5, float("inf"), float("nan"), True, None, "3"):
        yield "model/gltf-binary", glb({**TRIANGLE, "accessors": [{**CORNERS, "count": count}]})
    yield "model/gltf-binary", glb({**TRIANGLE, "bufferViews": [{"buffer": 0, "byteLength": 36, "byteStride": 0}]})
    yield "model/gltf-binary", glb({**TRIANGLE, "extras": "a" * 3_000_000})
    for path in PATHS:
        yield "model/obj", f"mtllib {path}\nusemtl a\ncall {path}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".encode()
        yield "model/gltf-binary", glb({"buffers": [{"uri": path, "byteLength": 100}], **TRIANGLE})
    yield "model/gltf-binary", glb({"buffers": [{"byteLength": 2**50}], **TRIANGLE})
    huge = [{"bufferView": 0, "componentType": 5126, "count": BILLION, "type": "VEC3"}]
    yield "model/gltf-binary", glb({"buffers": [{"byteLength": 4}], **TRIANGLE, "accessors": huge})
    nodes = [{"children": [n + 1]} for n in range(5000)] + [{"children": [0]}]
    yield "model/gltf-binary", glb({**TRIANGLE, "nodes": nodes, "scenes": [{"nodes": [0]}]})
    bush = [{"children": [n + 1] * 50} for n in range(12)] + [{"mesh": 0}]
    yield "model/gltf-binary", glb({**TRIANGLE, "nodes": bush, "scenes": [{"nodes": [0]}]})
    yield "model/gltf-binary", struct.pack("<4sII", b"glTF", 2, 0xFFFFFFFF) + struct.pack("<I4s", 0xFFFFFFFF, b"JSON")
    for media_type in ("model/stl", "model/obj", "model/ply", "model/gltf-binary"):
        yield media_type, _zip_bomb()
        yield media_type, gzip.compress(bytes(10_000_000))
        yield media_type, b"[" * 200_000


def bodies() -> Iterator[bytes]:
    """Yield bodies of tasks; every one must be refused."""
    for depth in (1000, 100_000):
        yield b"[" * depth
        yield b"[" * depth + b"]" * depth
        yield b'{"a":' * depth + b"1" + b"}" * depth
        yield b'{"kind":"plate_lift","plate":' + b"[" * depth + b"]" * depth + b"}"
    yield b"1" * 1_000_000
    yield b'{"kind":"plate_lift","seed":' + b"9" * 100_000 + b"}"
    yield b'{"kind":"plate_lift","plate":{"mass":1e' + b"9" * 1000 + b"}}"
    yield b'"' + b"\\u0000" * 100_000 + b'"'
    yield b'"\\ud800"'
    yield b"\xff\xfe" + '{"kind":"plate_lift"}'.encode("utf-16-le")
    yield json.dumps({"kind": "plate_lift", **{f"k{n}": n for n in range(50_000)}}).encode()
    for path in PATHS:
        yield json.dumps({"kind": "plate_lift", "cell": path}).encode()
        shape = {"type": "mesh", "asset": path}
        yield json.dumps({"kind": "suction_tool", "objects": [{"name": "a", "shape": shape}]}).encode()


CORNERS = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}
TRIANGLE = {
    "asset": {"version": "2.0"},
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "accessors": [CORNERS],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "nodes": [{"mesh": 0}],
    "scenes": [{"nodes": [0]}],
    "scene": 0,
}


def glb(document: dict[str, object], binary: bytes = bytes(36)) -> bytes:
    """Return a binary glTF file."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def heaped_stl(heaped: int, spread: float) -> bytes:
    """Return an STL file of one triangle with sides of 1, and so many whose corners are all within `spread` of 0."""
    rows = np.zeros(heaped + 1, dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    rows["corners"][:heaped] = np.random.default_rng(0).uniform(0.0, spread, (heaped, 3, 3))
    rows["corners"][heaped] = np.eye(3)
    return bytes(80) + struct.pack("<I", len(rows)) + rows.tobytes()


def grouped_obj(groups: int) -> bytes:
    """Return an OBJ file with so many materials of one triangle each."""
    faces = b"".join(b"usemtl m%d\nf 1 2 3\n" % number for number in range(groups))
    return b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + faces


def solids_stl(solids: int) -> bytes:
    """Return an STL file of text with so many solids of one triangle and one name."""
    return b"solid a\nfacet\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendsolid\n" * solids


def ply_of_properties(properties: int) -> bytes:
    """Return a PLY file with a vertex of so many lists."""
    lists = b"".join(b"property list uchar int a%d\n" % number for number in range(properties))
    return (
        b"ply\nformat binary_little_endian 1.0\nelement vertex 1\n" + lists + b"end_header\n" + b"\1" * 5 * properties
    )


def ply_with_rows_behind(rows: int) -> bytes:
    """Return a PLY file of text with one triangle and so many empty lines behind it."""
    axes = b"property float x\nproperty float y\nproperty float z\n"
    head = b"ply\nformat ascii 1.0\nelement vertex 3\n" + axes + b"element face 1\n"
    return head + b"property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n" + b"\n" * rows


def glb_of_accessors(accessors: int, binary: bytes) -> bytes:
    """Return a GLB file of so many accessors to almost all of its data."""
    views = [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteLength": len(binary)}]
    whole = {**CORNERS, "bufferView": 1, "count": len(binary) // 12 - 1}
    tree = {**TRIANGLE, "buffers": [{"byteLength": len(binary)}], "bufferViews": views}
    return glb({**tree, "accessors": [CORNERS] + [whole] * accessors}, binary)


def glb_of_views(views: int, binary: bytes) -> bytes:
    """Return a GLB file of so many views of almost all of its data."""
    seen = [{"buffer": 0, "byteLength": 36}] + [{"buffer": 0, "byteLength": len(binary) - 4}] * views
    return glb({**TRIANGLE, "buffers": [{"byteLength": len(binary)}], "bufferViews": seen}, binary)


def glb_of_parts(parts: int) -> bytes:
    """Return a GLB file of a mesh with so many parts, which have no triangles."""
    primitive = {"attributes": {"POSITION": 0}, "indices": 1}
    return glb(
        {**TRIANGLE, "accessors": [CORNERS, {**CORNERS, "count": 0}], "meshes": [{"primitives": [primitive] * parts}]}
    )


def _zip_bomb() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("../../mesh.stl", bytes(10_000_000))
    return out.getvalue()
