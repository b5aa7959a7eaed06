"""The files that describe a cell of one's own, as one value: from a folder, a zip, or one document."""

from __future__ import annotations

import hashlib
import io
import json
import lzma
import re
import stat
import tempfile
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, Self

from pydantic.json_schema import models_json_schema

from planners.cell.asset_files import (
    RELATIVE_PATH,
    CellFile,
    GripperFile,
    JawsFile,
    MountFile,
    RobotFile,
    SensorFile,
    StickFile,
    UrdfRobotFile,
)
from planners.cell.asset_shelf import KINDS, AssetKind, AssetShelf, mapping_in, shipped_shelf, validated
from planners.cell.cell import Cell, load_cell_file
from planners.cell.urdf_robot import RobotFigures, robot_from_urdf
from planners.errors import AssetError, AssetFault, AssetFaults

MOST_FILES = 500
MOST_BYTES = 64_000_000
"""Of all files together, unpacked."""
LONGEST_TEXT = 1_000_000
"""Of a file of text [bytes]."""
_TEXTS = (".yaml", ".yml", ".json")
_CELL = re.compile(r"^(?:cells/[^/]+|cell)\.(?:yaml|yml|json)$")
_LITTER = re.compile(r"(?:^|/)(?:__MACOSX|\.DS_Store|Thumbs\.db)(?:/|$)")
_PATH = re.compile(RELATIVE_PATH)
_BROKEN = (
    zipfile.BadZipFile,
    zipfile.LargeZipFile,
    EOFError,
    NotImplementedError,
    RuntimeError,
    OSError,
    ValueError,
    zlib.error,
    lzma.LZMAError,
)
"""What a broken archive raises depends on where it is broken, and by which method it is packed."""
_SOLIDS = ".solids"
"""Of an unpacked bundle: none of its own files can be there, since no name in one begins with a dot."""
_EPOCH = (1980, 1, 1, 0, 0, 0)
_NAMED: Mapping[AssetKind, tuple[tuple[str, AssetKind], ...]] = {
    "cells": (
        ("mount", "mounts"),
        ("arms/left/robot", "robots"),
        ("arms/left/hand", "hands"),
        ("arms/right/robot", "robots"),
        ("arms/right/hand", "hands"),
    ),
    "hands": (("sensor", "sensors"),),
}
"""Members that name another file, by the kind of file that they are in: that file's content may stand there itself."""


