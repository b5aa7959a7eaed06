"""The stand-in controller: the language it runs, the arm it moves, and that `ur-rtde` takes it for a controller."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import numpy as np
import pytest
from dashboard_client import DashboardClient
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface
from scipy.spatial.transform import Rotation
from script_client import ScriptClient

from planners.kinematics.forward import flange_pose
from planners.program.urscript import ProgramState
from tests.support.controller.arm import Arm, ArmLimits, SafetyMode
from tests.support.controller.controller import Configuration
from tests.support.controller.intrinsics import Intrinsics, Registers, matrix_of, pose_of
from tests.support.controller.lexer import ScriptRefused
from tests.support.controller.stand_in import StandIn, hosts, stand_ins
from tests.support.controller.translator import ProgramFault, translate
from tests.support.service import wait_for

CYCLE = 0.002
DH = [[0.0, np.pi / 2, 0.15185, 0.0], [-0.24355, 0, 0, 0], [-0.2132, 0, 0, 0],
      [0, np.pi / 2, 0.13105, 0], [0, -np.pi / 2, 0.08535, 0], [0, 0, 0.0921, 0]]  # fmt: skip


def arm_at(q: list[float], acceleration: float = 100.0) -> Arm:
    limits = ArmLimits(np.full(6, -6.0), np.full(6, 6.0), np.full(6, 3.0), np.full(6, acceleration))
    return Arm(np.array(q), limits, np.array(DH), CYCLE)


def run(body: str, arm: Arm | None = None, cycles: int = 2000) -> Registers:
    """Run the lines of a program's body on an arm to its end, and return its registers."""
    arm, registers = arm or arm_at([0.0] * 6), Registers()
    _, start = translate(f"def test():\n{body}\nend\n", Intrinsics(arm, registers))
    program = start()
    for _ in range(cycles):
        if next(program, "over") == "over":
            break
        arm.step()
    return registers


@pytest.mark.parametrize(
    "expression",
    ["1 + 2 * 3", "(1 + 2) * 3", "-2 * -3 + 1", "7 % 3 - 10 / 4", "2 * 3 < 7 and not 1 > 2", "1 == 2 or 3 != 4",
     "not True or True", "1e-3 * 5. + .5", "[1, 2, 3][1 + 1]", "[[1, 2], [3, 4]][1][0]", "- - 2", "5 - 3 - 1"],
)  # fmt: skip
def test_expressions_mean_what_they_mean_in_python(expression: str) -> None:
    body = f"if ({expression}) == True:\n write_output_float_register(1, 1)\nelse:\n"
    wanted = eval(expression)
    if not isinstance(wanted, bool):
        body = f"write_output_float_register(1, {expression})\nif False:\n"
    assert run(body + "pass\nend").output_float[1] == wanted


def test_lists_are_copied_when_they_are_assigned() -> None:
    body = "a = [1, 2]\nb = a\nb[0] = 5\nwrite_output_integer_register(1, a[0])\nwrite_output_integer_register(2, b[0])"
    assert run(body).output_int[1:3] == [1, 5]


def test_a_function_changes_a_global_and_no_local_of_another() -> None:
    body = """
    global shared = 1
    def change(n):
      shared = shared + n
      own = 7
      return own
    end
    own = 3
    change(2)
    write_output_integer_register(1, shared)
    write_output_integer_register(2, own)
    """
    assert run(body).output_int[1:3] == [3, 3]


