"""What no arm reaches in whatever posture, derived again: links stretched out in one line, and the hand beyond them."""

from __future__ import annotations

import math

import numpy as np

from planners.certify.bound import Bound
from planners.certify.plan_view import ArmView, BodyView, HandView, PlanView
from planners.certify.surfaces import pad_face
from planners.geometry.pose import Array

_TOLERANCES = 0.005
"""Where bodies rest, are held and end may be off by less, all in all [m]: contacts and attachments, goals and settling
of the contract."""


def reach_bound(plan: PlanView, point: Array, further: float) -> Bound:
    """Return how far a point is from the shoulder of the arm that misses it by least, and how far that one reaches [m].

    Args:
        plan: has arms and hands.
        point: (3,) in the world [m].
        further: what a hand reaches with, and how far around the point it may touch [m].
    """
    reaches = []
    for name, arm in plan.arms.items():
        needed = float(np.linalg.norm(point - _shoulder(arm)))
        reaches.append((needed, _stretched(arm) + _hand_length(plan.hands[name]) + further + _TOLERANCES))
    needed, available = max(reaches, key=lambda pair: pair[1] - pair[0])
    return Bound(max(needed, _TOLERANCES), (max(needed, _TOLERANCES),), available)


def body_radius(body: BodyView) -> float:
    """Return how far a body's farthest corner is from its origin [m]."""
    return float(np.linalg.norm(body.shape.vertices, axis=1).max())


def _shoulder(arm: ArmView) -> Array:
    """Return the point on the first axis at which the first row ends; the joint turns about it: (3,) [m]."""
    return arm.T_world_base[:3, 3] + float(arm.dh[0, 2]) * arm.T_world_base[:3, 2]


def _stretched(arm: ArmView) -> float:
    """Return how far the flange's origin can be from the shoulder [m]."""
    return abs(float(arm.dh[0, 0])) + sum(math.hypot(a, d) for a, _, d, _ in arm.dh[1:].tolist())


def _hand_length(hand: HandView) -> float:
    """Return how far from the flange's origin a hand can touch anything: pads opened widest, or the tip's pole [m]."""
    if hand.tcp_table is None:
        assert hand.T_flange_tip is not None
        return float(np.linalg.norm(hand.T_flange_tip[:3, 3])) + hand.tip_radius
    width, length = pad_face()
    opening, height = hand.tcp_table.max(axis=0)
    return math.hypot(width / 2, float(opening) / 2, float(height) + length / 2)
