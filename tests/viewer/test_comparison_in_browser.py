"""Two plans side by side in a real browser: one clock moves both scenes, and a table tells what they differ in."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, ViewportSize, expect

from tests.support.browser import LOADING_MILLISECONDS, draw_no_scene, needs_browser, running_browser
from tests.support.plan_shelf import PlanShelf
from tests.support.samples import sample
from tests.support.service import ServiceProcess, finished, running_service, task

WINDOW: ViewportSize = {"width": 900, "height": 600}
PIXELS_PER_POINT = 0.5
DRAWS = sample(quick=False, whole=True)

pytestmark = [needs_browser, pytest.mark.slow]


@pytest.fixture(scope="module")
def service(shelf: PlanShelf, data_dir: Path) -> Iterator[ServiceProcess]:
    with running_service(data_dir, shelf.solver) as service:
        yield service


@pytest.fixture(scope="module")
def plans(shelf: PlanShelf, service: ServiceProcess) -> list[dict[str, Any]]:
    """Return a lift that can be, and one whose cup is too weak."""
    bodies = [task("pb1.json"), task("pb1_weak_cup.json")]
    for body in bodies:
        shelf.document(body)
    with service.client() as client:
        posted = [client.post("/v1/plans", json=body).json() for body in bodies]
        return [finished(client, plan) for plan in posted]


@pytest.fixture(scope="module")
def page(service: ServiceProcess, plans: list[dict[str, Any]]) -> Iterator[Page]:
    """Return a window with both; errors of its scripts fail the module."""
    errors: list[str] = []
    # No test looks at the two scenes; that drawing them raises nothing is seen where everything is tried.
    with running_browser(draws=DRAWS) as browser:
        page = browser.new_page(viewport=WINDOW, device_scale_factor=PIXELS_PER_POINT)
        page.set_default_timeout(LOADING_MILLISECONDS)
        page.on("pageerror", lambda error: errors.append(str(error)))
        if not DRAWS:
            draw_no_scene(page)
        page.goto(f"{service.address}/viewer/compare?plans={','.join(plan['id'] for plan in plans)}")
        page.wait_for_function("comparison.sides.every(({ description, task }) => description && task)")
        yield page
    assert errors == []


def rows(page: Page) -> dict[str, list[str]]:
    """Return the rows of all tables by their labels."""
    found = page.eval_on_selector_all(
        "#tables tbody tr", "rows => rows.map((row) => [...row.children].map((cell) => cell.textContent))"
    )
    return {row[0]: row[1:3] for row in found}


def test_the_table_tells_what_the_tasks_differ_in_and_nothing_else(page: Page) -> None:
    one, other = task("pb1.json"), task("pb1_weak_cup.json")
    told = rows(page)
    assert [float(value) for value in told["cup, max force [N]"]] == [each["cup"]["max_force"] for each in (one, other)]
    assert all(left != right for left, right in told.values())
    assert "plate, mass [kg]" not in told or one["plate"]["mass"] != other["plate"]["mass"]
    page.locator("#all-rows").check()
    assert len(rows(page)) > len(told)
    assert rows(page)["outcome"] == ["solved", "infeasible"]
    counts = page.locator("#tables table", has_text="Nodes by contact").locator("tbody td").first.inner_text()
    assert re.fullmatch(r"[\d,]+ nodes, [\d,]+ alive, [\d,]+ dead", counts)
    page.locator("#all-rows").uncheck()


@pytest.mark.slow
def test_one_clock_moves_both(page: Page) -> None:
    duration = page.evaluate("comparison.duration")
    assert duration == pytest.approx(page.evaluate("comparison.sides[0].duration"))
    page.evaluate(f"comparison.seek({0.5 * duration})")
    assert page.locator("#time").evaluate("(slider) => slider.valueAsNumber") == pytest.approx(0.5 * duration, abs=1e-2)
    expect(page.locator(".now").nth(0)).not_to_be_empty()
    expect(page.locator(".now").nth(1)).to_contain_text("at its end")
    # Slowly: at its end it stops by itself, and a click there would play again.
    page.locator("#speed").select_option("0.5")
    page.locator("#play").click()
    page.wait_for_function(f"comparison.time > {0.5 * duration + 0.5}")
    page.locator("#play").click()
    assert page.evaluate("comparison.playing") is False


def test_the_two_are_exchanged_and_the_address_follows(page: Page, plans: list[dict[str, Any]]) -> None:
    page.locator("#swap").click()
    page.wait_for_function("comparison.sides.every(({ description, task }) => description && task)")
    assert page.url.endswith(f"?plans={plans[1]['id']},{plans[0]['id']}")
    assert page.locator("#left-plan").input_value() == plans[1]["id"]
    page.locator("#swap").click()
    page.wait_for_function("comparison.sides.every(({ description, task }) => description && task)")


def test_a_plan_older_than_those_listed_is_called_by_its_name_and_opened_by_its_link(
    page: Page, plans: list[dict[str, Any]]
) -> None:
    page.route("**/v1/plans?page_size=*", lambda route: route.fulfill(json={"plans": []}))
    page.reload()
    for side, plan in zip(("left", "right"), plans, strict=True):
        chosen = page.locator(f"#{side}-plan option:checked")
        expect(chosen).to_contain_text(f"{plan['external_id']}, {plan['outcome']}, ")
        link = page.get_by_role("link", name=f"Open the {side} plan")
        assert link.get_attribute("href") == f"./?plan={plan['id']}"


def test_where_a_side_is_missing_the_page_says_what_to_do(
    page: Page, service: ServiceProcess, plans: list[dict[str, Any]]
) -> None:
    page.goto(f"{service.address}/viewer/compare?plans={plans[0]['id']}")
    expect(page.locator("#tables")).to_contain_text("choose one on each side")
