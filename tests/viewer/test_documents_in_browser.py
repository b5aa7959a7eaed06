"""Documents as they may come, in a real browser: with a reserve or without one, with faults; and by keyboard."""

from __future__ import annotations

import copy
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, ViewportSize

from app.viewer.palette import MEANINGS
from tests.support.browser import LOADING_MILLISECONDS, draw_no_scene, needs_browser, running_browser, wait_for_plan
from tests.support.plan_shelf import PlanShelf
from tests.support.samples import among, sample
from tests.support.scene_pictures import settled
from tests.support.service import ServiceProcess, finished, running_service, task, unsolved_task

REQUESTED, LEAST = 0.1, 0.04
SQUEEZE = 60.0
WINDOW: ViewportSize = {"width": 1280, "height": 720}
SMALL: ViewportSize = {"width": 480, "height": 320}
"""Of a window whose scene is drawn, in software."""
PIXELS_PER_POINT = 0.5
POLLS_MILLISECONDS = 7e3
"""In which the page asks twice for the list of plans."""

UNSOLVED = {
    "pb1_weak_cup": "infeasible",
    "ab1_under_beams": "not_found",
    "lid_too_heavy": "infeasible",
    "lid_under_roof": "not_found",
}
"""Outcome by shipped task that has no plan: of each kind one that cannot be, and one that was searched in vain."""
SHOWN = sample(["ab1_under_beams"], [*UNSOLVED])

DRAWS = sample(quick=False, whole=True)
"""Whether the browser draws scenes; where it does not, a recording complains of that, which has its scene within it."""

pytestmark = [needs_browser, pytest.mark.slow]


@pytest.fixture(scope="module")
def documents(shelf: PlanShelf) -> dict[str, dict[str, Any]]:
    """Return what comes of shipped tasks, by name: a lift as it is planned, and tasks that have no plan."""
    unsolved = {name: shelf.document(unsolved_task(name)) for name in SHOWN}
    return {"ab1": {**shelf.document(task("ab1.json")), "simulation": None}, **unsolved}


@pytest.fixture(scope="module")
def planned(documents: dict[str, dict[str, Any]]) -> dict[str, Any]:
    return documents["ab1"]


@pytest.fixture(scope="module")
def newer(planned: dict[str, Any]) -> dict[str, Any]:
    """Return the planned document with a reserve in every sample of a hold, and with squeezes of the gripper."""
    document = copy.deepcopy(planned)
    document["task"]["options"]["reserve"] = REQUESTED
    for segment in document["segments"]:
        count, held = len(segment["time"]), segment["hold"] is not None
        segment["reserve"] = [0.2 + 0.001 * sample if held else None for sample in range(count)]
        if held and segment["hold"]["grip"] is not None:
            segment["hold"]["grip"]["squeeze"] = SQUEEZE
        for contact in segment["contacts"]:
            if contact["kind"] == "soft_finger":
                contact["squeeze"] = SQUEEZE
    number, least = _longest_transfer(document)
    sample = len(least["time"]) // 2
    least["reserve"][sample] = LEAST
    where = {"segment": number, "sample": sample}
    document["statistics"]["reserve"] = {"value": LEAST, "limited_by": "cup", "body": "plate", **where}
    return document


def _longest_transfer(document: dict[str, Any]) -> tuple[int, dict[str, Any]]:
    moved = [(i, each) for i, each in enumerate(document["segments"]) if each["kind"] == "transfer" and each["hold"]]
    return max(moved, key=lambda each: len(each[1]["time"]))


