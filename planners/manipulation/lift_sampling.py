"""What a plate lift is planned among: poses of the plate in its scene, and holds on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from planners.balance.contacts import GripContacts, PushContact
from planners.balance.solver import Balance
from planners.geometry.polyhedron import ConvexPrism
from planners.geometry.pose import Array
from planners.manipulation.contacts.dense_contact_states import DenseContactStateGraph
from planners.manipulation.graph.manipulation_graph import HandHold
from planners.manipulation.holds.grips import CupFootprint, Jaw, PlateGrip, generate_grips, given_grips
from planners.manipulation.holds.pushes import (
    PlatePush,
    generate_pushes,
    given_pushes,
    largest_tip,
    least_thickness,
    lowest_contact,
)
from planners.manipulation.lift_settings import LiftSettings
from planners.manipulation.reach.hand_reach import ALL_POSTURES
from planners.manipulation.reach.lift_workcell import LiftWorkcell
from planners.manipulation.statics.hold_balance import BalancePrograms, HoldBalance, MotionSampling
from planners.manipulation.statics.lift_programs import balance_program, keeping_back, tolerant_program
from planners.scene.lift_scene import PlateLiftScene


@dataclass(frozen=True, eq=False)
class LiftSampling:
    """Poses of the plate in one scene, and grips and pushes on it, as densely as the settings say."""

    workcell: LiftWorkcell
    settings: LiftSettings
    prism: ConvexPrism
    poses: DenseContactStateGraph
    grips: tuple[PlateGrip, ...]
    pushes: tuple[PlatePush, ...]
    stated: Balance
    """Program (5) for the plate as stated, with nothing kept back."""

    @classmethod
    def of(cls, scene: PlateLiftScene, settings: LiftSettings) -> LiftSampling:
        """Sample poses and holds; a task's own grips and pushes come before generated ones."""
        workcell = LiftWorkcell(scene, scene.cell.gripper_arms[0], scene.cell.pusher_arms[0])
        prism = ConvexPrism.from_outline(scene.plate.outline, scene.plate.height)
        poses = DenseContactStateGraph.build(prism, scene.plate.com, scene.T_world_plate, settings.sampling)
        if scene.given_grips is None:
            cup = cup_footprint(scene)
            grips = generate_grips(prism, jaw_of(workcell), gripping_reach(workcell), cup=cup, sampling=settings.grips)
        else:
            grips = given_grips(scene.given_grips, prism)
        radius = workcell.pushing_hand.tip_radius
        if scene.given_pushes is None:
            lowest = lowest_contact(radius, workcell.settings.margin, scene.surface_beyond)
            reach = workcell.arm(workcell.pusher).robot.reach
            pushes = generate_pushes(prism, radius, reach, settings.pushes, lowest=lowest)
        else:
            pushes = given_pushes(scene.given_pushes, radius, settings.pushes.rolls)
        return cls(workcell, settings, prism, poses, grips, pushes, balance_program(scene))

    def with_limits(self, scene: PlateLiftScene) -> LiftSampling:
        """Return the same poses and holds for a scene in which nothing but forces is another."""
        return replace(self, workcell=replace(self.workcell, scene=scene), stated=balance_program(scene))

    @property
    def scene(self) -> PlateLiftScene:
        """The scene."""
        return self.workcell.scene

    @cached_property
    def T_world_plates(self) -> Array:
        """(poses, 4, 4)."""
        return np.array([pose.T_world_plate for pose in self.poses.poses])

    @cached_property
    def holds(self) -> tuple[tuple[HandHold, ...], tuple[HandHold, ...]]:
        """All grips and all pushes, in any posture."""
        return (
            tuple(HandHold(grip.index, ALL_POSTURES) for grip in self.grips),
            tuple(HandHold(push.index, ALL_POSTURES) for push in self.pushes),
        )

    def balance(self, reserve: float, *, tolerances: bool = True) -> HoldBalance:
        """Return who is asked whether holds bear the plate.

        Args:
            reserve: share of every limit that is kept back [1].
            tolerances: whether every plate within the tolerances has to be held, or the stated one alone.
        """
        tolerant = tolerant_program(self.scene, self.stated) if tolerances else self.stated
        return HoldBalance(
            BalancePrograms(self.keeping(reserve), tolerant, reserve),
            self.poses,
            [GripContacts(grip.points[0], grip.normals[0]) for grip in self.grips],
            [PushContact(push.point, push.normal) for push in self.pushes],
            MotionSampling.of(self.scene.cell),
        )

    def keeping(self, reserve: float) -> Balance:
        """Return program (5) for the plate as stated, with a share of every limit kept back [1]."""
        return keeping_back(self.stated, reserve=reserve)

    @property
    def least_thickness(self) -> float:
        """Up to which the stick finds no room beside the plate where it lies [m]; 0 where pushes are given."""
        return self.least_thickness_with(self.scene.surface_beyond)

    def least_thickness_with(self, beyond: float) -> float:
        """Return the same for a plate that lies on what reaches so far beyond it [m]."""
        if self.scene.given_pushes is not None:
            return 0.0
        radius, margin = self.workcell.pushing_hand.tip_radius, self.workcell.settings.margin
        return least_thickness(radius, margin, self.settings.pushes, beyond)

    @property
    def largest_tip(self) -> float:
        """Radius of the largest tip that has room beside the plate, on a board as large as it or at an edge [m]."""
        return largest_tip(self.prism.height, self.workcell.settings.margin, self.settings.pushes, 0.0)

    def figures(self) -> dict[str, int]:
        """Return how many of everything there are, for the plan."""
        return {
            "poses": len(self.poses.poses),
            "pose_edges": len(self.poses.edges),
            "grips": len(self.grips),
            "pushes": len(self.pushes),
        }


def jaw_of(workcell: LiftWorkcell) -> Jaw:
    """Return what matters of the gripper to where it can grip."""
    hand, thickness = workcell.gripping_hand, workcell.scene.plate.height
    room = hand.palm_distance(min(thickness, hand.width_max))
    return Jaw(hand.width_max, (float(hand.pad_size[0]), float(hand.pad_size[2])), room)


def gripping_reach(workcell: LiftWorkcell) -> float:
    """Return how far the arm that grips reaches, as its maker states it [m]."""
    return workcell.arm(workcell.gripper).robot.reach


def cup_footprint(scene: PlateLiftScene) -> CupFootprint:
    """Return where the cup is in the way of grips."""
    return CupFootprint((float(scene.cup.position[0]), float(scene.cup.position[1])), scene.cup.radius)