@dataclass(frozen=True, eq=False)
class CellBundle:
    """Everything that describes one cell, in the layout of the assets folder; whatever else it names is shipped."""

    files: Mapping[str, bytes]
    """By path inside the folder: `cells/NAME.yaml`, and what belongs to it in `mounts`, `robots`, `hands` and so on."""
    notes: tuple[str, ...] = ()
    """What was taken otherwise than written, or left out."""

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a cell from a folder, a zip, or one YAML or JSON file.

        A file in a folder named `cells` is taken with what lies in the folders beside it.

        Raises:
            AssetError: It is none of these, or too large; each fault names its file.
            OSError: It cannot be read.
        """
        if path.is_dir():
            return cls._of(_files_of_folder(path))
        if path.suffix.lower() == ".zip":
            return cls.of_zip(path.read_bytes())
        if path.absolute().parent.name == "cells":
            beside = _files_of_folder(path.absolute().parent.parent)
            kept = {name: content for name, content in beside.items() if not name.startswith("cells/")}
            return cls._of({**kept, f"cells/{path.name}": path.read_bytes()})
        return cls.of_text(path.read_bytes(), path.name)

    @classmethod
    def of_text(cls, content: bytes, name: str = "cell.yaml") -> Self:
        """Take a cell that is described by one document of YAML or JSON, in which every part stands itself.

        Raises:
            AssetError: It is none.
        """
        suffix = Path(name).suffix.lower()
        return cls._of({f"cell{suffix if suffix in _TEXTS else '.yaml'}": content})

    @classmethod
    def of_zip(cls, content: bytes) -> Self:
        """Take a cell from a zip of its folder.

        Raises:
            AssetError: It is no zip, holds paths that lead elsewhere, links or encrypted files, or is too large.
        """
        try:
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                files = _files_of_zip(archive)
        except _BROKEN as error:
            raise AssetError(f"the zip cannot be read: {error}") from error
        return cls._of(files)

    @classmethod
    def _of(cls, given: Mapping[str, bytes]) -> Self:
        """Check the sizes, and bring everything to the layout of the assets folder."""
        files = _without_common_folder({name: each for name, each in given.items() if not _LITTER.search(name)})
        faults = AssetFaults()
        for name, content in files.items():
            if name.endswith(_TEXTS) and len(content) > LONGEST_TEXT:
                faults.add(f"has {len(content)} bytes; at most {LONGEST_TEXT} are read", name)
        faults.raise_any()
        layout = _Layout(files)
        return cls(layout.laid_out(), tuple(layout.notes))

    @cached_property
    def name(self) -> str:
        """The cell's name, by its file."""
        return PurePosixPath(next(name for name in self.files if name.startswith("cells/"))).stem

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all files and their paths, the same on every machine."""
        digest = hashlib.sha256()
        for name, content in sorted(self.files.items()):
            digest.update(f"{name}\0{len(content)}\0".encode())
            digest.update(content)
        return digest.hexdigest()

    def zip(self) -> bytes:
        """Return all files as a zip, the same for the same files."""
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
            for name, content in sorted(self.files.items()):
                archive.writestr(zipfile.ZipInfo(name, _EPOCH), content, zipfile.ZIP_DEFLATED)
        return packed.getvalue()

    def load(self, folder: Path) -> Cell:
        """Load the cell from its files, unpacked into a folder of their own below `folder` unless they are there.

        Raises:
            AssetError: Something is wrong with it; every fault names its file as it is called in the bundle.
            OSError: The folder cannot be written.
        """
        unpacked = self.unpack(folder)
        try:
            return load_unpacked(unpacked)
        except AssetError as error:
            raise AssetError(*(_inside(fault, unpacked) for fault in error.faults)) from error

    def unpack(self, folder: Path) -> Path:
        """Return the folder below `folder` that holds exactly these files; it is made whole or not at all."""
        place = folder / self.digest
        if place.is_dir():
            return place
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix=".unpacking-") as fresh:
            whole = Path(fresh, "whole")
            for name, content in self.files.items():
                path = whole / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
            try:
                whole.replace(place)
            except OSError:
                # Another process was faster.
                if not place.is_dir():
                    raise
        return place


def load_unpacked(folder: Path) -> Cell:
    """Load the cell of an unpacked bundle. The solids that its meshes are stay beside its files for the next time.

    Raises:
        AssetError: Something is wrong with it.
    """
    (path,) = (folder / "cells").glob("*.yaml")
    return load_cell_file(path, kept=folder / _SOLIDS)


def cell_schema() -> dict[str, Any]:
    """Return the JSON schema of a cell as one document: each part may stand where it is named."""
    models = (MountFile, RobotFile, UrdfRobotFile, GripperFile, JawsFile, StickFile, SensorFile)
    _, parts = models_json_schema([(model, "validation") for model in models])
    schema = CellFile.model_json_schema()
    definitions: dict[str, Any] = {**schema.pop("$defs"), **parts["$defs"]}
    schema["$defs"] = definitions
    hands = ("GripperFile", "JawsFile", "StickFile")
    places = [(schema, "mount", ("MountFile",)), (definitions["ArmFile"], "robot", ("RobotFile", "UrdfRobotFile"))]
    places += [
        (definitions["ArmFile"], "hand", hands),
        *((definitions[hand], "sensor", ("SensorFile",)) for hand in hands),
    ]
    for holder, member, names in places:
        named = holder["properties"][member]
        holder["properties"][member] = {"anyOf": [named, *({"$ref": f"#/$defs/{name}"} for name in names)]}
    return schema


def shelf_of(folder: Path) -> AssetShelf:
    """Return the files of an unpacked bundle, and behind them the shipped ones."""
    return AssetShelf((folder, *shipped_shelf().folders))


def _inside(fault: AssetFault, folder: Path) -> AssetFault:
    """Return a fault with its file as it is called inside a folder; of what is shipped, inside the assets."""
    for root in shelf_of(folder).folders:
        if Path(fault.file).is_relative_to(root):
            return replace(fault, file=Path(fault.file).relative_to(root).as_posix())
    return fault


class _Layout:
    """Brings files to the layout of the assets folder: one file a part, named by its name."""

    def __init__(self, given: Mapping[str, bytes]) -> None:
        self._given = given
        self._files: dict[str, bytes] = {}
        self._faults = AssetFaults()
        self.notes: list[str] = []

    def laid_out(self) -> dict[str, bytes]:
        given = self._given
        cells = [name for name in given if _CELL.match(name)]
        if len(cells) != 1:
            found = f"{len(cells)} were found: {', '.join(sorted(cells)[:5])}" if cells else "none was found"
            raise AssetError(f"a cell is described by one file, cell.yaml or cells/NAME.yaml; {found}")
        for name, content in given.items():
            kind, _, rest = name.partition("/")
            with self._faults.at(name):
                if name in cells:
                    self._take("cells", name, content, PurePosixPath(rest).stem if rest else None)
                elif kind in KINDS and "/" not in rest and rest.endswith(_TEXTS):
                    self._take(kind, name, content, PurePosixPath(rest).stem)
                else:
                    self._files[name] = content
        self._check_folders()
        self._faults.raise_any()
        return self._files

    def _check_folders(self) -> None:
        """Refuse a file that is called as a folder of others: a zip may have both, a disk has one."""
        folders = {folder.as_posix(): name for name in self._files for folder in PurePosixPath(name).parents}
        for name in self._files.keys() & folders.keys():
            self._faults.add(f"is a file, and cannot be the folder that {folders[name]} is in", name)

    def _take(self, kind: AssetKind, name: str, content: bytes, stem: str | None) -> None:
        data = mapping_in(content)
        given = data.get("name")
        if not isinstance(given, str) or not re.fullmatch(r"[A-Za-z0-9_-]{1,64}", given):
            raise AssetError(AssetFault("must be 1 to 64 letters, digits, underscores and hyphens", name, "/name"))
        if stem is not None and stem != given:
            raise AssetError(AssetFault(f"must be that of the file, {stem!r}", name, "/name"))
        if self._take_parts(kind, data, name) or not name.endswith(".yaml"):
            content = _written(data)
        self._keep(f"{kind}/{given}.yaml", self._robot_of_urdf(data, name) or content, name)

    def _take_parts(self, kind: AssetKind, data: dict[str, Any], name: str) -> bool:
        """Give each part that stands in another's file a file of its own; tell whether there was one."""
        taken = False
        for member, of_kind in _NAMED.get(kind, ()):
            *way, last = member.split("/")
            holder: Any = data
            for step in way:
                holder = holder.get(step) if isinstance(holder, dict) else None
            part = holder.get(last) if isinstance(holder, dict) else None
            if not isinstance(part, dict):
                continue
            taken = True
            part.setdefault("name", f"{data['name']}_{member.replace('/', '_').removeprefix('arms_')}")
            holder[last] = part["name"]
            self._take_parts(of_kind, part, name)
            with self._faults.at(name, f"/{member}"):
                content = self._robot_of_urdf(part, name) or _written(part)
                self._keep(f"{of_kind}/{part['name']}.yaml", content, name)
        return taken

    def _robot_of_urdf(self, data: Mapping[str, Any], name: str) -> bytes | None:
        """Return a robot's file that says what a URDF does; None: `data` does not name one."""
        if "urdf" not in data:
            return None
        file = validated(UrdfRobotFile, data, name)
        content = self._given.get(file.urdf)
        if content is None:
            raise AssetError(AssetFault(f"there is no file {file.urdf} in the cell", name, "/urdf"))
        figures = RobotFigures(**file.model_dump(exclude={"urdf"}))
        folder = PurePosixPath(file.urdf).parent.as_posix().removeprefix(".")
        try:
            robot = robot_from_urdf(content, figures, self._given.get, folder)
        except AssetError as error:
            # What has a pointer is of the figures, the rest of the URDF.
            told = (replace(each, file=name if each.pointer else file.urdf) for each in error.faults)
            raise AssetError(*told) from error
        self.notes += (f"{file.name}: {note}" for note in robot.notes)
        return _written(robot.file.model_dump(mode="json", exclude_none=True))

    def _keep(self, path: str, content: bytes, given: str) -> None:
        if not _PATH.match(path):
            raise AssetError(AssetFault(f"a part cannot be called {path!r}", given))
        if self._files.get(path, content) != content:
            raise AssetError(
                AssetFault(f"describes {path.removesuffix('.yaml')} a second time, and differently", given)
            )
        self._files[path] = content