@pytest.fixture(scope="module")
def kept(documents: dict[str, dict[str, Any]], newer: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return all documents that the service has, by name."""
    uncertified = {**documents["ab1_under_beams"], "certificate": None}
    others = {
        "older": of_before(documents["ab1"]),
        "newer": newer,
        "uncertified": uncertified,
        "no document": {"outcome": "solved"},
    }
    return {**{name: documents[name] for name in SHOWN}, **others}


@pytest.fixture(scope="module")
def service(
    kept: dict[str, dict[str, Any]], data_dir: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ServiceProcess]:
    folder = tmp_path_factory.mktemp("documents")
    for name, document in kept.items():
        named = {**document, "task": {**document.get("task", {}), "external_id": name}}
        (folder / f"{name}.json").write_text(json.dumps(named))
    solver = (sys.executable, "-m", "tests.support.document_solver", str(folder))
    with running_service(data_dir, solver) as service:
        yield service


@pytest.fixture(scope="module")
def plans(service: ServiceProcess, kept: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return finished plans by name."""
    with service.client() as client:
        posted = {name: client.post("/v1/plans", json=task(external_id=name)).json() for name in kept}
        return {name: finished(client, plan) for name, plan in posted.items()}


@pytest.fixture(scope="module")
def views(service: ServiceProcess, plans: dict[str, dict[str, Any]]) -> dict[str, str]:
    """Return addresses of the viewer by plan."""
    return {name: service.address + plan["links"]["view"] for name, plan in plans.items()}


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with running_browser(draws=DRAWS) as browser:
        yield browser


@pytest.fixture(scope="module")
def open_window(browser: Browser) -> Iterator[Callable[..., Page]]:
    """Return a function that opens a window of its own; errors of its scripts fail the module."""
    errors: list[str] = []

    def open_(**options: Any) -> Page:
        settings = {"viewport": WINDOW, "device_scale_factor": PIXELS_PER_POINT, **options}
        page = browser.new_context(**settings).new_page()
        page.set_default_timeout(LOADING_MILLISECONDS)
        if DRAWS or not options.get("offline"):
            page.on("pageerror", lambda error: errors.append(str(error)))
        return page

    yield open_
    assert errors == []


@pytest.fixture(scope="module")
def window(open_window: Callable[..., Page]) -> Page:
    """Return a window without the scene's picture: drawn without a graphics card, it keeps the machine busy."""
    page = open_window()
    draw_no_scene(page)
    return page


@pytest.fixture
def page(window: Page, views: dict[str, str]) -> Page:
    """Return the window with the newer document at its start."""
    if window.url != views["newer"].replace("/v1/plans/", "/viewer/?plan=").removesuffix("/view"):
        window.goto(views["newer"])
        wait_for_plan(window, "newer")
    window.evaluate("player.play(false); player.seek(0); player.panel.open('View'); document.activeElement.blur()")
    return window


def titles(page: Page) -> list[str]:
    return page.eval_on_selector_all(".chart h3", "found => found.map((title) => title.firstChild.textContent)")


def focused(page: Page) -> list[Any]:
    """Return where the focus is: id of what it is in, and its number there."""
    return page.evaluate(
        "[document.activeElement.closest('[id]')?.id, [...document.activeElement.parentElement?.children ?? []]"
        ".indexOf(document.activeElement)]"
    )


def test_the_reserve_stands_beside_the_forces_with_what_was_requested(page: Page, newer: dict[str, Any]) -> None:
    assert titles(page)[:3] == ["Hands, vertical force", "Vacuum cup", "Force reserve"]
    chart = page.evaluate("player.source.charts[2]")
    kept, requested = chart["series"]
    stated = [value for segment in newer["segments"] for value in segment["reserve"]]
    assert None in stated
    assert kept["values"] == [None if value is None else pytest.approx(100.0 * value) for value in stated]
    assert set(requested["values"]) == {100.0 * REQUESTED}
    assert requested["dashed"]
    assert chart["unit"] == "%"
    low, high = page.evaluate("player.charts.charts[2].plot.y")
    assert low == 0.0
    assert max(value for value in kept["values"] if value is not None) < high
    assert "reserve" in page.locator(".legend.pairs").inner_text()
    colour = MEANINGS["reserve"][0]
    assert page.evaluate("player.charts.charts[2].plot.settings.series[0].colour") == colour


def test_the_smallest_reserve_is_told_and_leads_to_where_it_is(page: Page, newer: dict[str, Any]) -> None:
    least = newer["statistics"]["reserve"]
    time = newer["segments"][least["segment"]]["time"][least["sample"]]
    button = page.locator("#least-reserve")
    told = button.inner_text()
    assert f"{100.0 * LEAST:.1f} % at {time:.1f} s" in told
    assert f"less than the {100.0 * REQUESTED:g} % asked for" in told
    assert "cup" in told
    assert f"segment {least['segment'] + 1}" in told
    button.click()
    assert page.evaluate("player.time") == pytest.approx(time, abs=1e-3)
    assert page.evaluate("player.timeline.segmentAt(player.time)") == least["segment"]
    shown = page.locator(".chart", has_text="Force reserve").locator("li b").first.inner_text()
    assert float(shown) == pytest.approx(100.0 * LEAST, abs=0.1)


@pytest.mark.parametrize("size", [(1920, 1080), (1280, 720), (800, 600)], ids=str)
def test_nothing_overlaps_or_leaves_its_place_in_any_window(
    page: Page, newer: dict[str, Any], size: tuple[int, int]
) -> None:
    number = max(range(len(newer["segments"])), key=lambda i: newer["segments"][i]["hold"] is not None)
    page.set_viewport_size({"width": size[0], "height": size[1]})
    try:
        page.locator("#segments button").nth(number).click()
        assert page.evaluate("document.body.scrollWidth <= innerWidth")
        header = page.locator("#links a").last.bounding_box()
        assert header
        assert header["x"] + header["width"] <= size[0]
        now, views = (page.locator(name).bounding_box() for name in ("#now", "#views"))
        assert now
        assert views
        beside = now["x"] + now["width"] <= views["x"] or now["y"] >= views["y"] + views["height"]
        assert beside
        assert page.evaluate(
            "[...document.querySelectorAll('.chart')].every((chart) => [...chart.querySelectorAll('li')].every("
            "(line) => line.getBoundingClientRect().right <= chart.getBoundingClientRect().right))"
        )
    finally:
        page.set_viewport_size(WINDOW)


def test_a_grip_says_with_what_it_squeezes(page: Page, newer: dict[str, Any]) -> None:
    number = next(i for i, each in enumerate(newer["segments"]) if each["hold"] and each["hold"]["grip"])
    assert f"squeezed with {SQUEEZE:.0f} N" in (
        page.locator("#segments button").nth(number).get_attribute("title") or ""
    )
    page.locator("#segments button").nth(number).click()
    assert f"squeezed with {SQUEEZE:.0f} N" in page.locator("#now").inner_text()


def of_before(document: dict[str, Any]) -> dict[str, Any]:
    """Return a document without what 0.1.0 did not state: reserves and squeezes."""
    older = json.loads(json.dumps(document))
    older["statistics"].pop("reserve", None)
    older["task"]["options"].pop("reserve", None)
    older["explanation"]["summary"] = "The plate is lifted."
    checks = older["certificate"]["checks"]
    older["certificate"]["checks"] = [check for check in checks if check["name"] not in ("reserve", "squeeze")]
    for segment in older["segments"]:
        segment.pop("reserve", None)
        for grip in filter(None, [(segment["hold"] or {}).get("grip")]):
            grip.pop("squeeze", None)
    return older


def test_a_document_without_reserve_looks_as_before(window: Page, views: dict[str, str]) -> None:
    window.goto(views["older"])
    wait_for_plan(window, "older")
    assert titles(window) == ["Hands, vertical force", "Vacuum cup", "Fastest joint, of its limit"]
    assert window.locator("#least-reserve").count() == 0
    everything = window.locator("body").inner_text().lower()
    assert "reserve" not in everything
    assert "squeezed" not in everything


def test_the_keyboard_alone_goes_through_the_timeline_and_out_of_it(page: Page) -> None:
    segments = page.evaluate("player.source.segments")
    page.locator("#speed").focus()
    for number in range(3):
        page.keyboard.press("Tab")
        assert focused(page) == ["segments", number]
    page.keyboard.press("Shift+Tab")
    assert focused(page) == ["segments", 1]
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    assert page.evaluate("player.time") == pytest.approx(segments[2]["start"])
    page.keyboard.press(" ")
    assert page.evaluate("player.playing") is True
    page.keyboard.press(" ")
    assert page.evaluate("player.playing") is False
    assert page.evaluate("player.time") >= segments[2]["start"]
    before = page.evaluate("player.time")
    page.keyboard.press("ArrowRight")
    assert page.evaluate("player.time") == pytest.approx(before + 0.2)
    page.keyboard.press("Shift+ArrowLeft")
    assert page.evaluate("player.time") == pytest.approx(max(before - 1.8, 0.0))
    page.keyboard.press("]")
    assert page.evaluate("player.time") in [pytest.approx(segment["start"]) for segment in segments]
    assert focused(page) == ["segments", 2]
    page.locator("#segments button").last.focus()
    page.keyboard.press("Tab")
    assert focused(page)[0] == "time"
    page.keyboard.press("Home")
    page.keyboard.press("ArrowRight")
    assert page.evaluate("player.time") == pytest.approx(0.2)
    page.keyboard.press("Tab")
    assert focused(page)[0] not in ("time", "segments")


def test_the_keyboard_alone_chooses_a_plan_and_leaves_the_list(page: Page) -> None:
    page.locator("#plan-list li", has_text="newer").focus()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowUp")
    assert page.evaluate("document.activeElement.innerText").startswith("newer")
    page.keyboard.press("Enter")
    page.wait_for_function("loaded === wanted")
    page.locator("#plan-list li").last.focus()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.closest('#plan-list')") is None


def test_a_fault_is_shown_as_one_and_not_tried_again_by_itself(window: Page, views: dict[str, str]) -> None:
    window.goto(views["no document"])
    window.wait_for_function("document.getElementById('message').innerText.includes('A fault of the service')")
    told = window.locator("#message").inner_text()
    assert "could not show this plan" in told
    assert "ValidationError" in told
    window.wait_for_timeout(POLLS_MILLISECONDS)
    # Another try would have another fault's name.
    assert window.locator("#message").inner_text() == told
    window.locator("#plan-list li", has_text="no document").click()
    window.wait_for_function("(told) => document.getElementById('message').innerText.includes('A fault') && "
                             "document.getElementById('message').innerText !== told", arg=told)  # fmt: skip
    window.locator("#plan-list li", has_text="older").click()
    wait_for_plan(window, "older")
    assert window.locator("#message").inner_text() == ""


def tells_why(page: Page, document: dict[str, Any]) -> None:
    """Assert that a page says that there is no plan, why, and what was looked at, and has nothing to play."""
    page.wait_for_function("document.querySelector('#message h3')")
    assert words(page, "#outcome") == document["outcome"].replace("_", " ")
    said = words(page, "#message")
    assert document["explanation"]["summary"] in said
    assert all(cause["reason"].rstrip(".") in said for cause in document["explanation"]["causes"])
    assert "No connection" not in said
    assert not page.locator("#timeline").is_visible()
    for name in page.locator("#tabs button").all_inner_texts():
        page.get_by_role("tab", name=name).click()
        assert "null" not in words(page, "#tab-body")
        assert "None" not in words(page, "#tab-body").replace("None were asked", "")
    page.get_by_role("tab", name="Figures").click()
    for figure in document["statistics"]["search"]:
        row = page.locator("#tab-body tr").filter(has_text=figure.replace("_", " ")).first
        assert row.inner_text().split("\t")[1]
    page.get_by_role("tab", name="Checks").click()
    if document["certificate"] is None:
        assert "nothing was planned" in words(page, "#tab-body")
    page.get_by_role("tab", name="View").click()


@pytest.mark.parametrize(
    "name",
    among([*UNSOLVED, "uncertified"], SHOWN),
)
def test_a_plan_that_was_not_found_says_why_and_so_does_its_recording(
    name: str,
    service: ServiceProcess,
    kept: dict[str, dict[str, Any]],
    plans: dict[str, Any],
    window: Page,
    open_window: Callable[..., Page],
    tmp_path: Path,
) -> None:
    document = kept[name]
    assert document["outcome"] == UNSOLVED.get(name, "not_found")
    window.goto(service.address + plans[name]["links"]["view"])
    wait_for_plan(window, name)
    tells_why(window, document)
    window.goto("about:blank")
    file = tmp_path / "recording.html"
    with service.client() as client:
        file.write_text(client.get(plans[name]["links"]["recording"]).raise_for_status().text, encoding="utf-8")
    page = open_window(offline=True, viewport=SMALL)
    page.goto(file.as_uri())
    wait_for_plan(page, name)
    assert document["explanation"]["summary"] in words(page, "#message")
    if DRAWS:
        settled(page)
    page.context.close()


def words(page: Page, selector: str) -> str:
    return page.locator(selector).inner_text()
