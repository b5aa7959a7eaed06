"""The process: one arm, its three servers and its program, in one loop with one tick a control cycle.

Its clock is the wall's, until it is told to be held: then a control cycle passes each time it is told so, and at no
other time, so that the clock of a whole cell waits for whatever is late on a busy machine.

`python -m tests.support.controller.controller CONFIGURATION` with JSON of `Configuration`'s members; tells "ready"
on its standard output, then does what the lines on its standard input say (`{"protective_stop": true}` and so on: what
a test does to it that no client could), and answers each with a line.
"""

from __future__ import annotations

import heapq
import json
import selectors
import socket
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .arm import Arm, ArmLimits, SafetyMode, Vector
from .intrinsics import REGISTERS, Halted, Intrinsics, Registers, pose_of
from .lexer import ScriptRefused
from .rtde_server import LineSession, RtdeSession, Value, Variable
from .translator import Pose, Program, ProgramFault, translate

RTDE_PORT, DASHBOARD_PORT, SCRIPT_PORT = 30004, 29999, 30002
STOPPED, PLAYING, PAUSED = 1, 2, 4
"""RTDE's `runtime_state`."""
REPEATED = 0.1
"""After which a controller that is held tells again what it told last [s]."""
RESENT = 0.2
"""After which TCP sends again what was lost, at the least (RFC 6298, as Linux has it) [s]."""


@dataclass(frozen=True)
class Configuration:
    """What one controller is told at its start; SI units."""

    host: str
    start: list[float]
    position_min: list[float]
    position_max: list[float]
    velocity_max: list[float]
    acceleration_max: list[float]
    dh: list[list[float]]
    cycle: float = 0.002
    wires: str = ""
    """File that both controllers map: what one has on its digital outputs the other has on its inputs."""
    wire_side: int = 0


@dataclass
class Faults:
    """What tests do to the network of a controller; the dashboard is spared, whose clients wait for its answer."""

    delay: float = 0.0
    """By which whatever is sent, either way, is late [s]."""
    jitter: float = 0.0
    """By which it is late besides, at most, another time each time [s]."""
    loss: float = 0.0
    """Share of what is sent that is lost, and sent again `RESENT` later; what follows it waits, as in TCP."""
    silent: bool = False
    """Nothing is sent any more, and nothing read: a cable that was pulled."""
    seed: int = 0
    _rng: np.random.Generator | None = None
    _arrived: dict[object, float] = field(default_factory=dict)

    def arrival(self, way: object, now: float) -> float:
        """Return when what is sent now arrives; nothing overtakes what went the same way."""
        self._rng = self._rng or np.random.default_rng(self.seed)
        arrival = now + self.delay
        if self.jitter:
            arrival += self._rng.uniform(0.0, self.jitter)
        if self.loss and self._rng.random() < self.loss:
            arrival += RESENT
        self._arrived[way] = max(arrival, self._arrived.get(way, arrival))
        return self._arrived[way]


