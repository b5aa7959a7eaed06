"""Three folders, one direction: app, workers, planners."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from importlib.metadata import packages_distributions, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.support.syntax import nodes_of, tree_of

ROOT = Path(__file__).resolve().parents[2]
FORBIDDEN = {
    "planners": {
        *("app", "workers", "fastapi", "starlette", "uvicorn", "httpx", "dbos", "sqlalchemy", "sqlite3"),
        *(
            "pybullet",
            "viser",
            "os",
            "time",
            "datetime",
            "logging",
            "structlog",
            "rich",
            "random",
            "socket",
            "subprocess",
        ),
    },
    "workers": {"app", "fastapi", "starlette", "uvicorn", "viser"},
    "assets": {"app", "workers", "planners"},
}
EXCEPTED = {"planners/planning.py": {"time"}}
"""The public surface tells how long each stage took; the planners below it take a clock, and decide nothing by it."""


@cache
def imported_packages(path: Path) -> set[str]:
    return {name.split(".")[0] for name in _imported_modules(path)}


def _imported_modules(path: Path) -> Iterator[str]:
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield node.module


@pytest.mark.parametrize("folder", FORBIDDEN)
def test_a_folder_imports_only_what_lies_below_it(folder: str) -> None:
    bad = {
        str(path.relative_to(ROOT)): sorted(found)
        for path in (ROOT / folder).rglob("*.py")
        if (found := imported_packages(path) & FORBIDDEN[folder] - EXCEPTED.get(str(path.relative_to(ROOT)), set()))
    }
    assert bad == {}


MOST_MODULES = 16
"""In one folder, its `__init__` with them."""
PRODUCT = ("app", "workers", "planners")
LAYERS = {
    "planners": (
        ("errors", "progress"),
        ("geometry",),
        ("contract", "kinematics"),
        ("plan", "collision", "balance"),
        ("cell", "graph", "motion"),
        ("scene", "hands"),
        ("manipulation", "regrasp", "perception", "certify", "survey"),
        ("lifting", "remedies"),
        ("planning",),
        ("study", "program"),
    ),
    "workers": (
        ("settings", "software", "loading", "processor", "kept_files"),
        ("simulation", "stores", "robot"),
        ("solver", "webhooks"),
        ("engine",),
    ),
    "app.viewer": (
        ("palette", "playback"),
        ("drawing",),
        ("description",),
        ("page",),
    ),
}
"""From the lowest up; parts of one layer do not know each other. Of the viewer, those beside its servers."""


def _name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


@cache
def _imports_of_each_module() -> dict[str, set[str]]:
    """Which modules of the product each of them imports, wherever in its file."""
    paths = {_name(path): path for folder in PRODUCT for path in (ROOT / folder).rglob("*.py")}
    found: dict[str, set[str]] = {}
    for name, path in paths.items():
        named = set(_imported_modules(path))
        for node in nodes_of(path):
            if isinstance(node, ast.ImportFrom) and node.module is not None:
                named |= {f"{node.module}.{each.name}" for each in node.names}
        found[name] = (named & paths.keys()) - {name}
    return found


def test_no_module_imports_itself_by_way_of_others() -> None:
    imports = _imports_of_each_module()
    # Whoever imports nothing that is left is taken away, until only circles and what leads to them are left.
    left = imports
    while free := {name for name, needed in left.items() if not needed & left.keys()}:
        left = {name: needed for name, needed in left.items() if name not in free}
    assert {name: sorted(needed & left.keys()) for name, needed in left.items()} == {}


@pytest.mark.parametrize("folder", LAYERS)
def test_no_part_imports_what_stands_above_it(folder: str) -> None:
    height = {part: layer for layer, parts in enumerate(LAYERS[folder]) for part in parts}
    # What stands beside the ranked parts may import them and is imported by none of them.
    ranked, height = height.keys(), defaultdict(lambda: len(LAYERS[folder]), height)
    bad = [
        f"{name} imports {each}"
        for name, needed in _imports_of_each_module().items()
        for each in sorted(needed)
        if name.startswith(f"{folder}.") and each.startswith(f"{folder}.")
        for part, other in [tuple(path.removeprefix(f"{folder}.").split(".")[0] for path in (name, each))]
        if part != other and part in ranked and height[part] <= height[other]
    ]
    assert bad == []


def test_a_module_of_the_tests_has_one_name() -> None:
    """Imported by two names, it would be two modules: what one is told, the other would not know."""
    parts = {path.stem for path in (ROOT / "tests").iterdir()}
    imported = re.compile(rf"^\s*(?:from|import) ({'|'.join(parts)})\b", re.MULTILINE)
    double = [
        path
        for path in (ROOT / "tests").rglob("*.py")
        # A script that is run by itself finds what lies beside it.
        for part in imported.findall(path.read_text())
        if not path.with_name(f"{part}.py").exists()
    ]
    assert not double


def test_no_folder_has_more_modules_than_can_be_taken_in_at_a_glance() -> None:
    folders = [path for top in PRODUCT for path in [ROOT / top, *(ROOT / top).rglob("*/")] if path.name != "versions"]
    modules = {str(path.relative_to(ROOT)): len([*path.glob("*.py")]) for path in folders}
    assert {folder: count for folder, count in modules.items() if count > MOST_MODULES} == {}


def test_no_two_classes_or_types_have_one_name() -> None:
    homes: dict[str, list[str]] = {}
    for path in (path for folder in PRODUCT for path in (ROOT / folder).rglob("*.py")):
        for node in tree_of(path).body:
            names = [node.name] if isinstance(node, ast.ClassDef) else []
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                name = node.targets[0].id
                # An alias of a type is written as a class is; constants are in capitals.
                names = [name] if name[0].isupper() and not name.isupper() else []
            for name in names:
                homes.setdefault(name, []).append(str(path.relative_to(ROOT)))
    assert {name: found for name, found in homes.items() if len(found) > 1} == {}


def plainly_installed() -> set[str]:
    """What `pip install liftwright[postgres]` brings: the run-time dependencies and what they need in turn."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = [*project["dependencies"], *project["optional-dependencies"]["postgres"]]
    found: set[str] = set()
    while asked:
        wanted = Requirement(asked.pop())
        name = canonicalize_name(wanted.name)
        if name not in found and (wanted.marker is None or wanted.marker.evaluate({"extra": ""})):
            found.add(name)
            asked += requires(name) or ()
    return found


