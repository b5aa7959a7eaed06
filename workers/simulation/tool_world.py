"""The cell with a suction tool and the objects that it moves, in PyBullet."""

from __future__ import annotations

from collections.abc import Iterator

from planners.scene.suction_tool import TOOL_NAME
from planners.scene.tool_scene import SuctionToolScene
from workers.simulation.cell_world import CellWorld
from workers.simulation.free_body import FreeBody
from workers.simulation.tool_settings import ToolSimulationSettings


class ToolWorld(CellWorld):
    """Tool and objects are free rigid bodies that collide with everything but fingers."""

    def __init__(self, scene: SuctionToolScene, settings: ToolSimulationSettings) -> None:
        """Build the scene at its start."""
        super().__init__(
            scene.cell,
            scene.obstacles,
            scene.start_positions,
            step=settings.step,
            servo_gain=settings.servo_gain,
            friction=scene.friction.environment,
        )
        self.tool = FreeBody(scene.tool.body, self, scene.tool.mass)
        self.objects = {
            moved.name: FreeBody(moved.body, self, settings.truth.object_mass * (moved.body.mass or 1.0))
            for moved in scene.objects
        }

    def bodies(self) -> Iterator[tuple[str, FreeBody]]:
        """Yield all free bodies with their names, the tool first."""
        yield TOOL_NAME, self.tool
        yield from self.objects.items()

    def advance(self) -> None:
        """Take one step of the physics."""
        super().advance()
        for _, body in self.bodies():
            body.read()
