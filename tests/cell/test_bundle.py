"""Cells of one's own as one value: the same from a folder, a zip and a document, and nothing that leads elsewhere."""

from __future__ import annotations

import copy
import io
import itertools
import json
import math
import random
import stat
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from planners.cell import bundle as bundle_module
from planners.cell.bundle import CellBundle
from planners.certify import load_surfaces
from planners.errors import AssetError
from planners.survey.faults import load_checked
from tests.cell.urdf_arms import INDUSTRIAL_AXES, INDUSTRIAL_TIP, UrdfArm
from tests.geometry.mesh_shapes import file_of
from tests.support.own_cell import (
    INDUSTRIAL,
    furnished,
    furnished_files,
    own_robot,
    station,
    station_files,
    written,
    zipped,
)
from tests.support.samples import sample

MUTATIONS = 300


def test_a_folder_a_zip_a_document_and_a_file_among_others_are_the_same_cell(tmp_path: Path) -> None:
    for name, content in station_files().items():
        path = tmp_path / "assets" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    in_parts = CellBundle.read(tmp_path / "assets")
    assert CellBundle.read(tmp_path / "assets/cells/station.yaml").digest == in_parts.digest
    assert CellBundle.of_zip(zipped(station_files())).digest == in_parts.digest
    in_a_folder = {f"station-1.0/{name}": content for name, content in station_files().items()}
    assert CellBundle.of_zip(zipped({**in_a_folder, "__MACOSX/._x": b"?"})).digest == in_parts.digest
    assert CellBundle.of_zip(in_parts.zip()).digest == in_parts.digest
    assert in_parts.zip() == CellBundle.of_zip(in_parts.zip()).zip()
    whole = CellBundle.of_text(written(station()))
    assert sorted(whole.files) == sorted(in_parts.files)
    cells = [each.load(tmp_path / "unpacked") for each in (in_parts, whole)]
    assert cells[0].hash == cells[1].hash
    assert cells[0].name == cells[1].name == whole.name == "station"


def test_every_part_may_stand_in_the_document_itself(tmp_path: Path) -> None:
    stick = {
        "name": "short_stick",
        "kind": "stick",
        "mass": 0.2,
        "com": 0.06,
        "tip_distance": 0.20,
        "tip_radius": 0.012,
        "stick_radius": 0.012,
        "tip_length": 0.01,
        "sensor": {
            "name": "flat",
            "radius": 0.04,
            "length": 0.02,
            "mass": 0.2,
            "force_max": 300.0,
            "torque_max": 30.0,
            "rate": 500.0,
            "force_noise": 0.2,
            "torque_noise": 0.01,
        },
    }
    document = station()
    document["arms"]["left"]["hand"] = stick
    cell = CellBundle.of_text(written(document)).load(tmp_path)
    assert cell.arms["left"].hand.name == "short_stick"
    assert cell.arms["left"].hand.mass == pytest.approx(0.4)


@pytest.mark.slow
def test_links_may_have_meshes_of_ones_own_in_any_format(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.1, 0.1, 0.2))
    shapes = {}
    for kind in ("stl", "obj", "ply", "glb"):
        files = {**station_files(), f"meshes/wrist.{kind}": file_of(box, kind)}
        robot = {**own_robot(), "name": "ur10e"}
        mesh = {"path": f"meshes/wrist.{kind}", "scale": 0.5}
        robot["links"][6] = {"name": "wrist_3", "position": [0, 0, 0], "rpy_deg": [0, 0, 0], "mesh": mesh}
        files["robots/ur10e.yaml"] = written(robot)
        cell = CellBundle.of_zip(zipped(files)).load(tmp_path)
        shapes[kind] = cell.arms["left"].robot.links[6].points
        np.testing.assert_allclose(np.ptp(shapes[kind], axis=0), [0.05, 0.05, 0.1], atol=1e-6)
        # The certificate finds and reads the file by itself.
        (hull,) = load_surfaces({"left": ("ur10e", "pushing_stick_ft300")}, cell.shelf.folders)["left"].links[6]
        np.testing.assert_allclose(np.ptp(hull.vertices, axis=0), [0.05, 0.05, 0.1], atol=1e-6)


