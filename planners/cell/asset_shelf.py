"""Where the files of cells are: the shipped ones, and those of a cell of one's own. Reads and validates them."""

from __future__ import annotations

import hashlib
import json
import re
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails
from scipy.spatial import ConvexHull, QhullError

from assets import assets_folder
from planners.cell.asset_files import (
    FINGER_PATTERN,
    RELATIVE_PATH,
    Asset,
    CellFile,
    GripperFile,
    HandFile,
    JawsFile,
    MeshFile,
    MountFile,
    RobotFile,
    SensorFile,
    StickFile,
    ToolFile,
)
from planners.contract.problems import json_pointer, problem_of
from planners.contract.quantities import NAME_PATTERN, WHAT_NAMES_ARE
from planners.contract.strict_yaml import NotYaml, parse_yaml
from planners.contract.task_spec import UNION_TAGS, CustomTool
from planners.errors import AssetError, AssetFault, AssetFaults
from planners.geometry.mesh_file import MeshFormat, MeshRefused, obj_vertices, read_mesh_file
from planners.geometry.pose import Array
from planners.geometry.solid_mesh import SolidMesh, take_mesh

AssetKind = Literal["cells", "mounts", "robots", "hands", "sensors", "tools"]
KINDS: tuple[AssetKind, ...] = ("cells", "mounts", "robots", "hands", "sensors", "tools")
"""Folders of a shelf, and what the files in them are."""
TOOLS_MEMBER = "tools"
"""Under which a cell's file may hold tools, each of which becomes a file of its own."""
PARTS: Mapping[AssetKind, tuple[tuple[str, AssetKind], ...]] = {
    "cells": (
        ("mount", "mounts"),
        ("arms/left/robot", "robots"),
        ("arms/left/hand", "hands"),
        ("arms/right/robot", "robots"),
        ("arms/right/hand", "hands"),
    ),
    "hands": (("sensor", "sensors"),),
}
"""Members that name another file, and of which kind that is, by the kind of file that they are in."""
SHORTEST_STILL, LONGEST_STILL = 1e-3, 20.0
"""Of a mesh that never moves [m]: what is shorter or longer was most likely drawn in another unit."""
MESHES = "meshes"
"""The folder of shipped meshes that tasks name, all OBJ and in metres."""
MESH_FORMATS: dict[str, MeshFormat] = {".stl": "stl", ".obj": "obj", ".ply": "ply", ".glb": "glb"}
_HAND_KINDS: dict[str, type[HandFile]] = {"gripper": GripperFile, "jaws": JawsFile, "stick": StickFile}
WHAT_PATHS_ARE = "letters from A to Z or a to z, digits, _, - and dots inside names, folders parted by /"
_PLAIN = {
    NAME_PATTERN: WHAT_NAMES_ARE,
    RELATIVE_PATH: f"must be a path inside the cell's folder: {WHAT_PATHS_ARE}",
    FINGER_PATTERN: "must be 1 to 32 small letters from a to z, digits and underscores, a letter first",
}
"""What patterns say, in words."""
_NAME = re.compile(NAME_PATTERN)
_File = TypeVar("_File", bound=Asset)


