"""All pages at the widths of a screen, a laptop and a phone, light and dark: readable, nothing cut off, no errors."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, expect

from tests.support.browser import (
    LOADING_MILLISECONDS,
    WINDOWS,
    draw_no_scene,
    looks,
    needs_browser,
    running_browser,
    serious_findings,
    wait_for_plan,
)
from tests.support.plan_shelf import PlanShelf
from tests.support.samples import among, sample
from tests.support.service import FAKE_SOLVER, ServiceProcess, finished, running_service, task

PLANS = ("ab1", "pb1_weak_cup")
"""Shipped tasks: a lift with its simulation, and one that cannot be."""
PAGES = ("start", "cells", "reference", "no plan", "editor", "editor of a pile", "comparison", *PLANS)
LONGEST_PAUSE = 6000
"""After which a page asks again at the latest [ms]."""
FINGER = 40
"""Least height of what a finger must hit on a phone [px]; Chromium rounds."""
OVERFLOWING = """() => [...document.querySelectorAll('header, header *, main, main > *, #tabs, #timeline, section')]
    .filter((each) => each.offsetParent && getComputedStyle(each).textOverflow !== 'ellipsis')
    .filter((each) => each.getBoundingClientRect().right > innerWidth + 1 || each.getBoundingClientRect().left < -1)
    .map((each) => each.id || each.className || each.tagName)"""
"""What reaches over the sides of the window."""
BELOW = """() => [...document.querySelectorAll('#scene, #timeline, #panes, #plans, #charts, #panel, main button')]
    .filter((each) => each.offsetParent && each.getBoundingClientRect().bottom > innerHeight + 1)
    .map((each) => each.id || each.textContent)"""
"""What is below the window's lower side."""
LOWEST_SCENE = 185
"""Least height of the scene in a window in which the page scrolls [px]."""

pytestmark = needs_browser


