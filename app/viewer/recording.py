"""One file that plays a plan with its curves, offline, to be archived or mailed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from app.viewer.page import recorded_page
from app.viewer.room import Room
from app.viewer.sources import Sources

PICTURES_PER_SECOND = 30.0
MOST_PICTURES = 3000
"""A longer plan is recorded with fewer pictures a second."""


def record(room: Room, sources: Sources, story: Mapping[str, Any]) -> str:
    """Return the page of a plan that is in a room."""
    durations = sources.durations
    step = max(1.0 / PICTURES_PER_SECOND, sum(durations.values()) / MOST_PICTURES)
    scene, begins = room.record(durations, step)
    return recorded_page(story, scene, begins)