@pytest.mark.parametrize("left", ["empty", "gone"])
def test_what_a_loss_of_power_has_left_in_part_is_unpacked_anew(tmp_path: Path, left: str) -> None:
    """The folder's name may be there, and its files not, or not what was written into them."""
    bundle = CellBundle.of_text(written(station()))
    place = bundle.unpack(tmp_path)
    for name in bundle.files:
        if left == "empty":
            (place / name).write_bytes(b"")
        else:
            (place / name).unlink()
    assert bundle.unpack(tmp_path) == place
    assert {name: (place / name).read_bytes() for name in bundle.files} == dict(bundle.files)
    assert [path.name for path in tmp_path.iterdir()] == [place.name]


def test_what_is_unpacked_twice_is_unpacked_once_and_nothing_is_left_of_a_failure(tmp_path: Path) -> None:
    bundle = CellBundle.of_text(written(station()))
    first = bundle.unpack(tmp_path)
    marks = {path: path.stat().st_mtime_ns for path in first.rglob("*")}
    assert bundle.unpack(tmp_path) == first
    assert {path: path.stat().st_mtime_ns for path in first.rglob("*")} == marks
    assert list(tmp_path.iterdir()) == [first]


def linked() -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        entry = zipfile.ZipInfo("meshes/link.stl")
        entry.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(entry, "/etc/passwd")
        archive.writestr("cell.yaml", written(station()))
    return packed.getvalue()


WHOLE = written(station())
REFUSED = {
    "no zip": (b"PK\x03\x04", "the zip cannot be read"),
    "an empty zip": (zipped({}), "none was found"),
    "no cell": (zipped({"mounts/x.yaml": b"name: x"}), "none was found"),
    "two cells": (zipped({"cells/a.yaml": b"name: a", "cells/b.yaml": b"name: b"}), "2 were found"),
    "a way out": (zipped({"../evil.yaml": b"", "cell.yaml": WHOLE}), "../evil.yaml: cannot be called so"),
    "a way out further down": (zipped({"a/../../evil": b"", "cell.yaml": WHOLE}), "cannot be called so"),
    "an absolute path": (zipped({"/etc/evil": b"", "cell.yaml": WHOLE}), "cannot be called so"),
    "a path of another system": (zipped({"a\\..\\evil": b"", "cell.yaml": WHOLE}), "cannot be called so"),
    "a hidden file": (zipped({".ssh/keys": b"", "cell.yaml": WHOLE}), "cannot be called so"),
    "a link": (linked(), "meshes/link.stl: is a link"),
    "a mapping that is none": (zipped({"cell.yaml": b"[1, 2]"}), "cell.yaml: must be a mapping"),
    "no YAML": (zipped({"cell.yaml": b"a: [1"}), "cell.yaml: the file is not YAML"),
    "no name": (zipped({"cell.yaml": b"mount: x"}), "cell.yaml: /name: must be 1 to 64"),
    "a name that leads elsewhere": (zipped({"cell.yaml": b"name: ../x"}), "/name: must be 1 to 64"),
    "a name that is not the file's": (zipped({"cells/a.yaml": b"name: b"}), "/name: must be that of the file"),
    "a bomb of aliases": (
        zipped({"cell.yaml": b"a: &a [1,1,1,1,1,1,1,1,1,1]\n" + b"".join(
            b"%c: &%c [%s]\n" % (c, c, b",".join([b"*%c" % (c - 1)] * 10)) for c in range(ord("b"), ord("i")))}),
        "more than 100000 values",
    ),
    "a file where a folder is needed": (
        zipped({"cell.yaml": WHOLE, "cells": b""}), "cells: is a file, and cannot be the folder that cells/station.yaml"
    ),
    "a file and a folder of one name": (
        zipped({"cell.yaml": WHOLE, "meshes": b"", "meshes/x.stl": b""}), "meshes: is a file, and cannot be the folder"
    ),
    "a long text": (zipped({"cell.yaml": b"#" * 1_000_001}), "has 1000001 bytes"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "reason"), REFUSED.values(), ids=REFUSED.keys())
