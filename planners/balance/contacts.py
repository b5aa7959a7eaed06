"""What can push on the plate: fingers, a stick, the table, the suction cup. All in the plate frame.

The plate frame is the frame of the plate's shape. A contact frame has its origin at the contact point and
its z axis along the normal into the plate, so that a push is a positive z force.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from planners.contract.quantities import SOFT_FINGER_EPS
from planners.errors import LiftwrightError
from planners.geometry.pose import Array, Transform, transform

UPWARD = np.array([0.0, 0.0, 1.0])
"""Normal of the plate's bottom face, into the plate."""
_SAME_POINT = 1e-6
"""Points of a plate that are nearer to one another are one [m]."""


@dataclass(frozen=True, eq=False)
class GripContacts:
    """Two soft fingers on the plate: paper B, eq. (1), F_g1 and F_g2."""

    points: Array
    """(2, 3), finger 0 then finger 1 [m]."""
    normals: Array
    """(2, 3), unit, into the plate."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", _locked(self.points, (2, 3), "the points of a grip"))
        object.__setattr__(self, "normals", _locked(self.normals, (2, 3), "the normals of a grip", unit=True))

    @cached_property
    def rotations(self) -> Array:
        """(2, 3, 3): the axes of each finger's contact frame in the plate frame."""
        return np.stack([contact_axes(normal) for normal in self.normals])


@dataclass(frozen=True, eq=False)
class PushContact:
    """One point contact with friction: paper B, eq. (1), F_p."""

    point: Array
    """(3,) [m]"""
    normal: Array
    """(3,), unit, into the plate."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", _locked(self.point, (3,), "the point of a push"))
        object.__setattr__(self, "normal", _locked(self.normal, (3,), "the normal of a push", unit=True))

    @cached_property
    def rotation(self) -> Array:
        """(3, 3): the axes of the contact frame in the plate frame."""
        return contact_axes(self.normal)


@dataclass(frozen=True, eq=False)
class Cup:
    """The lifter's suction cup on the plate."""

    T_plate_cup: Transform
    """z is the normal into the plate, x the plate's x projected on the pad, y = z x x."""
    radius: float
    """Of the pad [m]."""
    max_force: float
    """Largest vacuum force [N]."""
    mu: float = 0.5
    """Friction of pad on plate: Schmalz, dry."""
    kappa: float = 0.005
    """Stiffness of the pad's material in (5g) [N]: a public Dex-Net 3.0 implementation."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_plate_cup", _locked(self.T_plate_cup, (4, 4), "the pose of the cup"))
        _require_not_negative(self)
        if self.radius == 0.0:
            raise LiftwrightError("radius of Cup must be positive")

    @classmethod
    def on_top(cls, position: tuple[float, float, float], radius: float, max_force: float, **parameters: float) -> Cup:
        """Place a cup at `position` on a face whose outward normal is the plate's +z."""
        axes = np.diag([1.0, -1.0, -1.0])
        return cls(transform(axes, position), radius, max_force, **parameters)

    def keeping_back(self, reserve: float) -> Cup:
        """Return the cup with that share of its limits kept back: force, friction and bending [1]."""
        left = 1.0 - reserve
        return replace(self, max_force=left * self.max_force, mu=left * self.mu, kappa=left * self.kappa)


@dataclass(frozen=True)
class Friction:
    """Friction coefficients of (5c)-(5e)."""

    grip: float = 0.5
    """Fingers on plate."""
    push: float = 0.5
    """Stick on plate."""
    environment: float = 0.4
    """Plate on table or support."""
    eps: float = SOFT_FINGER_EPS
    """Eccentricity of the soft finger: torque over tangential force at the limit [m]."""

    def __post_init__(self) -> None:
        _require_not_negative(self)
        if 0.0 in (self.grip, self.push, self.environment, self.eps):
            raise LiftwrightError("friction coefficients and eps must be positive")

    def keeping_back(self, reserve: float) -> Friction:
        """Return the coefficients with that share kept back; `eps` is a length and stays [1]."""
        left = 1.0 - reserve
        return Friction(left * self.grip, left * self.push, left * self.environment, self.eps)


