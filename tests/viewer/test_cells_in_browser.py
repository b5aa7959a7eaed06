"""The page of cells: one's own is added from a file, looked at, planned in; what is wrong with it is told."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, Route, expect

from tests.support.browser import LOADING_MILLISECONDS, draw_no_scene, needs_browser, running_browser
from tests.support.own_cell import station, station_files, written, zipped
from tests.support.service import FAKE_SOLVER, ServiceProcess, running_service

SHOWN_MILLISECONDS = 200.0
"""In which a page shows what it was answered."""

pytestmark = needs_browser


@pytest.fixture(scope="module")
def service(data_dir: Path) -> Iterator[ServiceProcess]:
    with running_service(data_dir, FAKE_SOLVER) as service:
        yield service


@pytest.fixture(scope="module")
def page(service: ServiceProcess) -> Iterator[Page]:
    with running_browser() as browser:
        page = browser.new_page()
        page.set_default_timeout(LOADING_MILLISECONDS)
        draw_no_scene(page)
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(f"{service.address}/viewer/cells")
        page.locator("#sentences li").first.wait_for()
        yield page
        assert errors == []


def test_a_cell_is_added_from_a_file_and_looked_at(page: Page, tmp_path: Path) -> None:
    file = tmp_path / "station.zip"
    file.write_bytes(zipped(station_files()))
    page.locator("#file").set_input_files(file)
    expect(page.locator("#name")).to_have_text("station")
    expect(page.locator("#sentences li").first).to_contain_text("Table 1.2 × 2 m")
    expect(page.locator("#cells [aria-current=true]")).to_contain_text("version 1")
    page.wait_for_function("document.getElementById('picture').naturalWidth > 300")
    assert page.locator("#lift").get_attribute("href") == "/viewer/new?kind=plate_lift&cell=station"
    assert page.locator("#move").is_hidden()
    assert "cell=" in page.url


def test_what_was_noticed_in_its_files_is_told_beside_a_cell(page: Page, tmp_path: Path) -> None:
    expect(page.locator("#noted")).to_be_hidden()
    file = tmp_path / "noted.zip"
    file.write_bytes(zipped({"cell.yaml": written(station(name="noted")), "as built.pdf": b""}))
    page.locator("#file").set_input_files(file)
    expect(page.locator("#notes li")).to_contain_text(["'as built.pdf' is left out"])
    page.locator("#cells button").first.click()
    expect(page.locator("#noted")).to_be_hidden()


def test_a_list_that_was_asked_for_before_a_cell_was_added_and_comes_later_hides_it_not(
    page: Page, service: ServiceProcess, tmp_path: Path
) -> None:
    file = tmp_path / "later.json"
    file.write_bytes(written(station(name="later")))
    held: list[Route] = []
    page.route("**/v1/cells", lambda route: route.fallback() if held or is_post(route) else held.append(route))
    page.goto(f"{service.address}/viewer/cells")
    while not held:
        page.wait_for_timeout(SHOWN_MILLISECONDS)
    before = held[0].fetch()
    page.locator("#file").set_input_files(file)
    expect(page.locator("#name")).to_have_text("later")
    with page.expect_response(f"{service.address}/v1/cells"):
        held[0].fulfill(response=before)
    page.wait_for_timeout(SHOWN_MILLISECONDS)
    assert page.locator("#name").inner_text() == "later"
    expect(page.locator("#state")).to_have_text(re.compile("^later is kept, version 1, "))
    page.unroute("**/v1/cells")


def is_post(route: Route) -> bool:
    return route.request.method == "POST"


def test_everything_that_is_wrong_is_told(page: Page, tmp_path: Path) -> None:
    wrong = station(name="wrong", gravity=[0, 0, 9.81])
    wrong["mount"]["arms"]["right"]["position"][2] = 0.87
    file = tmp_path / "wrong.json"
    file.write_bytes(written(wrong))
    page.locator("#file").set_input_files(file)
    expect(page.locator("#faults li").filter(has_text="/gravity")).to_have_count(1)
    expect(page.locator("#faults li").filter(has_text="30.0 mm deep in the table")).to_have_count(1)
    file = tmp_path / "wrong.txt"
    file.write_text("?")
    page.locator("#file").set_input_files(file)
    expect(page.locator("#refusal")).to_contain_text("neither a zip nor YAML nor JSON")


def test_the_editor_begins_in_the_cell(page: Page, service: ServiceProcess) -> None:
    page.goto(f"{service.address}/viewer/new?kind=plate_lift&cell=station")
    page.locator("#task-details summary").click()
    expect(page.locator("#task-details")).to_contain_text("station")


def test_a_cell_is_deleted(page: Page, service: ServiceProcess) -> None:
    page.goto(f"{service.address}/viewer/cells?cell=station")
    expect(page.locator("#name")).to_have_text("station")
    page.once("dialog", lambda dialog: dialog.accept())
    page.locator("#delete").click()
    expect(page.locator("#cells")).not_to_contain_text("station")
