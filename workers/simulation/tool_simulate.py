"""From a certified suction-tool plan to the `simulation` of its document."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from planners.plan.simulation import GoalError, LargestLoads, ToolSimulation
from planners.progress import Progress
from planners.scene.tool_scene import SuctionToolScene
from workers.simulation.outcome import Failure, ToolOutcome
from workers.simulation.tool_execution import ToolExecution
from workers.simulation.tool_settings import ToolSimulationSettings
from workers.simulation.tool_world import ToolWorld

MODEL = (
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


def simulate_tool(
    document: Mapping[str, Any],
    scene: SuctionToolScene,
    progress: Progress,
    settings: ToolSimulationSettings | None = None,
) -> ToolSimulation:
    """Execute a plan in physics; that something gives way is an answer.

    Args:
        document: a solved plan.
        scene: that it was planned in.
        progress: told of stage "simulate".
        settings: what is assumed. Nothing is random.

    Returns:
        The `simulation` of a plan.
    """
    settings = settings or ToolSimulationSettings()
    with ToolWorld(scene, settings) as world:
        execution = ToolExecution(document, scene, world, settings)
        failure = execution.run(progress)
        return _result(execution, failure)


def _result(execution: ToolExecution, failure: Failure[ToolOutcome] | None) -> ToolSimulation:
    recorder = execution.recorder
    largest = {
        "suction_share": recorder.largest("suction share"),
        "squeeze": max(recorder.largest(f"{arm} squeeze") for arm in ("left", "right")),
        "tool_off_plan": recorder.largest("tool off plan"),
        "object_off_plan": recorder.largest("object off plan"),
    }
    return ToolSimulation(
        kind="suction_tool",
        outcome=(ToolOutcome.DONE if failure is None else failure.outcome).value,
        time=round(execution.time, _DIGITS),
        failed_at=None if failure is None else round(failure.time, _DIGITS),
        cause=None if failure is None else failure.cause,
        force_curves=recorder.curves(),
        goals={
            name: GoalError(distance=round(error.distance, _DIGITS), angle=round(error.angle, _DIGITS))
            for name, error in execution.goal_errors().items()
        },
        largest=LargestLoads(**{name: round(value, _DIGITS) for name, value in largest.items()}),
        motion=recorder.motion(),
        model=list(MODEL),
        settings=json.loads(json.dumps(asdict(execution.settings))),
    )
