"""The list of plans in a real browser: all of them, page by page, found by name, part, kind, result and day."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page

from tests.support.browser import LOADING_MILLISECONDS, draw_no_scene, needs_browser, running_browser
from tests.support.service import FAKE_SOLVER, ServiceProcess, finished, running_service, task

PAGE = 50
"""Plans on a page of the list."""
MANY = PAGE + 3
POLLS_MILLISECONDS = 4e3
"""In which the page asks for the list once more."""

pytestmark = [needs_browser, pytest.mark.slow]


@pytest.fixture(scope="module")
def service(data_dir: Path) -> Iterator[ServiceProcess]:
    with running_service(data_dir, FAKE_SOLVER) as service:
        yield service


@pytest.fixture(scope="module")
def plans(service: ServiceProcess) -> list[dict[str, Any]]:
    """Return plans of many orders, the last ones of a tool, of a part of its own, and one that cannot be."""
    bodies: list[tuple[dict[str, Any], dict[str, str]]] = [
        *((task(external_id=f"order {number:03d}"), {}) for number in range(MANY)),
        (task("domino_pile.json", external_id="dominoes"), {}),
        (task(external_id="of a part"), {"work_master": "LID-7"}),
        (task(external_id="infeasible"), {}),
        (task(external_id="simulate-slip"), {}),
    ]
    with service.client() as client:
        posted = [client.post("/v1/plans", json=body, params=query).json() for body, query in bodies]
        return [finished(client, plan) for plan in posted]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with running_browser() as browser:
        yield browser


@pytest.fixture
def window(browser: Browser, service: ServiceProcess, plans: list[dict[str, Any]]) -> Iterator[Page]:
    """Return a window without the scene's picture, with the first page of the list."""
    page = browser.new_page(viewport={"width": 1280, "height": 720}, device_scale_factor=0.5)
    page.set_default_timeout(LOADING_MILLISECONDS)
    draw_no_scene(page)
    page.goto(f"{service.address}/viewer/")
    page.wait_for_function(f"document.querySelectorAll('[data-plan]').length === {PAGE}")
    yield page
    page.close()


def listed(page: Page, *names: str) -> None:
    """Wait until exactly these plans are listed, in this order."""
    page.wait_for_function(
        "(names) => [...document.querySelectorAll('[data-plan] b')].map((name) => name.textContent).join() === names",
        arg=",".join(names),
    )


def test_older_plans_come_page_by_page_and_stay(window: Page, plans: list[dict[str, Any]]) -> None:
    window.get_by_role("button", name="Older plans").click()
    everything = [plan["external_id"] for plan in reversed(plans)]
    listed(window, *everything)
    assert not window.locator("#older").is_visible()
    window.wait_for_timeout(POLLS_MILLISECONDS)
    listed(window, *everything)


def test_plans_are_found_by_name_part_kind_result_and_day(window: Page) -> None:
    search = window.get_by_role("searchbox")
    search.fill("ORDER 00")
    listed(window, *(f"order 00{number}" for number in range(9, -1, -1)))
    search.fill("lid-7")
    listed(window, "of a part")
    assert "LID-7" in window.locator("[data-plan]").inner_text()
    search.fill("no such plan")
    window.locator("#plan-list .none", has_text="none that fits").wait_for()
    search.fill("")
    window.get_by_text("Filter", exact=True).click()
    window.get_by_label("Kind").select_option("suction_tool")
    listed(window, "dominoes")
    window.get_by_label("Kind").select_option("")
    window.get_by_label("Result").select_option("outcome=infeasible")
    listed(window, "infeasible")
    window.get_by_label("Result").select_option("physics=failed")
    listed(window, "simulate-slip")
    assert "solved, failed in physics" in window.locator("[data-plan]").inner_text()
    window.get_by_label("Result").select_option("outcome=infeasible")
    today = datetime.now().date()
    window.get_by_label("Until").fill(str(today - timedelta(days=1)))
    listed(window)
    window.get_by_label("Until").fill(str(today))
    listed(window, "infeasible")
    assert window.locator(".day").all_inner_texts() == ["Today"]


def test_what_is_typed_into_the_search_moves_nothing_else(window: Page) -> None:
    window.get_by_role("searchbox").press_sequentially("order 1 p")
    assert window.get_by_role("searchbox").input_value() == "order 1 p"


def test_a_job_that_is_not_listed_is_followed_all_the_same(window: Page, service: ServiceProcess) -> None:
    """It tells when it begins, is cancelled in its page, and is missed once it is deleted."""
    start = datetime.now().astimezone() + timedelta(days=9)
    with service.client() as client:
        body = task(external_id="for later")
        posted = client.post("/v1/plans", json=body, params={"start_time": start.isoformat()}).raise_for_status().json()
        window.get_by_role("searchbox").fill("no such plan")
        listed(window)
        message = window.locator("#message")
        window.evaluate(f"choose('{posted['id']}')")
        message.get_by_role("heading", name="Waiting for its start").wait_for()
        assert f"{start:%-d %b %Y}" in message.inner_text()
        assert f"{start:%H:%M}" in message.inner_text()
        message.get_by_role("button", name="Cancel").click()
        message.get_by_role("heading", name="Cancelled").wait_for()
        client.delete(f"/v1/plans/{posted['id']}").raise_for_status()
        message.get_by_role("heading", name="Deleted").wait_for()


def test_the_browser_leads_back_to_the_plan_before(window: Page, plans: list[dict[str, Any]]) -> None:
    names = ["infeasible", "of a part"]
    for name in names:
        window.locator("[data-plan]", has_text=name).click()
    chosen = window.locator("[data-plan][aria-selected='true'] b")
    assert chosen.inner_text() == names[1]
    window.go_back()
    window.locator("[data-plan][aria-selected='true']", has_text=names[0]).wait_for()
    window.go_back()
    window.wait_for_function("!document.querySelector('[data-plan][aria-selected=true]')")
    window.go_forward()
    window.locator("[data-plan][aria-selected='true']", has_text=names[0]).wait_for()
