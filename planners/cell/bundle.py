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
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, Self

from pydantic.json_schema import models_json_schema

from planners.cell.asset_files import (
    MOST_TOOLS,
    RELATIVE_PATH,
    CellFile,
    GripperFile,
    JawsFile,
    MountFile,
    RobotFile,
    SensorFile,
    StickFile,
    ToolFile,
    UrdfRobotFile,
)
from planners.cell.asset_shelf import (
    KINDS,
    PARTS,
    TOOLS_MEMBER,
    WHAT_PATHS_ARE,
    AssetKind,
    AssetShelf,
    mapping_in,
    shipped_shelf,
    validated,
)
from planners.cell.cell import Cell, CellParts, read_cell
from planners.cell.urdf_robot import RobotFigures, robot_from_urdf
from planners.contract.problems import json_pointer
from planners.contract.quantities import NAME_PATTERN, WHAT_NAMES_ARE
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
_OUTSIDE = re.compile(r"^/|\\|:|\0|(?:^|/)\.")
"""In a name: what leads elsewhere, on some system, or is hidden."""
_NAMES = f"{WHAT_PATHS_ARE}, at most 200 characters"
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


@dataclass(frozen=True)
class PartOrigin:
    """Where a part stood in what was given."""

    file: str
    """Empty: all was one document."""
    pointer: str | None
    """Of the part in it; None: it is no file of members."""

    def of(self, fault: AssetFault) -> AssetFault:
        """Return a fault of the part as one of what was given."""
        return replace(fault, file=self.file, pointer="" if self.pointer is None else self.pointer + fault.pointer)