@pytest.mark.parametrize(
    ("body", "line", "what"),
    [
        ("  x = y", 2, "there is no variable y"),
        ("  def f():\n    return x\n  end\n  x = 1", 3, "there is no variable x"),
        ("  launch()", 2, "there is no function launch"),
        ("  servoj()", 2, "servoj"),
        ("  servoj([0], b=2)", 2, "servoj"),
        ("  def f(a):\n    return a\n  end\n  f()", 5, "f takes 1 arguments"),
        ("  x = 1;", 2, "';' is no word"),
        ("  x = [1, 2", 2, "expected"),
        ("  p = 1\n  p[0] = 2", 3, "begins no statement"),
        ("  import os", 2, "begins no statement"),
        ("  thread go():\n  end", 2, "begins no statement"),
        ("  while True\n  end", 2, "expected"),
        ("  if True:\n  x = 1", 5, "`end` is missing"),
        ("  x = __import__", 2, "no variable"),
        ("  _zero()", 2, "no function _zero"),
        ("  x = 'a'", 2, "is no word"),
        ("  halt = 1", 2, "is a function"),
        ("end\ndef other():", 3, "one def"),
    ],
)
def test_what_is_not_in_the_subset_is_refused_with_its_place(body: str, line: int, what: str) -> None:
    with pytest.raises(ScriptRefused, match=what) as refused:
        translate(f"def test():\n{body}\nend\n", Intrinsics(arm_at([0.0] * 6), Registers()))
    assert refused.value.line == line


@pytest.mark.parametrize(
    "body",
    ["x = [1][1]", "x = [1][0.5]", "if 1:\nend", "while True:\nend", "servoj([1, 2])", "set_tcp([0, 0, 0, 0, 0, 0])",
     "servoj([0, 0, 0, 0, 0, 0], t=0.002, gain=5)", "write_output_integer_register(1, 0.5)"],
)  # fmt: skip
def test_what_a_controller_would_end_a_program_for_ends_it(body: str) -> None:
    with pytest.raises(ProgramFault):
        run(body)


def test_an_arm_that_is_sent_along_a_line_is_on_it_each_cycle() -> None:
    arm = arm_at([0.0] * 6)
    run(
        "n = 0\nwhile n < 50:\nn = n + 1\nservoj([n * 0.0001, 0, 0, 0, 0, 0], 0, 0, get_steptime(), 0.05, 300)\nend",
        arm,
    )
    assert arm.q[0] == pytest.approx(0.005, abs=1e-12)


@pytest.mark.parametrize(
    ("goal", "what"), [(0.0301, "speed"), (0.001, "acceleration"), (0.0, None), (0.0001, None)]
)  # the arm is at rest, 2 ms a cycle
def test_an_arm_stops_itself_at_its_limits(goal: float, what: str | None) -> None:
    arm = arm_at([0.0] * 6)
    arm.send(np.array([goal, 0, 0, 0, 0, 0]))
    arm.step()
    assert (arm.safety_mode is SafetyMode.PROTECTIVE_STOP) == (what is not None)
    assert what is None or what in arm.reason


def test_movej_arrives_and_keeps_speed_and_acceleration() -> None:
    arm = Arm(
        np.zeros(6), ArmLimits(np.full(6, -6.0), np.full(6, 6.0), np.full(6, 0.5), np.full(6, 1.1)), np.array(DH), CYCLE
    )
    run("movej([0.3, -0.2, 0.1, 0, 0, 0], a=1, v=0.5)\nstopj(2)", arm)
    assert arm.safety_mode is SafetyMode.NORMAL
    np.testing.assert_allclose(arm.q, [0.3, -0.2, 0.1, 0, 0, 0], atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 1.0, np.pi - 1e-6, np.pi])
def test_poses_are_those_of_scipy(angle: float) -> None:
    rng = np.random.default_rng(4)
    for axis in [*np.eye(3), *-np.eye(3), *rng.normal(size=(20, 3))]:
        turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
        T = matrix_of((0.1, -0.2, 0.3, *turn.as_rotvec()))
        np.testing.assert_allclose(T[:3, :3], turn.as_matrix(), atol=1e-12)
        pose = pose_of(T)
        assert np.linalg.norm(pose[3:]) < np.pi + 1e-9
        # At half a turn either axis is as good.
        np.testing.assert_allclose(Rotation.from_rotvec(pose[3:]).as_matrix(), turn.as_matrix(), atol=1e-9)
        np.testing.assert_allclose([*pose[:3], *T[3]], [0.1, -0.2, 0.3, 0, 0, 0, 1])


