"""A real browser for tests: Chromium without a screen and without a graphics card."""

from __future__ import annotations

import gc
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import product
from typing import Any, Literal

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, ViewportSize, expect, sync_playwright

from tests.support.samples import sample

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_browser = pytest.mark.skipif(
    CHROMIUM is None and "CI" not in os.environ, reason="no Chromium on this machine: the viewer cannot be looked at"
)
WITHOUT_SCREEN = ("--headless=new", "--no-sandbox")
SOFTWARE_WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
NO_WEBGL = ("--disable-gpu", "--disable-software-rasterizer")
WINDOWS: tuple[ViewportSize, ...] = (
    {"width": 1920, "height": 1080},
    {"width": 1280, "height": 720},
    {"width": 390, "height": 844},
)
Look = tuple[Literal["light", "dark"], ViewportSize]
SCHEMES: tuple[Literal["light", "dark"], ...] = ("light", "dark")
LOOKS = tuple(product(SCHEMES, WINDOWS))
"""Colours and windows in which a page is looked at."""
SERIOUS = ("serious", "critical")
"""Impacts of findings of axe-core that fail a page."""
EMPTY_SCENE = "<title>Scene</title><canvas></canvas>"
"""A page waits for something to be drawn in."""
LOADING_MILLISECONDS = 120e3
"""The first picture waits for the drawings of the robot to be made."""


@contextmanager
def running_browser(*, draws: bool = False) -> Iterator[Browser]:
    """Run Chromium for the time of a test.

    Args:
        draws: whether pages draw scenes. In software they take a core for as long as they are open, even where nothing
            moves; so what is said of words, curves and buttons needs a browser that has no WebGL.
    """
    # A busy machine may take long, and is no fault of the page.
    expect.set_options(timeout=LOADING_MILLISECONDS)
    with sync_playwright() as playwright:
        arguments = [*WITHOUT_SCREEN, *(SOFTWARE_WEBGL if draws else NO_WEBGL)]
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments)
        # What tests ask of a page is evaluated in it, which our pages forbid; test_pages looks at them as they are.
        browser.new_context = partial(browser.new_context, bypass_csp=True)
        browser.new_page = partial(browser.new_page, bypass_csp=True)
        yield browser
        browser.close()
    # Whatever is left open is told here, and not by a test that happens to run when garbage is collected.
    gc.collect()


@contextmanager
def flawless_page(browser: Browser, address: str, **options: Any) -> Iterator[Page]:
    """Open a page of a service, at whose address it begins; any error that its scripts or its console tell fails it."""
    page = browser.new_page(base_url=address, device_scale_factor=0.5, **options)
    page.set_default_timeout(LOADING_MILLISECONDS)
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
    yield page
    page.close()
    assert wrong == []


def looks(number: int) -> tuple[Look, ...]:
    """Return in what colours and windows a page is looked at: in all of them, or in one by the page's number.

    Each of them has a page, then.
    """
    return sample(quick=(LOOKS[number % len(LOOKS)],), whole=LOOKS)


def draw_no_scene(page: Page) -> None:
    """Have an empty page in the place of each scene from now on, and nothing move by itself.

    Drawn in software, both keep the machine busy.
    """
    page.emulate_media(reduced_motion="reduce")
    page.route("**/viewer/scene/**", lambda route: route.fulfill(content_type="text/html", body=EMPTY_SCENE))


def wait_for_plan(page: Page, name: str) -> None:
    """Wait until the viewer tells of a plan of this name."""
    page.wait_for_function(f"player.description?.title === '{name}'", timeout=LOADING_MILLISECONDS)


def serious_findings(page: Page) -> list[str]:
    """Return what axe-core calls serious or critical on a page."""
    found: list[dict[str, Any]] = Axe().run(page).response["violations"]
    return [
        f"{each['id']}: {node['html'][:160]} {node['any'][0]['message'] if node['any'] else ''}"
        for each in found
        if each["impact"] in SERIOUS
        for node in each["nodes"]
    ]
