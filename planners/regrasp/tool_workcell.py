"""The cell with a suction tool and objects in it, as collision queries ask for it."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planners.cell.arm import Arm
from planners.cell.cell import Cell
from planners.cell.hand import Gripper
from planners.collision.model import CollisionModel, CollisionQuery, NamePair, PairChoice, PairMask, Placement
from planners.errors import LiftwrightError
from planners.geometry.convex import CollisionBody
from planners.hands.workcell import Clearance, Workcell
from planners.scene.body import Body
from planners.scene.suction_tool import SuctionTool
from planners.scene.tool_scene import SuctionToolScene

TOOL_FRAME = "tool"
"""Name of the frame that the tool is in."""


@dataclass(frozen=True)
class ToolClearance(Clearance):
    """What there is beside, where things touch by intention."""

    touch_depth: float = 0.0005
    """How deep bodies that touch by intention may seem to overlap [m]: rounding, and a soft lip."""
    width_step: float = 0.001
    """Openings of a hand that differ by less share a collision model [m]: fingers are off by a quarter of it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.touch_depth < 0.0 or self.width_step <= 0.0:
            raise LiftwrightError("the depth of a touch is not negative, and the step between openings is positive")


@dataclass(frozen=True, eq=False)
class ToolWorkcell(Workcell):
    """Two grippers, the tool, the objects and what stands about. One collision model for each pair of openings.

    Movable frames: "tool", and each object's own name. Models are built when first asked for.
    """

    cell: Cell
    tool: SuctionTool
    objects: tuple[Body, ...] = ()
    obstacles: tuple[Body, ...] = ()
    settings: ToolClearance = field(default_factory=ToolClearance)
    _models: dict[tuple[float, ...], CollisionModel] = field(default_factory=dict, init=False, repr=False)
    _masks: dict[Hashable, PairMask] = field(default_factory=dict, init=False, repr=False)

    @staticmethod
    def of(scene: SuctionToolScene, settings: ToolClearance | None = None) -> ToolWorkcell:
        """Return the workcell of a scene."""
        bodies = tuple(moved.body for moved in scene.objects)
        return ToolWorkcell(scene.cell, scene.tool, bodies, scene.obstacles, settings or ToolClearance.of(scene.cell))

    @property
    def arms(self) -> Mapping[str, Arm]:
        """Both arms by name."""
        return self.cell.arms

    def gripper(self, arm: str) -> Gripper:
        """Return the hand of an arm."""
        hand = self.arm(arm).hand
        assert isinstance(hand, Gripper)
        return hand

    def model(self, widths: Mapping[str, float]) -> CollisionModel:
        """Return the collision model at these openings by arm [m], to `ToolClearance.width_step`."""
        step = self.settings.width_step
        drawn = {arm: min(round(widths[arm] / step) * step, self.gripper(arm).width_max) for arm in self.cell.arms}
        key = tuple(drawn.values())
        if key not in self._models:
            self._models[key] = self._build(drawn)
        return self._models[key]

    def pairs(self, key: Hashable, choice: PairChoice) -> PairMask:
        """Return which pairs a choice takes; asked once for each key, which says all of the choice.

        Asking every pair takes longer than everything else about a query. Models differ in where fingers are, and have
        the same bodies in the same order. Choices look at frames and groups of bodies, and at whether they are hands:
        of all pairs that are alike in these, one is asked.
        """
        if key not in self._masks:
            asked, kinds = self._kinds_of_pairs
            self._masks[key] = np.array([choice(a, b) for a, b in asked], dtype=bool)[kinds]
        return self._masks[key]

    @cached_property
    def _kinds_of_pairs(self) -> tuple[list[tuple[CollisionBody, CollisionBody]], NDArray[np.intp]]:
        """One pair of bodies of each kind, and the kind of every pair of the model."""
        model = self.model({arm: self.gripper(arm).width_max for arm in self.cell.arms})
        bodies = {body.name: body for body in model.bodies}
        alike = {
            name: (body.frame, body.group, any(self.is_hand(body, arm) for arm in self.cell.arms))
            for name, body in bodies.items()
        }
        kinds: dict[Hashable, int] = {}
        asked: list[tuple[CollisionBody, CollisionBody]] = []
        numbers = []
        for a, b in model.pair_names:
            number = kinds.setdefault((alike[a], alike[b]), len(asked))
            if number == len(asked):
                asked.append((bodies[a], bodies[b]))
            numbers.append(number)
        return asked, np.array(numbers, dtype=np.intp)

    def query(  # noqa: PLR0913 - openings, places, and what may be how close
        self,
        widths: Mapping[str, float],
        placements: Mapping[str, Placement | None],
        *,
        holding: Iterable[str] = (),
        around: Iterable[str] = (),
        touching: Iterable[NamePair] = (),
        margins: Mapping[NamePair, float] | None = None,
        share: float = 1.0,
        only: PairChoice | PairMask | None = None,
    ) -> CollisionQuery:
        """Place tool and objects and choose what is kept apart.

        Args:
            widths: opening of each arm's hand [m].
            placements: of the frame "tool" and of each object's, by name: Fixed, Attached to an arm or Riding on the
                tool; None where it is not there.
            holding: arms whose hands hold the tool: their pads touch it, and the fingers come close.
            around: arms whose open fingers are about to hold it, or have just let go of it.
            touching: pairs of names that touch by intention: cup and object, an object and what it rests on.
            margins: other margins for some pairs [m]; they win.
            share: the part of all margins that is kept.
            only: checks these pairs alone.
        """
        settings, holding = self.settings, frozenset(holding)
        near, hands = dict(self._within_arms), {*holding, *around}
        near |= {(name, TOOL_FRAME): settings.near for arm in hands for name in self._hands[arm]}
        near |= {(name, TOOL_FRAME): settings.finger_margin for arm in hands for name in self.fingers(arm)}
        meant = {pair: -settings.touch_depth for pair in touching}
        given = dict(margins or {})
        kept = {pair: share * margin if margin > 0.0 else margin for pair, margin in (near | meant | given).items()}
        return self.model(widths).scene(
            placements,
            allowed=[(pad, TOOL_FRAME) for arm in sorted(holding) for pad in self.pads(arm)],
            margin=share * settings.margin,
            margins=kept,
            only=only,
        )

    def pads(self, arm: str) -> tuple[str, str]:
        """Return the names of the pads of an arm's hand, finger 0 first."""
        return (f"{arm}_pad_0", f"{arm}_pad_1")

    def fingers(self, arm: str) -> tuple[str, ...]:
        """Return the names of the parts of the fingers of an arm's hand but the pads."""
        parts = sorted(self.gripper(arm).finger_parts)
        return tuple(f"{arm}_finger_{finger}_{part}" for finger in (0, 1) for part in parts)

    @cached_property
    def _within_arms(self) -> dict[NamePair, float]:
        """Margins of parts of one arm [m]."""
        return self.settings.within_arms(self.cell.collision_bodies())

    @cached_property
    def _hands(self) -> dict[str, tuple[str, ...]]:
        """By arm, the names of all bodies of its hand."""
        bodies = self.cell.collision_bodies()
        return {arm: tuple(body.name for body in bodies if self.is_hand(body, arm)) for arm in self.cell.arms}

    def _build(self, widths: Mapping[str, float]) -> CollisionModel:
        cell = self.cell
        bodies = [
            *cell.collision_bodies(widths),
            self.tool.body.collision_body(),
            *(body.collision_body() for body in self.objects),
            *(body.collision_body_in_world() for body in self.obstacles),
        ]
        if self._models:
            # Only fingers have moved.
            return next(iter(self._models.values())).with_bodies(bodies)
        arms = {name: (arm.dh, arm.T_world_base) for name, arm in cell.arms.items()}
        return CollisionModel.build(arms, bodies, cell.excluded_pairs)
