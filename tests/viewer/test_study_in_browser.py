"""The page of a study: its map is painted onto the plate while it is found, and a point opens as a plan."""

from __future__ import annotations

import re
from collections.abc import Iterator
from urllib.parse import parse_qs, urlsplit

import httpx
import pytest
from playwright.sync_api import Browser, Page, expect

from app.settings import ServiceSettings
from tests.support.browser import draw_no_scene, flawless_page, looks, needs_browser, running_browser, serious_findings
from tests.support.samples import sample
from tests.support.service import FAKE_EXAMINER, FAKE_SOLVER, task
from tests.support.serving import served

pytestmark = needs_browser
X = {"pointer": "/cup/position/0", "min": -0.1, "max": 0.1, "count": 5}
Y = {"pointer": "/cup/position/1", "min": -0.1, "max": 0.1, "count": 4}


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    fakes = {"solver_command": FAKE_SOLVER, "study_command": FAKE_EXAMINER, "study_slots": 1}
    with served(ServiceSettings.model_validate({"data_dir": tmp_path_factory.mktemp("data"), **fakes})) as address:
        yield address


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with running_browser() as browser:
        yield browser


@pytest.fixture
def page(browser: Browser, address: str) -> Iterator[Page]:
    with flawless_page(browser, address) as page:
        yield page


def posted(address: str, wish: str, *axes: dict, wait: int = 60) -> dict:
    body = {"task": task(external_id=wish), "axes": list(axes)}
    return httpx.post(f"{address}/v1/studies", json=body, headers={"Prefer": f"wait={wait}"}, timeout=90).json()


@pytest.mark.slow
def test_the_map_fills_while_the_study_runs(page: Page, address: str) -> None:
    study = posted(address, "slow", X, Y, wait=0)
    page.goto(study["links"]["view"])
    expect(page.locator("#drawing .cell")).to_have_count(20)
    expect(page.locator("#drawing .cell.solved")).to_have_count(14, timeout=60_000)
    expect(page.locator("#drawing .cell.unsolved")).to_have_count(6)
    expect(page.locator("#state")).to_have_text("succeeded, 20 of 20 points", timeout=20_000)
    expect(page.locator("#drawing .cell.best")).to_have_count(1)


@pytest.mark.slow
def test_points_lie_on_the_plate_where_the_cup_would_sit(page: Page, address: str) -> None:
    study = posted(address, "now", X, Y)
    page.goto(study["links"]["view"])
    plate = page.locator("#drawing .plate").bounding_box()
    assert plate is not None

    def place(index: int) -> tuple[float, float]:
        box = page.locator(f"#point-{index} rect").bounding_box()
        assert box is not None
        return box["x"] + box["width"] / 2 - plate["x"], box["y"] + box["height"] / 2 - plate["y"]

    # The plate has 0.3 m; its x is up and its y to the left, from its middle.
    for index, (x, y) in ((0, (-0.1, -0.1)), (3, (-0.1, 0.1)), (16, (0.1, -0.1))):
        right, down = place(index)
        assert right / plate["width"] == pytest.approx(0.5 - y / 0.3, abs=0.02)
        assert down / plate["height"] == pytest.approx(0.5 - x / 0.3, abs=0.02)


@pytest.mark.slow
def test_a_point_is_reached_by_keys_and_opened_as_a_plan(page: Page, address: str) -> None:
    study = posted(address, "now", {"pointer": "/cup/max_force", "values": [15, 20, 25]})
    page.goto(study["links"]["view"])
    page.locator("#point-0").click()
    page.keyboard.press("ArrowRight")
    expect(page.locator("#point")).to_contain_text("20")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#point")).to_contain_text("not found")
    page.keyboard.press("ArrowLeft")
    page.route(re.compile(r"/viewer/\?plan="), lambda route: route.fulfill(body="the plan"))
    page.keyboard.press("Enter")
    page.wait_for_url(re.compile(r"/viewer/\?plan="))
    opened = parse_qs(urlsplit(page.url).query)
    assert opened["study"] == [study["id"]]
    (plan,) = opened["plan"]
    planned = httpx.get(f"{address}/v1/plans/{plan}/document", timeout=30)
    wait = 60
    while planned.status_code == 404 and wait:
        page.wait_for_timeout(500)
        planned, wait = httpx.get(f"{address}/v1/plans/{plan}/document", timeout=30), wait - 1
    assert planned.json()["task"]["cup"]["max_force"] == 20


def test_a_study_that_is_not_there_is_told_in_the_page_with_a_way_on(browser: Browser, address: str) -> None:
    page = browser.new_page(base_url=address)
    page.goto("/viewer/study?study=zzz")
    expect(page.locator("#list")).to_contain_text("There is no study 'zzz'")
    page.locator("#list").get_by_role("link", name="All studies").click()
    page.wait_for_url("**/viewer/study")
    page.close()


@pytest.mark.slow
def test_studies_are_listed(page: Page, address: str) -> None:
    study = posted(address, "now", X)
    page.goto("/viewer/study")
    page.locator(f"a[href='study?study={study['id']}']").click()
    expect(page.locator("#drawing .cell")).to_have_count(5)


@pytest.mark.parametrize("what", ["map", "list"])
@pytest.mark.slow
def test_the_page_is_readable_at_every_width_in_light_and_dark(page: Page, address: str, what: str) -> None:
    study, shown = posted(address, "now", X, Y), False
    for scheme, size in looks(("map", "list").index(what)):
        page.emulate_media(color_scheme=scheme)
        page.set_viewport_size(size)
        # A window that is made smaller, or dark, has the same page: it is opened anew where everything is tried.
        if not shown or sample(quick=False, whole=True):
            page.goto(study["links"]["view"] if what == "map" else "/viewer/study")
            page.locator("#drawing .cell.best" if what == "map" else "#list li").first.wait_for()
            shown = True
        assert serious_findings(page) == [], f"{scheme}, {size['width']} px"
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


@pytest.mark.parametrize("start", ["/", "/viewer/"])
def test_the_list_of_studies_is_found_from_where_people_begin(page: Page, start: str) -> None:
    draw_no_scene(page)
    page.goto(start)
    page.get_by_role("link", name="Studies").click()
    page.wait_for_url("**/viewer/study")
