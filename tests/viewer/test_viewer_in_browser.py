"""The viewer in a real browser: load, choose a plan, move through it, side by side, and with no server at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Browser, Page, ViewportSize

from tests.support.browser import LOADING_MILLISECONDS, draw_no_scene, needs_browser, running_browser, wait_for_plan
from tests.support.plan_shelf import PlanShelf
from tests.support.samples import sample
from tests.support.scene_pictures import LAYER_SHARE, settled, wait_until_it_differs, wait_until_it_is_as_before
from tests.support.service import ServiceProcess, finished, running_service, task, wait_for

WINDOW: ViewportSize = {"width": 960, "height": 640}
PIXELS_PER_POINT = 0.5
"""Few: every pixel is drawn without a graphics card."""

pytestmark = needs_browser


@pytest.fixture(scope="module")
def service(shelf: PlanShelf, data_dir: Path) -> Iterator[ServiceProcess]:
    with running_service(data_dir, shelf.solver) as service:
        yield service


@pytest.fixture(scope="module")
def plans(shelf: PlanShelf, service: ServiceProcess) -> dict[str, dict[str, Any]]:
    """Return finished plans: a lift with its simulation and one of a suction tool; where everything is tried, one that
    cannot be and one without simulation, too."""
    bodies = {
        "pb1": task("pb1.json"),
        "one domino": task(
            "domino_pile.json", external_id="one domino", objects=task("domino_pile.json")["objects"][:1]
        ),
    }
    if sample(quick=False, whole=True):
        bodies["pb1_weak_cup"] = task("pb1_weak_cup.json")
        bodies["planned only"] = task("pb1.json", external_id="planned only", options={"simulate": False})
    for body in bodies.values():
        shelf.document(body)
    with service.client() as client:
        posted = {name: client.post("/v1/plans", json=body).json() for name, body in bodies.items()}
        return {name: finished(client, plan) for name, plan in posted.items()}


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with running_browser(draws=True) as browser:
        yield browser


@pytest.fixture(scope="module")
def open_page(browser: Browser) -> Iterator[Callable[..., Page]]:
    """Return a function that opens a window of its own at an address; errors of its scripts fail the module."""
    contexts = []
    errors: list[str] = []

    def open_(address: str, *, drawn: bool = True, **options: Any) -> Page:
        contexts.append(browser.new_context(viewport=WINDOW, device_scale_factor=PIXELS_PER_POINT, **options))
        contexts[-1].set_default_timeout(LOADING_MILLISECONDS)
        page = contexts[-1].new_page()
        if not drawn:
            draw_no_scene(page)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(address)
        return page

    yield open_
    for context in contexts:
        context.close()
    assert errors == []


@pytest.fixture(scope="module")
def loaded_page(service: ServiceProcess, plans: dict[str, Any], open_page: Callable[..., Page]) -> Page:
    """Return a window with the simulated plan and its scene, for all tests that do not close it."""
    page = open_page(service.address + plans["pb1"]["links"]["view"])
    wait_for_plan(page, "pb1")
    return page


@pytest.fixture(scope="module")
def plain_page(service: ServiceProcess, plans: dict[str, Any], open_page: Callable[..., Page]) -> Page:
    """Return a window with the simulated plan, for tests that do not look at its scene."""
    page = open_page(service.address + plans["pb1"]["links"]["view"], drawn=False)
    wait_for_plan(page, "pb1")
    return page


@pytest.fixture
def page(loaded_page: Page) -> Page:
    """Return the window with the scene as it is at first."""
    return at_first(loaded_page)


@pytest.fixture
def undrawn(plain_page: Page) -> Page:
    """Return the window without a scene as it is at first."""
    return at_first(plain_page)


def at_first(page: Page) -> Page:
    """Return a window with the plan's start, and at rest."""
    page.evaluate("player.play(false); player.choose('plan'); player.seek(0); player.panel.open('View')")
    page.select_option("#speed", "1")
    return page


def drag_to(page: Page, fraction: float) -> None:
    """Put the time slider at a fraction of its length, with the mouse."""
    box = page.locator("#time").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 7 + fraction * (box["width"] - 14), box["y"] + 0.5 * box["height"])