@dataclass(frozen=True, eq=False)
class CellBundle:
    """Everything that describes one cell, in the layout of the assets folder; whatever else it names is shipped."""

    files: Mapping[str, bytes]
    """By path inside the folder: `cells/NAME.yaml`, and what belongs to it in `mounts`, `robots`, `hands` and so on."""
    notes: tuple[str, ...] = ()
    """What was taken otherwise than written, or left out."""
    faults: tuple[AssetFault, ...] = ()
    """What is wrong with files that are none of `files` therefore; whoever loads the cell is told with the rest."""
    told: frozenset[str] = frozenset()
    """Paths of those."""
    origins: Mapping[str, PartOrigin] = field(default_factory=dict[str, PartOrigin])
    """Where each part stood in what was given, by its path; what is not listed stood there."""

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
        return cls._of({f"cell{suffix if suffix in _TEXTS else '.yaml'}": content}, is_document=True)

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
    def _of(cls, given: Mapping[str, bytes], *, is_document: bool = False) -> Self:
        """Check the sizes, and bring everything to the layout of the assets folder."""
        named = _without_common_folder({name: each for name, each in given.items() if not _LITTER.search(name)})
        files = {name: content for name, content in named.items() if _is_path(name)}
        left_out = [f"{name!r} is left out: {_NAMES}" for name in named if name not in files]
        faults = AssetFaults()
        for name, content in files.items():
            if name.endswith(_TEXTS) and len(content) > LONGEST_TEXT:
                faults.add(f"has {len(content)} bytes; at most {LONGEST_TEXT} are read", "" if is_document else name)
        faults.raise_any()
        layout = _Layout(files, named, is_document=is_document)
        laid_out = layout.laid_out()
        return cls(laid_out, (*left_out, *layout.notes), layout.faults.found, frozenset(layout.told), layout.origins)

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
            AssetError: Something is wrong with it; every fault names its file and member as they were given.
            OSError: The folder cannot be written.
        """
        faults = AssetFaults()
        return self.read_parts(folder, faults).whole(faults)

    def read_parts(self, folder: Path, faults: AssetFaults) -> CellParts:
        """Read what can be used of the cell, and gather all that is wrong with it; arguments as of `load`.

        Raises:
            OSError: The folder cannot be written.
        """
        unpacked, found = self.unpack(folder), AssetFaults()
        shelf = replace(_shelf_at(unpacked), told=self.told)
        parts = CellParts.read(_cell_file(unpacked), shelf, found)
        faults.take(self.faults)
        faults.take(self.as_given(_inside(fault, unpacked)) for fault in found.found)
        return parts

    def as_given(self, fault: AssetFault) -> AssetFault:
        """Return a fault of one of `files` as one of the file and member in which it was given."""
        return self.origins[fault.file].of(fault) if fault.file in self.origins else fault

    def unpack(self, folder: Path) -> Path:
        """Return the folder below `folder` that holds exactly these files; it is made whole or not at all."""
        place = folder / self.digest
        if self._is_at(place):
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
                # Another process was faster, or a loss of power has left a part of it.
                if not place.is_dir():
                    raise
                if not self._is_at(place):
                    place.replace(Path(fresh, "torn"))
                    whole.replace(place)
        return place

    def _is_at(self, place: Path) -> bool:
        """Tell whether a folder holds these files, whole."""
        try:
            return all((place / name).read_bytes() == content for name, content in self.files.items())
        except FileNotFoundError:
            return False


def load_unpacked(folder: Path) -> Cell:
    """Load the cell of an unpacked bundle. The solids that its meshes are stay beside its files for the next time.

    Raises:
        AssetError: Something is wrong with it.
    """
    return read_cell(_cell_file(folder), _shelf_at(folder))


def _cell_file(folder: Path) -> Path:
    (path,) = (folder / "cells").glob("*.yaml")
    return path


def _shelf_at(folder: Path) -> AssetShelf:
    """Return the files of an unpacked bundle, and behind them the shipped ones; solids are kept beside the former."""
    return AssetShelf((folder, *shipped_shelf().folders), kept=folder / _SOLIDS)


def cell_schema() -> dict[str, Any]:
    """Return the JSON schema of a cell as one document: each part may stand where it is named."""
    models = (MountFile, RobotFile, UrdfRobotFile, GripperFile, JawsFile, StickFile, SensorFile, ToolFile)
    _, parts = models_json_schema([(model, "validation") for model in models])
    schema = CellFile.model_json_schema()
    definitions: dict[str, Any] = {**schema.pop("$defs"), **parts["$defs"]}
    schema["$defs"] = definitions
    # Under `tools` its name is that of its member.
    definitions[ToolFile.__name__].update(required=["tool"])
    tools = {
        "additionalProperties": {"$ref": f"#/$defs/{ToolFile.__name__}"},
        "description": "Suction tools that the cell brings beside the shipped ones, by their names.",
        "maxProperties": MOST_TOOLS,
        "type": "object",
    }
    schema.setdefault("properties", {}).update(tools=tools)
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


def _inside(fault: AssetFault, folder: Path) -> AssetFault:
    """Return a fault with its file as it is called inside a folder; of what is shipped, inside the assets."""
    for root in _shelf_at(folder).folders:
        if Path(fault.file).is_relative_to(root):
            return replace(fault, file=Path(fault.file).relative_to(root).as_posix())
    return fault


class _Layout:
    """Brings files to the layout of the assets folder: one file a part, named by its name."""

    def __init__(self, given: Mapping[str, bytes], named: Mapping[str, bytes], *, is_document: bool) -> None:
        """Take the files, and what a URDF may name, which may be called as no file of a cell is.

        With `is_document`, faults of the one file that there is are those of no file.
        """
        self._given, self._named, self._is_document = given, named, is_document
        self._files: dict[str, bytes] = {}
        self.faults, self.notes = AssetFaults(), list[str]()
        self.told: set[str] = set()
        self.origins: dict[str, PartOrigin] = {}

    def laid_out(self) -> dict[str, bytes]:
        """Return the files that there are then; what is wrong with others is in `faults`.

        Raises:
            AssetError: There is no cell among them.
        """
        given = self._given
        cells = [name for name in given if _CELL.match(name)]
        if len(cells) != 1:
            found = f"{len(cells)} were found: {', '.join(sorted(cells)[:5])}" if cells else "none was found"
            raise AssetError(f"a cell is described by one file, cell.yaml or cells/NAME.yaml; {found}")
        for name, content in given.items():
            kind, _, rest = name.partition("/")
            if name in cells:
                self._take("cells", name, content, PurePosixPath(rest).stem if rest else None)
            elif kind in KINDS and "/" not in rest and rest.endswith(_TEXTS):
                self._take(kind, name, content, PurePosixPath(rest).stem)
            else:
                self._files[name] = content
        self._check_folders()
        if not any(name.startswith("cells/") for name in self._files):
            self.faults.raise_any()
        return self._files

    def _check_folders(self) -> None:
        """Refuse a file that is called as a folder of others: a zip may have both, a disk has one."""
        folders = {folder.as_posix(): name for name in self._files for folder in PurePosixPath(name).parents}
        for name in self._files.keys() & folders.keys():
            self.faults.add(f"is a file, and cannot be the folder that {folders[name]} is in", name)
            del self._files[name]

    def _take(self, kind: AssetKind, name: str, content: bytes, stem: str | None) -> None:
        origin = PartOrigin("" if self._is_document else name, "")
        with self._told_of(f"{kind}/{stem}.yaml", origin):
            data = mapping_in(content)
            given = data.get("name")
            if not isinstance(given, str) or not re.fullmatch(NAME_PATTERN, given):
                raise AssetError(AssetFault(WHAT_NAMES_ARE, pointer="/name"))
            if stem is not None and stem != given:
                raise AssetError(AssetFault(f"must be that of the file, {stem!r}", pointer="/name"))
            taken = self._take_parts(kind, data, origin)
            if kind == "cells" and TOOLS_MEMBER in data:
                self._take_tools(data.pop(TOOLS_MEMBER), origin)
                taken = True
            if taken or not name.endswith(".yaml"):
                content = _written(data)
            self._keep(f"{kind}/{given}.yaml", data, content, origin)

    def _take_parts(self, kind: AssetKind, data: dict[str, Any], holder_origin: PartOrigin) -> bool:
        """Give each part that stands in another's file a file of its own; tell whether there was one."""
        taken = False
        for member, of_kind in PARTS.get(kind, ()):
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
            origin = replace(holder_origin, pointer=f"{holder_origin.pointer}/{member}")
            self._take_parts(of_kind, part, origin)
            path = f"{of_kind}/{part['name']}.yaml"
            with self._told_of(path, origin):
                self._keep(path, part, _written(part), origin)
        return taken

    def _take_tools(self, tools: Any, holder_origin: PartOrigin) -> None:
        """Give each suction tool that stands in a cell's file, under its name, a file of its own."""
        if not isinstance(tools, dict):
            raise AssetError(AssetFault("must be a mapping: tools by their names", pointer="/tools"))
        for name, tool in tools.items():
            path, pointer = f"tools/{name}.yaml", json_pointer(["tools", name])
            with self._told_of(path, replace(holder_origin, pointer=f"{holder_origin.pointer}{pointer}")) as origin:
                if not isinstance(tool, dict):
                    raise AssetError("must be a mapping of fields")
                if not re.fullmatch(NAME_PATTERN, name) or tool.setdefault("name", name) != name:
                    raise AssetError(f"a tool is called as its member is, and a name {WHAT_NAMES_ARE}")
                self._keep(path, tool, _written(tool), origin)

    def _keep(self, path: str, data: Mapping[str, Any], content: bytes, origin: PartOrigin) -> None:
        """Keep a part, a robot that is described by a URDF as what that says."""
        if not _PATH.match(path):
            raise AssetError(f"a part cannot be called {path!r}")
        if "urdf" in data:
            content, origin = self._robot_of_urdf(validated(UrdfRobotFile, data, ""))
        if self._files.get(path, content) != content:
            raise AssetError(f"describes {path.removesuffix('.yaml')} a second time, and differently")
        self._files[path] = content
        self.origins.setdefault(path, origin)

    def _robot_of_urdf(self, file: UrdfRobotFile) -> tuple[bytes, PartOrigin]:
        """Return a robot's file that says what a URDF does, which is where it is from."""
        content = self._given.get(file.urdf)
        if content is None:
            raise AssetError(AssetFault(f"there is no file {file.urdf} in the cell", pointer="/urdf"))
        figures = RobotFigures(**file.model_dump(exclude={"urdf"}))
        folder = PurePosixPath(file.urdf).parent.as_posix().removeprefix(".")
        try:
            robot = robot_from_urdf(content, figures, self._named.get, folder)
        except AssetError as error:
            # What has a pointer is of the figures, the rest of the URDF.
            told = (each if each.pointer else replace(each, file=file.urdf) for each in error.faults)
            raise AssetError(*told) from error
        self.notes += (f"{file.name}: {note}" for note in robot.notes if f"{file.name}: {note}" not in self.notes)
        return _written(robot.file.model_dump(mode="json", exclude_none=True)), PartOrigin(file.urdf, None)

    @contextmanager
    def _told_of(self, path: str, origin: PartOrigin) -> Iterator[PartOrigin]:
        """Gather what is wrong with the part that would be kept so; faults without a file are of where it stands."""
        try:
            yield origin
        except AssetError as error:
            self.told.add(path)
            self.faults.take(each if each.file else origin.of(each) for each in error.faults)


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


def _is_path(name: str) -> bool:
    """Tell whether a file may be called so; a cell can name no other."""
    return len(name) <= 200 and _PATH.fullmatch(name) is not None


def _check_sizes(files: Iterable[tuple[str, int]]) -> None:
    """Refuse what is too much, and names that lead out of the folder."""
    faults, total, count = AssetFaults(), 0, 0
    for name, size in files:
        total, count = total + size, count + 1
        if count > MOST_FILES:
            raise AssetError(f"there are more than {MOST_FILES} files")
        if not _is_path(name) and _OUTSIDE.search(name):
            faults.add(f"cannot be called so: {_NAMES}", name[:200])
    if total > MOST_BYTES:
        raise AssetError(f"the files have {total} bytes together; at most {MOST_BYTES} are taken")
    faults.raise_any()