@pytest.mark.parametrize("folder", ["app", "workers", "planners"])
def test_what_the_product_imports_comes_with_a_plain_install(folder: str) -> None:
    """A package that only the dev extra brings is missing on every machine but the developers'."""
    # Pinocchio installs itself below a prefix, where the index of packages does not look.
    brought_by = {"pinocchio": ["pin"], **packages_distributions()}
    installed = plainly_installed()
    ours = set(sys.stdlib_module_names) | {"app", "workers", "planners", "assets"}
    bad = {
        str(path.relative_to(ROOT)): missing
        for path in (ROOT / folder).rglob("*.py")
        if (
            missing := [
                package
                for package in imported_packages(path) - ours
                if not installed & {canonicalize_name(name) for name in brought_by.get(package, ())}
            ]
        )
    }
    assert bad == {}


def test_the_certificate_shares_no_code_with_the_planner() -> None:
    shared = {
        "planners.collision",
        "planners.balance",
        "planners.kinematics",
        "planners.motion",
        "planners.manipulation",
    }
    bad = {
        str(path.relative_to(ROOT)): sorted(found)
        for path in (ROOT / "planners" / "certify").rglob("*.py")
        if (found := {m for m in _imported_modules(path) if m.startswith(tuple(shared))})
    }
    assert bad == {}


def test_planners_keep_no_state_of_their_own() -> None:
    """No `global`, and no module-level list, dict or set that somebody could write to."""
    bad = []
    for path in (ROOT / "planners").rglob("*.py"):
        bad += [f"{path}: global" for node in nodes_of(path) if isinstance(node, ast.Global)]
        for node in tree_of(path).body:
            target = node.targets[0] if isinstance(node, ast.Assign) else None
            name = target.id if isinstance(target, ast.Name) else ""
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.List | ast.Dict | ast.Set):
                if not name.isupper() and not name.lstrip("_").isupper() and name != "__all__":
                    bad.append(f"{path}: {name}")
    assert bad == []