def now_lines(page: Page) -> list[float]:
    """Return where in each curve the line is that says "now"."""
    return page.eval_on_selector_all(".now-line", "lines => lines.map((line) => line.getBoundingClientRect().left)")


def text(page: Page, selector: str) -> str:
    return page.locator(selector).inner_text()


def document_of(service: ServiceProcess, plan: dict[str, Any]) -> dict[str, Any]:
    with service.client() as client:
        return client.get(plan["links"]["document"]).raise_for_status().json()


def test_nothing_is_said_of_a_scene_that_is_drawn(page: Page) -> None:
    assert page.locator(".undrawn").count() == 0


@pytest.mark.slow
def test_the_slider_moves_robot_and_curves(page: Page) -> None:
    before, lines = settled(page), now_lines(page)
    assert len(lines) == 4
    drag_to(page, 0.6)
    wait_until_it_differs(page, before)
    assert all(later > earlier + 20 for earlier, later in zip(lines, now_lines(page), strict=True))
    assert float(text(page, "#clock").split()[0]) == pytest.approx(
        0.6 * page.evaluate("player.source.duration"), rel=0.02
    )
    drag_to(page, 0.0)
    wait_until_it_is_as_before(page, before)


@pytest.mark.slow
def test_at_its_end_the_plan_goes_on_with_the_simulated_lift(
    page: Page, service: ServiceProcess, plans: dict[str, Any]
) -> None:
    simulation = document_of(service, plans["pb1"])["simulation"]
    page.evaluate("player.seek(player.source.duration - 0.5)")
    before = settled(page)
    page.select_option("#speed", "4")
    page.locator("#play").click()
    page.wait_for_function("player.sourceName === 'simulation'")
    page.wait_for_function("!player.playing")
    assert page.evaluate("player.time") == pytest.approx(simulation["time"])
    assert text(page, "#ending").lower().startswith(simulation["outcome"].replace("_", " "))
    assert page.locator("#source-simulation").get_attribute("aria-checked") == "true"
    wait_until_it_differs(page, before)


@pytest.mark.slow
def test_the_simulation_shows_its_own_curves_and_the_lift_on_a_page_of_its_own(
    page: Page, service: ServiceProcess, plans: dict[str, Any]
) -> None:
    simulation = document_of(service, plans["pb1"])["simulation"]
    before = settled(page)
    page.locator("#source-simulation").click()
    titles = page.eval_on_selector_all(".chart h3", "found => found.map((title) => title.firstChild.textContent)")
    assert titles == ["Hands, vertical force", "Vacuum cup", "Lift, speed upward", "Plate, tilt"]
    page.locator("#segments button").last.click()
    begin = simulation["lift"]["begin"]
    assert page.evaluate("player.time") == pytest.approx(begin)
    assert page.evaluate("player.charts.charts[0].plot.x") == pytest.approx([begin, simulation["time"]])
    wait_until_it_differs(page, before)
    at_begin, lines = settled(page), now_lines(page)
    page.evaluate(f"player.seek(0.9 * {simulation['time']} + 0.1 * {begin})")
    wait_until_it_differs(page, at_begin)
    assert all(later > earlier + 20 for earlier, later in zip(lines, now_lines(page), strict=True))
    page.get_by_role("tab", name="Lift").click()
    assert f"{1e3 * simulation['lift']['height']:.0f} mm" in text(page, "#tab-body")
    assert f"{simulation['minimum_total_force']:.1f} N" in text(page, "#tab-body")


@pytest.mark.slow
def test_a_click_on_the_timeline_jumps_to_a_segment(undrawn: Page) -> None:
    page = undrawn
    page.locator("#segments button").nth(2).click()
    assert page.evaluate("player.time") == pytest.approx(page.evaluate("player.source.segments[2].start"))
    assert text(page, "#now").startswith(page.evaluate("player.source.segments[2].words"))


