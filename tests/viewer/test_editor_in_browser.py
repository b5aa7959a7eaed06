"""The editor in a real browser: tasks are made by mouse alone and by keyboard alone, refused, undone and planned."""

from __future__ import annotations

import json
import math
import re
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, ViewportSize, expect

from app.viewer.drawing.camera import DRAFT_VIEW, FIELD_OF_VIEW
from app.viewer.editor.draft import cell_of
from planners.cell.cell import load_cell
from planners.geometry.pose import Array
from tests.support.browser import LOADING_MILLISECONDS, draw_no_scene, needs_browser, running_browser, wait_for_plan
from tests.support.plan_shelf import PlanShelf
from tests.support.samples import sample
from tests.support.service import ServiceProcess, finished, running_service, task

WINDOW: ViewportSize = {"width": 960, "height": 600}
PIXELS_PER_POINT = 0.5
"""Few: every pixel is drawn without a graphics card."""
TABLE_TOP = 1.094
UNDER_THE_POINTER = 0.006
"""What is dragged stays so near to where it was grabbed: a pixel is 2 mm, and what is at rest is at whole ones [m]."""
UNNAMED = None
"""The `external_id` of a task that is made here: whoever made it has not named it."""
OWN_TOOL = {
    "shapes": [
        {"shape": {"type": "cylinder", "radius": 0.0175, "height": 0.06}, "pose": [0, 0, 0.03, 1, 0, 0, 0]},
        {"shape": {"type": "box", "size": [0.018, 0.018, 0.19]}, "pose": [0, 0, 0.155, 1, 0, 0, 0]},
    ],
    "mass": 0.25,
    "cup": {"radius": 0.0175, "max_force": 20},
}
FOR_PROGRAMS = (
    r"/kind|/scene_id|/tool/shapes/.*|/options/(search|grips|pushes)|/support|/obstacles|/tool_pose|.*/upload"
)
"""What nobody types: it comes as a task begins, is a list of places that a program knows, or is added as a whole."""

pytestmark = needs_browser


@pytest.fixture(scope="module")
def service(shelf: PlanShelf, data_dir: Path) -> Iterator[ServiceProcess]:
    with running_service(data_dir, shelf.solver) as service:
        yield service


@pytest.fixture(scope="module")
def planned(
    shelf: PlanShelf, service: ServiceProcess, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ServiceProcess]:
    """Return a service that has a plan for whatever is asked; where everything is tried, the one that plans."""
    if sample(quick=False, whole=True):
        yield service
        return
    documents = tmp_path_factory.mktemp("documents")
    (documents / f"{UNNAMED}.json").write_text(json.dumps(shelf.document(task("pb1.json"))))
    solver = (sys.executable, "-m", "tests.support.document_solver", str(documents))
    with running_service(tmp_path_factory.mktemp("planned"), solver) as planned:
        yield planned


@pytest.fixture(scope="module")
def open_page(service: ServiceProcess) -> Iterator[Callable[..., Page]]:
    """Return a function that opens the editor with an empty scene in a window of its own."""
    with running_browser() as browser, opening(browser, service, drawn=False) as open_page:
        yield open_page


@pytest.fixture
def open_drawn(service: ServiceProcess) -> Iterator[Callable[..., Page]]:
    """Return a function that opens the editor in a window of its own, its scene drawn."""
    with running_browser(draws=True) as browser, opening(browser, service, drawn=True) as open_page:
        yield open_page


@contextmanager
def opening(browser: Browser, service: ServiceProcess, *, drawn: bool) -> Iterator[Callable[..., Page]]:
    """Yield a function that opens the editor; whatever the console of a page calls an error fails all."""
    contexts = []
    errors: list[str] = []

    def open_(query: str, at: ServiceProcess = service) -> Page:
        contexts.append(browser.new_context(viewport=WINDOW, device_scale_factor=PIXELS_PER_POINT))
        contexts[-1].set_default_timeout(LOADING_MILLISECONDS)
        contexts[-1].grant_permissions(["clipboard-read", "clipboard-write"])
        page = contexts[-1].new_page()
        if not drawn:
            draw_no_scene(page)
        page.on("pageerror", lambda error: errors.append(str(error)))
        # What viser's own page says in its frame is not ours.
        page.on("console", lambda told: errors.append(told.text) if told.type == "error" and ours(told) else None)
        page.goto(f"{at.address}/viewer/new{query}")
        page.wait_for_function("typeof editor !== 'undefined' && editor?.draft.task.kind")
        return page

    yield open_
    for context in contexts:
        context.close()
    assert errors == []


