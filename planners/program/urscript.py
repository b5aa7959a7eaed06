"""A program in URScript for each of two Universal Robots controllers that share one plan.

Motion is streamed with `servoj`: between two samples of the plan the program evaluates the same cubic as `Plan.at`,
once each control cycle, so that an arm never leaves the path that was checked; a hand on the plate of a lift is off it
by the millimetres that it gives way, see `HandAdmittance`. Both programs wait for each other before every step.
Integrators fill in the functions at the head of a program: fingers, vacuum, and who confirms steps.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum

import numpy as np
from scipy.spatial.transform import Rotation

from planners.contract.arrays import ArmName
from planners.geometry.pose import Array, Transform
from planners.lifting.leader_follower import FollowerGains, LeaderFollower
from planners.plan.scenery import ARMS, GripperDocument
from planners.program.schedule import STOP_DURATION, ArmStep, ProgramStep, Schedule, WrenchCurve, in_base

JOINT_TOLERANCE = 0.01
"""How far each joint may be from where the plan begins [rad]."""
SENSOR_DRIFT = (3.0, 0.2)
"""What a sensor may tell of force and torque since it was zeroed, while its hand touches nothing [N, Nm]."""
SMOOTHING = 0.012
"""Time constant of what is felt: at a lever of 0.2 m a sensor's noise is one of the torque, too [s]."""
LONGEST_BOUND = 0.5
"""A program ends when the TCP of a hand gives way as far as it may for longer [s]."""
TAKEN_OVER = 1.1
"""A program begins with a hand on the plate that is off the plan by at most so many times what it may give way [1]."""
APART_IN_LIFT = 0.01
"""Between the heights of both hands in the lift, beyond which both stop [m]."""
BEARING_TOLERANCE = 0.4
"""Likewise of an arm whose hand is on the plate: near a wrist's singularity joints are off the plan by far more than
the TCP, of which it is asked besides [rad]."""
SETTLING = 1.5
"""How long hands take on the forces with which a lift begins, in the first half linearly [s]."""
GIVING_ACCELERATION, TURNING_ACCELERATION = 2.0, 15.0
"""With which a hand on the plate begins to give way, or to press on [m/s², rad/s²]."""
JOINT_ACCELERATION = 80.0
"""Of any joint while its hand gives way: twice that of a program's own stop [rad/s²]."""
LEADER = ARMS[0]
"""The arm whose program has law (11): the other hand rises as this one tells, so that both rise alike."""
CATCHING_UP = 2.0
"""Rate at which the other hand makes up for a height at which it is behind, while the first one rises [1/s]."""
STOP_ACCELERATION = 40.0
"""Of the joints when a program stops by itself: from 3 rad/s they stand still in less than 0.1 s [rad/s²]."""
FASTEST_LIFT = 0.25
"""The hands never rise faster behind a lifter [m/s]."""
LIFT_ACCELERATION = 4.0
"""With which hands take on the law's speed, and brake: from the fastest they stand still in less than 0.1 s [m/s²]."""
LOOKAHEAD, GAIN = 0.03, 1000
"""Of `servoj`: how far it looks ahead [s], and how stiffly it follows."""
SETTLED = 0.1
"""How long a program goes on after it has stopped on the path, before it ends: joints lag by `LOOKAHEAD` [s]."""
OPENING_SECONDS = 2.0
"""How long both arms wait before the first step for fingers to be as far open as the plan has them [s]."""
HEARTBEAT_RATE = 20.0
"""A program stops when its register `heartbeat` is written less often than that [1/s]."""


class Handshake(StrEnum):
    """How the two controllers wait for each other."""

    REGISTERS = "registers"
    """Through registers that a computer passes on by RTDE; it confirms steps."""
    DIGITAL = "digital"
    """Through one crossed pair of digital wires, without anybody else."""


@dataclass(frozen=True)
class Registers:
    """General purpose registers of RTDE that a program uses."""

    confirmed: int = 18
    """Input, integer: the last step that may be begun."""
    other_barrier: int = 19
    """Input, integer: the last barrier that the other arm has reached."""
    stop: int = 20
    """Input, integer: 1 stops the arm on its path."""
    heartbeat: int = 21
    """Input, integer: written again and again by whoever supervises; see `HEARTBEAT_RATE`."""
    share: int = 18
    """Input, double: share of the planned speed, 0 to 1."""
    other_force: int = 19
    """Input, double: vertical force that the other hand exerts on the plate [N]."""
    other_lift_speed: int = 20
    """Input, double: `lift_speed` of the arm that leads the other in the lift [m/s]."""
    other_lift_height: int = 21
    """Input, double: `lift_height` of that arm [m]."""
    step: int = 12
    """Output, integer: the step that is being run."""
    barrier: int = 13
    """Output, integer: the last barrier that was reached."""
    state: int = 14
    """Output, integer: see `ProgramState`."""
    path_time: int = 12
    """Output, double: time in the step, on the plan's clock [s]."""
    force: int = 13
    """Output, double: vertical force that this hand exerts on the plate [N]."""
    lift_speed: int = 14
    """Output, double: with which the hand rises behind the lifter [m/s]."""
    lift_height: int = 15
    """Output, double: how far it has risen [m]."""