@dataclass(frozen=True)
class AssetShelf:
    """Folders of assets, searched in order: `<folder>/robots/<name>.yaml` and so on."""

    folders: tuple[Path, ...]
    kept: Path | None = None
    """A folder of ours where solids are kept, since covering one by convex parts takes up to ten seconds."""
    told: frozenset[str] = frozenset()
    """Files that are not there since something is wrong with them that is told already: `robots/<name>.yaml`."""

    def names(self, kind: AssetKind) -> list[str]:
        """List the names of all files of a kind."""
        return sorted({path.stem for folder in self.folders for path in (folder / kind).glob("*.yaml")})

    def own_names(self, kind: AssetKind) -> list[str]:
        """List the names of the files of a kind that are not shipped."""
        shipped = shipped_shelf().folders
        return replace(self, folders=tuple(folder for folder in self.folders if folder not in shipped)).names(kind)

    def find(self, kind: AssetKind, name: str) -> Path:
        """Return the file of a name.

        Raises:
            AssetError: There is none; the message lists those there are. Of what is told already it has no faults.
        """
        if f"{kind}/{name}.yaml" in self.told:
            raise AssetError
        for folder in self.folders:
            path = folder / kind / f"{name}.yaml"
            if path.is_file():
                return path
        known = ", ".join(self.names(kind)) or "none"
        raise AssetError(f"no file {name!r} among the {kind}; there are: {known}")

    def mesh_path(self, mesh: MeshFile) -> Path:
        """Return where a mesh is: in one of the folders, or in an installed package, which is not imported.

        Raises:
            AssetError: It is nowhere.
        """
        if mesh.package is None:
            for folder in self.folders:
                if (folder / mesh.path).is_file():
                    return folder / mesh.path
            raise AssetError(f"there is no file {mesh.path} beside robots, hands and the like")
        spec = find_spec(mesh.package)
        if spec is None or not spec.submodule_search_locations:
            raise AssetError(f"the package {mesh.package!r} is not installed; it ships {mesh.path}")
        file = Path(spec.submodule_search_locations[0]) / mesh.path
        if not file.is_file():
            raise AssetError(f"the package {mesh.package!r} ships no {mesh.path}")
        return file

    def hull_points(self, mesh: MeshFile) -> Array:
        """Return the corners (n, 3) of the convex hull of a mesh, in its own frame [m].

        Raises:
            AssetError: There is no such mesh, or it spans no volume.
        """
        path = self.mesh_path(mesh)
        try:
            corners = _hull_corners(path) if mesh.package is None else _package_corners(path)
            return corners * mesh.scale
        except MeshRefused as error:
            raise AssetError(f"{mesh.path}: {error}") from error
        except (QhullError, ValueError) as error:
            where = "" if mesh.package is None else f" of the package {mesh.package!r}"
            raise AssetError(f"{mesh.path}{where} spans no volume") from error

    def solid(self, mesh: MeshFile, longest: float = LONGEST_STILL) -> SolidMesh:
        """Return the closed solid that a mesh is, in its own frame [m]; no side of it may be longer than `longest` [m].

        Raises:
            AssetError: There is no such mesh, it encloses no one solid, or is larger than any part of a cell.
        """
        path = self.mesh_path(mesh)
        try:
            solid = self._taken(path.read_bytes(), _format_of(path)).scaled(mesh.scale)
        except MeshRefused as error:
            raise AssetError(f"{mesh.path}: {error}") from error
        size = float(solid.size.max())
        if not SHORTEST_STILL <= size <= longest:
            hint = "; is the unit of the file what scale says, metres unless told?"
            raise AssetError(f"{mesh.path} is {size:.4g} m long; {SHORTEST_STILL:g} to {longest:g} m fit{hint}")
        return solid

    def _taken(self, content: bytes, file_format: MeshFormat) -> SolidMesh:
        """Return the solid that a file is, as it was kept if it was."""
        if self.kept is None:
            return take_mesh(content, file_format)
        # Another version may cover in another way.
        key = fingerprint((content, file_format.encode(), version("liftwright").encode()))
        place = self.kept / f"{key}.json"
        # One that cannot be read is made again.
        with suppress(OSError, ValueError, KeyError, TypeError):
            return SolidMesh.from_document(json.loads(place.read_bytes()))
        solid = take_mesh(content, file_format)
        # It is as good without: a full disk or somebody else who writes is no reason to have no cell.
        with suppress(OSError):
            self.kept.mkdir(exist_ok=True)
            with tempfile.TemporaryDirectory(dir=self.kept) as fresh:
                whole = Path(fresh, "whole")
                whole.write_text(json.dumps(solid.document()))
                whole.replace(place)
        return solid


def _format_of(path: Path) -> MeshFormat:
    return MESH_FORMATS.get(path.suffix.lower(), "obj")


def _hull_corners(path: Path) -> Array:
    """Return the corners (n, 3) of the convex hull of a mesh file, in its own unit."""
    content = path.read_bytes()
    file_format = _format_of(path)
    vertices = obj_vertices(content) if file_format == "obj" else read_mesh_file(content, file_format)[0]
    return vertices[ConvexHull(vertices).vertices]


@lru_cache(maxsize=256)
def _package_corners(path: Path) -> Array:
    """Return `_hull_corners` of a file that stays what it is; kept, since cells that are checked share most robots."""
    return _hull_corners(path)


def shipped_shelf() -> AssetShelf:
    """Return the assets that are part of the product."""
    return AssetShelf((assets_folder(),))


def fingerprint(contents: Iterable[bytes]) -> str:
    """Return a hash of contents in this order, the same on every machine."""
    digest = hashlib.sha256()
    for content in contents:
        digest.update(hashlib.sha256(content).digest())
    return digest.hexdigest()


def read_cell_file(path: Path) -> CellFile:
    """Read cells/*.yaml."""
    return _read(CellFile, path)


def part_names(kind: AssetKind, path: Path) -> dict[str, str]:
    """Return what a file of a kind names, by the member of `PARTS` that does, whatever else is wrong with the file.

    What is no name of a part is left out, and so is everything of a file that cannot be read.
    """
    named = dict[str, str]()
    with suppress(AssetError):
        data = _mapping_at(path)
        for member, _ in PARTS[kind]:
            name: Any = data
            for step in member.split("/"):
                name = name.get(step) if isinstance(name, dict) else None
            if isinstance(name, str) and _NAME.fullmatch(name):
                named[member] = name
    return named


def read_mount_file(path: Path) -> MountFile:
    """Read mounts/*.yaml."""
    table = _mapping_at(path).get("table")
    faults = AssetFaults()
    if not (isinstance(table, dict) and "mesh" in table):
        return _read(MountFile, path)
    # One sentence for all members that a box has, or has not.
    faults.add("the table is a box, by center and size; what is a mesh stands in platform", str(path), "/table")
    try:
        _read(MountFile, path)
    except AssetError as error:
        faults.take(fault for fault in error.faults if not fault.pointer.startswith("/table/"))
    raise AssetError(*faults.found)