class Controller:
    """An arm with its clients; `run` never returns."""

    def __init__(self, configuration: Configuration) -> None:
        given = configuration
        limits = ArmLimits(
            position_min=np.array(given.position_min, dtype=float),
            position_max=np.array(given.position_max, dtype=float),
            velocity_max=np.array(given.velocity_max, dtype=float),
            acceleration_max=np.array(given.acceleration_max, dtype=float),
        )
        self.arm = Arm(np.array(given.start, dtype=float), limits, np.array(given.dh, dtype=float), given.cycle)
        self.registers = Registers()
        self.intrinsics = Intrinsics(self.arm, self.registers)
        self.program: Program | None = None
        self.program_name, self.runtime_state = "", STOPPED
        self.messages: list[str] = []
        self.faults = Faults()
        self.speed_slider = 1.0
        self._time, self._ticks, self._told_tick = 0.0, 0, 0
        self._is_held = False
        self._number = 0
        self._late: list[tuple[float, int, Callable[[], None]]] = []
        self._hidden: dict[socket.socket, Callable[[], None]] = {}
        self._written: dict[str, float] = {}
        self._selector = selectors.DefaultSelector()
        self._rtde: list[RtdeSession] = []
        self._record: list[tuple[float, ...]] = []
        self._placed: tuple[Vector, np.ndarray, Pose] | None = None
        self._outputs = self._output_variables()
        self._wires = np.memmap(given.wires, dtype=np.uint8, mode="r+", shape=(2,)) if given.wires else None
        self._wire_side = given.wire_side
        for port, opened in (
            (RTDE_PORT, self._open_rtde),
            (DASHBOARD_PORT, self._open_dashboard),
            (SCRIPT_PORT, self._open_script),
        ):
            server = socket.create_server((given.host, port), backlog=8)
            server.setblocking(False)
            self._selector.register(server, selectors.EVENT_READ, lambda server=server, opened=opened: opened(server))
        self._selector.register(sys.stdin, selectors.EVENT_READ, self._told)

    # The loop

    def run(self) -> None:
        cycle = self.arm.cycle
        self._time = self._clock()
        print("ready", flush=True)
        while True:
            pause = REPEATED if self._is_held else max(0.0, self._time + cycle - time.monotonic())
            ready = self._selector.select(pause)
            for key, _ in ready:
                key.data()
            if self._is_held and not ready:
                self._repeat()
            if not self._is_held and self._clock() >= self._time + cycle:
                # A process that waited for the processor catches up, so that its clock is that of the world.
                self._time += cycle
                self._tick()

    def _clock(self) -> float:
        return self._time if self._is_held else time.monotonic()

    def _repeat(self) -> None:
        """Tell again what was told last: clients have clocks of their own, and leave where nothing comes for long."""
        for session in [] if self.faults.silent else list(self._rtde):
            self._guarded(session.connection, session.repeat)

    def _cycle_passes(self) -> None:
        """Let one control cycle pass, after everything that clients have sent by now has been taken."""
        taken = True
        while taken:
            taken = [key for key, _ in self._selector.select(0.0) if key.fileobj is not sys.stdin]
            for key in taken:
                key.data()
        self._time += self.arm.cycle
        self._tick()

    def _tick(self) -> None:
        self._ticks += 1
        while self._late and self._late[0][0] <= self._time:
            heapq.heappop(self._late)[2]()
        self._watch()
        if self._wires is not None:
            self._wires[self._wire_side] = self.registers.digital_out & 0xFF
            self.registers.digital_in = int(self._wires[1 - self._wire_side])
        if self.program is not None and self.runtime_state == PLAYING:
            self._advance(self.program)
        self.arm.step()
        if self.arm.safety_mode is SafetyMode.PROTECTIVE_STOP and self.runtime_state == PLAYING:
            self.messages.append(f"protective stop: {self.arm.reason}")
            self.runtime_state = PAUSED
        registers = self.registers
        self._record.append(
            (self._time, *self.arm.q.tolist(), *registers.output_int[12:15], registers.output_float[12],
             self.arm.safety_mode, self.runtime_state, registers.input_float[18])
        )  # fmt: skip
        if not self.faults.silent:
            for session in list(self._rtde):
                if (package := session.cycle_ended()) is not None:
                    self._deliver(session, lambda s=session, p=package, t=self._ticks: self._tell(s, p, t))

    def _deliver(self, way: object, act: Callable[[], None]) -> None:
        """Do something when what was sent arrives."""
        arrival = self.faults.arrival(way, self._time)
        if arrival <= self._time:
            act()
        else:
            self._number += 1
            heapq.heappush(self._late, (arrival, self._number, act))

    def _tell(self, session: RtdeSession, package: bytes, tick: int) -> None:
        if not self.faults.silent:
            self._told_tick = tick
            self._guarded(session.connection, lambda: session.send(package))

    def _advance(self, program: Program) -> None:
        try:
            next(program)
        except (StopIteration, Halted):
            self._end("")
        except (ProgramFault, TypeError, ValueError, IndexError, ZeroDivisionError) as error:
            self._end(f"runtime error: {error}")

    def _end(self, message: str) -> None:
        if message:
            self.messages.append(message)
        self.program, self.runtime_state = None, STOPPED
        self.intrinsics._watchdogs.clear()

    def _watch(self) -> None:
        """Stop or pause the program whose watched input was not written for too long."""
        for name, (longest, action) in self.intrinsics._watchdogs.items():
            now = self._clock()
            if now - self._written.setdefault(name, now) > longest and self.runtime_state == PLAYING:
                self.messages.append(f"watchdog: {name}")
                if action == "stop":
                    self._end(f"stopped: {name} was not written")
                    return
                if action == "pause":
                    self.runtime_state = PAUSED

    # Connections

    def _accept(self, server: socket.socket) -> socket.socket:
        connection, _ = server.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setblocking(False)
        return connection

    def _guarded(self, connection: socket.socket, act: Callable[[], None]) -> None:
        """Do something for a client; one that went away, does not read or talks nonsense is let go."""
        try:
            act()
        except (OSError, ValueError, IndexError, UnicodeDecodeError):
            self._drop(connection)

    def _drop(self, connection: socket.socket) -> None:
        self._rtde = [session for session in self._rtde if session.connection is not connection]
        self._hidden.pop(connection, None)
        if connection.fileno() >= 0:
            if not self.faults.silent:
                self._selector.unregister(connection)
            connection.close()

    def _listen(self, connection: socket.socket, take: Callable[[bytes], None], *, spared: bool = False) -> None:
        def read() -> None:
            try:
                data = connection.recv(1 << 20)
            except BlockingIOError:
                # Something that was done before in this round has read it already.
                return
            if not data:
                raise ConnectionResetError
            if spared:
                take(data)
            else:
                self._deliver(connection, lambda: self._guarded(connection, lambda: take(data)))

        self._selector.register(connection, selectors.EVENT_READ, lambda: self._guarded(connection, read))

    def _hide(self, *, silent: bool) -> None:
        """Let nothing be read any more, or all again."""
        if silent and not self.faults.silent:
            keys = [key for key in self._selector.get_map().values() if key.fileobj is not sys.stdin]
            self._hidden = {key.fileobj: key.data for key in keys}  # type: ignore[misc]
            for connection in self._hidden:
                self._selector.unregister(connection)
        elif self.faults.silent and not silent:
            for connection, act in self._hidden.items():
                self._selector.register(connection, selectors.EVENT_READ, act)
            self._hidden = {}
        self.faults.silent = silent

    def _open_rtde(self, server: socket.socket) -> None:
        connection = self._accept(server)
        session = RtdeSession(connection, self._outputs, _INPUT_TYPES, self._write, 1.0 / self.arm.cycle)
        self._rtde.append(session)
        self._listen(connection, session.take)

    def _open_dashboard(self, server: socket.socket) -> None:
        connection = self._accept(server)
        session = LineSession(connection)

        def take(data: bytes) -> None:
            session.received += data
            while b"\n" in session.received:
                line, session.received = session.received.split(b"\n", 1)
                connection.send((self._dashboard(line.decode().strip()) + "\n").encode())

        self._listen(connection, take, spared=True)
        connection.send(b"Connected: Universal Robots Dashboard Server\n")

    def _open_script(self, server: socket.socket) -> None:
        connection = self._accept(server)
        session = LineSession(connection)

        def take(data: bytes) -> None:
            session.received += data
            if session.received.find(b"\nend", max(0, len(session.received) - len(data) - 4)) < 0:
                return
            lines = session.received.decode().split("\n")
            ends = [i for i, line in enumerate(lines) if line.rstrip() == "end"]
            if ends:
                # The `end` in the first column closes the program; what is after it is another.
                script, rest = "\n".join(lines[: ends[-1] + 1]), "\n".join(lines[ends[-1] + 1 :])
                session.received = rest.encode()
                self.load(script)

        self._listen(connection, take)

    # What clients do

    def load(self, script: str) -> None:
        """Start a script, in place of what runs; one that is not in the subset is refused and told of."""
        try:
            with ThreadPoolExecutor(1) as beside:
                reading = beside.submit(translate, script, self.intrinsics)
                while not wait([reading], REPEATED).done:
                    self._repeat()
            self.program_name, start = reading.result()
        except ScriptRefused as error:
            self.messages.append(f"refused: {error}")
            return
        self._end("")
        if self.arm.safety_mode is SafetyMode.NORMAL:
            self._written.clear()
            # Real controllers read a script beside their control loop.
            self._time = self._clock()
            self.program, self.runtime_state = start(), PLAYING

    def _dashboard(self, line: str) -> str:
        if line == "stop":
            self._end("")
            return "Stopped"
        if line == "pause":
            self.runtime_state = PAUSED if self.program else STOPPED
            return "Pausing program"
        if line == "play":
            if self.program is None or self.arm.safety_mode is not SafetyMode.NORMAL:
                return "Failed to execute: play"
            self.runtime_state = PLAYING
            return "Starting program"
        if line == "unlock protective stop":
            self.arm.unlock()
            self._end("")
            return "Protective stop releasing"
        state = {STOPPED: "STOPPED", PLAYING: "PLAYING", PAUSED: "PAUSED"}[self.runtime_state]
        answers = {
            "running": f"Program running: {str(self.runtime_state == PLAYING).lower()}",
            "programState": f"{state} {self.program_name}",
            "robotmode": "Robotmode: RUNNING",
            "safetymode": f"Safetymode: {self.arm.safety_mode.name}",
            "safetystatus": f"Safetystatus: {self.arm.safety_mode.name}",
            "PolyscopeVersion": "URSoftware 5.12.0.0 (stand-in)",
            "get loaded program": f"Loaded program: {self.program_name}",
            "is in remote control": "true",
            "close popup": "closing popup",
            "close safety popup": "closing safety popup",
            "quit": "Disconnected",
        }
        return answers.get(line, f"could not understand: '{line}'")

    def _write(self, name: str, value: Value) -> None:
        self._written[name] = self._clock()
        kind, _, number = name.rpartition("_")
        if kind == "input_int_register":
            self.registers.input_int[int(number)] = int(value)  # type: ignore[arg-type]
        elif kind == "input_double_register":
            self.registers.input_float[int(number)] = float(value)  # type: ignore[arg-type]
        elif name == "speed_slider_fraction":
            self.speed_slider = float(value)  # type: ignore[arg-type]

    def _tcp_pose(self) -> Pose:
        """Return the TCP's pose, which is asked for twice each cycle."""
        q, tcp = self.arm.q, self.arm.tcp
        if self._placed is None or self._placed[0] is not q or self._placed[1] is not tcp:
            self._placed = q, tcp, pose_of(self.arm.tcp_pose())
        return self._placed[2]

    def _output_variables(self) -> dict[str, Variable]:
        arm, registers = self.arm, self.registers
        zeros = (0.0,) * 6

        def vector(read: Callable[[], np.ndarray]) -> Variable:
            return Variable("VECTOR6D", lambda: tuple(read().tolist()))

        def stopped() -> bool:
            return arm.safety_mode is SafetyMode.PROTECTIVE_STOP

        found = {
            "timestamp": Variable("DOUBLE", lambda: self._ticks * arm.cycle),
            **{name: vector(lambda: arm.q) for name in ("target_q", "actual_q")},
            **{name: vector(lambda: arm.qd) for name in ("target_qd", "actual_qd")},
            "actual_TCP_force": vector(lambda: arm.felt),
            "actual_TCP_pose": Variable("VECTOR6D", self._tcp_pose),
            "target_TCP_pose": Variable("VECTOR6D", self._tcp_pose),
            **{
                name: Variable("VECTOR6D", lambda: zeros)
                for name in (
                    "target_qdd target_current target_moment actual_current joint_control_output actual_TCP_speed "
                    "target_TCP_speed joint_temperatures actual_joint_voltage ft_raw_wrench actual_current_window"
                ).split()
            },
            **{name: Variable("VECTOR3D", lambda: (0.0,) * 3)
               for name in ("actual_tool_accelerometer", "payload_cog", "elbow_position", "elbow_velocity")},
            "payload_inertia": Variable("VECTOR6D", lambda: zeros),
            "joint_mode": Variable("VECTOR6INT32", lambda: (253,) * 6),
            "robot_mode": Variable("INT32", lambda: 7),
            "safety_mode": Variable("INT32", lambda: int(arm.safety_mode)),
            "safety_status": Variable("INT32", lambda: int(arm.safety_mode)),
            "safety_status_bits": Variable("UINT32", lambda: (1 << 2 | 1 << 10) if stopped() else 1),
            "robot_status_bits": Variable("UINT32", lambda: 1 | (self.runtime_state == PLAYING) << 1),
            "runtime_state": Variable("UINT32", lambda: self.runtime_state),
            "speed_scaling": Variable("DOUBLE", lambda: self.speed_slider),
            "target_speed_fraction": Variable("DOUBLE", lambda: self.speed_slider),
            "payload": Variable("DOUBLE", lambda: arm.payload),
            **{
                name: Variable("DOUBLE", lambda: 0.0)
                for name in (
                    "actual_execution_time actual_momentum actual_main_voltage actual_robot_voltage "
                    "actual_robot_current standard_analog_input0 standard_analog_input1 standard_analog_output0 "
                    "standard_analog_output1"
                ).split()
            },
            "actual_digital_input_bits": Variable("UINT64", lambda: registers.digital_in),
            "actual_digital_output_bits": Variable("UINT64", lambda: registers.digital_out),
        }  # fmt: skip
        for n in range(REGISTERS):
            found[f"output_int_register_{n}"] = Variable("INT32", lambda n=n: registers.output_int[n])
            found[f"output_double_register_{n}"] = Variable("DOUBLE", lambda n=n: registers.output_float[n])
        return found

    # What tests do

    def _told(self) -> None:
        line = sys.stdin.readline()
        if not line:
            sys.exit()
        print(json.dumps(self._obey(json.loads(line))), flush=True)

    def _obey(self, order: dict[str, Any]) -> object:
        if "held" in order:
            # What passed of the world's time while it was held is not made up for.
            now = order.get("time", 0.0) if order["held"] else time.monotonic()
            self._is_held, self._time = order["held"], max(now, self._time)
        if "protective_stop" in order:
            self.arm.protective_stop(str(order["protective_stop"]))
        if "wrench" in order:
            self.arm.wrench = np.array(order["wrench"], dtype=float)
        for name in ("delay", "jitter", "loss", "seed"):
            setattr(self.faults, name, order.get(name, getattr(self.faults, name)))
        self._hide(silent=order.get("silent", self.faults.silent))
        if "script" in order:
            self.load(order["script"])
        if "joints" in order:
            self.arm.q = np.array(order["joints"], dtype=float)
        if "record" in order:
            np.save(Path(order["record"]), np.array(self._record))
        if order.get("cycle"):
            self._cycle_passes()
        return {
            "messages": [] if order.get("cycle") else self.messages + self.intrinsics._messages,
            "time": self._time,
            "told": self._told_tick * self.arm.cycle,
            "joints": self.arm.q.tolist(),
            "velocities": self.arm.qd.tolist(),
            "output_int": list(self.registers.output_int),
            "output_float": list(self.registers.output_float),
            "payload": self.arm.payload,
        }


_INPUT_TYPES = {
    **{f"input_int_register_{n}": "INT32" for n in range(REGISTERS)},
    **{f"input_double_register_{n}": "DOUBLE" for n in range(REGISTERS)},
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "standard_digital_output_mask": "UINT8",
    "standard_digital_output": "UINT8",
    "configurable_digital_output_mask": "UINT8",
    "configurable_digital_output": "UINT8",
    "tool_digital_output_mask": "UINT8",
    "tool_digital_output": "UINT8",
    "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8",
    "standard_analog_output_0": "DOUBLE",
    "standard_analog_output_1": "DOUBLE",
}


if __name__ == "__main__":
    Controller(Configuration(**json.loads(sys.argv[1]))).run()