@dataclass(frozen=True)
class HandLimits:
    """What the hands may do, each by what its arm's payload leaves beside it.

    A gripper commands a squeeze s: with nothing else to bear, each pad presses with s. A load along the closing axis
    adds half of itself on one pad and takes it off the other, so that the fingers' normal forces add up to 2 s, and
    what the arm feels is their net force alone (docs/grip-model.md). Paper B's fingers are free: two normal forces from
    nothing to a cap, (5i); they are had without a squeeze.
    """

    normal: float = 17.0
    """Cap of f+_gp [N]: the normal force of the stick, and the net force of the gripper; of free fingers, the normal
    force of each."""
    grip: float = 17.6
    """Cap of the norm of the gripper's net force [N]."""
    push: float = 19.0
    """Cap of the norm of the stick's force [N]."""
    squeeze: float | None = 60.0
    """What each pad presses with when the gripper bears nothing [N]; None for the free fingers of paper B."""
    least_push: float = 0.0
    """Normal force that the stick has to press with at least [N]: none in (5), which only says whether it is held."""

    def __post_init__(self) -> None:
        _require_not_negative(self)

    @property
    def finger(self) -> float:
        """Largest normal force that there can be at one finger [N]."""
        return self.normal if self.squeeze is None else self.squeeze + 0.5 * min(self.normal, self.grip)

    @property
    def pushing(self) -> float:
        """Largest normal force of the stick [N]."""
        return min(self.normal, self.push)

    def keeping_back(self, reserve: float) -> HandLimits:
        """Return the limits with that share kept back; what is commanded, squeeze and least push, stays [1]."""
        left = 1.0 - reserve
        return replace(self, normal=left * self.normal, grip=left * self.grip, push=left * self.push)


class StandingCones(NamedTuple):
    """Friction cones of what a plate stands on, at points of it; leading axes broadcast."""

    normals: Array
    """(..., k or 1, 3) unit, plate axes; zero where nothing is borne."""
    mu: Array | float
    """(..., k) or of all points [1]."""
    largest: Array | float
    """(..., k) or of all points: bound of the normal forces of all points together [N]."""


def standing_cones(points: Array, ups: Array, rim: Array, mu: float, largest: float) -> StandingCones:
    """Return the cones in which the forces are that what a plate stands on exerts for sure.

    At a rim nobody knows which edge bears: that of the plate on the surface, with the surface's normal, or, once the
    plate stands a little beyond it, that of the surface on the plate's bottom face, with the plate's normal. What both
    can exert is around the middle between the normals; of that the largest circular cone is taken.

    Args:
        points: (..., k, 3) where the plate stands, plate axes [m].
        ups: (..., 3) unit, world +z in plate axes.
        rim: (m, 2) points of the plate's bottom face that stand at the rim, plate axes [m].
        mu: friction of plate and surface [1].
        largest: bound of all vertical forces together [N].
    """
    normals = ups[..., None, :]
    if not len(rim):
        return StandingCones(normals, mu, largest)
    on_rim = (np.abs(points[..., None, :2] - rim).max(axis=-1) <= _SAME_POINT).any(axis=-1)
    half = 0.5 * np.arctan2(np.hypot(normals[..., 0], normals[..., 1]), normals[..., 2])
    left = np.arctan(mu) - half
    middle = normals + UPWARD
    middle /= np.linalg.norm(middle, axis=-1, keepdims=True)
    middle *= (left >= 0.0)[..., None]
    cone = np.where(half > 0.0, np.tan(np.maximum(0.0, left)), mu)
    # No force is longer than its vertical part lets it be.
    return StandingCones(
        np.where(on_rim[..., None], middle, normals),
        np.where(on_rim, cone, mu),
        np.where(on_rim, np.hypot(1.0, mu), 1.0) * largest,
    )


def contact_axes(normal: Array) -> Array:
    """Return (3, 3) right-handed axes whose z is the unit `normal`; x is square to the plate axis furthest from it."""
    axis = np.zeros(3)
    axis[int(np.argmin(np.abs(normal)))] = 1.0
    x = _cross(axis, normal)
    x /= np.sqrt(x @ x)
    return np.column_stack([x, _cross(normal, x), normal])


def _cross(a: Array, b: Array) -> Array:
    """Return a x b for two vectors (3,), ten times faster than `np.cross`."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _locked(values: Array, shape: tuple[int, ...], what: str, *, unit: bool = False) -> Array:
    """Return a copy that nobody can write to, of finite numbers of a shape; with `unit`, of vectors of length 1."""
    array = np.array(values, dtype=float)
    if array.shape != shape or not np.all(np.isfinite(array)):
        raise LiftwrightError(f"{what} must be finite numbers of shape {shape}, not {array.shape}")
    if unit and np.any(np.abs(np.linalg.norm(array, axis=-1) - 1.0) > 1e-6):
        raise LiftwrightError(f"{what} must have length 1")
    array.setflags(write=False)
    return array


def _require_not_negative(record: Cup | Friction | HandLimits) -> None:
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, (int, float)) and not value >= 0.0:
            raise LiftwrightError(f"{field.name} of {type(record).__name__} must not be negative, but is {value}")
