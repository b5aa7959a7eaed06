"""What holds the tool, and the object on it, in the simulation: fingers and a cup that can fail."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planners.geometry.pose import Array, Transform, inverse, rotation_angle
from planners.regrasp.statics.finger_forces import least_squeeze
from planners.regrasp.statics.hold_statics import EPS
from planners.regrasp.suction.suction_hold import SuctionLimit, suction_margins
from planners.scene.suction_tool import CupData
from planners.scene.tool_scene import SuctionToolScene
from workers.simulation.bond import Bond
from workers.simulation.endurance import Endurance
from workers.simulation.free_body import FreeBody
from workers.simulation.tool_reference import PlannedGrip, PlannedSuction
from workers.simulation.tool_settings import TakingSettings, ToolSimulationSettings


class FingerHold:
    """Two fingers of one hand on the tool."""

    def __init__(
        self,
        planned: PlannedGrip,
        tool: FreeBody,
        T_world_tcp: Transform,
        T_flange_tcp: Transform,
        scene: SuctionToolScene,
        settings: ToolSimulationSettings,
    ) -> None:
        """Close them on the tool as it is."""
        self.arm, self._width = planned.arm, planned.width
        self.T_flange_tcp = T_flange_tcp
        self.bond = Bond(tool, None, T_world_tcp, settings.fingers)
        self.limit = settings.truth.grip_strength * planned.squeeze
        """With which the fingers squeeze, as the plan commands it [N]."""
        self._mu = settings.truth.grip_friction * scene.friction.grip
        self._endurance = Endurance(settings.endurance)

    @property
    def squeeze(self) -> float:
        """The least squeeze with which the fingers do what they do now [N]."""
        return float(least_squeeze(self.bond.wrench_in_parent()[None], self._width, self._mu, EPS)[0])

    def lets_go(self, squeeze: float, period: float) -> str | None:
        """Say why the fingers lose the tool after a period [s] of needing a squeeze [N]; None while they do not."""
        if not self._endurance.lets_go(squeeze / self.limit, period):
            return None
        return (
            f"the tool slipped in the {self.arm} hand: {squeeze:.0f} N of squeeze were needed, the fingers "
            f"squeeze with {self.limit:.0f} N"
        )


@dataclass(frozen=True)
class CupLoad:
    """What a cup is asked for."""

    pull: float
    """Outward along its axis [N]."""
    share: float
    """Of what it bears, by the limit that is nearest [1]."""
    limit: SuctionLimit


class CupHold:
    """The cup on an object."""

    def __init__(
        self, planned: PlannedSuction, tool: FreeBody, item: FreeBody, cup: CupData, settings: ToolSimulationSettings
    ) -> None:
        """Hold the object as it is; its lip gives way within its cones, and bears any pressure."""
        self.name = planned.name
        self.bond = Bond(item, tool, tool.T_world_body, settings.cup)
        strength = settings.truth.cup_strength
        self._cup = replace(cup, max_force=strength * cup.max_force, kappa=strength * cup.kappa)
        self._endurance = Endurance(settings.endurance)

    @property
    def load(self) -> CupLoad:
        """What the cup bears now."""
        wrench = self.bond.wrench_in_parent()
        pull = float(wrench[2])
        wrench[2] = max(0.0, pull)
        margins = suction_margins(wrench, self._cup)
        weakest = int(np.argmin(margins))
        return CupLoad(pull, 1.0 - float(margins[weakest]), tuple(SuctionLimit)[weakest])

    def lets_go(self, load: CupLoad, period: float) -> str | None:
        """Say why the cup loses the object after a period [s] under a load; None while it does not."""
        if not self._endurance.lets_go(load.share, period):
            return None
        return f"{self.name} came off the cup at {load.share:.2f} times what it bears. {load.limit.value}"


def misses_tool(planned: PlannedGrip, T_world_tcp: Transform, tool: FreeBody, taking: TakingSettings) -> str | None:
    """Say how fingers that close now miss the tool; None: they get it."""
    distance, angle = _off(tool.T_world_body @ planned.T_tool_tcp, T_world_tcp)
    if distance <= taking.finger_distance and angle <= taking.finger_angle:
        return None
    return f"the fingers of the {planned.arm} hand closed {1e3 * distance:.0f} mm beside the tool"


def leaves_behind(planned: PlannedSuction, tool: FreeBody, item: FreeBody, taking: TakingSettings) -> str | None:
    """Say why a vacuum that comes on now does not hold the object; None: it seals."""
    T_found = inverse(tool.T_world_body) @ item.T_world_body @ inverse(planned.T_tool_object)
    offset, gap = float(np.hypot(*T_found[:2, 3])), abs(float(T_found[2, 3]))
    angle = float(np.arccos(np.clip(T_found[2, 2], -1.0, 1.0)))
    if gap <= taking.cup_gap and offset <= taking.cup_offset and angle <= taking.cup_angle:
        return None
    return (
        f"the cup did not seal on {planned.name}: it was {1e3 * gap:.0f} mm away, {1e3 * offset:.0f} mm beside its "
        f"place and {np.degrees(angle):.0f} degrees askew"
    )


def _off(T_world_a: Transform, T_world_b: Transform) -> tuple[float, float]:
    """Return distance [m] and angle [rad] between two frames."""
    apart: Array = T_world_a[:3, 3] - T_world_b[:3, 3]
    return float(np.linalg.norm(apart)), rotation_angle(T_world_a[:3, :3], T_world_b[:3, :3])
