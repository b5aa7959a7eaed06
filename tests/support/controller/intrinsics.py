"""The built-in functions that a script may call; each that takes time is a generator, one turn a control cycle."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass, field

import numpy as np

from .arm import Arm, SafetyMode, Vector
from .translator import Pose, ProgramFault

Turns = Generator[None, None, None]
REGISTERS = 48
LEVER = 0.3
"""Makes an acceleration of joints of one of the TCP, as a typical lever [m]."""


class Halted(Exception):
    """The program ended itself."""


@dataclass
class Registers:
    """General purpose registers and digital lines, as RTDE and scripts share them."""

    input_int: list[int] = field(default_factory=lambda: [0] * REGISTERS)
    output_int: list[int] = field(default_factory=lambda: [0] * REGISTERS)
    input_float: list[float] = field(default_factory=lambda: [0.0] * REGISTERS)
    output_float: list[float] = field(default_factory=lambda: [0.0] * REGISTERS)
    digital_in: int = 0
    digital_out: int = 0


def matrix_of(pose: tuple[float, ...]) -> np.ndarray:
    """Return a pose as 4×4, by Rodrigues' formula."""
    x, y, z, *turn = pose
    angle = math.hypot(*turn)
    # sin(angle) / angle, and (1 - cos(angle)) / angle²
    one, two = 1.0, 0.5
    if angle > 0.0:
        one, two = math.sin(angle) / angle, 2.0 * (math.sin(0.5 * angle) / angle) ** 2
    cos, (u, v, w) = math.cos(angle), turn
    return np.array([
        [cos + two * u * u, two * u * v - one * w, two * u * w + one * v, x],
        [two * u * v + one * w, cos + two * v * v, two * v * w - one * u, y],
        [two * u * w - one * v, two * v * w + one * u, cos + two * w * w, z],
        [0.0, 0.0, 0.0, 1.0],
    ])  # fmt: skip


def pose_of(T: np.ndarray) -> Pose:
    """Return a 4×4 as a pose: the rotation vector from the quaternion, whose largest member is found first."""
    (a, b, c, x), (d, e, f, y), (g, h, i, z), _ = T.tolist()
    squares = (a + e + i, a - e - i, e - a - i, i - a - e)
    largest = squares.index(max(squares))
    quaternion = (
        (1.0 + squares[0], h - f, c - g, d - b),
        (h - f, 1.0 + squares[1], b + d, c + g),
        (c - g, b + d, 1.0 + squares[2], f + h),
        (d - b, c + g, f + h, 1.0 + squares[3]),
    )[largest]
    sign = -1.0 if quaternion[0] < 0.0 else 1.0
    real, *axis = (sign * each for each in quaternion)
    length = math.hypot(*axis)
    if length == 0.0:
        return Pose((x, y, z, 0.0, 0.0, 0.0))
    share = 2.0 * math.atan2(length, real) / length
    return Pose((x, y, z, *(share * each for each in axis)))


def _joints(values: object) -> Vector:
    if not isinstance(values, tuple) or len(values) != 6:
        raise ProgramFault("six joint positions are expected")
    q = np.array(values, dtype=float)
    if not np.isfinite(q).all():
        raise ProgramFault("joint positions are finite numbers")
    return q


