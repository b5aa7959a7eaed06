"""One run of a suction-tool plan: the timed motion by position control, until its end or until something gives way."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from planners.cell.hand import Gripper
from planners.geometry.pose import Array, Transform
from planners.progress import Progress, Report
from planners.scene.suction_tool import TOOL_NAME
from planners.scene.tool_scene import SuctionToolScene
from workers.simulation.bond import exert
from workers.simulation.goal_error import GoalError
from workers.simulation.outcome import Failure, ToolOutcome
from workers.simulation.sampled_plan import Place
from workers.simulation.standing import Standing
from workers.simulation.tool_holds import CupHold, CupLoad, FingerHold, leaves_behind, misses_tool
from workers.simulation.tool_recorder import ToolRecorder
from workers.simulation.tool_reference import PlannedGrip, PlannedSuction, ToolReference, ToolStage
from workers.simulation.tool_settings import ToolSimulationSettings
from workers.simulation.tool_world import ToolWorld

_REPORT_EVERY = 50
"""Steps between two reports of progress."""
_NO_LOAD = (0.0, 0.0)
ToolFailure = Failure[ToolOutcome]


class ToolExecution:
    """One simulated run of a plan. Call `run` once."""

    def __init__(
        self, document: Mapping[str, Any], scene: SuctionToolScene, world: ToolWorld, settings: ToolSimulationSettings
    ) -> None:
        """Prepare what the plan wants.

        Args:
            document: solved.
            scene: that it was planned in.
            world: the physics, at the start.
            settings: see there.
        """
        self.scene, self.world, self.settings = scene, world, settings
        self.reference = ToolReference.of(document)
        self.recorder = ToolRecorder()
        self.time = 0.0
        """[s]"""
        self._fingers: dict[str, FingerHold] = {}
        self._cup: CupHold | None = None
        self._standing = Standing(dict(world.bodies()), settings.watch)
        self._passing: frozenset[str] = frozenset()
        self._look = round(settings.watch.period / settings.step)
        self._record = round(settings.record_period / settings.step)
        self._steps = 0
        self._squeezes: dict[str, float] = {}
        self._load: CupLoad | None = None

    def run(self, progress: Progress) -> ToolFailure | None:
        """Execute everything; return what gave way, None when all objects are at their goals."""
        end = self.reference.duration + self.settings.settle
        failure = None
        while failure is None and self.time < end - 0.5 * self.settings.step:
            failure = self._step()
            if self._steps % _REPORT_EVERY == 0:
                progress(Report("simulate", round(1000.0 * self.time / end), 1000))
        failure = failure or self._miss()
        if failure is not None and self.time < end - 0.5 * self.settings.step:
            self._stand_still()
        progress(Report("simulate", 1, 1))
        return failure

    def goal_errors(self) -> dict[str, GoalError]:
        """Return how far each object is from its goal now."""
        return {m.name: GoalError.of(m, self.world.objects[m.name].T_world_body) for m in self.scene.objects}

    # One step.

    def _step(self) -> ToolFailure | None:
        place = self.reference.locate(self.time)
        failure = self._take_and_let_go(place)
        if failure is not None:
            return failure
        ahead = self.reference.locate(self.time + self.settings.step)
        self._advance(*self.reference.joints(ahead))
        if self._steps % self._look == 0:
            failure = self._give_way() or self._standing.look(self._held(), self.time)
        if failure is not None or self._steps % self._record == 0:
            self._keep(self.reference.locate(self.time))
        return failure

    def _advance(self, positions: Array, velocities: Array) -> None:
        """Let holds act for one step while the joints are driven to positions (12,)."""
        world, step = self.world, self.settings.step
        holds = list(self._fingers.values())
        for hold in holds:
            hold.bond.follow(*world.hand(hold.arm, hold.T_flange_tcp))
        bonds = [hold.bond for hold in holds]
        if self._cup is not None:
            self._cup.bond.follow(world.tool.T_world_body)
            bonds.append(self._cup.bond)
        exert(bonds, step, self.scene.cell.gravity)
        for hold in holds:
            world.push_hand(hold.arm, -hold.bond.wrench, hold.bond.point)
        world.drive(positions, velocities)
        world.advance()
        self.time += step
        self._steps += 1

    def _stand_still(self) -> None:
        """Stop the robot where it is, and see what becomes of the rest."""
        positions = self.world.positions.copy()
        for _ in range(round(self.settings.aftermath / self.settings.step)):
            self._advance(positions, np.zeros(12))
            if self._steps % self._record == 0:
                self._keep(None)

    # Taking and letting go, as the plan says.

    def _take_and_let_go(self, place: Place) -> ToolFailure | None:
        stage = self.reference.stage(place)
        self._let_pass(int(self.reference.segment_of[place[0]]))
        return self._move_fingers(self._wanted_grips(stage)) or self._switch_vacuum(self._wanted_suction(stage))

    def _wanted_grips(self, stage: ToolStage) -> tuple[PlannedGrip, ...]:
        part, s = stage.part(self.time), self.settings
        changing = {"grip": part >= s.close_at, "release": part < s.open_at}.get(stage.kind, True)
        return stage.grips if changing else stage.grips[1:]

    def _wanted_suction(self, stage: ToolStage) -> PlannedSuction | None:
        over = stage.part(self.time) >= self.settings.vacuum_at
        on = {"attach": over, "detach": not over}.get(stage.kind, True)
        return stage.suction if on else None

    def _move_fingers(self, wanted: tuple[PlannedGrip, ...]) -> ToolFailure | None:
        arms = {grip.arm for grip in wanted}
        self._fingers = {arm: hold for arm, hold in self._fingers.items() if arm in arms}
        for grip in wanted:
            if grip.arm in self._fingers:
                continue
            T_flange_tcp = _flange_tcp(self.scene, grip)
            T_world_tcp, _ = self.world.hand(grip.arm, T_flange_tcp)
            missed = misses_tool(grip, T_world_tcp, self.world.tool, self.settings.taking)
            if missed is not None:
                return Failure(ToolOutcome.TOOL_SLIPPED, self.time, missed)
            self._fingers[grip.arm] = FingerHold(
                grip, self.world.tool, T_world_tcp, T_flange_tcp, self.scene, self.settings
            )
        return None

    def _switch_vacuum(self, wanted: PlannedSuction | None) -> ToolFailure | None:
        if wanted is None:
            self._cup = None
            return None
        if self._cup is not None and self._cup.name == wanted.name:
            return None
        tool, item = self.world.tool, self.world.objects[wanted.name]
        missed = leaves_behind(wanted, tool, item, self.settings.taking)
        if missed is not None:
            return Failure(ToolOutcome.OBJECT_DROPPED, self.time, missed)
        self._cup = CupHold(wanted, tool, item, self.scene.tool.cup, self.settings)
        return None

    def _let_pass(self, segment: int) -> None:
        """Let the cup touch what it sucks, or is about to: its lip is no rigid body."""
        passing = self.reference.touching(segment)
        for name in passing ^ self._passing:
            self.world.tool.let_touch(self.world.objects[name], touches=name not in passing)
        self._passing = passing

    # Looking at it.

    def _give_way(self) -> ToolFailure | None:
        period = self.settings.watch.period
        self._squeezes = {arm: hold.squeeze for arm, hold in self._fingers.items()}
        self._load = None if self._cup is None else self._cup.load
        if self._cup is not None and self._load is not None:
            cause = self._cup.lets_go(self._load, period)
            if cause is not None:
                self._cup = None
                return Failure(ToolOutcome.OBJECT_DROPPED, self.time, cause)
        for arm, hold in self._fingers.items():
            cause = hold.lets_go(self._squeezes[arm], period)
            if cause is not None:
                del self._fingers[arm]
                return Failure(ToolOutcome.TOOL_SLIPPED, self.time, cause)
        return None

    def _held(self) -> list[str]:
        held = [] if self._cup is None else [self._cup.name]
        return [*held, TOOL_NAME] if self._fingers else held

    def _miss(self) -> ToolFailure | None:
        """Return which object is farthest off its goal, None if all are there."""
        s = self.settings.watch
        off = {n: e for n, e in self.goal_errors().items() if e.distance > s.goal_distance or e.angle > s.goal_angle}
        if not off:
            return None
        worst = max(off, key=lambda name: off[name].distance)
        error = off[worst]
        where = f"{1e3 * error.distance:.1f} mm and {np.degrees(error.angle):.1f} degrees off its goal"
        return Failure(ToolOutcome.OFF_GOAL, self.time, f"{worst} ended {where}")

    def _keep(self, place: Place | None) -> None:
        """Record this moment; without a place in the plan nothing is off it."""
        pull, share = _NO_LOAD if self._load is None else (self._load.pull, self._load.share)
        held = self._held()
        self.recorder.add(
            self.time,
            self.world.positions,
            self.world.bodies(),
            suction_load=pull,
            suction_share=share,
            left_squeeze=self._squeezes.get("left", 0.0),
            right_squeeze=self._squeezes.get("right", 0.0),
            tool_off_plan=self._off(TOOL_NAME, place) if TOOL_NAME in held else 0.0,
            object_off_plan=max((self._off(name, place) for name in held if name != TOOL_NAME), default=0.0),
        )

    def _off(self, name: str, place: Place | None) -> float:
        if place is None:
            return 0.0
        body = self.world.tool if name == TOOL_NAME else self.world.objects[name]
        return float(np.linalg.norm(body.T_world_body[:3, 3] - self.reference.position(name, place)))


def _flange_tcp(scene: SuctionToolScene, grip: PlannedGrip) -> Transform:
    hand = scene.cell.arms[grip.arm].hand
    assert isinstance(hand, Gripper)
    return hand.T_flange_tcp(grip.width)