def test_a_zip_that_is_no_cell_is_refused_with_the_reason(content: bytes, reason: str, tmp_path: Path) -> None:
    with pytest.raises(AssetError) as caught:
        CellBundle.of_zip(content).load(tmp_path)
    assert reason in str(caught.value)


def test_a_urdf_that_cannot_be_used_is_no_broken_zip(tmp_path: Path) -> None:
    """Neither a corner of a mesh that is no number, nor numbers beyond what a file of a cell may have."""
    files = furnished_files()
    stl = bytearray(files["arm/link.stl"])
    stl[100:104] = b"\0\0\xc0\x7f"
    for broken in ({"arm/link.stl": bytes(stl)}, {"arm/arm.urdf": files["arm/arm.urdf"].replace(b'"120"', b'"1e6"')}):
        with pytest.raises(AssetError) as caught:
            CellBundle.of_zip(zipped({**files, **broken})).load(tmp_path)
        assert "zip cannot be read" not in str(caught.value)
        assert {fault.file for fault in caught.value.faults} == {"arm/arm.urdf"}
        assert all(fault.detail.startswith(("link 'l", "joint 'j")) for fault in caught.value.faults)


def test_files_with_other_names_are_left_out_and_a_urdf_may_have_meshes_so_called(tmp_path: Path) -> None:
    files = furnished_files()
    plain = CellBundle.of_zip(zipped(files))
    files |= {"Maßblatt.pdf": b"", "drawings/as built.dwg": b"", "arm/the link.stl": files.pop("arm/link.stl")}
    files["arm/arm.urdf"] = files["arm/arm.urdf"].replace(b"link.stl", b"the link.stl")
    for name, content in files.items():
        path = tmp_path / "given" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    for bundle in (CellBundle.of_zip(zipped(files)), CellBundle.read(tmp_path / "given")):
        assert [note.partition(" is left out")[0] for note in sorted(bundle.notes)] == [
            "'Maßblatt.pdf'", "'arm/the link.stl'", "'drawings/as built.dwg'"
        ]  # fmt: skip
        assert bundle.load(tmp_path / "unpacked").hash == plain.load(tmp_path / "unpacked").hash


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_file_that_is_there_twice_is_refused() -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("cell.yaml", WHOLE)
        archive.writestr("cell.yaml", WHOLE)
    with pytest.raises(AssetError, match=r"cell\.yaml: is in the zip twice"):
        CellBundle.of_zip(packed.getvalue())


def test_a_bomb_ends_at_the_limit_whatever_it_says_of_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bundle_module, "MOST_BYTES", 100_000)
    honest = zipped({"cell.yaml": WHOLE, "meshes/x.stl": bytes(1_000_000)})
    with pytest.raises(AssetError, match="100000"):
        CellBundle.of_zip(honest)
    # The size in the directory at the end, and in the head of the file itself.
    lying = honest.replace((1_000_000).to_bytes(4, "little"), (10).to_bytes(4, "little"))
    with pytest.raises(AssetError):
        CellBundle.of_zip(lying)
    with pytest.raises(AssetError, match="more than 500 files"):
        CellBundle.of_zip(zipped({f"a{i}": b"" for i in range(501)}, zipfile.ZIP_STORED))


