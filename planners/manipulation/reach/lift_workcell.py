"""The cell with a plate in it, as collision queries ask for it: who may touch whom in which step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from planners.cell.arm import Arm
from planners.cell.hand import Gripper, Pusher
from planners.collision.model import (
    Attached,
    CollisionModel,
    CollisionQuery,
    Fixed,
    PairChoice,
    PairMask,
    Placement,
    Upright,
)
from planners.geometry.convex import CollisionBody
from planners.geometry.pose import Transform, transform
from planners.hands.workcell import Clearance, Workcell
from planners.manipulation.reach.hand_reach import PlateQuery
from planners.scene.clashes import arm_frames, gaps_below, placed_body
from planners.scene.lift_scene import PlateLiftScene

PLATE_FRAME = "plate"
_SCENERY = frozenset({"plate", "cup", "cable"})
_LIFTER = frozenset({"cup", "cable"})
_LIFTED = frozenset({"plate", "cup"})
"""What must keep clear of everything that stands in the cell; the cable gives way to all but arms."""


@dataclass(frozen=True)
class LiftClearance(Clearance):
    """What there is beside, where the task puts bodies close together."""

    rounding: float = 1e-6
    """What stands closer than its margin at the start must not come closer than then, by more than this [m]."""


@dataclass(frozen=True, eq=False)
class LiftWorkcell(Workcell):
    """One gripper, one pusher, the plate with cup and cable, and the rest of the scene.

    Two collision models differ in the gripper's opening: `holding` the plate, and `open` around it.
    """

    scene: PlateLiftScene
    gripper: str
    """Name of the arm that grips."""
    pusher: str
    """Name of the arm that pushes."""
    settings: LiftClearance = field(init=False)
    holding: CollisionModel = field(init=False)
    open: CollisionModel = field(init=False)
    start_margins: dict[tuple[str, str], float] = field(init=False)
    """Of bodies that the task puts closer together than the margin [m]."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "settings", LiftClearance.of(self.scene.cell))
        object.__setattr__(self, "holding", self._model(self.grip_width))
        object.__setattr__(self, "open", self._model(self.open_width))
        object.__setattr__(self, "start_margins", self._margins_at_start())

    @cached_property
    def unlifted(self) -> CollisionModel:
        """The gripper holding the plate, with no lifter there."""
        return self._model(self.grip_width, lifter=False)

    @property
    def cable_frame(self) -> str:
        """Name of the frame that the cable hangs in."""
        return self.scene.cup.cable_collision_body().frame

    @property
    def gripping_hand(self) -> Gripper:
        """The gripper."""
        hand = self.arm(self.gripper).hand
        assert isinstance(hand, Gripper)
        return hand

    @property
    def pushing_hand(self) -> Pusher:
        """The stick."""
        hand = self.arm(self.pusher).hand
        assert isinstance(hand, Pusher)
        return hand

    @property
    def grip_width(self) -> float:
        """Opening of the gripper while it holds the plate, at most fully open [m]."""
        return min(self.scene.plate.height, self.gripping_hand.width_max)

    @property
    def open_width(self) -> float:
        """Opening of the gripper while it holds nothing [m]."""
        return self.scene.start_widths[self.gripper]

    @property
    def arms(self) -> Mapping[str, Arm]:
        """Both arms by name."""
        return self.scene.cell.arms

    def plate_query(self, model: CollisionModel, only: PairChoice | PairMask, *, hands: Iterable[str]) -> PlateQuery:
        """Query `model` with the plate movable; the hands of the arms in `hands` hold or touch it."""
        query = self.query(model, only, Fixed(self.scene.T_world_plate), hands=hands)
        return PlateQuery(query, query.frame_index(PLATE_FRAME))

    def query(
        self,
        model: CollisionModel,
        only: PairChoice | PairMask,
        plate: Placement,
        *,
        hands: Iterable[str],
        share: float = 1.0,
    ) -> CollisionQuery:
        """Query `model` with the plate placed; the hands of the arms in `hands` hold or touch it.

        Of all margins a share is kept.
        """
        hands = frozenset(hands)
        touching, fingers = self._contacts(hands)
        near = {(name, "plate"): self.settings.near for arm in hands for name in self._hands[arm]}
        close = {(finger, "plate"): self.settings.finger_margin for finger in fingers}
        margins = self._within_arms | near | self.start_margins | close
        places = {PLATE_FRAME: plate, self.cable_frame: Upright(PLATE_FRAME, self.scene.cup.cable_anchor)}
        return model.scene(
            {frame: places[frame] for frame in model.movable_frames},
            allowed=touching,
            margin=share * self.settings.margin,
            margins={names: share * margin for names, margin in margins.items() if model.names.issuperset(names)},
            only=only,
        )

    def moving_arm_query(
        self, arm: str, T_world_plate: Transform, hands: Iterable[str], share: float = 1.0
    ) -> CollisionQuery:
        """Query the motion of one arm; plate, at (4, 4), and other arm stand still; an idle gripper is open."""
        hands = frozenset(hands)
        model = self.holding if self.gripper in hands and arm != self.gripper else self.open
        return self.query(model, self.with_arm(arm), Fixed(T_world_plate), hands=hands, share=share)

    def transfer_query(self, plate: Attached, hands: Iterable[str]) -> CollisionQuery:
        """Query timed motion of the plate, and the arms that hold it, among all else; `plate` rides on one of them."""
        hands = frozenset(hands)
        model = self.holding if self.gripper in hands else self.open

        choices = [self.lifted, *(self.with_idle(arm) for arm in hands)]

        def chosen(a: CollisionBody, b: CollisionBody) -> bool:
            return any(choice(a, b) for choice in choices)

        return self.query(model, chosen, plate, hands=hands, share=self.settings.executed_share)

    def without_other(self, arm: str) -> PairChoice:
        """Choose all pairs of an arm but those with the other arm."""
        other = self.other(arm)
        return lambda a, b: arm in (a.group, b.group) and other not in (a.group, b.group)

    def hand_without_other(self, arm: str) -> PairChoice:
        """Choose the pairs of an arm's hand with anything but the arms."""
        flange = f"{arm}/6"
        arms = (self.gripper, self.pusher)
        return lambda a, b: (a.frame == flange and b.group not in arms) or (b.frame == flange and a.group not in arms)

    def with_lifter(self, chosen: PairChoice) -> PairChoice:
        """Choose of chosen pairs those with the lifter's cup or cable."""
        return lambda a, b: (a.name in _LIFTER or b.name in _LIFTER) and chosen(a, b)

    def with_idle(self, arm: str) -> PairChoice:
        """Choose the pairs of an arm with everything, and those of the idle other arm with the plate, which moves."""
        other = self.other(arm)

        def chosen(a: CollisionBody, b: CollisionBody) -> bool:
            groups = {a.group, b.group}
            return arm in groups or (other in groups and bool(groups & _SCENERY))

        return chosen

    def lifted(self, a: CollisionBody, b: CollisionBody) -> bool:
        """Choose the pairs of plate and cup with what stands in the cell.

        Left out are what the plate rests on and the table: the plate never gets below the height of its support.
        """
        if a.name not in _LIFTED:
            a, b = b, a
        standing = b.frame == "world" and b.name not in ("table", self.scene.support_name)
        return a.name in _LIFTED and standing

    def _contacts(self, hands: Iterable[str]) -> tuple[list[tuple[str, str]], list[str]]:
        """Pairs that touch because these hands hold or push the plate, and the finger parts close to it."""
        touching: list[tuple[str, str]] = []
        fingers: list[str] = []
        for arm in hands:
            if arm == self.pusher:
                touching.append((f"{arm}_tip", "plate"))
                continue
            pads = {f"{arm}_pad_0", f"{arm}_pad_1"}
            touching += [(pad, "plate") for pad in sorted(pads)]
            hand = self.gripping_hand.bodies(arm, self.grip_width)
            fingers += [body.name for body in hand if "finger" in body.name and body.name not in pads]
        return touching, fingers

    def _margins_at_start(self) -> dict[tuple[str, str], float]:
        """Measure the gaps below the margin of everything that could meet, at the start."""
        scene, settings = self.scene, self.settings
        frames = arm_frames(scene.cell, scene.start_positions) | {"world": np.eye(4), PLATE_FRAME: scene.T_world_plate}
        anchor = scene.T_world_plate[:3, :3] @ scene.cup.cable_anchor + scene.T_world_plate[:3, 3]
        frames[self.cable_frame] = transform(position=anchor)
        placed_bodies = [placed_body(body, frames[body.frame], None) for body in self.open.bodies]
        gaps = gaps_below(placed_bodies, settings.margin, self.open.pair_index)
        kept = {names: gap for names, gap in gaps.items() if gap < self._within_arms.get(names, settings.margin)}
        return {names: max(0.0, gap - settings.rounding) for names, gap in kept.items()}

    @cached_property
    def _within_arms(self) -> dict[tuple[str, str], float]:
        """Margins of parts of one arm [m]."""
        return self.settings.within_arms(self.open.bodies)

    @cached_property
    def _hands(self) -> dict[str, tuple[str, ...]]:
        """By arm, the names of all bodies of its hand."""
        return {arm: tuple(body.name for body in self.open.bodies if self.is_hand(body, arm)) for arm in self.arms}

    def _model(self, width: float, *, lifter: bool = True) -> CollisionModel:
        scene = self.scene
        brought = [body for body in self._scene_bodies() if lifter or body.name not in _LIFTER]
        bodies = [*scene.cell.collision_bodies({self.gripper: width}), *brought]
        arms = {name: (arm.dh, arm.T_world_base) for name, arm in scene.cell.arms.items()}
        return CollisionModel.build(arms, bodies, scene.cell.excluded_pairs)

    def _scene_bodies(self) -> list[CollisionBody]:
        """Plate, cup, cable, support and obstacles. The cup is rigid on the plate; the cable stays upright above it."""
        scene = self.scene
        cup = tuple(part.placed(scene.cup.T_plate_cup_body) for part in scene.cup.body.solid.convex_parts)
        resting = [body.collision_body_in_world() for body in (scene.support, *scene.obstacles) if body is not None]
        return [
            scene.plate.collision_body(),
            CollisionBody("cup", "cup", PLATE_FRAME, cup),
            scene.cup.cable_collision_body(),
            *resting,
        ]
