"""A real browser for tests: Chromium without a screen and without a graphics card."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_browser = pytest.mark.skipif(
    CHROMIUM is None and "CI" not in os.environ, reason="no Chromium on this machine: the viewer cannot be looked at"
)
SOFTWARE_WEBGL = ("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
LOADING_MILLISECONDS = 120e3
"""The first picture waits for the drawings of the robot to be made."""


@contextmanager
def running_browser() -> Iterator[Browser]:
    """Run Chromium for the time of a test."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(SOFTWARE_WEBGL))
        # What tests ask of a page is evaluated in it, which our pages forbid; test_pages looks at them as they are.
        browser.new_context = partial(browser.new_context, bypass_csp=True)
        browser.new_page = partial(browser.new_page, bypass_csp=True)
        yield browser
        browser.close()


def wait_for_plan(page: Page, name: str) -> None:
    """Wait until the viewer tells of a plan of this name."""
    page.wait_for_function(f"player.description?.title === '{name}'", timeout=LOADING_MILLISECONDS)
