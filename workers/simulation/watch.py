"""Looks at cup, hands and plate after every step: the first that gives way ends the run."""

from __future__ import annotations

import numpy as np

from planners.geometry.pose import Array
from workers.simulation.hands import GrippingHand, PushingHand
from workers.simulation.lifter import SuctionLifter
from workers.simulation.outcome import Failure, SimulationOutcome
from workers.simulation.reference import Stage
from workers.simulation.settings import SimulationSettings


class Watch:
    """Remembers for how long something has been too much."""

    def __init__(
        self,
        lifter: SuctionLifter,
        gripping: GrippingHand,
        pushing: PushingHand,
        hand_limit: float,
        settings: SimulationSettings,
    ) -> None:
        """Watch the cup and two hands whose net force may be `hand_limit` [N]."""
        self._lifter, self._gripping, self._pushing = lifter, gripping, pushing
        self._step, self._settings = settings.step, settings.hand
        self._limit = settings.hand.overload * hand_limit
        self._overloaded = 0.0

    def look(self, stage: Stage, time: float, turned: float) -> Failure[SimulationOutcome] | None:
        """Return what gave way in the last step, None if nothing did.

        Args:
            stage: of the plan.
            time: [s].
            turned: the plate's rotation away from how it should hang while it is lifted [rad].
        """
        cause = self._lifter.lets_go(self._step)
        if cause is not None:
            return Failure(SimulationOutcome.CUP_LOST, time, cause)
        cause = self._slip(stage, turned)
        if cause is not None:
            return Failure(SimulationOutcome.SLIPPED, time, cause)
        cause = self._overload({hand.arm.name: hand.force for hand in (self._gripping, self._pushing)})
        if cause is not None:
            return Failure(SimulationOutcome.OVERLOAD, time, cause)
        return None

    def _slip(self, stage: Stage, turned: float) -> str | None:
        for hand, expected in ((self._gripping, stage.grip is not None), (self._pushing, stage.push is not None)):
            cause = hand.lost(expected and stage.kind not in ("grip", "release"), self._step)
            if cause is not None:
                return cause
        if turned > self._settings.largest_turn:
            return f"the plate turned by {np.degrees(turned):.0f} degrees in the hands"
        return None

    def _overload(self, forces: dict[str, Array]) -> str | None:
        s = self._settings
        net = {name: float(np.linalg.norm(force)) for name, force in forces.items()}
        worst = max(net, key=lambda name: net[name])
        self._overloaded = self._overloaded + self._step if net[worst] > self._limit else 0.0
        if self._overloaded > s.overload_time:
            return f"the {worst} hand bore {net[worst]:.1f} N, more than {self._limit:.1f} N, for {s.overload_time:g} s"
        return None