@pytest.fixture(scope="module")
def loaded(open_page: Callable[..., Page]) -> Page:
    """Return a window with a lift, its scene not drawn, for all tests that need no other one."""
    return open_page("?example=ab1")


@pytest.fixture
def page(loaded: Page) -> Page:
    """Return the window with the example as it is, and nothing to undo but what the test does."""
    loaded.evaluate(f"editor.begin({json.dumps(task('ab1.json'))})")
    wait_for_verdict(loaded, accepted=True)
    return loaded


def ours(told: ConsoleMessage) -> bool:
    """Tell whether a page of ours said something, and not viser's, nor the browser about viser's use of a wheel.

    Nor the browser about what a test keeps from being answered.
    """
    others = ("passive event listener", "net::ERR_FAILED")
    return "/viewer/scene/" not in told.location["url"] and not any(words in told.text for words in others)


def wait_for_scene(page: Page) -> None:
    """Wait until the scene is drawn in the frame."""
    page.wait_for_selector("#scene-frame[src]")
    page.frame_locator("#scene-frame").locator("canvas").first.wait_for()
    page.wait_for_timeout(4000)


def wait_for_verdict(page: Page, *, accepted: bool) -> None:
    """Wait until the service has judged the task as it is now."""
    page.wait_for_function("!editor.checking && !editor.asked")
    page.wait_for_selector("#check-status.yes" if accepted else "#check-status:is(.no, .empty)")


def wait_for_moves(page: Page, number: int) -> None:
    page.wait_for_function(f"editor.moves >= {number}")


def draft(page: Page) -> dict[str, Any]:
    return page.evaluate("editor.draft.task")


def on_screen(page: Page, point: Array) -> tuple[float, float]:
    """Return where a point of the world (3,) is in the window, as the camera is at first."""
    box = page.locator("#scene-frame").bounding_box()
    assert box is not None
    eye, target = DRAFT_VIEW.place(load_cell(str(cell_of(draft(page)))), np.zeros(3))
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    seen = point - eye
    per_metre = 0.5 * box["height"] / (np.tan(0.5 * FIELD_OF_VIEW) * (seen @ ahead))
    x = box["x"] + 0.5 * box["width"] + per_metre * (seen @ right)
    y = box["y"] + 0.5 * box["height"] - per_metre * (seen @ up)
    return float(x), float(y)


def drag(page: Page, begin: Array, end: Array) -> None:
    """Drag with the mouse from one point of the world to another, both (3,) [m]."""
    page.mouse.move(*on_screen(page, begin))
    page.mouse.down()
    for share in np.linspace(0.1, 1.0, 10):
        page.mouse.move(*on_screen(page, begin + share * (end - begin)))
        page.wait_for_timeout(80)
    page.wait_for_timeout(300)
    page.mouse.up()
    page.wait_for_timeout(500)


def plan_solved(page: Page) -> None:
    expect(page.locator("#plan-status .badge")).to_have_text("solved", timeout=LOADING_MILLISECONDS)


