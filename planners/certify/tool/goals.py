"""Objects are at their goals at the end, up to the symmetry that the task declares."""

from __future__ import annotations

import math

import numpy as np

from planners.certify.common.attachments import rotation_angles
from planners.certify.finding import Finding
from planners.certify.motion.segment_motion import SegmentMotion
from planners.certify.plan_view import PlanView
from planners.certify.settings import CertifySettings
from planners.certify.tool.task import StatedObject, ToolTask
from planners.geometry.pose import Array, Transform, inverse
from planners.plan.verdicts import Check

_SAME_SHAPE = 1e-4
"""Distance of corners within which a turn takes a shape to itself [m]."""


def goal_checks(plan: PlanView, motions: list[SegmentMotion], task: ToolTask, settings: CertifySettings) -> list[Check]:
    """Check where every object ends."""
    place, turn = Finding("goals", "m"), Finding("goal_angles", "rad")
    for stated in task.objects:
        name = stated.body.name
        T_goal_object = inverse(stated.T_world_goal) @ motions[-1].body_poses[name][-1]
        T_turn = nearest_turn(T_goal_object, stated, plan.bodies[name].shape.vertices)
        left, left_angle = _margins(T_goal_object, T_turn, settings)
        place.note(left, f"the end: {name}")
        turn.note(left_angle, f"the end: {name}")
    return [place.check(), turn.check()]


def goal_margin(T_goal_object: Transform, T_turn: Transform, settings: CertifySettings) -> float:
    """Return the lesser margin of a pose to its goal; negative where it is not there."""
    return min(_margins(T_goal_object, T_turn, settings))


def _margins(T_goal_object: Transform, T_turn: Transform, settings: CertifySettings) -> tuple[float, float]:
    away = float(np.linalg.norm(T_goal_object[:3, 3] - T_turn[:3, 3]))
    turned = float(rotation_angles(T_goal_object[None], T_turn)[0])
    return settings.goal_distance - away, settings.goal_angle - turned


def nearest_turn(T_goal_object: Transform, stated: StatedObject, vertices: Array) -> Transform:
    """Return the symmetric place that an object's pose, in the frame of its goal, is nearest to."""
    if stated.symmetry == "none":
        return np.eye(4)
    if stated.symmetry == "axis" or stated.round:
        flipped = stated.symmetry == "shape" and T_goal_object[2, 2] < 0.0
        return _about_axis(T_goal_object, flipped)
    return _same_shape(T_goal_object, vertices)


def _about_axis(T: Transform, flipped: bool) -> Transform:
    """Return the turn about z, after half a turn about x if flipped, that is nearest to an orientation."""
    half = np.diag([1.0, -1.0, -1.0, 1.0]) if flipped else np.eye(4)
    R = T[:3, :3] @ half[:3, :3]
    angle = math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
    turn = np.eye(4)
    turn[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    return turn @ half


def _same_shape(T: Transform, vertices: Array) -> Transform:
    """Return the rigid motion that takes every corner to the corner it is nearest to; none if it is no symmetry."""
    moved = vertices @ T[:3, :3].T + T[:3, 3]
    nearest = np.argmin(np.linalg.norm(moved[:, None] - vertices[None], axis=2), axis=1)
    if len(set(nearest.tolist())) != len(vertices):
        return np.eye(4)
    target = vertices[nearest]
    centre, target_centre = vertices.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((target - target_centre).T @ (vertices - centre))
    turn = np.eye(4)
    turn[:3, :3] = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    turn[:3, 3] = target_centre - turn[:3, :3] @ centre
    error = np.linalg.norm(vertices @ turn[:3, :3].T + turn[:3, 3] - target, axis=1).max()
    return turn if error <= _SAME_SHAPE else np.eye(4)
