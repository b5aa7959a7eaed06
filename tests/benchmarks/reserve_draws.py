"""How plate, contacts, cup and lifter really are: drawn by seed about what a task says, within tolerances and more."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from planners.contract.task_spec import PlateLiftTask
from workers.simulation.settings import SimulationSettings

MASS = 0.02
"""Of the plate's mass, either way [1]: the default of `plate.mass_tolerance`."""
COM = 0.005
"""Of the centre of mass along either axis of the plate [m]: the default of `plate.com_tolerance`."""
FRICTION = 0.05
"""Of the coefficient of each contact, either way [1]; no task states one."""
CUP = 0.05
"""Of the force that the cup really bears [1], as a vacuum varies; no task states one."""
LIFTER = 0.2
"""Of the speeds at which somebody operates the lifter in one run [1]; within a run they are uneven anyway."""
MULTIPLES = (1, 2, 3)
"""How many times these tolerances runs are drawn from, by turns."""


@dataclass(frozen=True)
class Deviation:
    """How one run differs from its task. Factors are of what the task says."""

    multiple: int
    """Of the tolerances it was drawn from."""
    mass: float
    com_x: float
    """Added, in the plate's frame [m]."""
    com_y: float
    grip: float
    """Friction, here and below."""
    push: float
    environment: float
    pad: float
    cup: float
    """Force that the cup bears."""
    lifter: float
    """Speed."""

    @classmethod
    def drawn(cls, seed: int) -> Self:
        """Draw evenly; a seed deviates in the same way, whatever the task and its plan."""
        multiple = MULTIPLES[seed % len(MULTIPLES)]
        rng = np.random.default_rng(seed)

        def off(tolerance: float) -> float:
            return multiple * tolerance * float(rng.uniform(-1.0, 1.0))

        return cls(
            multiple=multiple,
            mass=1.0 + off(MASS),
            com_x=off(COM),
            com_y=off(COM),
            grip=1.0 + off(FRICTION),
            push=1.0 + off(FRICTION),
            environment=1.0 + off(FRICTION),
            pad=1.0 + off(FRICTION),
            cup=1.0 + off(CUP),
            lifter=1.0 + off(LIFTER),
        )

    def actual(self, task: PlateLiftTask) -> PlateLiftTask:
        """Return the task that says how plate and contacts really are."""
        plate, friction, cup = task.plate, task.friction, task.cup
        # The plates of the five lifts are boxes: left out, the centre of mass is the origin.
        x, y, z = plate.com or (0.0, 0.0, 0.0)
        contacts = {
            "grip": friction.grip * self.grip,
            "push": friction.push * self.push,
            "environment": friction.environment * self.environment,
        }
        changed = {
            "plate": plate.model_copy(
                update={"mass": plate.mass * self.mass, "com": (x + self.com_x, y + self.com_y, z)}
            ),
            "friction": friction.model_copy(update=contacts),
            "cup": cup.model_copy(update={"mu": cup.mu * self.pad}),
        }
        return task.model_copy(update=changed)

    def settings(self) -> SimulationSettings:
        """Return what the simulation assumes: this cup and lifter; what friction there is the actual task says."""
        usual = SimulationSettings()
        winch = usual.winch.times(self.lifter)
        return replace(usual, cup=replace(usual.cup, strength=self.cup), winch=winch)