@pytest.mark.slow
def test_a_task_is_made_by_mouse_alone_from_an_empty_scene(open_drawn: Callable[..., Page]) -> None:
    page = open_drawn("")
    wait_for_scene(page)
    assert draft(page) == {"kind": "plate_lift"}
    wait_for_verdict(page, accepted=False)
    # Nobody is blamed for what is not begun.
    expect(page.locator("#check-status")).to_have_text("Add a plate and a cup, or begin with an example.")
    assert page.locator("#refusals li").count() == 0
    page.locator("#add-plate").click()
    page.locator("#add-cup").click()
    wait_for_verdict(page, accepted=True)
    before = np.array(draft(page)["plate_pose"])
    corner = np.array([before[0] + 0.08, before[1] - 0.12, TABLE_TOP + 0.04])
    moved = np.array([0.04, 0.06, 0.0])
    drag(page, corner, corner + moved)
    page.wait_for_function(f"Math.abs(editor.draft.task.plate_pose[0] - {before[0]}) > 0.01")
    after = np.array(draft(page)["plate_pose"])
    assert after[:3] - before[:3] == pytest.approx(moved, abs=UNDER_THE_POINTER)
    assert after[3:] == pytest.approx(before[3:]), "it was not turned"
    cup = np.array([after[0] + draft(page)["cup"]["position"][0], after[1], TABLE_TOP + 0.055])
    drag(page, cup, cup + np.array([-0.03, 0.02, 0.0]))
    assert draft(page)["cup"]["position"] == pytest.approx([0.07, 0.02], abs=UNDER_THE_POINTER)
    assert np.array(draft(page)["plate_pose"]) == pytest.approx(after), "the plate stays where it is"
    wait_for_verdict(page, accepted=True)
    page.context.close()


@pytest.mark.slow
def test_a_change_is_judged_though_the_one_before_could_not_be(open_page: Callable[..., Page]) -> None:
    page = open_page("")
    wait_for_verdict(page, accepted=False)
    for answer in ("refused", "fault"):
        page.wait_for_function("!editor.judging")
        page.evaluate(
            "(type) => { const { connection } = editor, send = connection.send.bind(connection);"
            " connection.send = (request) => (request.type === 'judge'"
            " ? connection.receive({ type, request: 'judge', detail: 'The database is away.' }) : send(request));"
            " editor.judge(); connection.send = send; }",
            answer,
        )
        assert not page.evaluate("editor.judging")
    expect(page.locator("#message")).to_contain_text("The database is away.")
    # It was said of what was asked for before.
    page.locator("#add-plate").click()
    expect(page.locator("#message")).to_be_empty()
    page.context.close()


@pytest.mark.slow
def test_what_is_written_is_not_undone_by_a_move_that_was_asked_for_before(open_page: Callable[..., Page]) -> None:
    page = open_page("")
    wait_for_verdict(page, accepted=False)
    # The scene is drawn, but news of moves stay away for a while.
    page.evaluate(
        "() => { const { connection } = editor, held = [], receive = connection.receive.bind(connection);"
        " connection.receive = (message) => "
        "(message.type === 'moved' || message.request === 'nudge' ? held.push(message) : receive(message));"
        " connection.deliver = () => { connection.receive = receive; held.splice(0).forEach(receive); }; }"
    )
    page.locator("#add-plate").click()
    page.locator("#add-cup").click()
    page.wait_for_function("editor.connection.nudges === 2")
    page.evaluate("editor.draft.set('/cup/position', [0.07, 0.02])")
    page.evaluate("editor.connection.deliver()")
    page.wait_for_function("editor.connection.nudged === 2")
    assert draft(page)["cup"]["position"] == [0.07, 0.02]
    # What is asked for after it begins where it was written to.
    page.keyboard.press("ArrowUp")
    page.wait_for_function("editor.connection.nudged === 3")
    assert draft(page)["cup"]["position"] == pytest.approx([0.06, 0.02])
    page.context.close()


