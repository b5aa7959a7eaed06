"""The viewer in a real browser: load, choose a plan, move through it, side by side, and with no server at all."""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright
from support.service import ServiceProcess, finished, running_service, task, wait_for

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
SOFTWARE_WEBGL = ("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
LOADING_SECONDS = 120.0
"""The first picture waits for the drawings of the robot to be made."""
WINDOW: ViewportSize = {"width": 960, "height": 640}
"""Small: every pixel is drawn without a graphics card."""
PICTURE_SECONDS = 40.0
MOVED_SHARE = 2e-3
"""Share of pixels that differ when something in the scene moved: a wrist covers more."""
LAYER_SHARE = 2e-4
"""The frames' axes are thin."""

pytestmark = pytest.mark.skipif(
    CHROMIUM is None and "CI" not in os.environ, reason="no Chromium on this machine: the viewer cannot be looked at"
)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    with running_service(tmp_path_factory.mktemp("data"), None) as service:
        yield service


@pytest.fixture(scope="module")
def plans(service: ServiceProcess) -> dict[str, dict[str, Any]]:
    """Return the finished plans of three tasks, one of which cannot be planned."""
    names = ("ab1", "pb1", "pb1_weak_cup")
    with service.client() as client:
        posted = {name: client.post("/v1/plans", json=task(f"{name}.json")).json() for name in names}
        return {name: finished(client, plan) for name, plan in posted.items()}


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(SOFTWARE_WEBGL))
        yield browser
        browser.close()


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Callable[..., Page]]:
    """Return a function that opens a window of its own at an address and fails the test on errors of its scripts."""
    contexts = []
    errors: list[str] = []

    def open_(address: str, **options: Any) -> Page:
        contexts.append(browser.new_context(viewport=WINDOW, **options))
        page = contexts[-1].new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(address)
        return page

    yield open_
    for context in contexts:
        context.close()
    assert errors == []


