"""A link to one arm's controller by the unmodified `ur-rtde`: its state, its registers, its programs."""

from __future__ import annotations

import ctypes
import threading
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from planners.errors import LiftwrightError
from planners.geometry.pose import Array
from planners.program.urscript import ProgramState, Registers
from workers.robot.clock import Clock, WallClock

NORMAL_MODES = (1, 2)
"""Of RTDE's `safety_mode`: normal and reduced."""
PLAYING = 2
"""Of RTDE's `runtime_state`."""
SCRIPT_PORT = 30002
LONGEST_LOOK = 0.004
"""What a look at a controller can say of its silence: two cycles of an e-Series [s]."""
LEAVE_SECONDS = 1.0
"""How long it may take to disconnect from a controller [s]."""
VARIABLES = (
    "timestamp actual_q actual_qd actual_TCP_force safety_mode runtime_state "
    "output_int_register_12 output_int_register_13 output_int_register_14 "
    "output_double_register_12 output_double_register_13 output_double_register_14 output_double_register_15"
).split()


class NoLink(LiftwrightError):
    """A controller cannot be reached, or the package that reaches it is missing."""


@dataclass(frozen=True, eq=False)
class ArmState:
    """What a controller last told of itself."""

    timestamp: float
    """The controller's clock [s]."""
    positions: Array
    """(6,) measured [rad]."""
    velocities: Array
    """(6,) measured [rad/s]."""
    force: Array
    """(3,) at the TCP, without the payload, in the base frame [N]."""
    safety_mode: int
    is_playing: bool
    state: ProgramState
    step: int
    barrier: int
    path_time: float
    """In the step, on the plan's clock [s]."""
    lift_force: float
    """That this hand exerts on the plate, along the vertical [N]."""
    lift_speed: float
    """With which it rises behind the lifter [m/s]."""
    lift_height: float
    """How far it has risen [m]."""

    @property
    def is_still(self) -> bool:
        """Whether no joint moves."""
        return float(np.abs(self.velocities).max()) < 1e-3