def test_the_tcp_is_where_the_planner_has_it_and_moves_as_differences_say() -> None:
    rng, step = np.random.default_rng(5), 1e-6
    for q in rng.uniform(-3.0, 3.0, (20, 6)):
        arm = arm_at(q.tolist())
        arm.tcp = matrix_of((0.02, -0.01, 0.15, 0.3, -0.2, 0.1))
        np.testing.assert_allclose(arm.tcp_pose(), flange_pose(np.array(DH), np.eye(4), q) @ arm.tcp, atol=1e-12)
        speeds = rng.normal(size=6)
        before, after = (arm.tcp_pose(q + sign * step * speeds) for sign in (-1.0, 1.0))
        turn = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec()
        twist = np.concatenate([after[:3, 3] - before[:3, 3], turn]) / (2.0 * step)
        np.testing.assert_allclose(arm.joint_speeds(twist), speeds, atol=1e-4)


def test_speedl_moves_the_tcp_as_fast_as_it_says() -> None:
    arm = arm_at([0.3, -1.2, -1.8, -0.4, 1.1, 0.2])
    run("speedl([0, 0, 0.05, 0, 0, 0], 2, 0.3)", arm)
    before = arm.tcp_pose()[:3, 3]
    run("speedl([0, 0, 0.05, 0, 0, 0], 2, 0.2)", arm)
    np.testing.assert_allclose(arm.tcp_pose()[:3, 3] - before, [0, 0, 0.01], atol=5e-5)


@pytest.fixture
def controller() -> Iterator[tuple[str, StandIn]]:
    host = hosts()["left"]
    configuration = Configuration(host, [0.0] * 6, [-6.0] * 6, [6.0] * 6, [3.0] * 6, [100.0] * 6, DH)
    with stand_ins(configuration) as (one,):
        yield host, one


@pytest.mark.slow
def test_the_unmodified_client_reads_writes_and_runs_programs(controller: tuple[str, StandIn]) -> None:
    host, stand_in = controller
    receive, write = RTDEReceiveInterface(host), RTDEIOInterface(host)
    dashboard, script = DashboardClient(host), ScriptClient(host, 5, 12, 30002)
    dashboard.connect()
    script.connect()
    assert dashboard.polyscopeVersion().startswith("5.12")
    assert receive.getActualQ() == [0.0] * 6
    assert write.setInputIntRegister(20, 41)
    assert write.setInputDoubleRegister(19, 0.25)
    script.sendScriptCommand(
        "def sum():\n while True:\n  write_output_integer_register(12, read_input_integer_register(20) + 1)\n"
        "  write_output_float_register(13, read_input_float_register(19) * 2)\n  sync()\n end\nend\n"
    )
    wait_for(lambda: (receive.getOutputIntRegister(12), receive.getOutputDoubleRegister(13)) == (42, 0.5))
    assert dashboard.running()
    stand_in.tell(protective_stop="by a test")
    wait_for(receive.isProtectiveStopped)
    wait_for(lambda: not dashboard.running())
    dashboard.unlockProtectiveStop()
    wait_for(lambda: not receive.isProtectiveStopped())
    script.sendScriptCommand("def wrong():\n x = y\nend\n")
    refusal = "refused: line 2, column 6: there is no variable y here"
    wait_for(lambda: refusal in stand_in.tell()["messages"])
    for client in (receive, write, dashboard, script):
        client.disconnect()


@pytest.mark.slow
def test_a_client_that_talks_nonsense_is_let_go_and_others_are_served(controller: tuple[str, StandIn]) -> None:
    host, _ = controller
    with socket.create_connection((host, 30004), timeout=5) as stranger:
        stranger.sendall(b"GET / HTTP/1.0\r\n\r\n" * 2000)
        receive = RTDEReceiveInterface(host)
        assert receive.getActualQ() == [0.0] * 6
        receive.disconnect()
    with socket.create_connection((host, 30004), timeout=5) as stranger:
        stranger.sendall(b"\x00\x04U\x09")
        assert stranger.recv(10) == b""


@pytest.mark.parametrize("value", [-7, 6, 2**31 - 1])
def test_what_another_program_left_in_the_register_is_no_state_of_a_plan(value: int) -> None:
    """It must not break off what looks at the arm, least of all what stops it."""
    state = ProgramState(value)
    assert state is ProgramState.FOREIGN
    assert state not in [ProgramState(each) for each in range(6)]