class ProgramState(IntEnum):
    """What a program tells of itself in its register `state`."""

    WAITING = 0
    RUNNING = 1
    DONE = 2
    WRONG_START = 3
    OVERLOAD = 4
    STOPPED = 5
    FOREIGN = -1
    """What some other program has left in the register: no program of a plan has told anything yet."""

    @classmethod
    def _missing_(cls, value: object) -> ProgramState:
        return cls.FOREIGN


SITE_FUNCTIONS = ("site_fingers", "site_vacuum")
"""What a program calls for what is mounted: `site_fingers(width, force)` in m and N, `site_vacuum(on)`."""


def write_urscript(
    schedule: Schedule,
    arm: ArmName,
    handshake: Handshake = Handshake.REGISTERS,
    registers: Registers | None = None,
    functions: str | None = None,
) -> str:
    """Return the program of one arm.

    Args:
        schedule: of a plan that may be exported, see `guard`.
        arm: whose program.
        handshake: how it waits for the other one.
        registers: which it uses.
        functions: URScript that defines `SITE_FUNCTIONS`; None: a Robotiq gripper, and a valve on output 0.
    """
    return "\n".join(_Writer(schedule, arm, handshake, registers or Registers(), functions).lines()) + "\n"


@dataclass(frozen=True, eq=False)
class _Writer:
    schedule: Schedule
    arm: ArmName
    handshake: Handshake
    registers: Registers
    functions: str | None

    @property
    def other(self) -> ArmName:
        return ARMS[1 - ARMS.index(self.arm)]

    def lines(self) -> Iterator[str]:
        yield from self._header()
        yield f"def liftwright_{self.arm}():"
        yield from _indented(self._site())
        yield from _indented(self._library())
        yield from _indented(self._main())
        yield "end"

    def _header(self) -> Iterator[str]:
        plan = self.schedule.plan
        assert plan.certificate is not None, "only plans with a certificate are exported"
        yield f"# Liftwright {plan.software.version}: program of the {self.arm} arm"
        yield f"# plan {_comment(plan.id)}, digest {plan.digest}"
        yield f"# cell {_comment(plan.cell.name)}, hash {plan.cell.hash}"
        yield f"# certificate passed, {len(plan.certificate.checks)} checks"
        yield f"# {plan.duration:.1f} s in {len(self.schedule.steps)} steps"
        yield "#"
        yield "# Load it on this arm's controller, and the other program of this plan on the other's, over port 30002"
        yield "# or as a script node. Both arms must be where the plan begins: a program moves from nowhere else."
        yield "# Fill in fingers and vacuum below for what is mounted. Nothing here is a safety function: limits and"
        yield "# stops of the safety configuration stay in force."

    def _site(self) -> Iterator[str]:
        """Yield what an integrator may have to change."""
        yield "# ---- of this site ----"
        hand = self.schedule.plan.cell.hands[self.arm]
        if self.functions is not None:
            yield from self.functions.splitlines()
        elif isinstance(hand, GripperDocument):
            stroke = float(hand.tcp[-1, 0])
            least, most = hand.force_range or (0.0, 1.0)
            yield "# Fingers: a Robotiq gripper whose software answers on port 63352. Width [m], force of a pad [N]."
            yield "def site_fingers(width, force):"
            yield '  socket_open("127.0.0.1", 63352, "fingers")'
            yield f"  local closed = floor(255 * (1 - width / {_number(stroke)}) + 0.5)"
            yield f"  local strength = {_strength(least, most)}"
            yield '  socket_set_var("SPE", 255, "fingers")'
            yield '  socket_set_var("FOR", strength, "fingers")'
            yield '  socket_set_var("POS", closed, "fingers")'
            yield '  socket_set_var("GTO", 1, "fingers")'
            yield '  socket_close("fingers")'
            yield "end"
            yield "# Vacuum of the tool, whichever hand has it: standard digital output 0. Both programs switch it, so"
            yield "# that its valve may be wired to either controller."
            yield "def site_vacuum(on):"
            yield "  set_standard_digital_out(0, on)"
            yield "end"
        if self._is_lift and "SITE_TORQUE_AT_FLANGE" not in (self.functions or ""):
            yield "# An e-Series tells the torque at its wrist about the flange, a CB3 about the TCP: False there."
            yield "global SITE_TORQUE_AT_FLANGE = True"
        if self.handshake is Handshake.DIGITAL:
            yield "# Barriers: standard digital output 1 of each controller is wired to digital input 1 of the other."
            yield "# A program that is broken off leaves its output as it is, so that the other arm waits. Set both low"
            yield "# before programs are loaded again: what was left would be taken for an answer."
            yield "global SITE_OUT = 1"
            yield "global SITE_IN = 1"
        yield ""

    def _library(self) -> Iterator[str]:
        r, by_registers = self.registers, self.handshake is Handshake.REGISTERS
        yield "# ---- how the arm is moved ----"
        yield "global lw_rest = 0"
        yield "global lw_path = 0"
        yield "global lw_share = 0"
        yield "global lw_asked = 0"
        yield "global lw_stood = 0"
        yield f"global lw_q = {_list(self.schedule.start[self.arm])}"
        yield f"global lw_v = {_list(np.zeros(6))}"
        yield f"global lw_force_limit = {_number(self.schedule.steps[0].arms[self.arm].force_limit)}"
        yield "def lw_tell(state):"
        yield f"  write_output_integer_register({r.state}, state)"
        yield "end"
        yield "def lw_end(state, words):"
        if self._is_lift and by_registers:
            yield f"  write_output_float_register({r.lift_speed}, 0)"
        yield f"  stopj({_number(STOP_ACCELERATION)})"
        yield "  lw_tell(state)"
        yield '  popup(words, title="Liftwright", error=True, blocking=False)'
        yield "  halt"
        yield "end"
        yield "# Ends the program where more is felt than any step of the plan may ask of the arm."
        yield "def lw_guard():"
        yield "  local felt = get_tcp_force()"
        yield "  if norm([felt[0], felt[1], felt[2]]) > lw_force_limit:"
        yield f'    lw_end({ProgramState.OVERLOAD}, "more force at the wrist than the plan allows")'
        yield "  end"
        if by_registers:
            yield "  # Joints lag behind what they are sent: they come to rest first, unless a hand gives way."
            rest = 0.0 if self._is_lift else SETTLED
            yield f"  if read_input_integer_register({r.stop}) == 1 and lw_share == 0 and lw_stood >= {_number(rest)}:"
            yield f'    lw_end({ProgramState.STOPPED}, "stopped on request")'
            yield "  end"
        yield "end"
        yield "# The share of the speed follows what is asked for, a little each cycle: the slower, the more gently."
        yield "def lw_pace():"
        wanted = f"read_input_float_register({r.share})" if by_registers else "1"
        yield f"  local wanted = {wanted}"
        if by_registers:
            yield f"  if read_input_integer_register({r.stop}) == 1:"
            yield "    wanted = 0"
            yield "  end"
        yield "  if wanted > lw_asked:"
        yield "    global lw_asked = wanted"
        yield "  end"
        yield f"  local most = lw_asked * get_steptime() / {_number(STOP_DURATION)}"
        yield "  if wanted > lw_share + most:"
        yield "    global lw_share = lw_share + most"
        yield "  elif wanted < lw_share - most:"
        yield "    global lw_share = lw_share - most"
        yield "  else:"
        yield "    global lw_share = wanted"
        yield "    if wanted > 0:"
        yield "      global lw_asked = wanted"
        yield "    end"
        yield "  end"
        yield "  if lw_share == 0:"
        yield "    global lw_stood = lw_stood + get_steptime()"
        yield "  else:"
        yield "    global lw_stood = 0"
        yield "  end"
        yield "end"
        if self._is_lift:
            yield from self._admittance()
        goal = "lw_on_plate(goal, w, s)" if self._is_lift else "goal"
        yield "# Moves to (q, v) in a time on the plan's clock, along the cubic that the plan means."
        yield f"def lw_to(duration, q, v{', w' if self._is_lift else ''}):"
        yield from _HERMITE_LOOP
        yield f"    write_output_float_register({r.path_time}, lw_path + lw_rest)"
        yield f"    servoj({goal}, 0, 0, get_steptime(), {_number(LOOKAHEAD)}, {GAIN})"
        yield "  end"
        yield "  global lw_rest = lw_rest - duration"
        yield "  global lw_path = lw_path + duration"
        yield "  global lw_q = q"
        yield "  global lw_v = v"
        if self._is_lift:
            yield "  global lw_w = w"
        yield "end"
        yield "# Ends a step where the plan has it end."
        yield "def lw_settle():"
        goal = "lw_on_plate(lw_q, lw_w, 1)" if self._is_lift else "lw_q"
        yield f"  servoj({goal}, 0, 0, get_steptime(), {_number(LOOKAHEAD)}, {GAIN})"
        yield f"  stopj({_number(STOP_ACCELERATION)})"
        if self._is_lift:
            yield "  lw_take_over(lw_bears, lw_comes)"
        yield "end"
        yield "# Waits on the spot for as long as the other arm moves."
        yield "def lw_stay(duration):"
        yield "  while lw_rest < duration:"
        yield "    lw_guard()"
        yield "    lw_pace()"
        yield "    global lw_rest = lw_rest + get_steptime() * lw_share"
        yield f"    write_output_float_register({r.path_time}, lw_path + lw_rest)"
        yield "    sync()"
        yield "  end"
        yield "  global lw_rest = lw_rest - duration"
        yield "end"
        yield from self._barrier()
        yield ""

    @property
    def _least_squeeze(self) -> float:
        """With which fingers move that close on nothing [N]."""
        hand = self.schedule.plan.cell.hands[self.arm]
        return hand.force_range[0] if isinstance(hand, GripperDocument) and hand.force_range is not None else 0.0

    @property
    def _is_lift(self) -> bool:
        return self.schedule.steps[0].arms[self.arm].wrenches is not None

    def _admittance(self) -> Iterator[str]:
        """Yield what has a hand exert the planned wrench, see `HandAdmittance`."""
        told = self.schedule.admittance
        grips = isinstance(self.schedule.plan.cell.hands[self.arm], GripperDocument)
        turning = 1.0 / told.torsional_damping if grips else 0.0
        yield "# A hand on the plate is off the plan by lw_trim [m, rad, base axes]: it gives way to more than the"
        yield "# planned wrench, and presses on below it. lw_w [N, Nm]: that of the hand on the plate, about the TCP."
        yield "# One that has let go is off it by lw_away [rad], which it takes back."
        yield "global lw_bears = False"
        yield "global lw_comes = False"
        yield "global lw_bound = 0"
        for name in ("lw_w", "lw_trim", "lw_away", "lw_rate", "lw_sensed"):
            yield f"global {name} = {_list(np.zeros(6))}"
        yield f"global lw_yield = {_list(np.repeat([1.0 / told.damping, turning], 3))}"
        yield f"global lw_change = {_list(np.repeat([GIVING_ACCELERATION, TURNING_ACCELERATION], 3))}"
        yield "def lw_changed(i, next):"
        yield f"  local most = get_steptime() * {_number(TURNING_ACCELERATION)}"
        yield "  if lw_bears:"
        yield "    most = get_steptime() * lw_change[i]"
        yield "  end"
        yield "  if next > lw_rate[i] + most:"
        yield "    return lw_rate[i] + most"
        yield "  elif next < lw_rate[i] - most:"
        yield "    return lw_rate[i] - most"
        yield "  end"
        yield "  return next"
        yield "end"
        yield "# The wrench on the tool about the TCP."
        yield "def lw_felt_at_tcp(here, goal):"
        yield "  local felt = get_tcp_force()"
        yield "  if SITE_TORQUE_AT_FLANGE:"
        yield "    local flange = get_forward_kin(goal, p[0, 0, 0, 0, 0, 0])"
        yield "    local x = here[0] - flange[0]"
        yield "    local y = here[1] - flange[1]"
        yield "    local z = here[2] - flange[2]"
        yield "    felt[3] = felt[3] - (y * felt[2] - z * felt[1])"
        yield "    felt[4] = felt[4] - (z * felt[0] - x * felt[2])"
        yield "    felt[5] = felt[5] - (x * felt[1] - y * felt[0])"
        yield "  end"
        yield "  return felt"
        yield "end"
        yield f"global lw_drift = {_list(np.repeat(SENSOR_DRIFT, 3))}"
        yield "def lw_on_plate(goal, w, s):"
        yield "  local rate = lw_rate"
        yield "  local i = 0"
        yield "  if not lw_bears:"
        yield "    local away = lw_away"
        yield "    while i < 6:"
        yield f"      rate[i] = lw_changed(i, -away[i] / {_number(told.fading)})"
        yield "      away[i] = away[i] + get_steptime() * rate[i]"
        yield "      goal[i] = goal[i] + away[i]"
        yield "      i = i + 1"
        yield "    end"
        yield "    global lw_rate = rate"
        yield "    global lw_away = away"
        yield "    return goal"
        yield "  end"
        yield "  local here = get_forward_kin(goal)"
        yield "  local felt = lw_felt_at_tcp(here, goal)"
        yield "  local sensed = lw_sensed"
        yield "  local trim = lw_trim"
        yield "  while i < 6:"
        yield f"    sensed[i] = sensed[i] + get_steptime() / {_number(SMOOTHING)} * (felt[i] - sensed[i])"
        yield "    local missing = (1 - s) * lw_w[i] + s * w[i] + sensed[i]"
        yield "    if lw_comes and missing < lw_drift[i] and missing > -lw_drift[i]:"
        yield "      missing = 0"
        yield "    end"
        yield f"    rate[i] = lw_changed(i, missing * lw_yield[i] - {_number(told.leak)} * trim[i])"
        yield "    trim[i] = trim[i] + get_steptime() * rate[i]"
        yield "    i = i + 1"
        yield "  end"
        for name, first, most in (("far", 0, told.largest_correction), ("turned", 3, told.largest_turning)):
            yield f"  local {name} = norm([trim[{first}], trim[{first + 1}], trim[{first + 2}]])"
            yield f"  if {name} > {_number(most)}:"
            for i in range(first, first + 3):
                yield f"    trim[{i}] = trim[{i}] * {_number(most)} / {name}"
            yield "  end"
        yield "  global lw_bound = lw_bound + get_steptime()"
        yield f"  if far <= {_number(told.largest_correction)}:"
        yield "    global lw_bound = 0"
        yield "  end"
        yield f"  if lw_bound > {_number(LONGEST_BOUND)}:"
        yield f'    lw_end({ProgramState.OVERLOAD}, "a hand on the plate gives way as far as it may")'
        yield "  end"
        yield "  global lw_sensed = sensed"
        yield "  global lw_rate = rate"
        yield "  global lw_trim = trim"
        yield "  local moved = p[trim[0], trim[1], trim[2], trim[3], trim[4], trim[5]]"
        yield "  local next = get_inverse_kin(pose_add(moved, here), goal)"
        yield "  # Near a wrist's singularity joints would jerk by what little a hand gives way to a sensor's noise."
        yield "  local now = get_target_joint_positions()"
        yield "  local speeds = get_target_joint_speeds()"
        yield f"  local most = get_steptime() * get_steptime() * {_number(JOINT_ACCELERATION)}"
        yield "  i = 0"
        yield "  while i < 6:"
        yield "    local on = now[i] + get_steptime() * speeds[i]"
        yield "    if next[i] > on + most:"
        yield "      next[i] = on + most"
        yield "    elif next[i] < on - most:"
        yield "      next[i] = on - most"
        yield "    end"
        yield "    i = i + 1"
        yield "  end"
        yield "  return next"
        yield "end"
        yield "# Takes the hand to be off the plan by as much as it is: a step begins where the one before ended."
        yield "def lw_take_over(bears, comes):"
        yield "  local away = get_target_joint_positions()"
        yield "  local here = get_forward_kin(away)"
        yield "  local felt = lw_felt_at_tcp(here, away)"
        yield "  local planned = get_forward_kin(lw_q)"
        yield "  local turn = pose_trans(here, pose_inv(planned))"
        yield "  local off = [here[0] - planned[0], here[1] - planned[1], here[2] - planned[2]]"
        yield "  local i = 0"
        yield "  while i < 6:"
        yield "    away[i] = away[i] - lw_q[i]"
        yield "    i = i + 1"
        yield "  end"
        farthest, most_turned = (_number(TAKEN_OVER * most) for most in (told.largest_correction, told.largest_turning))
        yield f"  if bears and (norm(off) > {farthest} or norm([turn[3], turn[4], turn[5]]) > {most_turned}):"
        yield f'    lw_end({ProgramState.WRONG_START}, "a hand on the plate is not where the plan has it")'
        yield "  end"
        yield "  global lw_away = away"
        yield "  global lw_sensed = felt"
        yield f"  global lw_rate = {_list(np.zeros(6))}"
        yield "  global lw_trim = [off[0], off[1], off[2], turn[3], turn[4], turn[5]]"
        yield "  global lw_bears = bears"
        yield "  global lw_comes = comes"
        yield "  global lw_bound = 0"
        yield "end"
        yield "# Holds still for a control cycle: a hand on the plate goes on exerting what it did last."
        yield "def lw_hold():"
        yield "  if lw_bears:"
        yield f"    servoj(lw_on_plate(lw_q, lw_w, 1), 0, 0, get_steptime(), {_number(LOOKAHEAD)}, {GAIN})"
        yield "  else:"
        yield "    sync()"
        yield "  end"
        yield "end"

    def _barrier(self) -> Iterator[str]:
        r = self.registers
        yield "# Neither arm begins a step before the other has ended the one before."
        yield "def lw_meet(number):"
        if self.handshake is Handshake.REGISTERS:
            yield f"  write_output_integer_register({r.barrier}, number)"
            yield f"  lw_tell({ProgramState.WAITING})"
            yield (
                f"  while read_input_integer_register({r.other_barrier}) < number or "
                f"read_input_integer_register({r.confirmed}) < number:"
            )
            yield "    lw_guard()"
            yield "    lw_pace()"
            yield f"    {'lw_hold' if self._is_lift else 'sync'}()"
            yield "  end"
        else:
            yield "  local odd = number % 2 == 1"
            yield "  set_standard_digital_out(SITE_OUT, odd)"
            yield f"  lw_tell({ProgramState.WAITING})"
            yield "  while get_standard_digital_in(SITE_IN) != odd:"
            yield "    lw_guard()"
            yield f"    {'lw_hold' if self._is_lift else 'sync'}()"
            yield "  end"
            yield "  # Long enough for the other controller to have seen it before it changes again."
            yield "  sleep(0.05)"
        yield "end"
        if self.schedule.openings:
            yield "# Waits where the plan begins until the fingers of both arms are as far open as it has them."
            yield "def lw_open():"
            yield "  local waited = 0"
            yield f"  while waited < {_number(OPENING_SECONDS)}:"
            yield "    lw_guard()"
            yield "    lw_pace()"
            yield "    sync()"
            yield "    waited = waited + get_steptime()"
            yield "  end"
            yield "end"
        yield "def lw_run(number):"
        if self._is_lift:
            yield "  if lw_bears:"
            yield f"    stopj({_number(STOP_ACCELERATION)})"
            yield "  end"
        yield f"  write_output_integer_register({r.step}, number)"
        yield f"  lw_tell({ProgramState.RUNNING})"
        yield "  global lw_rest = 0"
        yield "  global lw_path = 0"
        yield "end"
        yield "def lw_begin(number):"
        yield "  lw_meet(number)"
        yield "  lw_run(number)"
        yield "end"

    def _main(self) -> Iterator[str]:
        yield "# ---- the plan ----"
        if self.handshake is Handshake.REGISTERS:
            if self._is_lift:
                for register in (self.registers.force, self.registers.lift_speed, self.registers.lift_height):
                    yield f"write_output_float_register({register}, 0)"
            yield "# Nobody supervises any more: stop."
            watched = f"input_int_register_{self.registers.heartbeat}"
            yield f'rtde_set_watchdog("{watched}", {_number(HEARTBEAT_RATE)}, "stop")'
        yield f"write_output_integer_register({self.registers.step}, 0)"
        yield f"lw_begin_at = {_list(self.schedule.start[self.arm])}"
        yield "lw_now = get_actual_joint_positions()"
        yield "lw_joint = 0"
        tolerance = _number(start_tolerance(self.schedule, self.arm))
        yield "while lw_joint < 6:"
        yield "  lw_off = lw_now[lw_joint] - lw_begin_at[lw_joint]"
        yield f"  if lw_off > {tolerance} or lw_off < -{tolerance}:"
        yield f'    lw_end({ProgramState.WRONG_START}, "the arm is not where the plan begins")'
        yield "  end"
        yield "  lw_joint = lw_joint + 1"
        yield "end"
        before: ArmStep | None = None
        for step in self.schedule.steps:
            mine = step.arms[self.arm]
            yield from self._step(step, mine, before)
            before = mine
        yield from self._lift()
        yield f"stopj({_number(STOP_ACCELERATION)})"
        if self.handshake is Handshake.DIGITAL:
            yield "# Nobody waits for an answer any more: the next program begins with what is left here."
            yield "set_standard_digital_out(SITE_OUT, False)"
        yield f"lw_tell({ProgramState.DONE})"

    def _step(self, step: ProgramStep, mine: ArmStep, before: ArmStep | None) -> Iterator[str]:
        yield f"# step {step.number} of {self.schedule.last}: {step.words}"
        if step.stop_share < 1.0:
            yield f"# A stop from more than {step.stop_share:g} of the planned speed may lose what is carried."
        if before is None:
            yield from self._opening(step.number)
        else:
            yield f"lw_begin({step.number})"
        if before is None or mine.load != before.load:
            com = ", ".join(map(_number, mine.load.com))
            yield f"set_payload({_number(mine.load.mass)}, [{com}])"
        yield f"set_tcp({_pose(mine.T_flange_tcp)})"
        yield f"global lw_force_limit = {_number(mine.force_limit)}"
        if mine.vacuum is not None:
            yield f"site_vacuum({mine.vacuum})"
        if mine.width is not None:
            yield f"site_fingers({_number(mine.width)}, {_number(mine.squeeze or self._least_squeeze)})"
        if mine.wrenches is not None:
            yield from self._on_plate(mine, mine.wrenches)
            return
        if not mine.moves:
            yield f"lw_stay({_number(step.duration)})"
            return
        for duration, q, v in zip(np.diff(mine.time), mine.positions[1:], mine.velocities[1:], strict=True):
            yield f"lw_to({_number(duration)}, {_list(q)}, {_list(v)})"
        yield "lw_settle()"

    def _opening(self, number: int) -> Iterator[str]:
        """Yield how the first step is begun: behind its barrier, and before either arm moves, fingers open."""
        yield f"lw_meet({number})"
        openings = self.schedule.openings
        if self.arm in openings:
            if not self._is_lift:
                yield "site_vacuum(False)"
            yield f"site_fingers({_number(openings[self.arm])}, {_number(self._least_squeeze)})"
        if openings:
            yield "lw_open()"
        yield f"lw_run({number})"

    def _on_plate(self, mine: ArmStep, wrenches: WrenchCurve) -> Iterator[str]:
        """Yield a step of a lift: the motion, with the wrench that the hand exerts on the plate meanwhile."""
        if wrenches.bears:
            yield f"global lw_w = {_list(wrenches.values[0])}"
        if mine.free:
            yield "# The hand touches nothing: what is felt now is the sensor's own."
            yield "zero_ftsensor()"
        yield f"lw_take_over({wrenches.bears}, {wrenches.comes})"
        time, positions, velocities = mine.time, mine.positions, mine.velocities
        if not mine.moves:
            time = wrenches.time if wrenches.bears else wrenches.time[[0, -1]]
            positions, velocities = np.repeat(positions, len(time), axis=0), np.zeros((len(time), 6))
        values = wrenches.at(time).values if wrenches.bears else np.zeros((len(time), 6))
        for row in zip(np.diff(time), positions[1:], velocities[1:], values[1:], strict=True):
            duration, q, v, wrench = row
            yield f"lw_to({_number(duration)}, {_list(q)}, {_list(v)}, {_list(wrench)})"
        yield "lw_settle()"

    def _take_on(self, wrench: Array) -> Iterator[str]:
        """Yield how a hand takes on the wrench (6,) with which the lift begins, world axes."""
        told = in_base(wrench[None], self.schedule.plan.cell.arms[self.arm].T_world_base)[0]
        yield "lw_take_over(True, False)"
        for _ in range(2):
            yield f"lw_to({_number(0.5 * SETTLING)}, lw_q, {_list(np.zeros(6))}, {_list(told)})"
        yield "lw_settle()"

    def _lift(self) -> Iterator[str]:
        """Yield law (11) of paper B, by which both hands follow the lifter; nothing for a pile."""
        simulation = self.schedule.lift
        if simulation is None or simulation.lift is None or simulation.lift.law is None:
            return
        assert simulation.lift.hand_wrenches is not None, "without them there is no lift in a schedule"
        if self.handshake is not Handshake.REGISTERS:
            yield "# The lift needs the other hand's force, which digital wires do not carry: registers do."
            return
        r, told, number = self.registers, simulation.lift.law, self.schedule.last + 1
        gains = FollowerGains(**told.model_dump(exclude={"goal_force"}))
        T_world_base = self.schedule.plan.cell.arms[self.arm].T_world_base
        height = simulation.lift.reachable_height
        yield f"# step {number}: follow the lifter by force (paper B, eq. 11), {height:.3f} m up at most;"
        yield f"# confirming step {number + 1} ends it."
        yield f"lw_begin({number})"
        yield from self._take_on(simulation.lift.hand_wrenches[self.arm])
        yield f"lw_up = {_list(T_world_base[2, :3])}"
        yield "lw_speed = 0"
        yield "lw_risen = 0"
        yield "# Neither rises before both have taken on their forces, and know each other's."
        yield f"write_output_integer_register({r.barrier}, {number + 1})"
        yield f"while read_input_integer_register({r.other_barrier}) < {number + 1}:"
        yield from _indented(self._feel())
        yield "  lw_hold()"
        yield "end"
        yield f"stopj({_number(STOP_ACCELERATION)})"
        yield "lw_begun = get_target_tcp_pose()"
        going_on = f"read_input_integer_register({r.confirmed}) < {number + 1}"
        if self.arm == LEADER:
            yield "lw_lifter = 0"
            yield f"lw_errors = {_list(np.zeros(gains.readings))}"
            yield "lw_count = 0"
            yield "lw_gained = 0"
            yield "lw_gained_before = 0"
            yield f"while lw_risen < {_number(height)} and {going_on}:"
            yield from _indented(self._law(gains, told.goal_force))
        else:
            led = f"read_input_float_register({r.other_lift_height})"
            yield f"while {led} < {_number(height)} and {going_on}:"
            yield from _indented(self._follow())
        yield "end"
        yield f"write_output_float_register({r.lift_speed}, 0)"
        yield f"write_output_float_register({r.lift_height}, lw_risen)"
        yield f"stopl({_number(LIFT_ACCELERATION)})"

    def _feel(self) -> Iterator[str]:
        """Yield what each period of the lift begins with: a stop on request, and the force of this hand is told."""
        r = self.registers
        yield f"if read_input_integer_register({r.stop}) == 1:"
        yield f'  lw_end({ProgramState.STOPPED}, "stopped on request")'
        yield "end"
        yield "lw_guard()"
        yield "lw_felt = get_tcp_force()"
        yield "lw_mine = -(lw_felt[0] * lw_up[0] + lw_felt[1] * lw_up[1] + lw_felt[2] * lw_up[2])"
        yield f"write_output_float_register({r.force}, lw_mine)"

    def _follow(self) -> Iterator[str]:
        """Yield one control cycle of the hand that rises as the other one tells."""
        r = self.registers
        yield from self._feel()
        behind = f"read_input_float_register({r.other_lift_height}) - lw_risen"
        yield f"lw_led = read_input_float_register({r.other_lift_speed})"
        yield f"lw_speed = lw_led + {_number(CATCHING_UP)} * ({behind})"
        yield "if lw_speed < 0 or lw_led == 0:"
        yield "  lw_speed = 0"
        yield f"elif lw_speed > {_number(FASTEST_LIFT)}:"
        yield f"  lw_speed = {_number(FASTEST_LIFT)}"
        yield "end"
        yield f"if norm({behind}) > {_number(APART_IN_LIFT)}:"
        yield f'  lw_end({ProgramState.OVERLOAD}, "the hands do not rise alike")'
        yield "end"
        yield from self._rise("get_steptime()")

    def _rise(self, period: str) -> Iterator[str]:
        yield "lw_xd = [lw_up[0] * lw_speed, lw_up[1] * lw_speed, lw_up[2] * lw_speed, 0, 0, 0]"
        yield f"speedl(lw_xd, {_number(LIFT_ACCELERATION)}, {period})"
        yield "lw_here = get_target_tcp_pose()"
        way = " + ".join(f"(lw_here[{i}] - lw_begun[{i}]) * lw_up[{i}]" for i in range(3))
        yield f"lw_risen = {way}"
        yield f"write_output_float_register({self.registers.lift_height}, lw_risen)"

    def _law(self, gains: FollowerGains, goal_force: float) -> Iterator[str]:
        """Yield one period of `LeaderFollower.follow`."""
        r, period, kept = self.registers, _number(gains.period), _number(math.exp(-gains.period / gains.memory))
        (a, b, c), (d, e, f) = (map(_number, row) for row in LeaderFollower(gains).discrete)
        yield from self._feel()
        yield f"lw_both = lw_mine + read_input_float_register({r.other_force})"
        yield f"lw_force = lw_both - {_number(gains.carried)} * lw_gained_before"
        yield f"lw_errors[lw_count % {gains.readings}] = {_number(goal_force)} - lw_force"
        yield "lw_count = lw_count + 1"
        yield f"lw_error = ({' + '.join(f'lw_errors[{i}]' for i in range(gains.readings))}) / {gains.readings}"
        yield f"if lw_count < {gains.readings}:"
        yield f"  lw_error = lw_error * {gains.readings} / lw_count"
        yield "end"
        yield f"lw_next = {a} * lw_speed + {b} * lw_lifter + {c} * lw_error"
        yield f"lw_estimate = {d} * lw_speed + {e} * lw_lifter + {f} * lw_error"
        yield f"if lw_next < 0 or lw_next > {_number(FASTEST_LIFT)}:"
        yield "  if lw_next < 0:"
        yield "    lw_next = 0"
        yield "  else:"
        yield f"    lw_next = {_number(FASTEST_LIFT)}"
        yield "  end"
        yield f"  lw_estimate = lw_next + {kept} * (lw_lifter - lw_next)"
        yield "end"
        yield "lw_gained_before = lw_gained"
        yield f"lw_gained = (lw_next - lw_speed) / {period}"
        yield "lw_lifter = lw_estimate"
        yield "lw_speed = lw_next"
        yield f"write_output_float_register({r.lift_speed}, lw_speed)"
        yield from self._rise(period)