@pytest.mark.slow
def test_a_task_is_planned_by_mouse_alone_and_its_path_is_followed_as_the_task_changes(
    open_page: Callable[..., Page],
) -> None:
    page = open_page("")
    page.locator("#add-plate").click()
    page.locator("#add-cup").click()
    wait_for_verdict(page, accepted=True)
    page.evaluate("editor.draft.set('/cup/position', [0.07, 0.02])")
    page.evaluate("editor.draft.set('/options', { simulate: false })")
    wait_for_verdict(page, accepted=True)
    page.locator("#plan").click()
    plan_solved(page)
    expect(page.locator("#feasibility")).to_contain_text("The last path still holds")
    page.locator("#things [data-pointer='/cup/position']").click()
    page.keyboard.press("ArrowUp")
    page.wait_for_function("editor.draft.task.cup.position[0] < 0.065")
    for _ in range(6):
        page.keyboard.press("ArrowUp")
    expect(page.locator("#feasibility")).to_contain_text("the plate is not held")
    expect(page.locator("#feasibility")).to_contain_text("way is left")
    # What was asked once is not asked again for ever.
    page.wait_for_function("!editor.judging && !editor.toJudge")
    page.locator("#undo").click(click_count=1)
    page.locator("#watch").click()
    page.frame_locator("#watch-frame").locator("#outcome.solved").wait_for()
    page.context.close()


def tab_to(page: Page, selector: str) -> None:
    """Press Tab until something has the focus."""
    for _ in range(80):
        if page.evaluate(f"document.activeElement?.matches({json.dumps(selector)})"):
            return
        page.keyboard.press("Tab")
    raise AssertionError(f"{selector} is not reached with Tab")


@pytest.mark.slow
def test_a_task_is_made_by_keyboard_alone_from_an_empty_scene_and_planned(
    open_page: Callable[..., Page], planned: ServiceProcess
) -> None:
    page = open_page("", planned)
    wait_for_verdict(page, accepted=False)
    for name in ("plate", "cup"):
        tab_to(page, f"#add-{name}")
        page.keyboard.press("Enter")
    page.wait_for_function("document.activeElement?.dataset.pointer === '/cup/position'")
    moves = 2
    wait_for_moves(page, moves)  # What was added came to lie.
    page.keyboard.press("ArrowUp")
    page.keyboard.press("Shift+ArrowRight")
    wait_for_moves(page, moves + 2)
    assert draft(page)["cup"]["position"] == pytest.approx([0.09, 0.001])
    page.keyboard.press("Shift+Tab")
    tab_to(page, "#things [data-pointer='/plate_pose']")
    page.keyboard.press("Enter")
    page.keyboard.press("Shift+Q")
    wait_for_moves(page, moves + 3)
    assert page.evaluate("yawOf(editor.draft.task.plate_pose) * 180 / Math.PI") == pytest.approx(1.0)
    tab_to(page, "#field-plate-mass")
    page.keyboard.press("ArrowDown")
    assert draft(page)["plate"]["mass"] == pytest.approx(2.9)
    tab_to(page, "#task-details summary")
    page.keyboard.press("Enter")
    tab_to(page, "#field-options-simulate")
    page.keyboard.press("Space")
    wait_for_verdict(page, accepted=True)
    page.keyboard.press("Control+Enter")
    plan_solved(page)
    page.context.close()


def test_every_step_is_undone_and_done_again(page: Page) -> None:
    first = draft(page)
    page.locator("#things [data-pointer='/plate_pose']").click()
    moves = page.evaluate("editor.moves")
    page.keyboard.press("ArrowRight")
    wait_for_moves(page, moves + 1)
    page.locator("#add-obstacle").click()
    wait_for_moves(page, moves + 2)
    page.locator("#field-obstacles-0-shape-size-0").fill("50")
    page.locator("#field-obstacles-0-shape-size-0").blur()
    made = draft(page)
    assert made["obstacles"][0]["shape"]["size"][0] == pytest.approx(0.05)
    assert made["plate_pose"][1] == pytest.approx(0.01)
    states = [made]
    while draft(page) != first:
        page.locator("#undo").click()
        states.append(draft(page))
        assert len(states) < 12
    for state in reversed(states[:-1]):
        page.keyboard.press("Control+Shift+Z")
        assert draft(page) == state
    assert page.locator("#redo").is_disabled()