def test_all_faults_of_all_files_are_told_at_once_by_the_names_that_they_have_in_the_bundle(tmp_path: Path) -> None:
    files = station_files()
    mount = json.loads(files["mounts/station_mount.yaml"])
    mount["table"]["size"][0] = -1.0
    mount["arms"]["left"]["home_deg"][2] = "straight"
    cell = json.loads(files["cells/station.yaml"])
    cell["arms"]["right"] = {"robot": "ur99", "hand": "hook"}
    files |= {"mounts/station_mount.yaml": written(mount), "cells/station.yaml": written(cell)}
    with pytest.raises(AssetError) as caught:
        CellBundle.of_zip(zipped(files)).load(tmp_path)
    told = {(fault.file, fault.pointer) for fault in caught.value.faults}
    assert told == {
        ("mounts/station_mount.yaml", "/table/size/0"),
        ("mounts/station_mount.yaml", "/arms/left/home_deg/2"),
        ("cells/station.yaml", "/arms/right/robot"),
        ("cells/station.yaml", "/arms/right/hand"),
    }


VALUES = (None, True, -1, 0, 1e308, math.nan, math.inf, "", "x" * 100, "../x", [], {}, [1, 2], {"name": "x"}, 3.7)


def mutated(document: dict[str, Any], chance: random.Random) -> dict[str, Any]:
    """Return a document with a member replaced, removed or added somewhere."""
    document = copy.deepcopy(document)
    places = list(_places(document))
    holder, key = chance.choice(places)
    kind = chance.randrange(4)
    if kind == 0 and isinstance(holder, dict):
        del holder[key]
    elif kind == 1 and isinstance(holder, dict):
        holder[f"{key}_"] = holder[key]
    elif isinstance(holder[key], int | float) and kind == 2:
        holder[key] *= chance.choice((-1, 0, 10, 1e6, 1e-6))
    else:
        holder[key] = chance.choice(VALUES)
    return document


def _places(document: Any) -> Iterator[tuple[Any, Any]]:
    members = document.items() if isinstance(document, dict) else enumerate(document)
    for key, value in members:
        yield document, key
        if isinstance(value, dict | list):
            yield from _places(value)


def spoiled(content: bytes, chance: random.Random) -> bytes:
    """Return bytes of which some are gone, others or there twice."""
    spoiled, at = bytearray(content), chance.randrange(len(content))
    match chance.randrange(3):
        case 0:
            return bytes(spoiled[:at])
        case 1:
            for _ in range(chance.randrange(1, 8)):
                spoiled[chance.randrange(len(spoiled))] = chance.randrange(256)
        case _:
            spoiled[at:at] = spoiled[at : at + 40]
    return bytes(spoiled)


def spoiled_cells(chance: random.Random) -> Iterator[Callable[[], CellBundle]]:
    """Yield what reads cells of which something is wrong, in documents, in archives, and in files within them."""
    whole, own, files = zipped(station_files()), furnished(), furnished_files()
    while True:
        plain = written(mutated(station(), chance))
        yield partial(CellBundle.of_text, plain)
        changed = {**files, "cell.yaml": written(mutated(own, chance))}
        yield partial(CellBundle.of_zip, zipped(changed))
        yield partial(CellBundle.of_zip, spoiled(whole, chance))
        name = chance.choice([name for name in files if name != "cell.yaml"])
        yield partial(CellBundle.of_zip, zipped({**files, name: spoiled(files[name], chance)}))


@pytest.mark.slow
def test_whatever_is_wrong_with_a_cell_is_told_as_a_fault_and_nothing_is_written_elsewhere(tmp_path: Path) -> None:
    folder, refused = tmp_path / "cells", list[AssetError]()
    count = sample(80, MUTATIONS)
    for read in itertools.islice(spoiled_cells(random.Random(16)), count):
        try:
            load_checked(read(), folder)
        except AssetError as error:
            refused.append(error)
    assert len(refused) > count // 2
    for fault in (fault for error in refused for fault in error.faults):
        assert fault.detail
        assert "pydantic" not in fault.detail
        assert str(tmp_path) not in f"{fault.file} {fault.detail}"
    assert {path.name for path in tmp_path.iterdir()} <= {"cells"}


