"""Takes the README's pictures of the viewer anew: `python tests/viewer/take_screenshots.py [NAME ...]`, into docs/."""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from playwright.sync_api import Browser, Page, ViewportSize, expect

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS.parent), str(TESTS)]

from tests.support.browser import running_browser, wait_for_plan  # noqa: E402
from tests.support.scan_frames import shipped  # noqa: E402
from tests.support.service import finished, running_service, task  # noqa: E402

DOCS = TESTS.parent / "docs"
WINDOW: ViewportSize = {"width": 1366, "height": 768}
"""A laptop's."""
DRAWING_MILLISECONDS = 30e3
"""Until the scene has faded in and is drawn at its full sharpness, without a graphics card."""
PHONE: ViewportSize = {"width": 390, "height": 844}
FULL_DRAWING = "localStorage.setItem('liftwright light', 'false')"
"""Without a graphics card the pages would draw lightly."""
EDITOR, COMPARISON = "editor", "comparison"
"""Names of the pictures of a lift that is changed after it was planned, and of it beside what it was before."""
SCENE = "viewer-scene"
"""Name of the picture of the scan that is shipped."""
STUDY, PLACES, EDGE = "study-viewer", 12, 0.12
"""Name of the picture of a map of cup places; how many it has along each side, the outermost from the middle [m]."""
TILES, FEW_PLACES = "study-scene", 4
"""Name of the picture of a map on the plate of a plan, and how many places it has along each side."""


@dataclass(frozen=True)
class Shot:
    """One picture of a plan."""

    task: str
    deed: str
    """What is done in its page."""
    window: ViewportSize
    colours: Literal["light", "dark"] = "light"


SHOTS = {
    "viewer": Shot("ab1", "player.seek(0.87 * player.source.duration)", WINDOW),
    "viewer-phone": Shot("ab1", "player.seek(0.6 * player.source.duration), showPane('charts')", PHONE, "dark"),
    "viewer-remedies": Shot("ab1_under_beams", "", WINDOW),
    "viewer-lift": Shot(
        "ab1",
        "player.choose('simulation'), player.seek(0.9 * player.source.duration), player.panel.open('Lift')",
        WINDOW,
    ),
    "viewer-suction": Shot(
        "tissue_pile_short_tool",
        "player.panel.open('Regrasp'),"
        "player.seek(player.source.segments.find(({ kind }) => kind === 'handover').start)",
        WINDOW,
    ),
    "viewer-regrasp": Shot(
        "tissue_pile_short_tool",
        "player.panel.open('Regrasp'), player.panel.regrasp.choose('tissue_box_2'), player.panel.regrasp.toggle(true)",
        WINDOW,
    ),
}
"""By name of the picture."""


def main(wanted: list[str]) -> None:
    """Plan the tasks with the real service and photograph them; without names all of them."""
    with (
        tempfile.TemporaryDirectory() as data,
        running_service(Path(data), None) as service,
        service.client() as client,
        running_browser(draws=True) as browser,
    ):

        def open_page(address: str, window: ViewportSize, colours: Literal["light", "dark"] = "light") -> Page:
            page = browser.new_page(viewport=window, color_scheme=colours)
            page.add_init_script(FULL_DRAWING)
            page.goto(service.address + address)
            return page

        for name, shot in SHOTS.items():
            if wanted and name not in wanted:
                continue
            posted = client.post("/v1/plans", json=task(f"{shot.task}.json"), headers={"Idempotency-Key": shot.task})
            plan = finished(client, posted.json())
            page = open_page(plan["links"]["view"], shot.window, shot.colours)
            wait_for_plan(page, shot.task)
            page.wait_for_timeout(DRAWING_MILLISECONDS)
            page.evaluate(shot.deed or "null")
            page.wait_for_timeout(DRAWING_MILLISECONDS)
            page.screenshot(path=DOCS / f"{name}.png")
            page.close()
        if not wanted or {EDITOR, COMPARISON} & set(wanted):
            photograph_editor(browser, service.address)
        if not wanted or TILES in wanted:
            study = finished(client, client.post("/v1/studies", json=study_of_cup(FEW_PLACES)).json())
            best = client.get(study["links"]["map"]).json()["best"]
            plan = finished(client, client.post(f"{study['links']['points']}/{best['index']}/plan").json())
            page = open_page(f"/viewer/?plan={plan['id']}&study={study['id']}", WINDOW)
            page.locator("#study-told").wait_for(timeout=DRAWING_MILLISECONDS)
            page.wait_for_timeout(DRAWING_MILLISECONDS)
            page.evaluate("connection.look('close')")
            page.wait_for_timeout(DRAWING_MILLISECONDS)
            page.screenshot(path=DOCS / f"{TILES}.png")
            page.close()
        if not wanted or STUDY in wanted:
            study = client.post("/v1/studies", json=study_of_cup(PLACES)).json()
            page = open_page(study["links"]["view"], WINDOW)
            expect(page.locator("#state")).to_contain_text(f"{PLACES**2} of {PLACES**2} points", timeout=300e3)
            page.locator("#drawing .cell.best").click()
            page.wait_for_timeout(DRAWING_MILLISECONDS)
            page.screenshot(path=DOCS / f"{STUDY}.png")
            page.close()
        if not wanted or SCENE in wanted:
            scene = client.post("/v1/scenes", files=shipped().form()).json()
            page = open_page(scene["links"]["view"], WINDOW)
            page.wait_for_function("perceived.description")
            page.wait_for_timeout(DRAWING_MILLISECONDS)
            page.screenshot(path=DOCS / f"{SCENE}.png")


def study_of_cup(places: int) -> dict[str, Any]:
    """Return a study of the cup at so many places along each side of AB1's plate."""
    axes = [{"pointer": f"/cup/position/{axis}", "min": -EDGE, "max": EDGE, "count": places} for axis in (0, 1)]
    return {"task": task("ab1.json"), "axes": axes}


def photograph_editor(browser: Browser, address: str) -> None:
    """Plan an example in the editor, change it, plan it again, and compare the two."""
    context = browser.new_context(viewport=WINDOW)
    context.set_default_timeout(300e3)
    context.add_init_script(FULL_DRAWING)
    page = context.new_page()
    page.goto(f"{address}/viewer/new?example=ab1")
    page.locator("#check-status.yes").wait_for()
    page.locator("#plan").click()
    page.locator("#plan-status .solved").wait_for()
    page.evaluate("editor.draft.set('/plate/mass', 3)")
    page.locator("#check-status.yes").wait_for()
    page.locator("#plan").click()
    page.locator("#plan-status .solved").wait_for()
    compared = page.get_by_role("link", name="Compare with the plan before").get_attribute("href")
    page.locator("#things [data-pointer='/cup/position']").click()
    page.keyboard.press("ArrowUp")
    page.keyboard.press("ArrowRight")
    page.wait_for_timeout(DRAWING_MILLISECONDS)
    page.screenshot(path=DOCS / f"{EDITOR}.png")
    page.goto(f"{address}/viewer/{compared}")
    page.wait_for_function("comparison.sides.every(({ description, task }) => description && task)")
    page.evaluate("comparison.seek(0.5 * comparison.duration)")
    page.wait_for_timeout(DRAWING_MILLISECONDS)
    page.screenshot(path=DOCS / f"{COMPARISON}.png")
    context.close()


if __name__ == "__main__":
    main(sys.argv[1:])
