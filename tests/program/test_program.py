"""Programs against the plan that they are made of, and what must never become one."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from app.cli.main import main
from app.settings import ServiceSettings
from planners.cell.cell import load_cell
from planners.certify.motion.kinematics import ArmKinematics
from planners.contract.task_spec import read_task
from planners.geometry.pose import Array, from_pose7
from planners.lifting.hand_admittance import LEAST_PUSH
from planners.plan.plan import Plan
from planners.plan.planned_wrenches import LEAD
from planners.plan.scenery import ARMS, GripperDocument
from planners.program import NotExportable, ProgramTarget, Schedule, exportable, write_program
from planners.program.archive import check_urscript
from planners.program.urscript import Handshake, write_urscript
from tests.support.plan_shelf import PlanShelf
from tests.support.service import finished, task
from tests.support.serving import served

TASKS = ("ab1", "domino_pile")
MOVE = re.compile(r"lw_to\(([^,]+), \[([^]]+)\], \[([^]]+)\](?:, \[[^]]+\])?\)")
STAY = re.compile(r"lw_stay\(([^)]+)\)")
BEGIN = re.compile(r"lw_(?:begin|run)\((\d+)\)$")
"""The first step is begun in two parts: between them fingers open."""


def streamed(script: str) -> list[tuple[int, float, Array | None, Array | None]]:
    """Return what a script streams: number of the step, duration, and joints with their velocities, or None."""
    found: list[tuple[int, float, Array | None, Array | None]] = []
    number = 0
    for line in map(str.strip, script.partition("# ---- the plan ----")[2].splitlines()):
        if begin := BEGIN.match(line):
            number = int(begin[1])
        elif move := MOVE.match(line):
            q, v = (np.array(each.split(","), dtype=float) for each in move.groups()[1:3])
            found.append((number, float(move[1]), q, v))
        elif stay := STAY.match(line):
            found.append((number, float(stay[1]), None, None))
    return found


def parsed(document: str) -> Any:
    try:
        return json.loads(document)
    except ValueError:
        return None


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.slow
def test_what_is_streamed_is_the_plan_between_its_samples_too(plans: dict[str, Plan], name: str) -> None:
    plan = plans[name]
    rng = np.random.default_rng(0)
    for arm, columns in (("left", slice(0, 6)), ("right", slice(6, 12))):
        q, v, time = plan.segments[0].positions[0, columns], np.zeros(6), 0.0
        for number, duration, q_end, v_end in streamed(write_urscript(Schedule.of(plan), arm)):
            for s in (rng.uniform(), 1.0):
                if q_end is None or v_end is None:
                    now = q
                else:
                    # Hermite's cubic in Bernstein's form, which the script does not use.
                    points = np.array([q, q + duration * v / 3, q_end - duration * v_end / 3, q_end])
                    now = np.array([(1 - s) ** 3, 3 * s * (1 - s) ** 2, 3 * s**2 * (1 - s), s**3]) @ points
                planned = plan.at(min(time + s * duration, plan.segments[number - 1].end - 1e-9))
                np.testing.assert_allclose(now, planned.positions[columns], atol=1e-6)
            if q_end is not None and v_end is not None:
                q, v = q_end, v_end
            time += duration
        assert time == pytest.approx(plan.duration, abs=1e-6)


@pytest.mark.parametrize("name", TASKS)
@pytest.mark.parametrize("handshake", Handshake)
def test_both_programs_have_the_same_steps_of_the_same_length_each_behind_its_barrier(
    plans: dict[str, Plan], name: str, handshake: Handshake
) -> None:
    schedule = Schedule.of(plans[name])
    left, right = (write_urscript(schedule, arm, handshake) for arm in ARMS)
    begun = [[int(n) for n in re.findall(r"^  lw_(?:begin|run)\((\d+)\)$", script, re.M)] for script in (left, right)]
    lifts = name == "ab1" and handshake is Handshake.REGISTERS
    assert begun[0] == begun[1] == list(range(1, len(plans[name].segments) + 1 + lifts))
    lengths = [np.zeros(len(plans[name].segments)) for _ in ARMS]
    for total, script in zip(lengths, (left, right), strict=True):
        for number, duration, *_ in streamed(script):
            total[number - 1] += duration
    np.testing.assert_allclose(lengths[0], lengths[1], atol=1e-6)


def test_the_payload_is_hand_and_what_rides_on_it_where_pinocchio_has_it(plans: dict[str, Plan]) -> None:
    plan = plans["domino_pile"]
    carried = 0
    for step, part in zip(Schedule.of(plan).steps, plan.segments, strict=True):
        at = plan.at(0.5 * (part.time[0] + part.end))
        for arm, columns in (("left", slice(0, 6)), ("right", slice(6, 12))):
            riding = [body for body, ride in part.rides if ride.to == arm]
            riding += [body for body, ride in part.rides if ride.to in riding]
            if any(sum(ride.to in ARMS for ride in part.attached[body]) > 1 for body in riding):
                continue
            robot, hand = plan.cell.arms[arm], plan.cell.hands[arm]
            T_world_flange = ArmKinematics(robot.dh, robot.T_world_base).frames(at.positions[None, columns])[0, 6]
            assert hand.mass is not None
            assert hand.com is not None
            masses, centres = [hand.mass], [T_world_flange[:3, :3] @ hand.com + T_world_flange[:3, 3]]
            for body in riding:
                T_world_body = from_pose7(at.body_poses[body])
                masses.append(plan.bodies[body].mass or 0.0)
                centres.append(T_world_body[:3, :3] @ plan.bodies[body].com + T_world_body[:3, 3])
            centre = np.average(centres, axis=0, weights=masses) - T_world_flange[:3, 3]
            load = step.arms[arm].load
            assert load.mass == pytest.approx(float(np.sum(masses)))
            np.testing.assert_allclose(load.com, T_world_flange[:3, :3].T @ centre, atol=1e-4)
            carried += len(riding) > 1
    assert carried, "an object is carried by the tool, which a hand carries"


@pytest.mark.parametrize("name", TASKS)
def test_fingers_close_with_the_planned_squeeze_whenever_a_hand_takes_hold(plans: dict[str, Plan], name: str) -> None:
    """Nothing is gripped that no step has gripped with that force before."""
    plan, squeezes = plans[name], dict.fromkeys(ARMS, 0.0)
    for step, part in zip(Schedule.of(plan).steps, plan.segments, strict=True):
        for arm in ARMS:
            mine = step.arms[arm]
            width = part.gripper_width.get(arm, np.zeros(1))
            assert (mine.width is None) == (np.ptp(width) == 0.0)
            assert mine.squeeze is None or part.kind == "grip"
            if mine.width is not None:
                squeezes[arm] = mine.squeeze or 0.0
        for grip in part.grips:
            if part.kind != "release":
                assert squeezes[grip.arm] == grip.squeeze


@pytest.mark.parametrize("name", TASKS)
def test_fingers_are_told_forces_of_their_range_where_they_open_too(plans: dict[str, Plan], name: str) -> None:
    schedule, all_told = Schedule.of(plans[name]), 0
    for arm in ARMS:
        hand = schedule.plan.cell.hands[arm]
        told = re.findall(r"^ +site_fingers\((.*), (.*)\)$", write_urscript(schedule, arm), re.MULTILINE)
        all_told += len(told)
        if isinstance(hand, GripperDocument):
            assert hand.force_range is not None
            least, most = hand.force_range
            assert all(least <= float(force) <= most for _, force in told)
        else:
            assert not told
    assert all_told


def test_the_plate_of_a_lift_is_no_payload(plans: dict[str, Plan]) -> None:
    """Controllers take the weight of the payload off what they feel; that of a plate is what hands are told to bear."""
    plan = plans["ab1"]
    for step in Schedule.of(plan).steps:
        for arm in ARMS:
            assert step.arms[arm].load.mass == plan.cell.hands[arm].mass


def test_without_objects_arms_move_as_planned_and_bear_nothing_but_hands_and_tool(plans: dict[str, Plan]) -> None:
    for name in ("ab1", "domino_pile"):
        plan = plans[name]
        whole, bare = Schedule.of(plan), Schedule.of(plan, with_objects=False)
        tool = sum(body.mass or 0.0 for body in plan.bodies.values() if body.role == "tool")
        lighter = 0
        for there, step in zip(whole.steps, bare.steps, strict=True):
            for arm in ARMS:
                mine, hand = step.arms[arm], plan.cell.hands[arm].mass or 0.0
                np.testing.assert_array_equal(mine.positions, there.arms[arm].positions)
                assert (mine.width, mine.squeeze, mine.vacuum) == (
                    there.arms[arm].width,
                    there.arms[arm].squeeze,
                    there.arms[arm].vacuum,
                )
                assert mine.wrenches is None
                assert any(mine.load.mass == pytest.approx(hand + share * tool) for share in (0.0, 0.5, 1.0))
                lighter += mine.load.mass < there.arms[arm].load.mass - 1e-9
        assert (lighter > 0) == (name == "domino_pile"), "a plate is in no payload anyway"
        assert bare.lift is None
        scripts = [write_urscript(bare, arm) for arm in ARMS]
        assert all("lw_on_plate" not in script for script in scripts)


def test_a_hand_gives_way_to_all_that_it_touches_while_it_comes_and_is_zeroed_where_it_touches_nothing(
    plans: dict[str, Plan],
) -> None:
    plan = plans["ab1"]
    steps = Schedule.of(plan).steps
    for arm in ARMS:
        touches = [any(getattr(each, "by", "") == arm for each in part.contacts) for part in plan.segments]
        for i, step in enumerate(steps):
            curve = step.arms[arm].wrenches
            assert curve is not None
            comes = not touches[i] and i + 1 < len(steps) and touches[i + 1]
            assert (curve.bears, curve.comes) == (touches[i] or comes, comes)
            came = i > 0 and not touches[i - 1] and touches[i]
            assert step.arms[arm].free == (not touches[i] and not touches[max(i - 1, 0)] and not came)


def test_hands_on_a_plate_are_told_the_sum_of_their_planned_contacts(plans: dict[str, Plan]) -> None:
    """At samples with contacts, in the base's axes, unless the next segment's begin to be taken on, or a stick presses
    with its least."""
    plan = plans["ab1"]
    compared = 0
    for step, part in zip(Schedule.of(plan).steps, plan.segments, strict=True):
        last = step.number == len(plan.segments)
        for sample in sorted({each.sample for each in part.contacts})[1:]:
            for arm in ARMS:
                contacts = [each for each in part.contacts if each.sample == sample and getattr(each, "by", "") == arm]
                curve = step.arms[arm].wrenches
                assert curve is not None
                if not contacts:
                    assert not np.nan_to_num(curve.values[sample]).any()
                    continue
                force = sum(each.wrench[:3] for each in contacts)
                if np.linalg.norm(force) < LEAST_PUSH or (part.end - part.time[sample] < LEAD and not last):
                    continue
                points = np.array([each.point for each in contacts])
                torque = sum(
                    each.wrench[3:] + np.cross(each.point - points.mean(axis=0), each.wrench[:3]) for each in contacts
                )
                R = plan.cell.arms[arm].T_world_base[:3, :3]
                np.testing.assert_allclose(curve.values[sample], [*(R.T @ force), *(R.T @ torque)], atol=1e-9)
                compared += 1
    assert compared > 10


@pytest.fixture(scope="module")
def passed_on(shelf: PlanShelf) -> Plan:
    """Return a plan in which the tool is passed on with an object on its cup: it begins and ends far to either side."""
    shape, turned = {"type": "box", "size": [0.13, 0.07, 0.02]}, [math.sqrt(0.5), 0, 0, math.sqrt(0.5)]
    poses = {"pose": [0.3, 0.42, 1.104, *turned], "goal_pose": [0.3, -0.42, 1.104, *turned]}
    domino = {"name": "domino", "shape": shape, "mass": 0.1, **poses, "goal_symmetry": "shape"}
    options = {"remedies": False, "simulate": False}
    plan = shelf.plan(read_task({"kind": "suction_tool", "objects": [domino], "options": options}))
    hands = [{grip.arm for grip in part.grips} for part in plan.segments if len(part.rides) > 1]
    assert set().union(*hands) == set(ARMS)
    return plan


def test_the_vacuum_is_on_while_objects_ride_whichever_controller_has_the_valve(
    plans: dict[str, Plan], passed_on: Plan
) -> None:
    for plan in (plans["domino_pile"], passed_on):
        for arm in ARMS:
            vacuum = False
            for step, part in zip(Schedule.of(plan).steps, plan.segments, strict=True):
                vacuum = vacuum if step.arms[arm].vacuum is None else step.arms[arm].vacuum
                objects = {body for body, _ in part.rides} - {"tool"}
                if part.kind not in ("attach", "detach"):
                    assert vacuum == bool(objects)


def test_all_that_hands_hold_is_in_the_payloads_while_fingers_close_and_open_too(
    plans: dict[str, Plan], passed_on: Plan
) -> None:
    """A hand that holds the tool before a step and after it holds it in that step."""
    held_meanwhile = 0
    for plan in (plans["domino_pile"], passed_on):
        hands = [plan.cell.hands[arm].mass for arm in ARMS]
        bare = sum(mass for mass in hands if mass is not None)
        grips = [{grip.arm for grip in part.grips} for part in plan.segments]
        steps = Schedule.of(plan).steps
        for index, (step, part) in enumerate(zip(steps, plan.segments, strict=True)):
            hanging = {body for body, _ in part.rides}
            if part.kind in ("grip", "release"):
                beside = plan.segments[index - 1], plan.segments[index + 1]
                held = grips[index - 1] & grips[index + 1]
                hanging = {body for each in beside for body, _ in each.rides} if held else set()
                held_meanwhile += bool(held)
            elif part.kind in ("attach", "detach"):
                hanging &= {"tool"}
            carried = sum(plan.bodies[body].mass or 0.0 for body in hanging)
            assert sum(step.arms[arm].load.mass for arm in ARMS) == pytest.approx(bare + carried), step.words
    assert held_meanwhile > 1


@pytest.mark.parametrize("name", TASKS)
def test_before_anything_moves_fingers_are_told_the_opening_that_the_plan_begins_with(
    plans: dict[str, Plan], name: str
) -> None:
    plan = plans[name]
    schedule = Schedule.of(plan)
    for arm, widths in plan.segments[0].gripper_width.items():
        begins = write_urscript(schedule, arm).partition("# ---- the plan ----")[2]
        before_moving = begins[: re.search(r"lw_(to|stay)\(", begins).start()]  # pyright: ignore[reportOptionalMemberAccess]
        met, opened, run = (before_moving.index(words) for words in ("lw_meet(1)", "site_fingers(", "lw_run(1)"))
        assert met < opened < before_moving.index("lw_open()") < run
        assert float(before_moving[opened:].split("(")[1].split(",")[0]) == pytest.approx(widths[0])
    assert schedule.since(2).openings == {}


@pytest.mark.slow
def test_tables_give_every_number_of_the_plan_again(documents: dict[str, bytes], plans: dict[str, Plan]) -> None:
    plan = plans["ab1"]
    packed = write_program(documents["ab1"], load_cell("dual_ur3e_lift"), ProgramTarget.CSV)
    assert packed == write_program(documents["ab1"], load_cell("dual_ur3e_lift"), ProgramTarget.CSV)
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        rows = list(csv.DictReader(io.StringIO(archive.read("trajectory.csv").decode())))
        forces = list(csv.DictReader(io.StringIO(archive.read("forces.csv").decode())))
        steps = list(csv.DictReader(io.StringIO(archive.read("steps.csv").decode())))
        assert archive.read("plan.json") == documents["ab1"]
    assert [int(step["step"]) for step in steps] == list(range(1, len(plan.segments) + 1))
    for number, part in enumerate(plan.segments, start=1):
        mine = [row for row in rows if row["step"] == str(number)]
        np.testing.assert_array_equal([float(row["time"]) for row in mine], part.time)
        for names, values in (
            (plan.joint_names, part.positions),
            ([f"{name}_velocity" for name in plan.joint_names], part.velocities),
            ([f"{name}_acceleration" for name in plan.joint_names], part.accelerations),
        ):
            np.testing.assert_array_equal([[float(row[name]) for name in names] for row in mine], values)
    stated = [
        (float(part.time[each.sample]), number, each)
        for number, part in enumerate(plan.segments, start=1)
        for each in part.contacts
        if each.kind != "inertia"
    ]
    for (time, number, contact), row in zip(stated, forces, strict=True):
        assert (float(row["time"]), int(row["step"]), row["by"], row["body"]) == (
            time,
            number,
            contact.by,
            contact.body,
        )
        told = [float(row[f"{name}_{axis}"]) for name in ("force", "torque") for axis in "xyz"]
        np.testing.assert_array_equal(told, contact.wrench)


@pytest.mark.slow
def test_the_vacuum_is_on_in_the_table_while_objects_ride_on_the_tool(
    documents: dict[str, bytes], plans: dict[str, Plan]
) -> None:
    plan, seen = plans["domino_pile"], set()
    packed = write_program(documents["domino_pile"], load_cell(plan.cell.name), ProgramTarget.CSV)
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        rows = list(csv.DictReader(io.StringIO(archive.read("trajectory.csv").decode())))
    for row in rows:
        part = plan.segments[int(row["step"]) - 1]
        if part.kind not in ("attach", "detach"):
            riding = any(ride.to == "tool" for _, ride in part.rides)
            assert ("on" in (row["left_vacuum"], row["right_vacuum"])) == riding
            seen.add(riding)
    assert seen == {True, False}


def test_one_digit_that_was_changed_anywhere_is_noticed(small: Plan) -> None:
    document = small.write().decode()
    cell = load_cell("dual_ur3e_lift")
    # Of its id and statistics nothing reaches the robot.
    begin = document.index('"task"')
    digits = [match.start() for match in re.finditer(r"\d", document) if match.start() > begin]
    end = document.index('"statistics"')
    rng = np.random.default_rng(0)
    for place in rng.choice([place for place in digits if place < end], 200, replace=False):
        other = str((int(document[place]) + rng.integers(1, 9)) % 10)
        changed = f"{document[:place]}{other}{document[place + 1 :]}"
        if parsed(changed) == parsed(document):
            # One more digit than a double has: the number is the same.
            continue
        with pytest.raises(NotExportable) as refused:
            exportable(changed.encode(), cell)
        assert re.search("changed|not a plan|nothing to run|cell", str(refused.value))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda plan: plan.model_copy(update={"outcome": "not_found"}), "nothing to run: the outcome is not_found"),
        (lambda plan: plan.model_copy(update={"certificate": None}), "no certificate"),
        (
            lambda plan: plan.model_copy(
                update={"certificate": plan.certificate.model_copy(update={"passed": False})},
            ),
            "no certificate that was passed",
        ),
        (lambda plan: plan.model_copy(update={"cell": plan.cell.model_copy(update={"name": "mine"})}), "the cell mine"),
        (
            lambda plan: plan.model_copy(update={"cell": plan.cell.model_copy(update={"hash": 64 * "0"})}),
            "not what it was planned in any more",
        ),
        (lambda plan: plan.model_copy(update={"digest": None}), "no digest"),
    ],
)
def test_what_is_not_certified_or_is_of_another_cell_becomes_no_program(small: Plan, change: Any, says: str) -> None:
    changed = change(small)
    document = (changed if changed.digest is None else changed.sealed()).write()
    with pytest.raises(NotExportable, match=re.escape(says)):
        exportable(document, load_cell("dual_ur3e_lift"))


@pytest.mark.parametrize("garbage", [b"", b"[]", b"{}", b"\xff\xfe", b'{"schema_version": "1.0"}'])
def test_what_is_no_plan_becomes_no_program(garbage: bytes) -> None:
    with pytest.raises(NotExportable, match="this is not a plan"):
        exportable(garbage, load_cell("dual_ur3e_lift"))


@pytest.mark.slow
def test_whoever_changes_a_plan_and_its_digest_does_not_get_past_the_certificate(plans: dict[str, Plan]) -> None:
    plan = plans["ab1"]
    moved = plan.segments[2].positions.copy()
    moved[len(moved) // 2, 1] += 0.02
    segments = [*plan.segments]
    segments[2] = segments[2].model_copy(update={"positions": moved})
    document = plan.model_copy(update={"segments": segments}).sealed().write()
    with pytest.raises(NotExportable, match="does not pass when it is certified again"):
        exportable(document, load_cell("dual_ur3e_lift"))


def test_arms_of_another_maker_get_tables_and_no_urscript(
    documents: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("planners.program.archive.UR_ROBOTS", ("ur10e",))
    with pytest.raises(NotExportable, match="the left arm is ur3e, none of ur10e: choose ros2 or csv"):
        write_program(documents["ab1"], load_cell("dual_ur3e_lift"), ProgramTarget.UR)


@pytest.mark.parametrize(
    ("turned", "longer", "told"),
    [(0.0, 0.003, None), (math.pi, 0.0, "first frame is 0 mm and 180 degrees off"), (0.0, 0.1, "is not built as one")],
)
def test_programs_are_for_arms_whose_controllers_mean_the_same_frame(
    turned: float, longer: float, told: str | None
) -> None:
    """As those of a URDF do not, whose first link is turned by half a turn; what calibration changes is no matter."""
    cell = load_cell("dual_ur10e_lift")
    dh = cell.arms["left"].robot.dh.copy()
    # Half a turn before the first joint, and back by the joint's own zero: another base, and the same flange.
    dh[0, 3] += turned
    dh[1, 0] -= longer
    arm = replace(cell.arms["left"], robot=replace(cell.arms["left"].robot, dh=dh))
    described = replace(cell, arms={**cell.arms, "left": arm})
    if told is None:
        check_urscript(described)
        return
    with pytest.raises(NotExportable, match=told):
        check_urscript(described)


@pytest.mark.slow
def test_the_command_writes_a_zip_or_says_why_not(
    documents: dict[str, bytes], small: Plan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = tmp_path / "plan.json"
    plan.write_bytes(documents["ab1"])
    assert main(["export", str(plan), "--target", "ur"]) == 0
    with zipfile.ZipFile(tmp_path / "plan.ur.zip") as archive:
        assert sorted(archive.namelist()) == ["README.txt", "left.script", "plan.json", "right.script"]
    plan.write_bytes(json.dumps({**json.loads(small.write()), "digest": 64 * "0"}).encode())
    assert main(["export", str(plan), "--target", "csv"]) == 2
    assert "changed after it was certified" in capsys.readouterr().err
    plan.write_text("{}")
    assert main(["export", str(plan), "--target", "csv"]) == 3
    assert "names no cell" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "none.json"), "--target", "csv"]) == 3


@pytest.mark.slow
def test_programs_are_fetched_over_http(shelf: PlanShelf, documents: dict[str, bytes], tmp_path: Path) -> None:
    settings = ServiceSettings(data_dir=tmp_path, solver_command=shelf.solver, worker_slots=1)
    with served(settings) as address, httpx.Client(base_url=address, timeout=60.0) as client:
        posted = client.post("/v1/plans", json=task("ab1.json")).raise_for_status().json()
        place = f"{posted['links']['self']}/program.zip"
        finished(client, posted)
        answer = client.get(place, params={"target": "ur"})
        assert (answer.status_code, answer.headers["Content-Type"]) == (200, "application/zip")
        with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
            assert f"# plan {posted['id']}, digest " in archive.read("left.script").decode()
        refused = client.get(place, params={"target": "kuka"})
        assert refused.status_code == 422
        assert all(f"'{each.value}'" in refused.text for each in ProgramTarget)
        answer = client.get(place, params={"target": "ros2"}).raise_for_status()
        with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
            assert {"plan.mcap", "metadata.yaml", "cell.urdf", "cell.srdf"} <= set(archive.namelist())
        assert client.get("/v1/plans/none/program.zip", params={"target": "csv"}).status_code == 404
