"""Robots, hands, mounts, cells and tasks as data; README.md tells where each number comes from."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path


def assets_folder() -> Path:
    """Return the folder that this package ships its files in."""
    return Path(str(files(__name__)))