def read_robot_file(path: Path) -> RobotFile:
    """Read robots/*.yaml."""
    return _read(RobotFile, path)


def read_hand_file(path: Path) -> HandFile:
    """Read hands/*.yaml."""
    kind = _mapping_at(path).get("kind")
    if not isinstance(kind, str) or kind not in _HAND_KINDS:
        raise AssetError(AssetFault(f"must be one of {', '.join(sorted(_HAND_KINDS))}", str(path), "/kind"))
    return _read(_HAND_KINDS[kind], path)


def read_sensor_file(path: Path) -> SensorFile:
    """Read sensors/*.yaml."""
    return _read(SensorFile, path)


def read_tool_file(path: Path) -> ToolFile:
    """Read tools/*.yaml."""
    return _read(ToolFile, path)


@cache
def shipped_tool(name: str) -> ToolFile:
    """Read the file of a shipped tool.

    Raises:
        AssetError: There is none of this name, or it is wrong.
    """
    return read_tool_file(shipped_shelf().find("tools", name))


def described_tool(name: str) -> CustomTool:
    """Return what a task would say of a shipped tool; arguments and errors as of `shipped_tool`."""
    described = shipped_tool(name).tool.as_task()
    if described is None:
        raise AssetError(f"the tool {name} has a mesh that no task can name")
    return described


def known_meshes() -> list[str]:
    """List the names of the meshes that are shipped for tasks."""
    return sorted(path.stem for path in (assets_folder() / MESHES).glob("*.obj"))


def read_mesh_asset(name: str) -> tuple[bytes, Literal["obj"]]:
    """Return the file of a mesh that is shipped for tasks, in metres, and its format.

    Raises:
        AssetError: There is none of this name.
    """
    path = assets_folder() / MESHES / f"{name}.obj"
    try:
        return path.read_bytes(), "obj"
    except OSError as error:
        raise AssetError(AssetFault(f"cannot be read: {error.strerror}", str(path))) from error


def mapping_in(content: bytes) -> dict[str, Any]:
    """Return what the text of a file says.

    Raises:
        AssetError: It is no YAML, or no mapping; of which file, it does not tell.
    """
    try:
        data, _ = parse_yaml(content)
    except NotYaml as error:
        raise AssetError(str(error)) from error
    if not isinstance(data, dict):
        raise AssetError("must be a mapping of fields")
    return data


def validated(model: type[_File], data: Mapping[str, Any], called: str) -> _File:
    """Return what a file says, which messages call so.

    Raises:
        AssetError: It lists everything that is wrong with it.
    """
    try:
        # Validated as JSON: there, and only there, does strict mode accept arrays for tuples.
        return model.model_validate_json(json.dumps(data))
    except ValidationError as error:
        raise AssetError(*faults_of(error, model, called)) from error


def faults_of(error: ValidationError, model: type[BaseModel], called: str = "") -> tuple[AssetFault, ...]:
    """Return everything that a file's model refuses, as faults of the file that messages call so."""
    return tuple(_fault(each, model, called) for each in error.errors(include_url=False))


def _mapping_at(path: Path) -> dict[str, Any]:
    try:
        return mapping_in(path.read_bytes())
    except OSError as error:
        raise AssetError(AssetFault(f"cannot be read: {error.strerror}", str(path))) from error
    except AssetError as error:
        raise error.at(str(path)) from error


def _read(model: type[_File], path: Path) -> _File:
    file = validated(model, _mapping_at(path), str(path))
    if file.name != path.stem:
        raise AssetError(AssetFault(f"must be that of the file, {path.stem!r}", str(path), "/name"))
    return file


def _fault(fault: ErrorDetails, model: type[BaseModel], file: str) -> AssetFault:
    """Return one of pydantic's faults.

    Steps in brackets are its own, a key of a mapping or a kind among several; and so is a shape's type behind `shape`.
    """
    steps = zip(("", *fault["loc"]), fault["loc"], strict=False)
    pointer = json_pointer(
        step for before, step in steps if not (str(step).startswith("[") or (before == "shape" and step in UNION_TAGS))
    )
    kind, context = fault["type"], fault.get("ctx", {})
    if kind == "string_pattern_mismatch":
        return AssetFault(_PLAIN.get(context.get("pattern", ""), problem_of(fault).detail), file, pointer)
    if kind in ("too_long", "too_short"):
        most = context.get("max_length")
        detail = f"at least {context.get('min_length')} are needed" if most is None else f"at most {most} are taken"
        return AssetFault(detail, file, pointer)
    problem = problem_of(fault, model)
    allowed = tuple(problem.allowed or ())
    if model is CellFile and kind == "extra_forbidden" and len(fault["loc"]) == 1:
        # Its tools are taken from a cell's file before that is read.
        allowed += (TOOLS_MEMBER,)
    return AssetFault(problem.detail.removeprefix("Value error, "), file, pointer, allowed)