def test_the_cups_place_may_be_left_to_the_planner(page: Page) -> None:
    page.locator("#things [data-pointer='/cup/position']").click()
    page.get_by_role("button", name="Find the best place").click()
    wait_for_verdict(page, accepted=True)
    assert "position" not in draft(page)["cup"]
    expect(page.locator("#plan")).to_be_enabled()
    expect(page.locator("#field-cup-position")).to_be_focused()
    expect(page.locator("#things [data-pointer='/cup/position']")).to_have_class("cup ")
    page.keyboard.press("Enter")
    wait_for_verdict(page, accepted=True)
    assert draft(page)["cup"]["position"] == [0, 0]
    page.keyboard.press("Control+z")
    page.keyboard.press("Control+z")
    assert draft(page)["cup"]["position"] == task("ab1.json")["cup"]["position"]


def test_what_was_most_probably_not_meant_is_told_and_taken(page: Page) -> None:
    page.evaluate("editor.draft.set('/plate_pose', [0.3, 0, 1.114, 0, 0, 0, 1])")
    wait_for_verdict(page, accepted=True)
    expect(page.locator("#check-status")).to_contain_text("/plate_pose: 0, 0, 0, 1 is half a turn")


@pytest.mark.slow
def test_what_is_refused_is_told_at_its_field_and_at_its_thing_in_the_services_words(page: Page) -> None:
    page.locator("#things [data-pointer='/cup/position']").click()
    page.locator("#field-cup-position-0").fill("160")
    wait_for_verdict(page, accepted=False)
    (said,) = page.evaluate("editor.errors")
    assert said["pointer"] == "/cup/position"
    assert "mm over the edge of the plate's top face" in said["detail"]
    # Neither axis is to blame alone.
    whole = page.locator("#fields .error[data-pointer='/cup/position']")
    expect(whole).to_have_text(said["detail"])
    expect(page.locator("#field-cup-position-0-error")).to_be_empty()
    expect(page.locator("#things [data-pointer='/cup/position']")).to_have_class("cup wrong")
    expect(page.locator("#refusals li")).to_contain_text([said["detail"]])
    expect(page.locator("#plan")).to_be_disabled()
    page.locator("#things [data-pointer='/plate_pose']").click()
    page.locator("#field-plate-mass").fill("")
    page.wait_for_function("editor.errors.some(({ pointer }) => pointer === '/plate/mass')")
    expect(page.locator("#field-plate-mass-error")).to_contain_text("must be a number")
    page.locator("#field-plate-mass").fill("4")
    wait_for_verdict(page, accepted=False)
    page.locator("#refusals button").click()
    expect(page.locator("#field-cup-position-0")).to_be_focused()
    page.locator("#field-cup-position-0").fill("100")
    wait_for_verdict(page, accepted=True)
    expect(whole).to_be_empty()
    expect(page.locator("#plan")).to_be_enabled()


def test_the_task_is_copied_as_json_and_as_a_line_that_posts_it(page: Page, service: ServiceProcess) -> None:
    page.evaluate("editor.draft.set('/external_id', \"it's ours\")")
    page.locator("#copy-json").click()
    expect(page.locator("#copy-json")).to_have_text("Copied")
    assert json.loads(page.evaluate("navigator.clipboard.readText()")) == draft(page)
    page.locator("#copy-curl").click()
    expect(page.locator("#copy-curl")).to_have_text("Copied")
    command = shlex.split(page.evaluate("navigator.clipboard.readText()"))
    assert command[0] == "curl"
    assert json.loads(command[command.index("-d") + 1]) == draft(page)
    assert command[-1] == f"{service.address}/v1/plans"