@pytest.mark.parametrize("source", ["plan", "simulation"])
def test_no_words_on_the_timeline_are_cut_off(undrawn: Page, source: str) -> None:
    page = undrawn
    page.evaluate(f"player.choose('{source}')")
    try:
        for width in (960, 1366, 1920):
            page.set_viewport_size({"width": width, "height": WINDOW["height"]})
            page.wait_for_function(
                "[...document.querySelectorAll('#states div')].every((place) => place.scrollWidth <= place.clientWidth)"
            )
            labels = page.eval_on_selector_all("#states div", "found => found.map((place) => place.textContent)")
            states = page.eval_on_selector_all("#states div", "found => found.map((place) => place.title)")
            assert any(words == state for words, state in zip(labels, states, strict=True))
            assert all("…" not in words for words in labels)
    finally:
        page.set_viewport_size(WINDOW)


@pytest.mark.slow
def test_keys_move_through_time_and_leave_the_camera_alone(page: Page) -> None:
    before = settled(page)
    # The scene has the focus now: without the page's care, arrows would turn the camera.
    page.locator("#scene-frame").click(position={"x": 30, "y": 200})
    page.keyboard.press("Shift+ArrowRight")
    assert page.evaluate("player.time") == pytest.approx(2.0)
    page.keyboard.press("]")
    assert page.evaluate("player.source.segments.map((segment) => segment.start).includes(player.time)")
    page.keyboard.press("p")
    assert page.evaluate("player.sourceName") == "simulation"
    page.keyboard.press("p")
    page.keyboard.press(" ")
    assert page.evaluate("player.playing") is True
    page.keyboard.press(" ")
    page.keyboard.press("Home")
    assert page.evaluate("[player.sourceName, player.playing, player.time]") == ["plan", False, 0]
    wait_until_it_is_as_before(page, before)


@pytest.mark.slow
def test_layers_are_shown_on_demand(page: Page) -> None:
    page.evaluate("player.seek(0.95 * player.source.duration)")
    far = settled(page)
    page.keyboard.press("5")
    wait_until_it_differs(page, far)
    for layer in ("forces", "cones", "frames", "start", "goal"):
        # Anew each time: viser draws coarser while frames are slow.
        plain = settled(page)
        page.locator(f"#layer-{layer}").click()
        wait_until_it_differs(page, plain, LAYER_SHARE)
        page.locator(f"#layer-{layer}").click()
    page.get_by_role("button", name="Overview").click()
    wait_until_it_is_as_before(page, far)


@pytest.mark.slow
def test_the_panels_tell_figures_rejections_and_checks(
    undrawn: Page, service: ServiceProcess, plans: dict[str, Any]
) -> None:
    page = undrawn
    document = document_of(service, plans["pb1"])
    page.get_by_role("tab", name="Figures").click()
    graph = document["statistics"]["graph"]
    assert f"{graph['nodes']:,}" in text(page, "#tab-body")
    for contact, figures in graph["contact_states"].items():
        row = page.locator("#tab-body tr").filter(has=page.get_by_text(contact, exact=True)).inner_text().split("\t")
        assert row == [contact, *(f"{figures[column]:,}" for column in ("nodes", "alive", "dead"))]
    page.get_by_role("tab", name="Rejected").click()
    for reason, count in document["statistics"]["rejections"].items():
        assert reason.rpartition(": ")[2].lower() in text(page, "#tab-body").lower()
        assert f"{count:,}" in text(page, "#tab-body")
    page.get_by_role("tab", name="Checks").click()
    assert page.locator(".checks .yes").count() == len(document["certificate"]["checks"])


@pytest.mark.slow
def test_two_people_watch_two_plans_and_one_of_them_learns_why_there_is_none(
    page: Page, service: ServiceProcess, plans: dict[str, Any], open_page: Callable[..., Page]
) -> None:
    seen_by_one = settled(page)
    other = open_page(f"{service.address}/viewer/")
    other.locator("#plan-list li", has_text="pb1_weak_cup").click()
    wait_for_plan(other, "pb1_weak_cup")
    assert text(other, "#outcome") == "infeasible"
    assert "needed 62.78 N" in text(other, "#message")
    settled(other)
    other.locator("#plan-list li", has_text="planned only").click()
    wait_for_plan(other, "planned only")
    assert not other.locator("#sources").is_visible()
    start = settled(other)
    drag_to(other, 0.5)
    wait_until_it_differs(other, start)
    wait_until_it_is_as_before(page, seen_by_one)
    assert page.evaluate("[player.description.title, player.time]") == ["pb1", 0]
    other.context.close()


