"""The address leads to the moment and the camera that are shown; and what else a person asks of curves and segments."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page

from tests.support.browser import LOADING_MILLISECONDS, draw_no_scene, needs_browser, running_browser, wait_for_plan
from tests.support.plan_shelf import PlanShelf
from tests.support.samples import among
from tests.support.service import ServiceProcess, finished, running_service, task

CAMERA = [1.5, -1.25, 1.75, 0.25, 0.0, 1.125]
NEAR = 2e-3
"""What the address may be off: it has millimetres."""

pytestmark = [needs_browser, pytest.mark.slow]


@pytest.fixture(scope="module")
def document(shelf: PlanShelf) -> dict[str, Any]:
    return shelf.document(task("ab1.json"))


@pytest.fixture(scope="module")
def folder(document: dict[str, Any], shelf: PlanShelf, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return where the service's solver finds its documents."""
    folder = tmp_path_factory.mktemp("documents")
    (folder / "ab1.json").write_text(json.dumps(document))
    (folder / "pb1_weak_cup.json").write_text(json.dumps(shelf.document(task("pb1_weak_cup.json"))))
    return folder


@pytest.fixture(scope="module")
def service(folder: Path, data_dir: Path) -> Iterator[ServiceProcess]:
    solver = (sys.executable, "-m", "tests.support.document_solver", str(folder))
    with running_service(data_dir, solver) as service:
        yield service


@pytest.fixture(scope="module")
def address(service: ServiceProcess) -> str:
    """Return where the plan is shown."""
    with service.client() as client:
        plan = finished(client, client.post("/v1/plans", json=task("ab1.json", external_id="ab1")).json())
    return f"{service.address}/viewer/?plan={plan['id']}"


@pytest.fixture
def drawn() -> Iterator[Page]:
    """Return a window with the scene's picture, for what concerns the camera."""
    with running_browser(draws=True) as browser:
        yield new_window(browser)


@pytest.fixture(scope="module")
def window() -> Iterator[Page]:
    """Return a window without the scene's picture."""
    with running_browser() as browser:
        page = new_window(browser)
        draw_no_scene(page)
        yield page


def new_window(browser: Browser) -> Page:
    page = browser.new_page(viewport={"width": 960, "height": 600}, device_scale_factor=0.5)
    page.set_default_timeout(LOADING_MILLISECONDS)
    return page


def show(page: Page, address: str) -> None:
    """Open an address anew; a change behind # alone would not load the page."""
    page.goto("about:blank")
    page.goto(address)
    wait_for_plan(page, "ab1")


def test_an_address_opens_its_moment_and_its_camera_and_follows_both(drawn: Page, address: str) -> None:
    show(drawn, f"{address}#t=4.5&source=simulation&camera={','.join(map(str, CAMERA))}")
    assert drawn.evaluate("[player.time, player.sourceName]") == [4.5, "simulation"]
    drawn.wait_for_function("frame.contentDocument?.querySelector('canvas')")
    # The service learns of a camera from the page that has it.
    drawn.wait_for_function("connection.askCamera(), camera && document.getElementById('drawing').hidden")
    drawn.evaluate("camera = null")
    drawn.wait_for_function("connection.askCamera(), camera !== null")
    assert drawn.evaluate("camera") == pytest.approx(CAMERA, abs=NEAR)
    drawn.evaluate("player.choose('plan'), player.seek(3.25)")
    drawn.wait_for_url("**#t=3.25*")
    drawn.get_by_role("button", name="Top").click()
    drawn.wait_for_function("connection.askCamera(), Math.hypot(camera[0] - 1.5, camera[1] + 1.25) > 0.1")
    drawn.wait_for_url(lambda url: f"camera={CAMERA[0]}," not in url)
    shown = drawn.url
    assert shown.count("camera=") == 1
    show(drawn, shown)
    assert drawn.evaluate("player.time") == 3.25
    assert drawn.url == shown


