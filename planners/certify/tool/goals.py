"""Objects are at their goals at the end, up to the symmetry that the task declares."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planners.certify.evidence import Evidence
from planners.certify.finding import Finding
from planners.certify.motion.segment_motion import rotation_angles
from planners.certify.tool.task import StatedObject
from planners.geometry.pose import Array, Transform, inverse
from planners.plan.verdicts import Check

_SAME_SHAPE = 1e-4
"""Distance of corners within which a turn takes a shape to itself [m]."""


def goal_checks(evidence: Evidence, objects: Sequence[StatedObject]) -> list[Check]:
    """Check where every object ends."""
    place, turn = Finding("goals", "m"), Finding("goal_angles", "rad")
    for stated in objects:
        name = stated.body.name
        T_world_object = evidence.motions[-1].body_poses[name][-1]
        left, left_angle = goal_margins(evidence, stated, T_world_object)
        place.note(left, f"the end: {name}")
        turn.note(left_angle, f"the end: {name}")
    return [place.check(), turn.check()]


def goal_margins(evidence: Evidence, stated: StatedObject, T_world_object: Transform) -> tuple[float, float]:
    """Return the margins of an object's pose to the nearest symmetric turn of its goal [m, rad]; negative if not there.

    Args:
        evidence: of the document.
        stated: the object, its goal and its symmetry.
        T_world_object: (4, 4) its pose.
    """
    T_goal_object, settings = inverse(stated.T_world_goal) @ T_world_object, evidence.settings
    T_turn = _nearest_turn(T_goal_object, stated, evidence.plan.bodies[stated.body.name].shape.vertices)
    away = float(np.linalg.norm(T_goal_object[:3, 3] - T_turn[:3, 3]))
    turned = float(rotation_angles(T_goal_object[None], T_turn)[0])
    return settings.goal_distance - away, settings.goal_angle - turned


def _nearest_turn(T_goal_object: Transform, stated: StatedObject, vertices: Array) -> Transform:
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