class ArmLink:
    """One controller: read `state`, write registers, load and end programs.

    Nothing of it raises once it is connected: a controller that is gone is told by `silence` alone.
    """

    def __init__(self, host: str, registers: Registers | None = None, clock: Clock | None = None) -> None:
        """Connect to a controller.

        Args:
            host: its address or name.
            registers: through which a program and this link talk.
            clock: by which silence is told, and an execution supervised; None: the wall's.

        Raises:
            NoLink: it does not answer, or `ur-rtde` is not installed.
        """
        self.host, self._registers, self.clock = host, registers or Registers(), clock or WallClock()
        try:
            receive, write, dashboard, script = map(
                import_module, ("rtde_receive", "rtde_io", "dashboard_client", "script_client")
            )
        except ImportError as error:
            raise NoLink("to execute plans the package ur-rtde is needed: pip install 'liftwright[robot]'") from error
        try:
            self._receive: Any = receive.RTDEReceiveInterface(host, -1.0, VARIABLES)
            self._write: Any = write.RTDEIOInterface(host)
            self._dashboard: Any = dashboard.DashboardClient(host)
            self._dashboard.connect()
            major, minor = self._dashboard.polyscopeVersion().split(".")[:2]
            self._script: Any = script.ScriptClient(host, int(major), int(minor), SCRIPT_PORT)
            self._script.connect()
        except (RuntimeError, ValueError) as error:
            raise NoLink(f"the controller at {host} does not answer as one of Universal Robots: {error}") from error
        self._looked_at = self._seen_at = self.clock.now()
        self._seen, self._silence = -1.0, 0.0
        self._heartbeat = 0
        self._is_lost = False

    @property
    def timestamp(self) -> float:
        """By the controller's clock, of what it told last [s]."""
        return self._receive.getTimestamp()

    def state(self) -> ArmState:
        """Return what the controller told last."""
        told, registers = self._receive, self._registers
        return ArmState(
            timestamp=self.timestamp,
            positions=np.array(told.getActualQ()),
            velocities=np.array(told.getActualQd()),
            force=np.array(told.getActualTCPForce()[:3]),
            safety_mode=told.getSafetyMode(),
            is_playing=told.getRuntimeState() == PLAYING,
            state=ProgramState(told.getOutputIntRegister(registers.state)),
            step=told.getOutputIntRegister(registers.step),
            barrier=told.getOutputIntRegister(registers.barrier),
            path_time=told.getOutputDoubleRegister(registers.path_time),
            lift_force=told.getOutputDoubleRegister(registers.force),
            lift_speed=told.getOutputDoubleRegister(registers.lift_speed),
            lift_height=told.getOutputDoubleRegister(registers.lift_height),
        )

    def silence(self, timestamp: float) -> float:
        """Return for how long the controller has told nothing new [s]; endless once it cannot be told anything.

        Only time in which somebody looked is counted: when this process had to wait for the processor, so had what
        receives for it, and that says nothing of the controller.
        """
        now = self.clock.now()
        self._silence += min(now - self._looked_at, LONGEST_LOOK)
        self._looked_at = now
        if timestamp != self._seen:
            self._seen, self._seen_at, self._silence = timestamp, now, 0.0
        is_connected = not self._is_lost and self._receive.isConnected()
        return self._silence if is_connected else float("inf")

    def unheard(self) -> float:
        """Return since when nothing new was heard when somebody looked last, whoever is to blame for it [s]."""
        return self._looked_at - self._seen_at

    def beat(self) -> None:
        """Tell the program that somebody supervises it."""
        self._heartbeat = (self._heartbeat + 1) % (1 << 30)
        self._tell(self._registers.heartbeat, self._heartbeat)

    def confirm(self, step: int) -> None:
        """Let the program begin every step up to this one."""
        self._tell(self._registers.confirmed, step)

    def relay(self, other: ArmState) -> None:
        """Pass on which barrier the other arm has reached, what its hand bears, and how it rises."""
        self._tell(self._registers.other_barrier, other.barrier)
        self._tell(self._registers.other_force, other.lift_force)
        self._tell(self._registers.other_lift_speed, other.lift_speed)
        self._tell(self._registers.other_lift_height, other.lift_height)

    def pace(self, share: float) -> None:
        """Have the program run at this share of the plan's speed."""
        self._tell(self._registers.share, float(share))

    def stop(self) -> None:
        """Have the program stop on its path and end."""
        self._tell(self._registers.stop, 1)
        self._tell(self._registers.share, 0.0)

    def load(self, script: str) -> None:
        """Reset what programs read, and start this one in place of whatever runs."""
        for register in (self._registers.confirmed, self._registers.other_barrier, self._registers.stop):
            self._tell(register, 0)
        self.beat()
        try:
            self._script.sendScriptCommand(script)
        except RuntimeError:
            self._is_lost = True

    def _tell(self, register: int, value: float) -> None:
        """Write a register. Where that fails the controller is gone, which `silence` tells whoever supervises it."""
        write = self._write.setInputIntRegister if isinstance(value, int) else self._write.setInputDoubleRegister
        try:
            write(register, value)
        except RuntimeError:
            self._is_lost = True

    def end_program(self) -> None:
        """End whatever runs there; a controller that is gone has nothing that could be ended."""
        with suppress(RuntimeError):
            self._dashboard.stop()

    def close(self) -> None:
        """Let go of the controller; one that is silent keeps `ur-rtde` waiting, which nobody here waits for."""
        leaving = threading.Thread(target=self._disconnect, name=f"leave {self.host}", daemon=True)
        leaving.start()
        leaving.join(LEAVE_SECONDS)

    def _disconnect(self) -> None:
        for part in (self._receive, self._write, self._dashboard, self._script):
            try:
                part.disconnect()
            except RuntimeError:
                # Its destructor would try once more, and an exception there ends the process: it is never destroyed.
                ctypes.pythonapi.Py_IncRef(ctypes.py_object(part))
