"""What a plate lift's planning stands on: its holds, its balance program, and what to ask of each hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planners.balance.contacts import Cup, Friction, HandForceLimit
from planners.balance.solver import Balance
from planners.balance.uncertainty import Uncertainty
from planners.geometry.polyhedron import Prism
from planners.geometry.pose import inverse
from planners.manipulation.graph.failures import Hand
from planners.manipulation.holds.grips import CupFootprint, Grip, Jaw, generate_grips, given_grips
from planners.manipulation.holds.pushes import Push, generate_pushes, given_pushes
from planners.manipulation.lift_settings import LiftSettings
from planners.manipulation.motion.posture_follower import PostureQueries
from planners.manipulation.reach.hand_reach import HandReach, PairReach, PlateQuery
from planners.manipulation.reach.lift_workcell import LiftWorkcell
from planners.scene.scene import PlateLiftScene


def balance_program(scene: PlateLiftScene, cup_reserve: float = 0.0, reserve: float = 0.0) -> Balance:
    """State the balance program (5) of a scene, for the plate as stated.

    Args:
        scene: what it is stated for.
        cup_reserve: part of the cup's largest force that is kept back at least [1].
        reserve: share of every limit that is kept back [1].
    """
    cup, friction = scene.cup, scene.friction
    stated = Balance(
        scene.plate.mass or 0.0,
        scene.plate.com,
        Cup(cup.T_plate_cup, cup.radius, cup.max_force, cup.mu, cup.kappa),
        Friction(friction.grip, friction.push, friction.environment, friction.eps),
        hand_force_limit(scene),
        scene.lifter_model,
        float(-scene.cell.gravity[2]),
    )
    return keeping_back(stated, cup_reserve, reserve)


def keeping_back(stated: Balance, cup_reserve: float = 0.0, reserve: float = 0.0) -> Balance:
    """Return a program with limits kept back; the arguments are those of `balance_program`."""
    less = min(1.0, (1.0 - cup_reserve) / (1.0 - reserve))
    cup = replace(stated.cup, max_force=less * stated.cup.max_force)
    return stated.with_limits(cup=cup).keeping_back(reserve)


def tolerant_program(scene: PlateLiftScene, stated: Balance) -> Balance:
    """Return the balance program (5) of a scene for all plates within the tolerances, with nothing kept back.

    A reserve is for what nobody states; what is stated, a mass and a centre of mass within tolerances, is proven.

    Args:
        scene: what the tolerances are stated for.
        stated: the program for the plate as stated, with nothing kept back.
    """
    return stated.for_all(Uncertainty(scene.mass_tolerance, scene.com_tolerance))


def hand_force_limit(scene: PlateLiftScene) -> HandForceLimit:
    """Return what the hands may do: what the task asks for, and no more than each arm's payload leaves."""
    asked, cell = scene.hand_force_limit, scene.cell
    gripper, pusher = (cell.payload_force(arms[0]) for arms in (cell.gripper_arms, cell.pusher_arms))
    return HandForceLimit(asked.normal, min(asked.net, gripper), min(asked.net, pusher), scene.squeeze)


def jaw_of(workcell: LiftWorkcell) -> Jaw:
    """Return what matters of the gripper to where it can grip."""
    hand = workcell.gripping_hand
    return Jaw(hand.width_max, (float(hand.pad_size[0]), float(hand.pad_size[2])))


def cup_footprint(scene: PlateLiftScene) -> CupFootprint:
    """Return where the cup is in the way of grips."""
    return CupFootprint((float(scene.cup.position[0]), float(scene.cup.position[1])), scene.cup.radius)


def grips_of(workcell: LiftWorkcell, plate: Prism, settings: LiftSettings) -> tuple[Grip, ...]:
    """Return the task's own grips, or generated ones."""
    scene = workcell.scene
    if scene.given_grips is not None:
        return given_grips(scene.given_grips, plate)
    return generate_grips(plate, jaw_of(workcell), cup=cup_footprint(scene), sampling=settings.grips)


def pushes_of(workcell: LiftWorkcell, plate: Prism, settings: LiftSettings) -> tuple[Push, ...]:
    """Return the task's own pushes, or generated ones."""
    scene, radius = workcell.scene, workcell.pushing_hand.tip_radius
    if scene.given_pushes is not None:
        return given_pushes(scene.given_pushes, radius, settings.pushes.rolls)
    return generate_pushes(plate, radius, settings.pushes)


def pair_reach(workcell: LiftWorkcell, grips: tuple[Grip, ...], pushes: tuple[Push, ...], rolls: int) -> PairReach:
    """Return what the two hands can be asked; a grip has two flips, a push `rolls` turns about the stick."""
    T_tcp_flange = inverse(workcell.gripping_hand.T_flange_tcp(workcell.grip_width))
    T_tip_flange = inverse(workcell.pushing_hand.T_flange_tcp)
    T_plate_tcp = np.array([grip.T_plate_tcp for grip in grips]).reshape(-1, 2, 4, 4)
    T_plate_tip = np.array([push.T_plate_tcp for push in pushes]).reshape(-1, rolls, 4, 4)
    between = workcell.plate_query(workcell.holding, workcell.between_arms, hands=[workcell.gripper, workcell.pusher])
    return PairReach(
        _hand_reach(workcell, workcell.gripper, T_plate_tcp @ T_tcp_flange),
        _hand_reach(workcell, workcell.pusher, T_plate_tip @ T_tip_flange),
        between,
    )


def posture_queries(workcell: LiftWorkcell, lifted: PlateQuery) -> PostureQueries:
    """Return what counts as a collision when postures are followed along the plate's motions and approaches."""
    gripper, pusher = workcell.gripper, workcell.pusher
    with_idle: dict[Hand, PlateQuery] = {
        "grip": workcell.plate_query(workcell.holding, workcell.with_idle(gripper), hands=[gripper]),
        "push": workcell.plate_query(workcell.open, workcell.with_idle(pusher), hands=[pusher]),
    }
    opened: dict[Hand, PlateQuery] = {
        "grip": workcell.plate_query(workcell.open, workcell.without_other(gripper), hands=[gripper]),
        "push": workcell.plate_query(workcell.open, workcell.without_other(pusher), hands=[pusher]),
    }
    return PostureQueries(with_idle, opened, lifted)


def _hand_reach(workcell: LiftWorkcell, arm: str, T_plate_flange: np.ndarray) -> HandReach:
    return HandReach(
        arm=workcell.arm(arm),
        first_joint=workcell.joints(arm).start,
        T_plate_flange=np.ascontiguousarray(T_plate_flange),
        alone=workcell.plate_query(workcell.holding, workcell.without_other(arm), hands=[arm]),
        hand_only=workcell.plate_query(workcell.holding, workcell.hand_without_other(arm), hands=[arm]),
        start_positions=workcell.scene.start_positions,
    )
