"""Takes the README's pictures of the viewer anew: `python tests/viewer/take_screenshots.py`, into docs/."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from playwright.sync_api import ViewportSize

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS.parent), str(TESTS)]

from support.browser import running_browser, wait_for_plan  # noqa: E402
from support.service import finished, running_service, task  # noqa: E402

from tests.support.scan_frames import shipped  # noqa: E402

DOCS = TESTS.parent / "docs"
WINDOW: ViewportSize = {"width": 1366, "height": 768}
"""A laptop's."""
DRAWING_MILLISECONDS = 30e3
"""Until the scene has faded in and is drawn at its full sharpness, without a graphics card."""
SHOTS = {
    "viewer": ("ab1", "player.seek(0.87 * player.source.duration)"),
    "viewer-lift": (
        "ab1",
        "player.choose('simulation'), player.seek(0.9 * player.source.duration), player.panel.open('Lift')",
    ),
    "viewer-suction": (
        "tissue_pile_short_tool",
        "player.panel.open('Regrasp'),"
        "player.seek(player.source.segments.find(({ kind }) => kind === 'handover').start)",
    ),
    "viewer-regrasp": (
        "tissue_pile_short_tool",
        "player.panel.open('Regrasp'), player.panel.regrasp.choose('tissue_box_2'), player.panel.regrasp.toggle(true)",
    ),
}
"""Name of the picture: task, and what is done in its page."""
SCENE = "viewer-scene"
"""Name of the picture of the scan that is shipped."""


def main() -> None:
    """Plan the tasks with the real service and photograph them."""
    with (
        tempfile.TemporaryDirectory() as data,
        running_service(Path(data), None) as service,
        service.client() as client,
    ):
        with running_browser() as browser:
            for name, (plan_name, deed) in SHOTS.items():
                posted = client.post(
                    "/v1/plans", json=task(f"{plan_name}.json"), headers={"Idempotency-Key": plan_name}
                )
                plan = finished(client, posted.json(), 300.0)
                page = browser.new_page(viewport=WINDOW)
                page.goto(service.address + plan["links"]["view"])
                wait_for_plan(page, plan_name)
                page.wait_for_timeout(DRAWING_MILLISECONDS)
                page.evaluate(deed)
                page.wait_for_timeout(DRAWING_MILLISECONDS)
                page.screenshot(path=DOCS / f"{name}.png")
                page.close()
            scene = client.post("/v1/scenes", files=shipped().form()).json()
            page = browser.new_page(viewport=WINDOW)
            page.goto(service.address + scene["links"]["view"])
            page.wait_for_function("perceived.description")
            page.wait_for_timeout(DRAWING_MILLISECONDS)
            page.screenshot(path=DOCS / f"{SCENE}.png")


if __name__ == "__main__":
    main()
