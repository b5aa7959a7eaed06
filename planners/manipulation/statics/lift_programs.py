"""The balance program (5) of a plate lift: as stated, for all plates within tolerances, with limits kept back."""

from __future__ import annotations

from dataclasses import replace

from planners.balance.contacts import Cup, Friction, HandLimits
from planners.balance.solver import Balance
from planners.balance.uncertainty import Uncertainty
from planners.cell.cell import Cell
from planners.scene.lift_scene import PlateLiftScene


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
    ).with_rim(scene.at_the_rim)
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


def hand_force_limit(scene: PlateLiftScene) -> HandLimits:
    """Return what the hands may do: what the task asks for, and no more than each arm's payload leaves."""
    asked = scene.hand_force_limit
    gripper, pusher = payload_forces(scene.cell)
    return HandLimits(asked.normal, min(asked.net, gripper), min(asked.net, pusher), scene.squeeze)


def payload_forces(cell: Cell) -> tuple[float, float]:
    """Return what the arms' payloads leave the gripper and the stick of a cell that has one of each [N]."""
    return cell.payload_force(cell.gripper_arms[0]), cell.payload_force(cell.pusher_arms[0])