@pytest.fixture(scope="module")
def service(shelf: PlanShelf, data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    folder = tmp_path_factory.mktemp("documents")
    for name in PLANS:
        (folder / f"{name}.json").write_text(json.dumps(shelf.document(task(f"{name}.json"))))
    solver = (sys.executable, "-m", "tests.support.document_solver", str(folder))
    with running_service(data_dir, solver) as service:
        yield service


@pytest.fixture(scope="module")
def addresses(service: ServiceProcess) -> dict[str, str]:
    """Return where the pages are, by name."""
    with service.client() as client:
        plans = [finished(client, client.post("/v1/plans", json=task(external_id=name)).json()) for name in PLANS]
    pages = {"start": "/", "reference": "/docs", "no plan": "/viewer/", "cells": "/viewer/cells?cell=dual_ur3e_tool"}
    pages |= {name: plan["links"]["view"] for name, plan in zip(PLANS, plans, strict=True)}
    pages |= {"editor": f"/viewer/new?plan={plans[0]['id']}", "editor of a pile": "/viewer/new?example=can_stack"}
    pages["comparison"] = f"/viewer/compare?plans={plans[0]['id']},{plans[1]['id']}"
    return {name: service.address + path for name, path in pages.items()}


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with running_browser() as browser:
        yield browser


@pytest.fixture(scope="module")
def window(browser: Browser) -> Iterator[Page]:
    """Return a window without the scene's picture; what its console calls an error fails the module."""
    page = browser.new_context(device_scale_factor=0.5).new_page()
    page.set_default_timeout(LOADING_MILLISECONDS)
    draw_no_scene(page)
    errors: list[str] = []

    def listen(message: ConsoleMessage) -> None:
        if message.type == "error":
            errors.append(message.text)

    page.on("console", listen)
    page.on("pageerror", lambda error: errors.append(str(error)))
    yield page
    assert errors == []


def show(page: Page, name: str, address: str) -> None:
    """Open a page and wait until it says what it has to say."""
    page.goto(address)
    if name in PLANS:
        wait_for_plan(page, name)
    elif name == "reference":
        page.locator(".opblock").first.wait_for()
    elif name == "no plan":
        page.locator("#plan-list li").first.wait_for()
    elif name.startswith("editor"):
        page.locator("#check-status.yes").wait_for()
        page.locator("#task-details summary").click()
    elif name == "comparison":
        page.locator("#tables td").first.wait_for()
    elif name == "cells":
        page.locator("#sentences li").first.wait_for()
    elif name == "start":
        page.locator("#capabilities dd").first.wait_for()


@pytest.mark.parametrize(("name", "scenes"), [("ab1", 1), ("editor", 1), ("comparison", 2)])
def test_a_page_says_that_no_scene_is_drawn_where_none_is(
    name: str, scenes: int, window: Page, addresses: dict[str, str]
) -> None:
    show(window, name, addresses[name])
    told = window.locator(".undrawn")
    expect(told).to_have_count(scenes)
    for each in told.all():
        expect(each).to_contain_text("WebGL")
        expect(each).to_be_visible()


@pytest.mark.parametrize("name", among(PAGES, ["start", "ab1", "editor"]))
def test_a_page_is_readable_and_whole_at_every_width_in_light_and_dark(
    name: str, window: Page, addresses: dict[str, str]
) -> None:
    shown = False
    for scheme, size in looks(PAGES.index(name)):
        window.emulate_media(color_scheme=scheme)
        window.set_viewport_size(size)
        # A window that is made smaller, or dark, has the same page: it is opened anew where everything is tried.
        if not shown or sample(quick=False, whole=True):
            show(window, name, addresses[name])
            shown = True
        where = f"{name}, {scheme}, {size['width']} px"
        assert serious_findings(window) == [], where
        assert window.evaluate(OVERFLOWING) == [], where
        for tab in window.locator("#tabs button:visible").all():
            tab.click()
            assert serious_findings(window) == [], f"{where}, {tab.inner_text()}"


@pytest.mark.slow
def test_the_page_that_asks_for_a_key_is_readable(window: Page, tmp_path: Path) -> None:
    with running_service(tmp_path, FAKE_SOLVER, command="api", authentication="required") as locked:
        for scheme, size in looks(len(PAGES)):
            window.emulate_media(color_scheme=scheme)
            window.set_viewport_size(size)
            window.goto(f"{locked.address}/viewer/")
            assert "/viewer/login" in window.url
            assert serious_findings(window) == []
        window.goto(f"{locked.address}/viewer/compare?plans=a,b#t=3&camera=side")
        expect(window.locator("[name=next]")).to_have_value("/viewer/compare?plans=a,b#t=3&camera=side")


@pytest.mark.slow
def test_on_a_phone_scene_timeline_and_one_of_list_curves_and_panel_are_seen_and_hit(
    window: Page, addresses: dict[str, str]
) -> None:
    window.set_viewport_size(WINDOWS[-1])
    show(window, "ab1", addresses["ab1"])
    panes = {"Plans": "#plans", "Curves": "#charts", "About": "#panel"}
    for name, pane in panes.items():
        window.locator("#panes").get_by_role("button", name=name).click()
        for shown in ("#scene", "#timeline", pane):
            box = window.locator(shown).bounding_box()
            assert box is not None
            assert box["height"] > 60
            assert box["y"] + box["height"] <= WINDOWS[-1]["height"] + 1
        assert not any(window.locator(other).is_visible() for other in panes.values() if other != pane)
    for button in window.locator("#transport button, #panes button, #tabs button").all():
        box = button.bounding_box()
        assert box is None or box["height"] >= FINGER


@pytest.mark.parametrize(
    "size", [(640, 360), (844, 390), (740, 400)], ids=["twice the size", "on its side", "embedded"]
)
def test_in_a_low_window_every_part_of_the_viewer_is_reached_by_scrolling(
    size: tuple[int, int], window: Page, addresses: dict[str, str]
) -> None:
    width, height = size
    window.set_viewport_size({"width": width, "height": height})
    for name in ("ab1", "pb1_weak_cup", "no plan"):
        show(window, name, addresses[name])
        for pane in window.locator("#panes button:visible").all() or [None]:
            if pane is not None:
                pane.click()
            window.evaluate("scrollTo(0, 0)")
            scene = window.locator("#scene").bounding_box()
            assert scene is not None
            assert scene["height"] >= LOWEST_SCENE
            views, now = (window.locator(each).bounding_box() for each in ("#views", "#now"))
            if views is not None and now is not None:
                assert views["y"] + views["height"] <= now["y"]
                assert now["y"] + now["height"] <= scene["y"] + scene["height"]
            # A wheel scrolls what a script could scroll although nobody else can.
            window.mouse.move(0.5 * width, 10.0)
            window.mouse.wheel(0.0, 1e5)
            window.wait_for_function("scrollY + innerHeight >= document.scrollingElement.scrollHeight - 1")
            below = window.evaluate(BELOW)
            assert below == [], f"{name} in {width} x {height}: {below}"


def test_the_start_page_says_so_while_the_service_does_not_answer(browser: Browser, addresses: dict[str, str]) -> None:
    page = browser.new_page()
    page.clock.install()
    page.goto(addresses["start"])
    health = page.locator("#health")
    expect(health).to_have_text("ready")
    page.route("**/readyz", lambda route: route.abort())
    page.clock.run_for(LONGEST_PAUSE)
    expect(health).to_have_text("no connection")
    page.unroute("**/readyz")
    page.clock.run_for(LONGEST_PAUSE)
    expect(health).to_have_text("ready")
    page.close()


@pytest.mark.parametrize("path", ["/", "/docs", "/viewer/"])
def test_a_page_loads_nothing_from_elsewhere(
    path: str, window: Page, service: ServiceProcess, addresses: dict[str, str]
) -> None:
    answer = httpx.get(service.address + path)
    assert "default-src 'self'" in answer.headers["content-security-policy"]
    asked: list[str] = []
    window.on("request", lambda request: asked.append(request.url))
    name = {"/": "start", "/docs": "reference", "/viewer/": "no plan"}[path]
    show(window, name, addresses[name])
    assert asked
    assert all(url.startswith((service.address, "data:", "blob:")) for url in asked)


@pytest.mark.slow
def test_the_start_page_leads_to_viewer_editor_reference_and_health(window: Page, addresses: dict[str, str]) -> None:
    for words, holds in {
        "Viewer": "/viewer/",
        "Editor": "/viewer/new",
        "Interface reference": "/docs",
        "Health": "/readyz",
    }.items():
        show(window, "start", addresses["start"])
        window.get_by_role("link", name=words).click()
        window.wait_for_url(f"**{holds}")