def test_a_study_of_the_cups_places_keeps_the_pad_on_the_plate_and_leads_to_its_map(
    page: Page, service: ServiceProcess
) -> None:
    page.evaluate("editor.draft.set('/plate/shape/size/1', 0.2)")
    wait_for_verdict(page, accepted=True)
    page.get_by_role("button", name="Where may the cup sit?").click()
    link = page.get_by_role("link", name="Open the map")
    expect(link).to_be_visible()
    address = link.get_attribute("href")
    assert address is not None
    with service.client() as client:
        found = client.get(address.removesuffix("/view")).json()
        client.post(found["links"]["cancel"])
        studied = client.get(found["links"]["map"]).json()
        values = {axis["pointer"]: axis["values"] for axis in studied["axes"]}
        assert sorted(values) == ["/cup/position/0", "/cup/position/1"]
        told = draft(page)
        for least_or_most in (0, -1):
            place = [values[f"/cup/position/{axis}"][least_or_most] for axis in range(2)]
            there = {**told, "cup": {**told["cup"], "position": place}}
            assert client.post("/v1/tasks/check", json=there).json()["accepted"]
            beyond = {**told, "cup": {**told["cup"], "position": [1.02 * each for each in place]}}
            assert not client.post("/v1/tasks/check", json=beyond).json()["accepted"]


def test_every_input_has_a_name_and_every_thing_has_fields(page: Page) -> None:
    page.evaluate(f"editor.begin({json.dumps(task('can_stack.json'))})")
    page.evaluate("document.getElementById('task-details').open = true")
    for pointer in page.evaluate("editor.things.map(({ pointer }) => pointer)"):
        page.locator(f"#things [data-pointer='{pointer}']").click()
        nameless = page.evaluate(
            "[...document.querySelectorAll('input, select, textarea, button')].filter((each) =>"
            " !each.labels?.length && !each.getAttribute('aria-label') && !each.textContent.trim())"
            ".map((each) => each.outerHTML)"
        )
        assert nameless == []
        assert page.locator("#thing-fields input, #thing-fields select").count() > 0


@pytest.mark.parametrize("name", ["pb1", "can_stack", "a tool of its own"])
def test_every_member_of_an_accepted_task_has_a_field_unless_only_programs_write_it(page: Page, name: str) -> None:
    body = {**task("can_stack.json" if name == "a tool of its own" else f"{name}.json"), "friction": {"eps": 0.01}}
    if name == "a tool of its own":
        body["tool"] = OWN_TOOL
    page.evaluate(f"editor.begin({json.dumps(body)})")
    page.evaluate("document.getElementById('task-details').open = true")
    page.wait_for_function("editor.accepted?.friction.eps === 0.01")
    fields = set[str]()
    for pointer in page.evaluate("editor.things.map(({ pointer }) => pointer)"):
        page.locator(f"#things [data-pointer='{pointer}']").click()
        fields |= set(
            page.evaluate("[...document.querySelectorAll('#fields .error')].map(({ dataset }) => dataset.pointer)")
        )
    members = page.evaluate("editor.accepted")
    without = [each for each in leaves(members) if not any(f"{each}/".startswith(f"{field}/") for field in fields)]
    assert [each for each in without if not re.fullmatch(FOR_PROGRAMS, each)] == []


