"""Stops lose nothing where they are said to: by Newton and Euler along splines, and forces of fingers and cup."""

from __future__ import annotations

import io
from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
import trimesh
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from planners.contract.shapes import Box, InlineMesh
from planners.geometry.pose import Array
from planners.geometry.wrench import wrench_about
from planners.plan.contacts import SoftFingerContact, SuctionContact
from planners.plan.plan import Plan
from planners.plan.segment import Hold, Segment, SegmentKind
from planners.program.recovery import way_back
from planners.program.schedule import STOP_DURATION, Schedule
from planners.program.stopping import SHARES, SUDDEN, StopBearing
from planners.regrasp.statics.finger_forces import squeezed
from planners.regrasp.suction.suction_hold import suction_margins
from planners.scene.suction_tool import CupData
from workers.robot.clock import WallClock
from workers.robot.execution_log import ExecutionLog
from workers.robot.executor import ExecutionSettings, Executor


@pytest.fixture(scope="module")
def pile(plans: dict[str, Plan]) -> Plan:
    return plans["domino_pile"]


@cache
def filled(size: tuple[float, ...], vertices: bytes, faces: bytes) -> trimesh.Trimesh:
    if size:
        return trimesh.creation.box(size)
    return trimesh.Trimesh(np.frombuffer(vertices).reshape(-1, 3), np.frombuffer(faces, dtype=np.int64).reshape(-1, 3))


def needed(plan: Plan, name: str, segment: Segment, times: Array, speed: float, rise: float) -> tuple[Array, Array]:
    """Return what must be exerted on a body about its centre (n, 6), and the centres (n, 3)."""
    body = plan.bodies[name]
    assert body.mass is not None
    shape, poses = body.shape, segment.transforms[name]
    if isinstance(shape, Box):
        solid = filled(tuple(shape.size), b"", b"")
    else:
        assert isinstance(shape, InlineMesh)
        solid = filled((), np.array(shape.vertices).tobytes(), np.array(shape.faces, dtype=np.int64).tobytes())
    solid = solid.copy()
    solid.density = body.mass / solid.volume
    off = np.asarray(body.com) - solid.center_mass
    tensor = solid.moment_inertia + body.mass * (off @ off * np.eye(3) - np.outer(off, off))
    way = CubicSpline(segment.time, poses[:, :3, :3] @ body.com + poses[:, :3, 3])
    turns = RotationSpline(segment.time, Rotation.from_matrix(poses[:, :3, :3]))
    R, rate, change = turns(times).as_matrix(), turns(times, 1), turns(times, 2)
    # SciPy gives rates in the axes of the body.
    omega, alpha = speed * rate, speed**2 * change + rise * rate
    torque = alpha @ tensor + np.cross(omega, omega @ tensor)
    force = body.mass * (speed**2 * way(times, 2) + rise * way(times, 1) - plan.cell.gravity)
    return np.hstack([force, np.einsum("nij,nj->ni", R, torque)]), way(times)


def uses(plan: Plan, segment: Segment, speed: float, rise: float) -> Iterator[Array]:
    """Yield which parts of what fingers and cup have are used at samples of a segment."""
    inner = slice(2, -2)
    times, tool = segment.time[inner], segment.transforms["tool"][inner]
    lip = tool[:, :3, 3]
    wrench = wrench_about(*needed(plan, "tool", segment, times, speed, rise), lip)
    for name in [body for body, ride in segment.rides if ride.to == "tool"]:
        pull = wrench_about(*needed(plan, name, segment, times, speed, rise), lip)
        wrench = wrench + pull
        stated = next(each for each in segment.contacts if isinstance(each, SuctionContact) and each.body == name)
        axes = (pull.reshape(-1, 2, 3) @ tool[:, :3, :3]).reshape(-1, 6)
        axes[:, 2] = np.maximum(axes[:, 2], 0.0)
        yield 1.0 - suction_margins(axes, CupData(stated.radius, stated.limit, stated.mu, stated.kappa)).min(axis=1)
    (grip,) = segment.grips
    finger = next(each for each in segment.contacts if isinstance(each, SoftFingerContact))
    tcp = tool @ grip.T_body_tcp
    axes = (wrench_about(wrench, lip, tcp[:, :3, 3]).reshape(-1, 2, 3) @ tcp[:, :3, :3]).reshape(-1, 6)
    assert grip.squeeze is not None
    yield squeezed(axes, grip.width, finger.mu, finger.eps, grip.squeeze).slip


def worst(plan: Plan, segment: Segment, share: float, speeds: tuple[float, ...]) -> float:
    brake = SUDDEN * share / STOP_DURATION
    return max(
        float(used.max())
        for speed in speeds
        for rise in (-brake, brake)
        for used in uses(plan, segment, speed * share, rise)
    )


@pytest.mark.slow
def test_the_share_is_the_largest_from_which_a_sudden_stop_is_borne(pile: Plan) -> None:
    bearing, slower = StopBearing(pile, STOP_DURATION), 0
    for segment in pile.segments:
        share = bearing.share(segment)
        if segment.kind is not SegmentKind.TRANSFER:
            assert share == 1.0
            continue
        # All the while that it brakes, not only at its begin and its end.
        assert worst(pile, segment, share, (0.0, 0.3, 0.7, 1.0)) < 1.02
        if share < 1.0:
            slower += 1
            faster = SHARES[SHARES.index(share) + 1]
            assert worst(pile, segment, faster, (0.0, 1.0)) > 0.98
    assert slower > 3


@pytest.mark.slow
def test_the_longer_a_stop_takes_the_faster_may_the_arms_be(pile: Plan) -> None:
    shares = [[StopBearing(pile, duration).share(each) for each in pile.segments] for duration in (0.03, 0.06, 0.5)]
    assert (np.diff(shares, axis=0) >= 0.0).all()
    assert (np.diff(shares, axis=0) > 0.0).any(axis=1).all()


def test_the_way_back_is_slow_enough_for_stops(pile: Plan) -> None:
    schedule = Schedule.of(pile)
    slow = [step for step in schedule.steps if step.stop_share < 0.4]
    assert slow
    for step in slow:
        reached = step.begin + step.duration
        back = way_back(schedule, {"left": reached, "right": reached})
        assert back is not None
        assert back.steps[0].way is not None
        time, clock = back.steps[0].way
        fastest = np.abs(np.diff(clock) / np.diff(time)).max()
        assert back.steps[0].stop_share * fastest <= step.stop_share + 1e-9
        # Slow by its speed, not by more samples than a controller reads.
        assert len(time) < 100 * reached


def test_what_bears_no_stop_at_all_is_told_and_not_executed(pile: Plan) -> None:
    weak = pile.model_copy(
        update={"segments": [each.model_copy(update={"hold": _weaker(each.hold)}) for each in pile.segments]}
    )
    schedule = Schedule.of(weak)
    assert {step.stop_share for step in schedule.steps if step.kind is SegmentKind.TRANSFER} == {0.0}
    with pytest.raises(ValueError, match="bears no stop"):
        Executor(schedule, {}, ExecutionLog(io.StringIO(), WallClock()), lambda _: True, ExecutionSettings(0.1))


def _weaker(hold: Hold | None) -> Hold | None:
    if hold is None or hold.grip is None:
        return hold
    return hold.model_copy(update={"grip": hold.grip.model_copy(update={"squeeze": 0.01})})
