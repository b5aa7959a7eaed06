"""The house is in order: what its settings name exists, and its texts speak of nothing but the product."""

from __future__ import annotations

import re
import subprocess
import tomllib
from importlib.metadata import version
from itertools import chain
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[2]
BINARY = {".png", ".jpg", ".stl", ".obj", ".glb", ".npz"}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
UNWANTED = {
    "a path of somebody's machine": re.compile(r"(?<![\w.])/(?:work|root|home/\w+|Users|tmp)/"),
    "an address packages come from": re.compile(r"pypi|index-url|extra-index|files\.python" + r"hosted", re.IGNORECASE),
    "an unfinished note": re.compile(r"\b(?:TO" + r"DO|FIX" + r"ME|XX" + r"X)\b"),
}


def tracked_files() -> list[Path]:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [ROOT / name for name in listed.split("\0") if name and (ROOT / name).is_file()]


@pytest.mark.parametrize("what", UNWANTED)
def test_no_file_holds(what: str) -> None:
    bad = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()[:100]}"
        for path in tracked_files()
        if path.suffix not in BINARY and path != Path(__file__)
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if UNWANTED[what].search(line)
    ]
    assert bad == []


def test_every_path_that_tool_settings_name_exists() -> None:
    tools = PROJECT["tool"]
    named = [*tools["basedpyright"]["include"], *tools["pytest"]["ini_options"]["testpaths"]]
    named += [*tools["pytest"]["ini_options"]["pythonpath"], *PROJECT["project"]["license-files"]]
    named += [name for name in tools["ruff"]["lint"]["per-file-ignores"] if "*" not in name]
    named += [f"{name.rstrip('*')}/__init__.py" for name in tools["setuptools"]["packages"]["find"]["include"]]
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_every_dependency_is_locked_within_its_range() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = (line.partition(";")[0].partition("==") for line in lines if "==" in line and line[0] != "#")
    locked = {canonicalize_name(name): Version(number) for name, _, number in pinned}
    extras = PROJECT["project"]["optional-dependencies"].values()
    wanted = [Requirement(text) for text in [*PROJECT["project"]["dependencies"], *chain(*extras)]]
    names = {requirement.name: canonicalize_name(requirement.name) for requirement in wanted}
    assert [each.name for each in wanted if names[each.name] not in locked] == []
    assert [str(each) for each in wanted if locked[names[each.name]] not in each.specifier] == []


def test_the_changelog_begins_with_the_version() -> None:
    first = re.search(r"^## ([\w.]+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert first is not None
    assert first.group(1) == version("liftwright") == PROJECT["project"]["version"]


def test_every_command_of_the_readme_exists() -> None:
    readme = (ROOT / "README.md").read_text()
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert {word for word in re.findall(r"`?make ([a-z]+)", readme)} <= targets
    for path in re.findall(r"\]\((?!http)([^)#]+)", readme):
        assert (ROOT / path).exists(), path


def test_every_module_that_a_text_names_exists() -> None:
    """Decisions tell of modules that there were, and of what was measured likewise."""
    modules = [f"/{path.relative_to(ROOT)}" for path in tracked_files() if path.suffix == ".py"]
    texts = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md"), ROOT / "planners/README.md"]
    named = {(path.name, name) for path in texts for name in re.findall(r"`([\w/]+\.py)`", path.read_text())}
    assert len(named) > 50
    assert sorted(each for each in named if not any(module.endswith(f"/{each[1]}") for module in modules)) == []


def test_decisions_are_dated_and_in_order() -> None:
    dates = re.findall(r"^## (\d{4}-\d\d-\d\d): \S", (ROOT / "DECISIONS.md").read_text(), re.MULTILINE)
    assert dates
    assert dates == sorted(dates)
