"""From a certified plan to the `simulation` of its document."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from planners.contract.arrays import rounded
from planners.geometry.pose import to_pose7s
from planners.plan.simulation import (
    ForceDips,
    LiftSimulation,
    SimulatedLift,
    SimulatedManipulation,
    SimulatedMotion,
)
from planners.progress import Progress
from planners.scene.lift_scene import PlateLiftScene
from workers.simulation.execution import Execution
from workers.simulation.outcome import Failure, SimulationOutcome
from workers.simulation.settings import SimulationSettings
from workers.simulation.world import World

MODEL = (
    "Plate, table, support and obstacles are rigid bodies in PyBullet; arms are chains of links driven by servos.",
    "True friction is a stated factor above the planned coefficients, at all contacts; a plan of least effort lies on "
    "the border of its friction cones.",
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
"""What is modelled, for a person."""
_MOTION_EVERY = 2
"""Of the recorded instants, how many apart the motion is kept."""
_DIGITS = 6


def simulate(
    document: Mapping[str, Any],
    scene: PlateLiftScene,
    progress: Progress,
    seed: int,
    settings: SimulationSettings | None = None,
    actual: PlateLiftScene | None = None,
) -> LiftSimulation:
    """Execute a plan in physics, then lift; that something gives way is an answer.

    Args:
        document: a solved plan.
        scene: that it was planned in.
        progress: told of stage "simulate".
        seed: of sensor noise, of the lifter's force error and of its profile.
        settings: what is assumed.
        actual: how plate, friction and cup really are, which neither plan nor controller know; None: as in `scene`.

    Returns:
        The `simulation` of a plan.
    """
    settings = settings or SimulationSettings()
    actual = actual or scene
    with World(actual, settings) as world:
        execution = Execution(document, actual, world, settings, np.random.default_rng(seed), scene)
        failure = execution.run(progress)
    return _result(execution, failure, seed)


def _result(execution: Execution, failure: Failure[SimulationOutcome] | None, seed: int) -> LiftSimulation:
    scene = execution.scene
    weight = (scene.plate.mass or 0.0) * float(-scene.cell.gravity[2])
    least = weight - scene.cup.max_force
    return LiftSimulation(
        kind="plate_lift",
        outcome=(SimulationOutcome.LIFTED if failure is None else failure.outcome).value,
        time=round(execution.time, _DIGITS),
        cause=None if failure is None else failure.cause,
        force_curves=execution.recorder.curves(),
        minimum_total_force=least,
        lift=_lift(execution),
        dips=_dips(execution, least),
        manipulation=_manipulation(execution, weight),
        motion=_motion(execution),
        model=list(MODEL),
        seed=seed,
        settings=json.loads(json.dumps(asdict(execution.settings))),
    )


def _lift(execution: Execution) -> SimulatedLift | None:
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
    )


def _dips(execution: Execution, least: float) -> ForceDips:
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


def _manipulation(execution: Execution, weight: float) -> SimulatedManipulation:
    """Compare the manipulation with its plan."""
    differences = [node.largest_difference() for node in execution.comparison.nodes]
    off = execution.largest_way_off
    return SimulatedManipulation(
        nodes=[node.stated() for node in execution.comparison.nodes],
        largest_difference=round(max(differences, default=0.0), _DIGITS),
        largest_difference_of_weight=round(max(differences, default=0.0) / weight, _DIGITS),
        largest_distance=round(float(off[0]), _DIGITS),
        largest_angle=round(float(off[1]), _DIGITS),
    )


def _motion(execution: Execution) -> SimulatedMotion:
    """Return how robot and plate moved, for playing it back."""
    rows = execution.motion[::_MOTION_EVERY]
    return SimulatedMotion(
        time=rounded(np.array([time for time, _, _ in rows]), _DIGITS),
        positions=rounded(np.array([positions for _, positions, _ in rows]).reshape(-1, 12), _DIGITS),
        plate=rounded(to_pose7s(np.array([T for _, _, T in rows]).reshape(-1, 4, 4)), _DIGITS),
    )
