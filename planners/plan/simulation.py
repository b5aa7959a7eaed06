"""What physics made of a plan: the member `simulation`, of either kind of task."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BeforeValidator, Field, JsonValue

from planners.contract.arrays import ArmName, Positive, Real, Rows, SampledWrench, Samples, Vector
from planners.contract.strict_model import StrictModel
from planners.geometry.pose import Array

Positions = Annotated[Array, Rows(12)]
SimulatedPoses = Annotated[Array, Rows(7)]
"""(n, 7) [x, y, z, w, x, y, z], written with so few digits that the quaternion is unit to 1e-5 only."""
LiftEnding = Literal["lifted", "slipped", "cup_lost", "overload"]
ToolEnding = Literal["done", "object_dropped", "tool_slipped", "toppled", "off_goal"]


class ForceCurve(StrictModel):
    """One quantity of the simulated lift over time."""

    name: str
    unit: str
    time: Samples
    value: Samples


class NodeComparison(StrictModel):
    """Forces on the plate at the end of one of the plan's motions, shortly before the lifter prepares the next."""

    segment: int
    time: Real
    planned: dict[str, Vector]
    """By "left", "right", "cup", "support"."""
    simulated: dict[str, Vector]
    largest_difference: Real
    """Largest norm of a difference [N]."""


class SimulatedManipulation(StrictModel):
    """How well the simulated manipulation kept to its plan."""

    nodes: list[NodeComparison]
    largest_difference: Real
    """[N]"""
    largest_difference_of_weight: Real
    """The same over the plate's weight [1]."""
    largest_distance: Real
    """Of the pad from its planned place [m]."""
    largest_angle: Real
    """Of the plate from its planned orientation [rad]."""


class FollowerLaw(StrictModel):
    """Law (11) of paper B as the hands followed it; see `planners.lifting.leader_follower.FollowerGains`."""

    goal_force: Real
    """F_goal: vertical force of both hands together [N]."""
    inertia: Positive
    damping: Positive
    carried: Real
    memory: Positive
    readings: Annotated[int, Field(strict=True, ge=1)]
    period: Positive


class SimulatedLift(StrictModel):
    """The cooperative lift, as prepared and as it went."""

    begin: Real
    """On the time axis of the curves, which begins with the plan's [s]."""
    height: Real
    """How far up the plate came, over the plan's last pose [m]."""
    reachable_height: Real
    """How far up both arms can go with the plate [m]."""
    end_of_reach: str
    """What ends the way up."""
    goal_force: Real
    """F_goal of paper B, eq. (11): vertical force of the pushing hand [N]."""
    cup_reserve: Real
    """Part of the cup's largest force that F_goal keeps back [1]."""
    lifter_travel: Real
    lifter_seconds: Real
    controlled: bool
    """Whether the hands followed by force."""
    law: FollowerLaw | None = None
    """By which they did; documents before this one do not say it."""
    hand_wrenches: dict[ArmName, SampledWrench] | None = None
    """What each hand exerts on the plate as the lift begins, of which `goal_force` is part: force and torque about the
    middle of its contacts, world axes [N, Nm]. The first documents do not say it."""


class ForceDips(StrictModel):
    """How often both hands together bore less than the minimum during the lift."""

    count: int
    seconds: Real
    lowest: Real | None
    """Smallest sum of both hands' vertical forces [N]."""


class SimulatedMotion(StrictModel):
    """How robot and plate moved from start to end, for playing it back."""

    time: Samples
    positions: Positions
    plate: SimulatedPoses
    """Poses [x, y, z, w, x, y, z]."""


class LiftSimulation(StrictModel):
    """A plate lift executed in physics, and the cooperative lift that follows it."""

    kind: Literal["plate_lift"]
    outcome: LiftEnding
    time: Real
    """When it ended [s]."""
    cause: str | None
    """What gave way."""
    force_curves: list[ForceCurve]
    """Forces of hands are vertical, upward on the plate."""
    minimum_total_force: Real | None
    """Weight less the cup's largest force: what both hands together must bear [N]."""
    lift: SimulatedLift | None
    dips: ForceDips
    manipulation: SimulatedManipulation
    motion: SimulatedMotion
    model: list[str]
    """What is modelled, in sentences."""
    seed: int
    settings: dict[str, JsonValue]
    """All assumptions, SI units."""


class BodyTrack(StrictModel):
    """How one body moved; it stands between two poses that are equal."""

    time: Samples
    poses: SimulatedPoses
    """[x, y, z, w, x, y, z]"""


class SimulatedToolMotion(StrictModel):
    """How robot, tool and objects moved from start to end, for playing it back."""

    time: Samples
    positions: Positions
    bodies: dict[str, BodyTrack]


class GoalError(StrictModel):
    """How far an object ended from its goal, up to its symmetry."""

    distance: Real
    """[m]"""
    angle: Real
    """[rad]"""


class LargestLoads(StrictModel):
    """Greatest values of the curves."""

    suction_share: Real
    """Of what the cup bears [1]."""
    squeeze: Real
    """[N]"""
    tool_off_plan: Real
    object_off_plan: Real
    """[m]"""


class ToolSimulation(StrictModel):
    """A suction-tool plan executed in physics."""

    kind: Literal["suction_tool"]
    outcome: ToolEnding
    time: Real
    """When it ended, some moments after a failure [s]."""
    failed_at: Real | None
    """[s]"""
    cause: str | None
    """What gave way."""
    force_curves: list[ForceCurve]
    goals: dict[str, GoalError]
    largest: LargestLoads
    motion: SimulatedToolMotion
    model: list[str]
    """What is modelled, in sentences."""
    settings: dict[str, JsonValue]
    """All assumptions, SI units."""


def _with_its_kind(simulation: Any) -> Any:
    """Return a simulation of one of the first documents, which name no kind: they had lifts only, with its kind."""
    if isinstance(simulation, dict) and "kind" not in simulation:
        return {"kind": "plate_lift", **simulation}
    return simulation


class PhysicsFailure(NamedTuple):
    """In which way a plan failed in physics."""

    outcome: str
    """As in the document."""
    time: float
    """When [s]."""
    cause: str
    """What gave way, without a full stop."""
    in_lift: bool = False
    """Whether that was in the lift that follows the plan."""

    def words(self) -> str:
        """Say it in a line."""
        when = ", in the lift behind the plan" if self.in_lift else ""
        return f"{self.outcome} at {self.time:.2f} s of motion{when}: {self.cause}"


Physics = Literal["passed", "failed"]
"""Whether a plan was carried out in physics to its end."""


def physics_of(simulation: LiftSimulation | ToolSimulation | None) -> Physics | None:
    """Return how a plan fared in physics; None: it was not tried."""
    if simulation is None:
        return None
    return "passed" if failure_of(simulation) is None else "failed"


def failure_of(simulation: LiftSimulation | ToolSimulation | None) -> PhysicsFailure | None:
    """Return how a plan failed in physics; None where it did not, or was not tried."""
    if simulation is None or simulation.outcome in ("lifted", "done"):
        return None
    cause = (simulation.cause or "it is not told what gave way").rstrip(".")
    if isinstance(simulation, ToolSimulation):
        failed_at = simulation.time if simulation.failed_at is None else simulation.failed_at
        return PhysicsFailure(simulation.outcome, failed_at, cause)
    in_lift = simulation.lift is not None and simulation.time > simulation.lift.begin
    return PhysicsFailure(simulation.outcome, simulation.time, cause, in_lift)


Simulation = Annotated[LiftSimulation | ToolSimulation, Field(discriminator="kind"), BeforeValidator(_with_its_kind)]
