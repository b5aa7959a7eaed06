"""The viewer's page: one document, live from the service or with everything inside for a recording."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from html import escape
from importlib import resources
from importlib.metadata import version
from typing import Any

from app.viewer.description.lift_description import LiftDescription
from app.viewer.description.plan_description import KindDescription, PlanDescription
from app.viewer.description.tool_description import ToolDescription
from app.viewer.drawing.camera import RecordedView
from app.viewer.drawing.plan_scene import Gate
from app.viewer.playback import SourceName
from planners.plan.plan import Plan
from workers.robot.execution_log import ExecutedMotion
from workers.software import describe_software

STYLES = ("style.css", "viewer.css")
SCRIPTS = ("page_parts.js", "plot.js", "charts.js", "timeline.js", "regrasp.js", "panel.js", "player.js")
LIVE_SCRIPTS = (*SCRIPTS, "perceived.js", "connection.js", "live.js")
EDITOR_STYLES = ("style.css", "editor.css")
EDITOR_SCRIPTS = ("page_parts.js", "connection.js", "task_fields.js", "task_draft.js", "editor.js")
COMPARE_STYLES = ("style.css", "compare.css")
COMPARE_SCRIPTS = ("page_parts.js", "connection.js", "compare.js")
PAGE_FILES = ("start.js", "login.js", "reference.css", "reference.js", "study.css", "study.js", "cells.css", "cells.js")
"""Of the pages beside the viewer."""
LIVE_FILES = frozenset(
    {*STYLES, *LIVE_SCRIPTS, *EDITOR_STYLES, *EDITOR_SCRIPTS, *COMPARE_STYLES, *COMPARE_SCRIPTS, *PAGE_FILES}
)
"""That pages ask for."""
RECORDED_SCRIPTS = (*SCRIPTS, "recorded.js")
MEDIA_TYPES = {".css": "text/css", ".js": "text/javascript"}
STYLES_MARK, SCRIPTS_MARK = "<!-- styles -->", "<!-- scripts -->"
NEXT_MARK, REFUSAL_MARK = "<!-- next -->", "<!-- refusal -->"
TITLE_MARK, DETAIL_MARK, SIGN_IN_MARK = "<!-- title -->", "<!-- detail -->", "<!-- sign in -->"
BY_KIND: Mapping[str, type[KindDescription]] = {"plate_lift": LiftDescription, "suction_tool": ToolDescription}


@cache
def static_text(name: str) -> str:
    """Return a file of the page.

    Raises:
        FileNotFoundError: There is none of that name.
    """
    return resources.files("app.viewer").joinpath("static", name).read_text(encoding="utf-8")


def live_page() -> str:
    """Return the page that talks to the service."""
    return _linked("page.html", STYLES, LIVE_SCRIPTS)


def editor_page() -> str:
    """Return the page on which a task is made."""
    return _linked("editor.html", EDITOR_STYLES, EDITOR_SCRIPTS)


def compare_page() -> str:
    """Return the page with two plans side by side."""
    return _linked("compare.html", COMPARE_STYLES, COMPARE_SCRIPTS)


def _linked(page: str, styles: Iterable[str], scripts: Iterable[str]) -> str:
    """Return a page that asks the service for its styles and scripts."""
    links = "\n".join(f'<link rel="stylesheet" href="{name}">' for name in styles)
    return _assemble(page, links, "\n".join(f'<script src="{name}"></script>' for name in scripts))


def login_page(wanted: str, refusal: str = "") -> str:
    """Return the page that asks for a key, and then goes to `wanted`."""
    page = static_text("login.html")
    return page.replace(NEXT_MARK, escape(wanted)).replace(REFUSAL_MARK, escape(refusal))


def problem_page(title: str, detail: str, sign_in: str | None = None) -> str:
    """Return the page that tells a person what is wrong, and where to go from there.

    Args:
        title: of what is wrong.
        detail: a sentence about it.
        sign_in: where another key can be shown; None: no keys are asked for.
    """
    way = "" if sign_in is None else f'<a href="{escape(sign_in)}">Sign in with another key</a>'
    page = static_text("problem.html").replace(SIGN_IN_MARK, way)
    return page.replace(TITLE_MARK, escape(title)).replace(DETAIL_MARK, escape(detail))


def describe_plan(plan: Plan, executed: ExecutedMotion | None = None) -> PlanDescription:
    """Return all the page needs of a plan, and of an execution of it, but its scene."""
    return BY_KIND[plan.task.kind](plan, executed).describe()


def recording_software() -> str:
    """Return what changes whenever the same plan would be recorded as another page."""
    software = describe_software()
    files = "".join(static_text(name) for name in ("page.html", *STYLES, *RECORDED_SCRIPTS))
    return f"{software.version} {software.commit} {version('viser')} {hashlib.sha256(files.encode()).hexdigest()}"


@dataclass(frozen=True)
class RecordedScene:
    """A scene that plays by itself, and what another page needs to play it, to hide parts of it, and to look around."""

    page: str
    begins: Mapping[SourceName, float]
    """When in it each source begins [s]."""
    gates: tuple[Gate, ...]
    views: Mapping[str, RecordedView]
    """By the names of the camera's places."""
    moved: tuple[str, ...]
    """Names of the nodes of the bodies that the plan's segments move; the first is there without segments too."""


def recorded_page(description: PlanDescription, scene: RecordedScene) -> str:
    """Return the page of a recording, with all styles and scripts inside.

    Args:
        description: what the page tells.
        scene: what it plays.
    """
    styles = "\n".join(f"<style>{static_text(name)}</style>" for name in STYLES)
    recorded = {"description": description.model_dump(mode="json", by_alias=True), **asdict(scene)}
    data = f"<script>const RECORDED = {_literal(recorded)};</script>"
    scripts = "\n".join(f"<script>{static_text(name)}</script>" for name in RECORDED_SCRIPTS)
    return _assemble("page.html", styles, f"{data}\n{scripts}")


def _assemble(page: str, styles: str, scripts: str) -> str:
    return static_text(page).replace(STYLES_MARK, styles).replace(SCRIPTS_MARK, scripts)


def _literal(value: Any) -> str:
    """Write JSON that may stand inside a script element."""
    return json.dumps(value, ensure_ascii=True, separators=(",", ":")).replace("<", "\\u003c")
