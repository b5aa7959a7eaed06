"""A perceived scene in a real browser: points, models and words are there, and what is hidden is gone."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page

from tests.support.browser import LOADING_MILLISECONDS, draw_no_scene, needs_browser, running_browser
from tests.support.samples import sample
from tests.support.scan_frames import shipped
from tests.support.scene_pictures import settled, wait_until_it_differs, wait_until_it_is_as_before
from tests.support.service import FAKE_SOLVER, ServiceProcess, running_service

LAYERS = {"points": 2e-3, "models": 2e-3, "tool": 1e-3, "robot": 2e-3}
"""Share of the picture that each one covers at least."""
DRAWN = sample(quick=False, whole=True)
"""Whether there is a picture: tests that look at it are slow."""

pytestmark = [needs_browser, pytest.mark.slow]


@pytest.fixture(scope="module")
def service(data_dir: Path) -> Iterator[ServiceProcess]:
    with running_service(data_dir, FAKE_SOLVER) as service:
        yield service


@pytest.fixture(scope="module")
def scene(service: ServiceProcess) -> dict[str, Any]:
    with service.client() as client:
        return client.post("/v1/scenes", files=shipped().form()).raise_for_status().json()


@pytest.fixture(scope="module")
def page(service: ServiceProcess, scene: dict[str, Any]) -> Iterator[Page]:
    errors: list[str] = []
    with running_browser(draws=DRAWN) as browser:
        page = browser.new_context(viewport={"width": 960, "height": 640}, device_scale_factor=0.5).new_page()
        page.set_default_timeout(LOADING_MILLISECONDS)
        if not DRAWN:
            draw_no_scene(page)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(service.address + scene["links"]["view"])
        page.wait_for_function("perceived.description")
        yield page
    assert errors == []


def test_every_object_is_told_with_its_size_and_the_scene_is_listed(page: Page, scene: dict[str, Any]) -> None:
    told = page.locator("#tab-body").inner_text()
    for each in scene["scene"]["objects"]:
        assert each["name"] in told
        assert " × ".join(f"{1e3 * side:.1f}" for side in each["shape"]["size"]) in told
    assert scene["scene"]["tool"]["name"] in told
    page.wait_for_selector(f"#scene-list li[data-scene='{scene['id']}'][aria-selected='true']")
    assert not page.locator("#timeline").is_visible()


def test_layers_are_hidden_and_shown_again(page: Page) -> None:
    shown = settled(page)
    for layer, share in LAYERS.items():
        page.locator(f"#layer-{layer}").click()
        wait_until_it_differs(page, shown, share)
        page.locator(f"#layer-{layer}").click()
        wait_until_it_is_as_before(page, shown)


def test_keys_hide_layers_and_move_the_camera(page: Page) -> None:
    shown = settled(page)
    page.keyboard.press("m")
    assert not page.locator("#layer-models").is_checked()
    page.keyboard.press("m")
    page.keyboard.press("4")
    wait_until_it_differs(page, shown)


def test_a_scene_that_is_gone_says_so(page: Page, service: ServiceProcess) -> None:
    page.goto(f"{service.address}/viewer/?scene={'0' * 32}")
    page.wait_for_function("document.getElementById('message').innerText.includes('there is no scene')")