def test_a_certified_plan_is_shown_at_once_and_again_where_one_is_when_its_simulation_is_there(
    window: Page, service: ServiceProcess, folder: Path, address: str
) -> None:
    simulating = folder / "ab1.simulating"
    simulating.touch()
    with service.client() as client:
        plan = client.post("/v1/plans", json=task("ab1.json", external_id="ab1")).json()
    show(window, f"{service.address}/viewer/?plan={plan['id']}")
    assert window.evaluate("player.description.simulation") is None
    window.evaluate("player.seek(2.5)")
    window.wait_for_function("simulating")
    simulating.unlink()
    window.wait_for_function("player.description?.simulation")
    assert window.evaluate("[player.time, player.sourceName, simulating]") == [2.5, "plan", False]


def test_a_proof_is_shown_at_once_and_what_to_change_once_that_is_known(
    window: Page, service: ServiceProcess, folder: Path
) -> None:
    trying = folder / "pb1_weak_cup.simulating"
    trying.touch()
    with service.client() as client:
        plan = client.post("/v1/plans", json=task("pb1_weak_cup.json", external_id="pb1_weak_cup")).json()
    window.goto("about:blank")
    window.goto(f"{service.address}/viewer/?plan={plan['id']}")
    wait_for_plan(window, "pb1_weak_cup")
    assert window.get_by_text("Changes are being tried").is_visible()
    window.wait_for_function("simulating")
    trying.unlink()
    window.locator(".remedies li").first.wait_for()
    assert not window.get_by_text("Changes are being tried").count()


NONSENSE = ("t=later", "t=1e9", "camera=1,2", "t=-3&camera=a,b,c,d,e,f", "x")


@pytest.mark.parametrize("told", among(NONSENSE, ("t=1e9", "t=-3&camera=a,b,c,d,e,f")))
@pytest.mark.slow
def test_an_address_that_makes_no_sense_opens_the_plan_all_the_same(window: Page, address: str, told: str) -> None:
    show(window, f"{address}#{told}")
    assert window.evaluate("0 <= player.time && player.time <= player.source.duration")


@pytest.mark.slow
def test_a_curve_tells_its_values_under_the_cursor(window: Page, address: str, document: dict[str, Any]) -> None:
    show(window, address)
    plot = window.locator(".plot-over").nth(1)
    box = plot.bounding_box()
    assert box is not None
    plot.hover(position={"x": 0.5 * box["width"], "y": 0.5 * box["height"]})
    told = window.locator(".under").inner_text()
    middle = 0.5 * window.evaluate("player.source.duration")
    assert float(told.split()[0]) == pytest.approx(middle, rel=0.02)
    assert f"{document['task']['cup']['max_force']:.1f} N" in told
    assert window.evaluate("player.time") == 0
    window.locator("#clock").hover()
    assert window.locator(".under").count() == 0


@pytest.mark.slow
def test_the_table_of_segments_has_each_of_them_and_leads_there(
    window: Page, address: str, document: dict[str, Any]
) -> None:
    show(window, address)
    window.get_by_role("tab", name="Segments").click()
    rows = window.locator(".segments tbody tr")
    assert rows.count() == len(document["segments"])
    for row, segment in zip(rows.all(), document["segments"], strict=True):
        told = row.locator("td").all_inner_texts()
        assert float(told[2]) == pytest.approx(segment["time"][0], abs=0.051)
        kept = [each for each in segment["reserve"] or [] if each is not None]
        assert told[4] == (f"{100 * min(kept):.1f}" if kept else "–")
    rows.nth(4).get_by_role("button").click()
    assert window.evaluate("player.time") == pytest.approx(document["segments"][4]["time"][0], abs=1e-4)
    window.get_by_role("tab", name="Checks").click()
    assert window.locator(".checks p").count() == len(document["certificate"]["checks"])
    assert all(words.endswith(".") for words in window.locator(".checks p").all_inner_texts())
