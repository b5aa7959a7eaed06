"""Executions on a page: what a log says is what is played, beside the plan."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from app.cli.output import BadInput
from app.cli.replay_command import replay_files
from app.viewer.description.charts import MILLIRADIANS, executed_charts
from app.viewer.page import describe_plan
from app.viewer.playback import Playback
from planners.kinematics.forward import flange_pose_of_plan
from planners.plan.plan import Plan
from planners.plan.scenery import ARMS
from tests.support.browser import needs_browser, running_browser, wait_for_plan
from tests.support.moving_plan import DURATION, moving_plan
from workers.robot.execution_log import ExecutedMotion, NotALog

STEP = 0.02
BEFORE = {"time": 0.0, "event": "begin", "plan": None, "speed": 1.0}
END = {"time": 99.0, "event": "end", "done": True, "step": 4, "reached": {}}


@pytest.fixture(scope="module")
def plan() -> Plan:
    return moving_plan()


def write_log(path: Path, plan: Plan, clock: Iterable[float], off: float = 0.0, end: dict | None = END) -> Path:
    """Write what an execution would have: both arms where the plan has them, and all joints off by some radians."""
    lines = [{**BEFORE, "digest": plan.digest}]
    for index, at in enumerate(clock):
        q = plan.at(at).positions + off
        arms = {
            arm: {"positions": q[6 * i : 6 * i + 6].tolist(), "force": [0.0, 3.0, 4.0 * i]}
            for i, arm in enumerate(ARMS)
        }
        lines.append({"time": 0.5 + STEP * index, "clock": float(at), "arms": arms})
    lines += [] if end is None else [end]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def there_and_back(plan: Plan) -> np.ndarray:
    """Return a clock that runs into the second step, back to the begin, and then to the end."""
    turn = 1.5 * DURATION
    return np.concatenate(
        [np.arange(0.0, turn, STEP), np.arange(turn, 0.0, -STEP), np.arange(0.0, plan.duration, STEP)]
    )


def test_arms_are_played_where_they_were_and_the_rest_where_the_plan_has_it(plan: Plan, tmp_path: Path) -> None:
    clock = there_and_back(plan)
    executed = ExecutedMotion.read(write_log(tmp_path / "log", plan, clock, off=0.01))
    playback = Playback(plan, executed)
    assert playback.durations["execution"] == pytest.approx(STEP * (len(clock) - 1))
    rng = np.random.default_rng(2)
    for time in rng.uniform(0.0, playback.durations["execution"], 30):
        at = float(np.interp(time, STEP * np.arange(len(clock)), clock))
        played, planned = playback.at("execution", float(time)), plan.at(at)
        np.testing.assert_allclose(played.positions, planned.positions + 0.01, atol=2e-3)
        for name, pose in planned.body_poses.items():
            np.testing.assert_allclose(played.body_poses[name], pose, atol=1e-12)


def test_segments_are_told_as_often_as_they_were_executed_back_and_forth(plan: Plan, tmp_path: Path) -> None:
    executed = ExecutedMotion.read(write_log(tmp_path / "log", plan, there_and_back(plan)))
    played = describe_plan(plan, executed).sources["execution"]
    planned = [segment.words for segment in describe_plan(plan).sources["plan"].segments]
    order = [0, 1, 0, 1, 2, 3]
    assert [segment.words for segment in played.segments] == [planned[index] for index in order]
    ends = [segment.end for segment in played.segments]
    assert ends[:-1] == pytest.approx([segment.start for segment in played.segments[1:]])
    assert ends[-1] == pytest.approx(played.duration)


def test_curves_say_how_far_off_arms_were_and_what_wrists_felt(plan: Plan, tmp_path: Path) -> None:
    executed = ExecutedMotion.read(write_log(tmp_path / "log", plan, np.arange(0.0, plan.duration, STEP), off=-0.02))
    off, force = executed_charts(plan, executed)
    for index, arm in enumerate(ARMS):
        assert off.series[index].name == force.series[index].name == arm
        np.testing.assert_allclose(off.series[index].values, 0.02 * MILLIRADIANS, rtol=1e-6)
        np.testing.assert_allclose(force.series[index].values, np.hypot(3.0, 4.0 * index))


def test_behind_the_lifter_the_plate_is_as_high_as_the_hands_and_nothing_is_off_a_plan(
    plan: Plan, tmp_path: Path
) -> None:
    clock = np.concatenate([np.arange(0.0, plan.duration, STEP), np.full(20, plan.duration)])
    log = write_log(tmp_path / "log", plan, clock)
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    lifted = lines[-2]["arms"]
    for arm in ARMS:
        lifted[arm]["positions"][1] -= 0.1
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    executed = ExecutedMotion.read(log)
    moment, ended = Playback(plan, executed).at("execution", float(executed.time[-1])), plan.at(plan.duration)
    arms = plan.cell.arms
    rises = []
    for arm in ARMS:
        here, there = (
            flange_pose_of_plan(arms[arm].dh, arms[arm].T_world_base, np.array(q))[2, 3]
            for q in (lifted[arm]["positions"], ended.positions[6 * ARMS.index(arm) :][:6])
        )
        rises.append(here - there)
    up = moment.body_poses["plate"] - ended.body_poses["plate"]
    np.testing.assert_allclose(up, [0.0, 0.0, np.mean(rises), 0.0, 0.0, 0.0, 0.0], atol=1e-9)
    off = executed_charts(plan, executed)[0].series[0].values
    assert np.isnan(off[-20:]).all()
    assert not np.isnan(off[:-20]).any()


def test_logs_that_were_cut_off_are_read_as_far_as_they_go(plan: Plan, tmp_path: Path) -> None:
    log = write_log(tmp_path / "log", plan, np.arange(0.0, plan.duration, STEP))
    whole, text = ExecutedMotion.read(log), log.read_text()
    assert whole.is_done
    log.write_text(text[: len(text) // 2])
    half = ExecutedMotion.read(log)
    assert 0.3 < len(half.time) / len(whole.time) < 0.7
    assert not half.is_done
    assert "ends before" in half.ending


@pytest.mark.parametrize("text", ["", "{}", "[1]", "nonsense", '{"event": "begin"}\n', '{"arms": 3}', "\x00\x01"])
def test_what_is_no_log_is_refused_by_its_name(text: str, tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    path.write_text(text)
    with pytest.raises(NotALog, match=r"log\.jsonl"):
        ExecutedMotion.read(path)


def test_a_log_of_another_plan_is_refused(plan: Plan, tmp_path: Path) -> None:
    document, log = tmp_path / "plan.json", tmp_path / "log.jsonl"
    document.write_bytes(plan.write())
    write_log(log, plan, [0.0, 0.1, 0.2])
    log.write_text(log.read_text().replace('"digest": null', f'"digest": "{64 * "0"}"'))
    with pytest.raises(BadInput, match="another plan"):
        replay_files(document, log, None, tmp_path / "page.html")


@needs_browser
@pytest.mark.slow
def test_a_page_plays_an_execution_that_was_stopped_beside_its_plan(plan: Plan, tmp_path: Path) -> None:
    document, log, page_file = tmp_path / "plan.json", tmp_path / "log.jsonl", tmp_path / "page.html"
    document.write_bytes(plan.write())
    stop = {"time": 9.0, "event": "stop", "reason": "asked", "words": "somebody asked to stop", "arm": None}
    write_log(log, plan, np.arange(0.0, 1.5 * DURATION, STEP), end=stop)
    assert replay_files(document, log, None, page_file) == 0
    with running_browser() as browser:
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.goto(page_file.as_uri())
        wait_for_plan(page, describe_plan(plan).title)
        assert page.locator("#sources button:visible").all_inner_texts() == ["Plan", "Execution"]
        assert page.locator("#executed").inner_text() == "stopped: somebody asked to stop"
        page.keyboard.press("p")
        assert page.evaluate("player.sourceName") == "execution"
        assert page.evaluate("player.source.duration") == pytest.approx(1.5 * DURATION, abs=2 * STEP)
        assert "Farthest joint off the plan" in page.locator("#charts").inner_text()
        page.keyboard.press("p")
        assert page.evaluate("player.sourceName") == "plan"