def leaves(value: Any, pointer: str = "") -> Iterator[str]:
    """Yield pointers of all members that are no object with members and no list with items."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    inner = [leaf for name, each in items for leaf in leaves(each, f"{pointer}/{name}")]
    yield from inner or [pointer]


def test_a_centre_of_mass_and_joints_at_the_beginning_are_typed_and_left_to_the_service_again(page: Page) -> None:
    page.evaluate("document.getElementById('task-details').open = true")
    page.locator("#things [data-pointer='/plate_pose']").click()
    page.locator("#field-plate-com-1").fill("4")
    joints = page.locator("#field-start_positions")
    joints.fill("90 -90 0 0 0 0\n180 0 0 0 0 -45")
    joints.blur()
    made = draft(page)
    assert made["plate"]["com"] == [0, 0.004, 0]
    half_turn = [math.radians(each) for each in (90, -90, 0, 0, 0, 0, 180, 0, 0, 0, 0, -45)]
    assert made["start_positions"] == pytest.approx(half_turn)
    # What is typed on the way to a number leaves the others as they are.
    page.locator("#field-plate-com-0").press("Control+a")
    page.locator("#field-plate-com-0").press_sequentially("-5")
    assert draft(page)["plate"]["com"] == [-0.005, 0.004, 0]
    page.locator("#field-plate-com-0").fill("")
    assert draft(page)["plate"]["com"] == [0, 0.004, 0]
    page.locator("#field-plate-com-1").fill("")
    joints.fill("")
    assert draft(page).keys() & {"start_positions"} == set()
    assert "com" not in draft(page)["plate"]


@pytest.mark.slow
def test_a_plan_is_changed_where_it_is_watched(open_page: Callable[..., Page], service: ServiceProcess) -> None:
    body = task("pb1_weak_cup.json")
    with service.client() as client:
        plan = finished(client, client.post("/v1/plans", json=body).json())
    page = open_page("?example=pb1")
    page.goto(service.address + plan["links"]["view"])
    wait_for_plan(page, "pb1_weak_cup")
    page.get_by_role("link", name="Change this task").click()
    page.wait_for_function("typeof editor !== 'undefined' && editor?.draft.task.kind")
    told = draft(page)
    assert told["cup"]["max_force"] == body["cup"]["max_force"]
    wait_for_verdict(page, accepted=True)


def test_objects_begin_and_end_on_the_table_of_the_cell_that_is_taken_where_none_is_named(
    open_page: Callable[..., Page],
) -> None:
    page = open_page("?kind=suction_tool")
    wait_for_scene(page)
    page.locator("#add-object").click()
    wait_for_verdict(page, accepted=True)
    (placed,) = draft(page)["objects"]
    assert placed["pose"][2] == pytest.approx(TABLE_TOP + 0.03)
    assert placed["goal_pose"][2] == pytest.approx(TABLE_TOP + 0.03)


@pytest.mark.slow
def test_a_draft_is_there_again_when_its_page_is_loaded_again_and_not_when_another_one_is_opened(
    open_page: Callable[..., Page],
) -> None:
    page = open_page("?example=pb1")
    wait_for_verdict(page, accepted=True)
    page.locator("#things [data-pointer='/plate_pose']").click()
    page.locator("#field-plate-mass").fill("3.25")
    wait_for_verdict(page, accepted=True)
    page.reload()
    page.wait_for_function("typeof editor !== 'undefined' && editor?.draft.task.plate?.mass === 3.25")
    page.goto(page.url.replace("pb1", "ab1"))
    page.goto(page.url.replace("ab1", "pb1"))
    page.wait_for_function(
        "typeof editor !== 'undefined' && editor?.draft.task.plate && editor.draft.task.plate.mass !== 3.25"
    )


@pytest.mark.slow
def test_a_task_that_cannot_be_posted_is_told_and_may_be_posted_once_the_service_answers(
    open_page: Callable[..., Page],
) -> None:
    page = open_page("?example=pb1")
    wait_for_verdict(page, accepted=True)
    page.route("**/v1/plans", lambda route: route.abort())
    page.locator("#plan").click()
    expect(page.locator("#plan-status")).to_have_text("The task was not posted: the service does not answer.")
    page.unroute("**/v1/plans")
    expect(page.locator("#plan")).to_be_enabled()
    page.route("**/v1/tasks/check", lambda route: route.abort())
    page.evaluate("editor.askSoon()")
    expect(page.locator("#plan")).to_be_disabled()
    expect(page.locator("#check-status")).to_have_text("The service does not answer.")
    page.unroute("**/v1/tasks/check")
    expect(page.locator("#plan")).to_be_enabled()


def test_nothing_but_an_empty_task_is_begun_where_there_is_no_such_plan(open_page: Callable[..., Page]) -> None:
    page = open_page("?plan=zzz")
    expect(page.locator("#message")).to_contain_text("there is no plan 'zzz'")
    page.wait_for_function("editor?.draft.task.kind === 'plate_lift'")
    expect(page.locator("#add-plate")).to_be_visible()
    expect(page.locator("#plan")).to_be_disabled()


@pytest.mark.slow
def test_what_cannot_be_begun_with_is_told(open_page: Callable[..., Page]) -> None:
    page = open_page("?example=pb1")
    page.evaluate("editor.connection.send({ type: 'start', of: 'example', name: 'none' })")
    expect(page.locator("#message")).to_contain_text("there is no example 'none'")