_HERMITE_LOOP = (
    "  while lw_rest < duration:",
    "    lw_guard()",
    "    lw_pace()",
    "    local s = lw_rest / duration",
    "    local a = (1 + 2 * s) * (1 - s) * (1 - s)",
    "    local b = s * (1 - s) * (1 - s) * duration",
    "    local c = s * s * (3 - 2 * s)",
    "    local d = s * s * (s - 1) * duration",
    "    local goal = [0, 0, 0, 0, 0, 0]",
    "    local i = 0",
    "    while i < 6:",
    "      goal[i] = a * lw_q[i] + b * lw_v[i] + c * q[i] + d * v[i]",
    "      i = i + 1",
    "    end",
    "    global lw_rest = lw_rest + get_steptime() * lw_share",
)


def start_tolerance(schedule: Schedule, arm: ArmName) -> float:
    """Return how far each joint of an arm may be from where a schedule begins [rad]."""
    wrenches = schedule.steps[0].arms[arm].wrenches
    return BEARING_TOLERANCE if wrenches is not None and wrenches.bears else JOINT_TOLERANCE


def _indented(lines: Iterator[str]) -> Iterator[str]:
    return (f"  {line}" if line else "" for line in lines)


def _number(value: float) -> str:
    return f"{value:.9g}"


def _strength(least: float, most: float) -> str:
    """Return the share of 255 that stands for a force between the least and the most of fingers [N]."""
    if not most > least:
        return "255"
    return f"floor(255 * (force - {_number(least)}) / {_number(most - least)} + 0.5)"


def _list(values: Array | Sequence[float]) -> str:
    return f"[{', '.join(map(_number, values))}]"


def _pose(T: Transform) -> str:
    """Return a pose as controllers write it: position, then rotation vector."""
    return f"p{_list([*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_rotvec()])}"


def _comment(text: str) -> str:
    """Return text as it may stand in a comment, which ends with its line."""
    return " ".join(text.split())