def picture(page: Page) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(page.locator("#scene-frame").screenshot())).convert("RGB"), dtype=int)


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Return the share of pixels that differ visibly."""
    return float((np.abs(a - b).max(axis=2) > 40).mean())


def settled(page: Page) -> np.ndarray:
    """Wait until there is a picture of the scene and it no longer changes, and return it."""
    shots = [picture(page)]

    def still() -> bool:
        page.wait_for_timeout(400)
        shots.append(picture(page))
        colours = len(np.unique(shots[-1].reshape(-1, 3) // 16, axis=0))
        return difference(*shots[-2:]) < 1e-5 and colours > 40

    wait_for(still, LOADING_SECONDS)
    return shots[-1]


def wait_until_it_differs(page: Page, reference: np.ndarray, share: float = MOVED_SHARE) -> None:
    """Wait until more than a share of the pixels differ: without a graphics card a frame takes a while."""
    wait_for(lambda: difference(reference, picture(page)) > share, PICTURE_SECONDS)


def wait_until_it_is_as_before(page: Page, reference: np.ndarray, share: float = MOVED_SHARE) -> None:
    wait_for(lambda: difference(reference, picture(page)) < share, PICTURE_SECONDS)


def wait_for_plan(page: Page, name: str) -> None:
    page.wait_for_function(f"document.getElementById('title').textContent === '{name}'", timeout=1e3 * LOADING_SECONDS)


def drag_to(page: Page, fraction: float) -> None:
    """Put the time slider at a fraction of its length, with the mouse."""
    box = page.locator("#time").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 7 + fraction * (box["width"] - 14), box["y"] + 0.5 * box["height"])


def visible_panels_of_viser(page: Page) -> int:
    panels = page.frame_locator("#scene-frame").locator(".mantine-Paper-root")
    assert panels.count() > 0
    return panels.locator("visible=true").count()


def now_lines(page: Page) -> list[float]:
    return page.locator(".now-line").evaluate_all("lines => lines.map((line) => parseFloat(line.style.left))")


def test_the_slider_moves_robot_and_curves(
    service: ServiceProcess, plans: dict[str, Any], open_page: Callable[..., Page]
) -> None:
    page = open_page(f"{service.address}/viewer/")
    page.locator("#plan-list li", has_text="ab1").first.click()
    wait_for_plan(page, "ab1")
    assert page.locator("#outcome").text_content() == "solved"
    before, lines = settled(page), now_lines(page)
    assert visible_panels_of_viser(page) == 0
    drag_to(page, 0.6)
    wait_until_it_differs(page, before)
    assert len(lines) == 3
    assert all(later > earlier + 20 for earlier, later in zip(lines, now_lines(page), strict=True))
    assert float(page.locator("#clock").inner_text().split()[0]) == pytest.approx(
        0.6 * page.evaluate("player.story.duration"), rel=0.02
    )
    drag_to(page, 0.0)
    wait_until_it_is_as_before(page, before)


def test_a_plan_comes_by_its_view_address_and_plays_to_its_end(
    service: ServiceProcess, plans: dict[str, Any], open_page: Callable[..., Page]
) -> None:
    page = open_page(service.address + plans["pb1"]["links"]["view"])
    wait_for_plan(page, "pb1")
    first = settled(page)
    page.select_option("#speed", "4")
    page.locator("#play").click()
    page.wait_for_function("!player.playing && player.time === player.story.duration", timeout=60_000)
    wait_until_it_differs(page, first)


def test_keys_move_through_time_and_leave_the_camera_alone(
    service: ServiceProcess, plans: dict[str, Any], open_page: Callable[..., Page]
) -> None:
    page = open_page(service.address + plans["ab1"]["links"]["view"])
    wait_for_plan(page, "ab1")
    before = settled(page)
    # The scene has the focus now: without the page's care, arrows would turn the camera.
    page.locator("#scene-frame").click(position={"x": 30, "y": 300})
    page.keyboard.press("Shift+ArrowRight")
    assert page.evaluate("player.time") == pytest.approx(2.0)
    page.keyboard.press("]")
    assert page.evaluate("player.time") == pytest.approx(page.evaluate("player.story.segments[2].start"))
    page.keyboard.press(" ")
    assert page.evaluate("player.playing") is True
    page.keyboard.press(" ")
    page.keyboard.press("Home")
    assert page.evaluate("[player.playing, player.time]") == [False, 0]
    wait_until_it_is_as_before(page, before)


def test_layers_are_shown_on_demand(
    service: ServiceProcess, plans: dict[str, Any], open_page: Callable[..., Page]
) -> None:
    page = open_page(service.address + plans["ab1"]["links"]["view"])
    wait_for_plan(page, "ab1")
    page.evaluate("player.seek(0.95 * player.story.duration)")
    far = settled(page)
    page.get_by_role("button", name="Close").click()
    wait_until_it_differs(page, far)
    for layer in ("cones", "frames", "start", "goal"):
        # Anew each time: viser draws coarser while frames are slow.
        plain = settled(page)
        page.check(f"#layer-{layer}")
        wait_until_it_differs(page, plain, LAYER_SHARE)
        page.uncheck(f"#layer-{layer}")


def test_two_people_watch_two_plans(
    service: ServiceProcess, plans: dict[str, Any], open_page: Callable[..., Page]
) -> None:
    one = open_page(service.address + plans["ab1"]["links"]["view"])
    wait_for_plan(one, "ab1")
    seen_by_one = settled(one)
    other = open_page(service.address + plans["pb1"]["links"]["view"])
    wait_for_plan(other, "pb1")
    wait_until_it_differs(other, seen_by_one)
    seen_by_other = picture(other)
    other.evaluate("player.seek(player.story.duration)")
    wait_until_it_differs(other, seen_by_other)
    assert difference(seen_by_one, settled(one)) < 1e-5
    assert one.evaluate("[player.story.title, player.time]") == ["ab1", 0]


def test_a_plan_that_cannot_be_says_why(
    service: ServiceProcess, plans: dict[str, Any], open_page: Callable[..., Page]
) -> None:
    page = open_page(service.address + plans["pb1_weak_cup"]["links"]["view"])
    wait_for_plan(page, "pb1_weak_cup")
    assert page.locator("#outcome").text_content() == "infeasible"
    assert "needed 62.78 N" in page.locator("#message").inner_text()
    settled(page)


def test_a_plan_deleted_while_it_is_watched_plays_on(service: ServiceProcess, open_page: Callable[..., Page]) -> None:
    with service.client() as client:
        plan = finished(client, client.post("/v1/plans", json=task("ab2.json", external_id="doomed")).json())
        page = open_page(service.address + plan["links"]["view"])
        wait_for_plan(page, "doomed")
        before = settled(page)
        assert client.delete(plan["links"]["self"]).status_code == 204
        page.wait_for_function("!document.querySelector('#plan-list').innerText.includes('doomed')")
        drag_to(page, 0.5)
        wait_until_it_differs(page, before)
        late = open_page(f"{service.address}/viewer/?plan={plan['id']}")
        late.wait_for_function("document.getElementById('message').innerText.includes('there is no plan')")


def test_a_watcher_who_leaves_takes_nothing_along(
    service: ServiceProcess, plans: dict[str, Any], open_page: Callable[..., Page]
) -> None:
    stays = open_page(service.address + plans["ab1"]["links"]["view"])
    wait_for_plan(stays, "ab1")
    before = settled(stays)
    leaves = open_page(service.address + plans["ab1"]["links"]["view"])
    wait_for_plan(leaves, "ab1")
    leaves.locator("#play").click()
    scene = leaves.evaluate("frame.src")
    leaves.close()
    wait_for(lambda: httpx.get(scene).status_code == 404, 20.0)
    drag_to(stays, 0.7)
    wait_until_it_differs(stays, before)


def test_a_recording_plays_with_no_server(
    service: ServiceProcess, plans: dict[str, Any], open_page: Callable[..., Page], tmp_path: Path
) -> None:
    file = tmp_path / "recording.html"
    with service.client() as client:
        file.write_text(client.get(plans["ab1"]["links"]["recording"]).raise_for_status().text, encoding="utf-8")
    page = open_page(file.as_uri(), offline=True)
    wait_for_plan(page, "ab1")
    before, lines = settled(page), now_lines(page)
    assert visible_panels_of_viser(page) == 0
    drag_to(page, 0.6)
    wait_until_it_differs(page, before)
    assert all(later > earlier + 20 for earlier, later in zip(lines, now_lines(page), strict=True))
    drag_to(page, 0.0)
    wait_until_it_is_as_before(page, before)
