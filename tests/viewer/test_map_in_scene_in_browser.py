"""The map of a study on the plate, in a real browser, in the colours of its scale: a click on a tile opens its plan."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, ViewportSize, expect

from app.pictures.study_picture import FULL_RESERVE
from app.viewer.drawing.camera import FIELD_OF_VIEW
from planners.geometry.pose import Array, from_pose7
from tests.support.browser import flawless_page, needs_browser, running_browser
from tests.support.plan_shelf import PlanShelf
from tests.support.scene_pictures import settled, wait_until_it_differs, wait_until_it_is_as_before
from tests.support.service import FAKE_EXAMINER, ServiceProcess, finished, running_service, task

pytestmark = [needs_browser, pytest.mark.slow]
WINDOW: ViewportSize = {"width": 960, "height": 640}
TASK = task("pb1.json", options={"simulate": False})
AXES = [
    {"pointer": "/cup/position/0", "values": [-0.045, 0.045]},
    {"pointer": "/cup/position/1", "values": [-0.08, 0.0]},
]
FROM_ABOVE = "(camera && Math.hypot(camera[0] - camera[3], camera[1] - camera[4]) < camera[2] - camera[5])"
SHOWN = 3
"""Point of the study: the cup of pb1 itself."""
SAME_COLOUR = 12
"""Of 255: a step of the scale's gradient beside the other."""


@pytest.fixture(scope="module")
def service(shelf: PlanShelf, data_dir: Path) -> Iterator[ServiceProcess]:
    with running_service(data_dir, shelf.solver, study_command=json.dumps(FAKE_EXAMINER)) as service:
        yield service


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with running_browser(draws=True) as browser:
        yield browser


@pytest.fixture
def page(browser: Browser, service: ServiceProcess) -> Iterator[Page]:
    with flawless_page(browser, service.address, viewport=WINDOW) as page:
        yield page


def on_screen(page: Page, place: Array) -> tuple[float, float]:
    """Return where in the window a place in the world (3,) [m] is seen: by a pinhole camera that stands upright."""
    eye, target = np.reshape(page.evaluate("camera"), (-1, 3))[:2]
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    across, up, depth = np.array([right, np.cross(right, ahead), ahead]) @ (place - eye)
    frame: Any = page.locator("#scene-frame").bounding_box()
    pixels = 0.5 * frame["height"] / np.tan(0.5 * FIELD_OF_VIEW) / depth
    return (
        frame["x"] + 0.5 * frame["width"] + pixels * across,
        frame["y"] + 0.5 * frame["height"] - pixels * up,
    )


def cup_in_world(plan: dict[str, Any]) -> Array:
    plate = plan["plate"]["shape"]["size"]
    return (from_pose7(plan["plate_pose"]) @ [*plan["cup"]["position"], 0.5 * plate[2], 1.0])[:3]


def look_from_above(page: Page) -> None:
    """Have the scene be seen from above, and wait until it is and the page knows from where."""
    aside = settled(page)
    page.evaluate("connection.look('top')")
    wait_until_it_differs(page, aside)
    # What the browser tells of its camera may be from before it was moved.
    page.wait_for_function(f"connection.askCamera() || {FROM_ABOVE}", polling=500)


def test_a_click_on_a_tile_opens_the_plan_of_its_point(page: Page, service: ServiceProcess, shelf: PlanShelf) -> None:
    # Planned before the page draws: a solver yields to whatever else keeps the machine busy.
    cup = {**TASK["cup"], "position": [AXES[0]["values"][1], AXES[1]["values"][0]]}
    shelf.document({**TASK, "cup": cup})
    with service.client() as client:
        study = client.post("/v1/studies", json={"task": TASK, "axes": AXES}).json()
        finished(client, study)
        shown = finished(client, client.post(f"{study['links']['points']}/{SHOWN}/plan").json())
    page.goto(f"/viewer/?plan={shown['id']}&study={study['id']}")
    expect(page.locator("#study-told")).to_contain_text("3 of 4 cup places are solved")
    look_from_above(page)
    painted = settled(page)

    # The switch of the layer hides the tiles and shows them again.
    page.keyboard.press("m")
    wait_until_it_differs(page, painted)
    page.keyboard.press("m")
    wait_until_it_is_as_before(page, painted)

    page.mouse.click(*on_screen(page, cup_in_world({**TASK, "cup": cup})))
    page.wait_for_url(re.compile(rf"plan=(?!{shown['id']})\w+&study={study['id']}"))
    with service.client() as client:
        plan = re.search(r"plan=(\w+)", page.url)
        assert plan is not None
        finished(client, client.get(f"/v1/plans/{plan[1]}").json())
        page.wait_for_function(f"player.description?.id === '{plan[1]}'")
        assert client.get(f"/v1/plans/{plan[1]}/document").json()["task"]["cup"]["position"] == cup["position"]
    expect(page.locator("#study-told")).to_contain_text("3 of 4 cup places are solved")


def test_a_plan_of_a_point_has_its_studys_map_in_the_colours_of_the_scale_however_it_is_opened(
    page: Page, service: ServiceProcess
) -> None:
    with service.client() as client:
        study = client.post("/v1/studies", json={"task": {**TASK, "external_id": "bright"}, "axes": AXES}).json()
        known = client.get(finished(client, study)["links"]["map"]).json()["points"]
        posted = client.post(f"{study['links']['points']}/{SHOWN}/plan").json()
        assert finished(client, posted)["study_id"] == study["id"]
        other = finished(client, client.post("/v1/plans", json=TASK).json())
    page.goto("/viewer/")
    page.locator(f"[data-plan='{posted['id']}']").click()
    expect(page.locator("#study-told")).to_contain_text("3 of 4 cup places are solved")
    assert f"study={study['id']}" in page.url

    look_from_above(page)
    named = settled(page)
    # The plate's name may stand over a tile.
    page.keyboard.press("n")
    wait_until_it_differs(page, named)
    settled(page)
    seen = np.asarray(Image.open(io.BytesIO(page.screenshot(scale="css"))).convert("RGB"), dtype=int)
    scale: Any = page.locator(".map-scale").bounding_box()
    # The first point's tile is seen whole: no arm is over it.
    place = [AXES[axis]["values"][at] for axis, at in enumerate(known[0]["at"])]
    column, row = on_screen(page, cup_in_world({**TASK, "cup": {"position": place}}))
    along = scale["x"] + known[0]["reserve"] / FULL_RESERVE * scale["width"]
    wanted = seen[round(scale["y"] + 0.5 * scale["height"]), round(along)]
    assert np.abs(seen[round(row), round(column)] - wanted).max() <= SAME_COLOUR

    # What is no point of it has no map.
    page.locator(f"[data-plan='{other['id']}']").click()
    page.wait_for_function(f"player.description?.id === '{other['id']}'")
    expect(page.locator("#study-told")).to_have_count(0)
    assert "study=" not in page.url