def _written(data: Mapping[str, Any]) -> bytes:
    """Write as JSON, which is YAML too."""
    return json.dumps(data, indent=1).encode()


def _without_common_folder(files: Mapping[str, bytes]) -> dict[str, bytes]:
    """Leave out the folder that everything is in, as whoever zips a folder packs it."""
    heads = {name.partition("/")[0] for name in files}
    if len(heads) == 1 and not heads & set(KINDS) and all("/" in name for name in files):
        return {name.partition("/")[2]: content for name, content in files.items()}
    return dict(files)


def _files_of_folder(folder: Path) -> dict[str, bytes]:
    """Read all files below a folder, but for hidden ones."""
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    named = [(path, path.relative_to(folder).as_posix()) for path in found]
    visible = [(path, name) for path, name in named if not name.startswith(".") and "/." not in name]
    _check_sizes(((name, path.stat().st_size) for path, name in visible))
    return {name: path.read_bytes() for path, name in visible}


def _files_of_zip(archive: zipfile.ZipFile) -> dict[str, bytes]:
    entries = [entry for entry in archive.infolist() if not entry.is_dir() and not _LITTER.search(entry.filename)]
    _check_sizes((entry.filename, entry.file_size) for entry in entries)
    names = [entry.filename for entry in entries]
    faults = AssetFaults()
    for entry in entries:
        if names.count(entry.filename) > 1:
            faults.add("is in the zip twice", entry.filename)
        if entry.flag_bits & 1:
            faults.add("is encrypted", entry.filename)
        if stat.S_ISLNK(entry.external_attr >> 16):
            faults.add("is a link", entry.filename)
    faults.raise_any()
    return dict(_unpacked(archive, entries))


def _unpacked(archive: zipfile.ZipFile, entries: Iterable[zipfile.ZipInfo]) -> Iterator[tuple[str, bytes]]:
    """Yield names and contents; what says it is small and is not ends at the limit."""
    left = MOST_BYTES
    for entry in entries:
        with archive.open(entry) as file:
            content = file.read(left + 1)
        left -= len(content)
        if left < 0:
            raise AssetError(f"the files have more than {MOST_BYTES} bytes together")
        yield entry.filename, content


def _check_sizes(files: Iterable[tuple[str, int]]) -> None:
    """Refuse what is too much, and names that lead out of the folder."""
    faults, total, count = AssetFaults(), 0, 0
    for name, size in files:
        total, count = total + size, count + 1
        if count > MOST_FILES:
            raise AssetError(f"there are more than {MOST_FILES} files")
        if not _PATH.match(name) or len(name) > 200:
            told = "letters, digits, _, - and dots inside names, folders parted by /, at most 200 characters"
            faults.add(f"cannot be called so: {told}", name[:200])
    if total > MOST_BYTES:
        raise AssetError(f"the files have {total} bytes together; at most {MOST_BYTES} are taken")
    faults.raise_any()