@pytest.mark.slow
def test_neither_a_plan_deleted_while_watched_nor_a_watcher_who_leaves_harms_anything(
    page: Page, service: ServiceProcess, plans: dict[str, Any], open_page: Callable[..., Page]
) -> None:
    doomed = plans["planned only"]
    leaves = open_page(service.address + doomed["links"]["view"])
    wait_for_plan(leaves, "planned only")
    before = settled(leaves)
    with service.client() as client:
        assert client.delete(doomed["links"]["self"]).status_code == 204
    leaves.wait_for_function("!document.querySelector('#plan-list').innerText.includes('planned only')")
    drag_to(leaves, 0.5)
    wait_until_it_differs(leaves, before)
    leaves.locator("#play").click()
    scene = leaves.evaluate("frame.src")
    leaves.goto(f"{service.address}/viewer/?plan={doomed['id']}")
    leaves.wait_for_function("document.getElementById('message').innerText.includes('there is no plan')")
    wait_for(lambda: httpx.get(scene).status_code == 404, 20.0)
    leaves.context.close()
    stays = settled(page)
    drag_to(page, 0.7)
    wait_until_it_differs(page, stays)


def with_suction_plan(page: Page) -> Page:
    """Return a window with the plan of the suction tool, loaded in place of the lift."""
    page.locator("#plan-list li", has_text="one domino").click()
    wait_for_plan(page, "one domino")
    return page


@pytest.mark.slow
def test_a_suction_tool_plan_plays_with_its_curves(plain_page: Page) -> None:
    page = with_suction_plan(plain_page)
    lines = now_lines(page)
    assert text(page, "#states").strip() == "domino 1"
    titles = page.eval_on_selector_all(".chart h3", "found => found.map((title) => title.firstChild.textContent)")
    assert titles == [
        "Suction cup, used of what it bears",
        "Finger force",
        "Force reserve",
        "Fastest joint, of its limit",
    ]
    page.evaluate("player.seek(player.source.segments.find(({ words }) => words.includes('lifts domino')).end)")
    assert "domino 1" in text(page, "#now")
    wait_for(lambda: all(later > earlier + 20 for earlier, later in zip(lines, now_lines(page), strict=True)))
    page.locator("#source-simulation").click()
    page.keyboard.press("End")
    assert text(page, "#ending").lower().startswith("done")


@pytest.fixture(scope="module")
def suction_page(loaded_page: Page) -> Page:
    return with_suction_plan(loaded_page)


@pytest.mark.slow
def test_the_object_of_a_suction_tool_plan_moves_with_it(suction_page: Page) -> None:
    page = suction_page
    before = settled(page)
    page.evaluate("player.seek(player.source.segments.find(({ words }) => words.includes('lifts domino')).end)")
    wait_until_it_differs(page, before)
    carried = settled(page)
    page.locator("#source-simulation").click()
    page.keyboard.press("End")
    wait_until_it_differs(page, carried)
    page.evaluate("player.choose('plan'); player.seek(0)")


@pytest.mark.slow
def test_what_was_considered_is_told_and_drawn_on_demand(
    suction_page: Page, service: ServiceProcess, plans: dict[str, Any]
) -> None:
    page, considered = suction_page, document_of(service, plans["one domino"])["statistics"]["considered"]
    page.get_by_role("tab", name="Regrasp").click()
    good = sum(place["reason"] is None for place in considered["places"]["domino_1"])
    assert page.locator(".tally li").first.inner_text().split() == ["good", str(good)]
    page.keyboard.press("r")
    graph = considered["regrasp_graphs"][-1]
    assert page.locator("#graph path.chosen").count() == len(graph["sequence"])
    dots = len(considered["tool_grasps"]["widths"]) * 2
    visited = 2 * len(graph["sequence"]) - 1
    columns = page.locator("#graph text.title").count()
    assert page.locator("#graph circle").count() == dots * columns + visited
    page.keyboard.press("Escape")
    assert not page.locator("#graph").is_visible()
    page.get_by_role("tab", name="View").click()
    page.get_by_role("button", name="Close", exact=True).click()
    for layer in ("places", "grasps"):
        plain = settled(page)
        page.locator(f"#layer-{layer}").click()
        wait_until_it_differs(page, plain, LAYER_SHARE)
        page.locator(f"#layer-{layer}").click()