class Intrinsics:
    """What scripts call, by its URScript name."""

    def __init__(self, arm: Arm, registers: Registers) -> None:
        self._arm, self._registers = arm, registers
        self._watchdogs: dict[str, tuple[float, str]] = {}
        self._messages: list[str] = []
        self._sockets: dict[str, dict[str, int]] = {}

    # Motion

    def servoj(
        self, q: object, a: float = 0, v: float = 0, t: float = 0.002, lookahead_time: float = 0.1, gain: float = 300
    ) -> Turns:
        if not 0.03 <= lookahead_time <= 0.2 or not 100 <= gain <= 2000:
            raise ProgramFault("servoj: lookahead_time is 0.03 to 0.2 s, gain 100 to 2000")
        goal, begin = _joints(q), self._arm.q
        turns = max(1, round(t / self._arm.cycle))
        for turn in range(1, turns + 1):
            self._arm.send(begin + (goal - begin) * turn / turns)
            yield

    def stopj(self, a: float) -> Turns:
        self._arm.brake(a)
        yield
        while not self._arm.is_still:
            yield

    def stopl(self, a: float) -> Turns:
        """Slow down along the TCP's way: all joints by the same share, so that it bends neither down nor aside."""
        while not self._arm.is_still:
            fastest = float(np.abs(self._arm.qd).max())
            kept = max(0.0, 1.0 - a / LEVER * self._arm.cycle / fastest)
            self._arm.send(self._arm.q + kept * self._arm.qd * self._arm.cycle)
            yield

    def movej(self, q: object, a: float = 1.4, v: float = 1.05, t: float = 0, r: float = 0) -> Turns:
        """Go straight in joint space with a trapezoid of speed; blends are refused."""
        if r:
            raise ProgramFault("movej: blends are not in the subset")
        goal, begin = _joints(q), self._arm.q
        way = float(np.abs(goal - begin).max())
        if way == 0.0:
            return
        v = min(v, math.sqrt(way * a))
        duration = t or way / v + v / a
        scale = (way / v + v / a) / duration
        time = 0.0
        while time < duration:
            time = min(time + self._arm.cycle, duration)
            at = time * scale
            left = way / v + v / a - at
            done = a * at**2 / 2 if at < v / a else way - a * left**2 / 2 if left < v / a else v * (at - v / a / 2)
            self._arm.send(begin + (goal - begin) * done / way)
            yield

    def speedl(self, xd: object, a: float = 1.2, t: float = 0) -> Turns:
        if not isinstance(xd, tuple) or len(xd) != 6:
            raise ProgramFault("speedl: six speeds are expected")
        for _ in range(max(1, round(t / self._arm.cycle))):
            wish = self._arm.joint_speeds(np.array(xd, dtype=float))
            change = wish - self._arm.qd
            most = a / LEVER * self._arm.cycle
            change *= min(1.0, most / max(float(np.abs(change).max()), 1e-12))
            self._arm.send(self._arm.q + (self._arm.qd + change) * self._arm.cycle)
            yield

    def sync(self) -> Turns:
        yield

    def sleep(self, t: float) -> Turns:
        for _ in range(max(1, round(t / self._arm.cycle))):
            yield

    # What is measured

    def get_steptime(self) -> float:
        return self._arm.cycle

    def get_actual_joint_positions(self) -> tuple[float, ...]:
        return tuple(self._arm.q.tolist())

    get_target_joint_positions = get_actual_joint_positions

    def get_actual_joint_speeds(self) -> tuple[float, ...]:
        return tuple(self._arm.qd.tolist())

    get_target_joint_speeds = get_actual_joint_speeds

    def get_actual_tcp_pose(self) -> Pose:
        return pose_of(self._arm.tcp_pose())

    get_target_tcp_pose = get_actual_tcp_pose

    def get_tcp_force(self) -> tuple[float, ...]:
        return tuple(self._arm.felt.tolist())

    def force(self) -> float:
        return float(np.linalg.norm(self._arm.felt[:3]))

    # What is set

    def set_payload(self, m: float, cog: tuple[float, ...] = (0.0, 0.0, 0.0)) -> None:
        if not m >= 0 or len(cog) != 3:
            raise ProgramFault("set_payload: a mass that is not negative, and three coordinates")
        self._arm.payload = m

    def set_tcp(self, pose: Pose) -> None:
        if not isinstance(pose, Pose) or len(pose) != 6:
            raise ProgramFault("set_tcp: a pose is expected")
        self._arm.tcp = matrix_of(pose)

    def zero_ftsensor(self) -> None:
        if not self._arm.is_still:
            raise ProgramFault("zero_ftsensor: the arm must stand still")
        self._arm.tare()

    def read_input_integer_register(self, address: int) -> int:
        return self._registers.input_int[address]

    def read_input_float_register(self, address: int) -> float:
        return self._registers.input_float[address]

    def write_output_integer_register(self, address: int, value: int) -> None:
        if isinstance(value, bool) or not isinstance(value, int):
            raise ProgramFault("an integer register takes a whole number")
        self._registers.output_int[address] = value

    def write_output_float_register(self, address: int, value: float) -> None:
        self._registers.output_float[address] = float(value)

    def set_standard_digital_out(self, n: int, b: bool) -> None:
        self._registers.digital_out = self._registers.digital_out & ~(1 << n) | (int(b) << n)

    def get_standard_digital_in(self, n: int) -> bool:
        return bool(self._registers.digital_in >> n & 1)

    def get_standard_digital_out(self, n: int) -> bool:
        return bool(self._registers.digital_out >> n & 1)

    def rtde_set_watchdog(self, variable_name: str, min_frequency: float, action: str = "pause") -> None:
        if not variable_name.startswith("input_") or action not in ("ignore", "pause", "stop"):
            raise ProgramFault("rtde_set_watchdog: an input variable, and ignore, pause or stop")
        self._watchdogs[variable_name] = (1.0 / min_frequency, action)

    # A gripper's software, which answers on the controller itself

    def socket_open(self, address: str, port: int, socket_name: str = "socket_0") -> bool:
        self._sockets[socket_name] = {}
        return True

    def socket_set_var(self, name: str, value: int, socket_name: str = "socket_0") -> None:
        if socket_name not in self._sockets:
            raise ProgramFault(f"socket {socket_name} is not open")
        if isinstance(value, bool) or not isinstance(value, int):
            raise ProgramFault("socket_set_var: a whole number is sent")
        self._sockets[socket_name][name] = value

    def socket_close(self, socket_name: str = "socket_0") -> None:
        sent = self._sockets.pop(socket_name, {})
        self._messages.append(f"{socket_name}: " + ", ".join(f"{name} {value}" for name, value in sent.items()))

    # People

    def textmsg(self, s1: object, s2: object = "") -> None:
        self._messages.append(f"{s1}{s2}")

    def popup(
        self, s: object, title: str = "Popup", warning: bool = False, error: bool = False, blocking: bool = False
    ) -> Turns:
        self._messages.append(f"{title}: {s}")
        yield
        if blocking:
            raise Halted

    def halt(self) -> Turns:
        yield
        raise Halted

    # Arithmetic

    def floor(self, x: float) -> int:
        return math.floor(x)

    def ceil(self, x: float) -> int:
        return math.ceil(x)

    def sqrt(self, x: float) -> float:
        return math.sqrt(x)

    def sin(self, x: float) -> float:
        return math.sin(x)

    def cos(self, x: float) -> float:
        return math.cos(x)

    def norm(self, x: object) -> float:
        return math.hypot(*x) if isinstance(x, tuple) else abs(float(x))  # type: ignore[arg-type]

    def length(self, x: tuple[object, ...]) -> int:
        return len(x)

    get_list_length = length

    def to_str(self, x: object) -> str:
        return str(x)

    def pose_trans(self, p_from: Pose, p_from_to: Pose) -> Pose:
        return pose_of(matrix_of(p_from) @ matrix_of(p_from_to))

    def pose_add(self, p_1: Pose, p_2: Pose) -> Pose:
        T, added = matrix_of(p_1), matrix_of(p_2)
        T[:3, :3], T[:3, 3] = T[:3, :3] @ added[:3, :3], T[:3, 3] + added[:3, 3]
        return pose_of(T)

    def get_forward_kin(self, q: object, tcp: Pose | None = None) -> Pose:
        return pose_of(self._arm.tcp_pose(_joints(q), None if tcp is None else matrix_of(tcp)))

    def get_inverse_kin(self, x: Pose, qnear: object) -> tuple[float, ...]:
        found = self._arm.joints_at(matrix_of(x), _joints(qnear))
        if found is None:
            raise ProgramFault("get_inverse_kin: no joints put the TCP there")
        return tuple(found.tolist())

    def pose_inv(self, p_from: Pose) -> Pose:
        return pose_of(np.linalg.inv(matrix_of(p_from)))

    def is_protective_stopped(self) -> bool:
        return self._arm.safety_mode is SafetyMode.PROTECTIVE_STOP