@pytest.mark.parametrize("links", [[5] * 7, [None] * 7, 5, ["cylinders"] * 7, [["pieces"]] * 7])
def test_links_that_are_no_mappings_are_told_so(links: Any, tmp_path: Path) -> None:
    document = furnished()
    document["arms"]["left"]["robot"]["links"] = links
    document["mount"]["platform"] = {}
    with pytest.raises(AssetError) as caught:
        CellBundle.of_text(written(document)).load(tmp_path)
    assert all("/links" in fault.pointer for fault in caught.value.faults)


@pytest.mark.slow
def test_what_would_take_for_ever_is_refused(tmp_path: Path) -> None:
    """As many bodies that pairs of them fill the memory, and a hand whose fingers open for kilometres."""
    document = furnished()
    document["arms"]["right"]["hand"]["width_max"] = 9999.0
    document["mount"]["frame"]["columns"] = [[5.0 + i, 30.0] for i in range(3000)]
    box = {"center": [9.0, 0.0, 0.5], "size": [0.1, 0.1, 0.1]}
    document["mount"]["platform"] = {f"box_{i}": box for i in range(3000)}
    with pytest.raises(AssetError) as caught:
        CellBundle.of_text(written(document)).load(tmp_path)
    told = {fault.pointer.rpartition("/")[2] for fault in caught.value.faults}
    assert told == {"width_max", "columns", "platform"}


def urdf_files(**changes: Any) -> dict[str, bytes]:
    """Return the station with arms from a URDF that is among its files."""
    robot = {**INDUSTRIAL, **changes}
    cell = station()
    for side in ("left", "right"):
        cell["arms"][side]["robot"] = "industrial"
    arm = UrdfArm(INDUSTRIAL_AXES, INDUSTRIAL_TIP)
    return {"cell.yaml": written(cell), "robots/industrial.yaml": written(robot), "arm/arm.urdf": arm.write()}


def test_an_arm_may_come_as_a_urdf_among_the_files(tmp_path: Path) -> None:
    bundle = CellBundle.of_zip(zipped(urdf_files()))
    cell = bundle.load(tmp_path)
    robot = cell.arms["left"].robot
    assert (robot.name, robot.payload) == ("industrial", 12.0)
    np.testing.assert_allclose(robot.acceleration_max, INDUSTRIAL["acceleration"])
    # What is sent back says the same without being made again.
    again = CellBundle.of_zip(bundle.zip())
    assert again.digest == bundle.digest
    assert again.load(tmp_path).hash == cell.hash


@pytest.mark.parametrize(
    ("changes", "file", "pointer", "detail"),
    [
        ({"urdf": "arm/other.urdf"}, "robots/industrial.yaml", "/urdf", "there is no file arm/other.urdf"),
        ({"payload": -1.0}, "robots/industrial.yaml", "/payload", "greater than 0"),
        ({"acceleration": [1.0]}, "robots/industrial.yaml", "/acceleration", "1 are listed; 6 are needed"),
        ({"torque": [1e5, 1, 1, 1, 1, 1]}, "robots/industrial.yaml", "/torque/0", "less than or equal to 10000"),
        ({"tip": "hand"}, "robots/industrial.yaml", "/tip", "there is no link 'hand'; there are: l0, l1"),
    ],
)
def test_what_is_wrong_with_a_urdf_or_with_what_is_said_of_it_is_told(
    changes: dict[str, Any], file: str, pointer: str, detail: str, tmp_path: Path
) -> None:
    with pytest.raises(AssetError) as caught:
        CellBundle.of_zip(zipped(urdf_files(**changes))).load(tmp_path)
    (fault,) = caught.value.faults
    assert (fault.file, fault.pointer) == (file, pointer)
    assert detail in fault.detail
