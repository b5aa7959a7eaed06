"""The stage "simulate" of a job: from a certified plan of either kind to its member `simulation`."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np

from planners.contract.arrays import rounded
from planners.geometry.pose import to_pose7s
from planners.plan.plan import Plan
from planners.plan.simulation import (
    FollowerLaw,
    ForceDips,
    GoalError,
    LargestLoads,
    LiftSimulation,
    SimulatedLift,
    SimulatedManipulation,
    SimulatedMotion,
    Simulation,
    ToolSimulation,
)
from planners.progress import Progress
from planners.scene.lift_scene import PlateLiftScene
from planners.scene.tool_scene import SuctionToolScene
from workers.simulation.lift_execution import LiftExecution, LiftFailure
from workers.simulation.recording import TOOL_UNITS
from workers.simulation.settings import SimulationSettings, ToolSimulationSettings
from workers.simulation.tool_execution import ToolExecution, ToolFailure
from workers.simulation.world import LiftWorld, ToolWorld

LIFT_MODEL = (
    "Plate, table, support and obstacles are rigid bodies in PyBullet; arms are chains of links driven by servos.",
    "Friction is what the task says, at all contacts, times a stated factor.",
    "Pads and tip are springs and dampers within Coulomb friction; the gripper squeezes with the force that the plan "
    "commands, which is no load of the arm.",
    "In the manipulation hands track the planned wrenches by admittance on a noisy, tared sensor; the stick never "
    "presses less than a stated force.",
    "In the manipulation the lifter is a force source: the planned cup force with a seeded error, at most the cup's "
    "largest force, and the cup's own stiffness about the planned path.",
    "The cup gives the torque that is planned for it, in the lift that of F_goal, as far as its pad bears it: bending "
    "up to pi r kappa / sqrt(2) about each of its axes, by (5g), and twist by friction. On a cable it gives none.",
    "In the lift the lifter is an independent winch with an uneven profile, drawn from the seed before the lift "
    "begins; both hands follow the vertical force that they bear together by eq. (11), with V_d estimated from their "
    "own speed: nothing is known of the lifter. Without control they rise at the speed that such lifters usually have.",
    "The paper's lifter pulls in all directions and its cup holds by friction; on a cable the trolley keeps above the "
    "cup, which bears a pull from any side and does not slide.",
)
TOOL_MODEL = (
    "Tool, objects, table, tool rest and obstacles are rigid bodies in PyBullet, evenly filled about their stated "
    "centres of mass; what lies on what rests there by gravity and friction. Arms are chains of links driven by servos "
    "along the timed plan; fingers collide with nothing.",
    "Fingers hold the tool by a compliant joint in all six directions, tied as the tool is found when they close. They "
    "lose it when the least squeeze that two soft fingers need for it is over the one that the plan commands.",
    "The cup holds an object by a compliant joint at the lip, tied as the object is found when the vacuum comes on; "
    "pressing loads it with nothing. It lets go when pull, shear, twist or bending leave its cones.",
    "A hold gives way when it is over its limit for a stated time, or at once above a stated multiple of it. Then the "
    "robot stops, and the simulation goes on for a moment.",
    "What nothing holds must stay where it was let go; at the end all objects must be at their goals.",
)
"""What is modelled, for a person."""
_DIGITS = 6


def simulate_plan(plan: Plan, scene: PlateLiftScene | SuctionToolScene, progress: Progress, seed: int) -> Simulation:
    """Execute a solved plan in physics, as fits its scene; `seed` is for what is random, in lifts only.

    The robot gets the numbers that are sent, which have fewer digits than those that were computed.
    """
    sent = Plan.read(plan.write())
    if isinstance(scene, SuctionToolScene):
        return simulate_tool(sent, scene, progress)
    return simulate_lift(sent, scene, progress, seed)


def simulate_lift(
    plan: Plan,
    scene: PlateLiftScene,
    progress: Progress,
    seed: int,
    settings: SimulationSettings | None = None,
    actual: PlateLiftScene | None = None,
) -> LiftSimulation:
    """Execute a plan in physics, then lift; that something gives way is an answer.

    Args:
        plan: a solved one.
        scene: that it was planned in.
        progress: told of stage "simulate".
        seed: of sensor noise, of the lifter's force error and of its profile.
        settings: what is assumed; None: what follows from the scene's cell and hands.
        actual: how plate, friction and cup really are, which neither plan nor controller know; None: as in `scene`.

    Returns:
        The `simulation` of a plan.
    """
    settings = settings or SimulationSettings.of(scene)
    actual = actual or scene
    with LiftWorld(actual, settings) as world:
        execution = LiftExecution(plan, actual, world, settings, np.random.default_rng(seed), scene)
        failure = execution.run(progress)
    return _lift_result(execution, failure, seed)


def simulate_tool(
    plan: Plan,
    scene: SuctionToolScene,
    progress: Progress,
    settings: ToolSimulationSettings | None = None,
) -> ToolSimulation:
    """Execute a plan in physics; that something gives way is an answer.

    Args:
        plan: a solved one.
        scene: that it was planned in.
        progress: told of stage "simulate".
        settings: what is assumed. Nothing is random.

    Returns:
        The `simulation` of a plan.
    """
    settings = settings or ToolSimulationSettings()
    with ToolWorld(scene, settings) as world:
        execution = ToolExecution(plan, scene, world, settings)
        failure = execution.run(progress)
        return _tool_result(execution, failure)


def _lift_result(execution: LiftExecution, failure: LiftFailure | None, seed: int) -> LiftSimulation:
    scene = execution.scene
    weight = (scene.plate.mass or 0.0) * float(-scene.cell.gravity[2])
    least = weight - scene.cup.max_force
    return LiftSimulation(
        kind="plate_lift",
        outcome="lifted" if failure is None else failure.outcome,
        time=round(execution.time, _DIGITS),
        cause=None if failure is None else failure.cause,
        force_curves=execution.recorder.curves(),
        minimum_total_force=least,
        lift=_lift(execution),
        dips=_dips(execution, least),
        manipulation=_manipulation(execution, weight),
        motion=_motion(execution),
        model=list(LIFT_MODEL),
        seed=seed,
        settings=json.loads(json.dumps(asdict(execution.settings))),
    )


def _lift(execution: LiftExecution) -> SimulatedLift | None:
    """Tell how the lift was prepared and how far it came; None when it was not come to."""
    lift = execution.lift
    if lift is None:
        return None
    height = execution.recorder.column("plate height", lift.begin)
    return SimulatedLift(
        begin=round(lift.begin, _DIGITS),
        height=round(float(height.max(initial=0.0)), _DIGITS),
        reachable_height=round(lift.path.height, _DIGITS),
        end_of_reach=lift.path.end,
        goal_force=lift.forces.push,
        cup_reserve=lift.forces.goal.cup_reserve,
        lifter_travel=round(float(lift.winch.heights[-1]), _DIGITS),
        lifter_seconds=round(lift.winch.duration, _DIGITS),
        controlled=execution.settings.controlled,
        law=FollowerLaw(goal_force=lift.forces.both, **asdict(lift.gains)),
        hand_wrenches={hand.arm.name: lift.forces.wrenches[hand.arm.name] for hand in execution.hands},
    )


def _dips(execution: LiftExecution, least: float) -> ForceDips:
    """Count how often, and say how long, both hands together bore less than the minimum during the lift."""
    if execution.lift is None:
        return ForceDips(count=0, seconds=0.0, lowest=None)
    total = execution.recorder.column("both hands", execution.lift.begin)
    below = total < least
    return ForceDips(
        count=int(np.count_nonzero(below & ~np.concatenate([[False], below[:-1]]))),
        seconds=round(float(below.sum()) * execution.settings.record_period, _DIGITS),
        lowest=round(float(total.min()), _DIGITS) if len(total) else None,
    )


def _manipulation(execution: LiftExecution, weight: float) -> SimulatedManipulation:
    """Compare the manipulation with its plan."""
    comparison, off = execution.comparison, execution.largest_way_off
    return SimulatedManipulation(
        nodes=comparison.nodes,
        largest_difference=round(comparison.largest_difference, _DIGITS),
        largest_difference_of_weight=round(comparison.largest_difference / weight, _DIGITS),
        largest_distance=round(float(off[0]), _DIGITS),
        largest_angle=round(float(off[1]), _DIGITS),
    )


def _motion(execution: LiftExecution) -> SimulatedMotion:
    """Return how robot and plate moved, for playing it back."""
    rows = execution.motion
    return SimulatedMotion(
        time=rounded(np.array([time for time, _, _ in rows]), _DIGITS),
        positions=rounded(np.array([positions for _, positions, _ in rows]).reshape(-1, 12), _DIGITS),
        plate=rounded(to_pose7s(np.array([T for _, _, T in rows]).reshape(-1, 4, 4)), _DIGITS),
    )


def _tool_result(execution: ToolExecution, failure: ToolFailure | None) -> ToolSimulation:
    recorder = execution.recorder
    most = {name: float(recorder.column(name).max(initial=0.0)) for name in TOOL_UNITS}
    return ToolSimulation(
        kind="suction_tool",
        outcome="done" if failure is None else failure.outcome,
        time=round(execution.time, _DIGITS),
        failed_at=None if failure is None else round(failure.time, _DIGITS),
        cause=None if failure is None else failure.cause,
        force_curves=recorder.curves(),
        goals={
            name: GoalError(distance=round(error.distance, _DIGITS), angle=round(error.angle, _DIGITS))
            for name, error in execution.goal_errors().items()
        },
        largest=LargestLoads(
            suction_share=round(most["suction share"], _DIGITS),
            squeeze=round(max(most["left squeeze"], most["right squeeze"]), _DIGITS),
            tool_off_plan=round(most["tool off plan"], _DIGITS),
            object_off_plan=round(most["object off plan"], _DIGITS),
        ),
        motion=execution.motion(),
        model=list(TOOL_MODEL),
        settings=json.loads(json.dumps(asdict(execution.settings))),
    )