@pytest.mark.slow
def test_a_recording_plays_plan_and_simulation_with_no_server(
    service: ServiceProcess, plans: dict[str, Any], loaded_page: Page, open_page: Callable[..., Page], tmp_path: Path
) -> None:
    # The other window would draw all the time.
    loaded_page.goto("about:blank")
    file = tmp_path / "recording.html"
    with service.client() as client:
        file.write_text(client.get(plans["pb1"]["links"]["recording"]).raise_for_status().text, encoding="utf-8")
    page = open_page(f"{file.as_uri()}#t=1.5&source=simulation", offline=True)
    wait_for_plan(page, "pb1")
    assert page.evaluate("[player.sourceName, player.time]") == ["simulation", 1.5]
    page.evaluate("player.seek(2.25)")
    page.wait_for_function("location.hash === '#t=2.25&source=simulation'")
    page.evaluate("player.choose('plan'), player.seek(0)")
    page.wait_for_function("location.hash === ''")
    before, lines = settled(page), now_lines(page)
    panels = page.frame_locator("#scene-frame").locator(".mantine-Paper-root")
    assert panels.count() > 0
    assert panels.locator("visible=true").count() == 0
    drag_to(page, 0.6)
    wait_until_it_differs(page, before)
    assert all(later > earlier + 20 for earlier, later in zip(lines, now_lines(page), strict=True))
    plan_end = page.evaluate("player.choose('plan'), player.seek(player.source.duration), player.time")
    at_plan_end = settled(page)
    page.evaluate("player.choose('simulation'), player.seek(player.source.duration)")
    assert page.evaluate("player.time") > plan_end
    assert "lifted" in text(page, "#ending").lower()
    wait_until_it_differs(page, at_plan_end)
    page.evaluate("player.choose('plan')")
    drag_to(page, 0.0)
    wait_until_it_is_as_before(page, before)
    for button in ("Top", "Overview"):
        plain = settled(page)
        page.get_by_role("toolbar", name="Camera").get_by_role("button", name=button).click()
        wait_until_it_differs(page, plain)
    wait_until_it_is_as_before(page, before)
    # At the start a ghost of the start is hardly seen.
    drag_to(page, 0.6)
    wait_until_it_differs(page, before)
    for layer in ("start", "forces"):
        plain = settled(page)
        page.locator(f"#layer-{layer}").click()
        wait_until_it_differs(page, plain, LAYER_SHARE)
        page.locator(f"#layer-{layer}").click()
        wait_until_it_is_as_before(page, plain)


@pytest.mark.slow
def test_a_job_that_was_cancelled_says_so_and_the_list_is_there_without_a_plan(
    service: ServiceProcess, open_page: Callable[..., Page]
) -> None:
    with service.client() as client:
        posted = [client.post("/v1/plans", json=task(external_id=f"unwanted {i}")).json() for i in range(2)]
        for plan in reversed(posted):
            client.post(plan["links"]["cancel"]).raise_for_status()
        finished(client, posted[-1])
    page = open_page(f"{service.address}/viewer/", drawn=False)
    page.wait_for_function("document.getElementById('message').innerText.includes('Choose a plan')")
    page.locator("#plan-list li", has_text="unwanted 1").click()
    page.wait_for_function("document.getElementById('message').innerText.includes('was cancelled')")
    assert not page.locator("#timeline").is_visible()


def test_who_is_signed_out_is_told_so_and_not_that_it_is_tried_again(
    service: ServiceProcess, open_page: Callable[..., Page]
) -> None:
    page = open_page(f"{service.address}/viewer/", drawn=False)
    page.wait_for_function("connection.ready")
    # As when a key is no longer good: pages lead to where another one is shown.
    page.route("**/viewer/", lambda route: route.fulfill(status=303, headers={"Location": "/login"}))
    page.evaluate("connection.socket.close()")
    page.wait_for_function("document.getElementById('message').innerText.includes('You are signed out')")
