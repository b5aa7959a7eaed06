"""A depth camera that is simulated by casting rays, with the noise of a Kinect-like one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planners.geometry.pose import Array, Transform, inverse, transform
from planners.perception.camera import Camera

TABLE_TOP = 1.094
TABLE_CENTER = np.array([0.45, 0.0, TABLE_TOP - 0.012])
TABLE_SIZE = (0.80, 1.83, 0.024)


@dataclass(frozen=True, eq=False)
class Block:
    """A box; the frame is its centre."""

    size: tuple[float, float, float]
    T_world_block: Transform

    def ball(self) -> tuple[Array, float]:
        return self.T_world_block[:3, 3], 0.5 * float(np.linalg.norm(self.size))

    def hit(self, eye: Array, directions: Array) -> Array:
        T = inverse(self.T_world_block)
        o, d = T[:3, :3] @ eye + T[:3, 3], directions @ T[:3, :3].T
        half = 0.5 * np.array(self.size)
        inverse_d = 1.0 / np.where(d == 0.0, 1e-300, d)
        near, far = np.full(len(d), -np.inf), np.full(len(d), np.inf)
        for k in range(3):
            a, b = (-half[k] - o[k]) * inverse_d[:, k], (half[k] - o[k]) * inverse_d[:, k]
            near, far = np.maximum(near, np.minimum(a, b)), np.minimum(far, np.maximum(a, b))
        return np.where((near <= far) & (near > 0.0), near, np.inf)


@dataclass(frozen=True, eq=False)
class Turned:
    """A solid of revolution about z: rings (z, radius) from bottom to top, closed by discs; the frame is its own."""

    profile: tuple[tuple[float, float], ...]
    T_world_turned: Transform

    def ball(self) -> tuple[Array, float]:
        return self.T_world_turned[:3, 3], max(math.hypot(z, r) for z, r in self.profile)

    def hit(self, eye: Array, directions: Array) -> Array:
        T = inverse(self.T_world_turned)
        o, d = T[:3, :3] @ eye + T[:3, 3], directions @ T[:3, :3].T
        hits = [_disc(o, d, z, r) for z, r in (self.profile[0], self.profile[-1])]
        hits += [
            _cone(o, d, low, high)
            for low, high in zip(self.profile, self.profile[1:], strict=False)
            if high[0] > low[0]
        ]
        hits += [
            _disc(o, d, low[0], max(low[1], high[1]))
            for low, high in zip(self.profile, self.profile[1:], strict=False)
            if high[0] == low[0]
        ]
        return np.min(hits, axis=0)


Thing = Block | Turned


def can(T_world_can: Transform) -> Turned:
    """A drinks can of 66.1 mm diameter whose top rim is only 54 mm across; the frame is its centre."""
    h = 0.5 * 0.1222
    return Turned(((-h, 0.03305), (h - 0.0122, 0.03305), (h - 0.003, 0.027), (h, 0.027)), T_world_can)


def cylinder(radius: float, height: float, T_world_cylinder: Transform) -> Turned:
    return Turned(((-0.5 * height, radius), (0.5 * height, radius)), T_world_cylinder)


def table() -> Block:
    return Block(TABLE_SIZE, transform(position=TABLE_CENTER))


def floor() -> Block:
    return Block((8.0, 8.0, 0.1), transform(position=[0.0, 0.0, -0.05]))


def _disc(o: Array, d: Array, z: float, radius: float) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (z - o[2]) / d[:, 2]
        x, y = o[0] + t * d[:, 0], o[1] + t * d[:, 1]
    return np.where((t > 0.0) & (x * x + y * y <= radius * radius), t, np.inf)


def _cone(o: Array, d: Array, low: tuple[float, float], high: tuple[float, float]) -> Array:
    (z0, r0), (z1, r1) = low, high
    slope = (r1 - r0) / (z1 - z0)
    base = r0 + slope * (o[2] - z0)
    a = d[:, 0] ** 2 + d[:, 1] ** 2 - (slope * d[:, 2]) ** 2
    b = o[0] * d[:, 0] + o[1] * d[:, 1] - slope * d[:, 2] * base
    c = o[0] ** 2 + o[1] ** 2 - base * base
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(b * b - a * c)
        ends = [(-b - root) / a, (-b + root) / a]
    best = np.full(len(d), np.inf)
    for t in ends:
        z = o[2] + t * d[:, 2]
        best = np.where((t > 0.0) & (z >= z0) & (z <= z1) & (t < best), t, best)
    return best


@dataclass(frozen=True)
class DepthNoise:
    """Engineering choices in the form of published Kinect models: noise along the ray that grows with distance and
    slant, noise across it, pixels that mix both sides of an edge, pixels without a measurement."""

    axial: float = 0.0015
    """Standard deviation at 1.15 m, seen straight on [m]."""
    growth: float = 0.0019
    """... and by how much it grows with the square of the distance beyond 1.15 m [1/m]."""
    slant: float = 0.0002
    """... and with slant^2 / (90 deg - slant)^2 [m]."""
    lateral: float = 0.4
    """Standard deviation of where a pixel looks [px]."""
    mixed: float = 0.3
    """Share of the pixels on an edge whose depth is a mean of both sides [1]."""
    lost: float = 0.005
    """Share of pixels without a measurement [1]."""
    drift: float = 0.0015
    """Largest error that changes slowly over the image, another one in each image [m]."""
    step: float = 0.001
    """Depths are whole multiples of this [m]."""


NOISELESS = DepthNoise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1e-6)


def overhead_camera(
    position: Sequence[float] = (0.45, 0.0, 2.25),
    tilt: float = 0.0,
    roll: float = 0.0,
    focal: float = 365.0,
    shape: tuple[int, int] = (424, 512),
) -> Camera:
    """A camera that looks down on the table, its image's right to the world's -y; `tilt` about its x, `roll` its z."""
    down = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    c, s = math.cos(tilt), math.sin(tilt)
    k, m = math.cos(roll), math.sin(roll)
    R = down @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ np.array([[k, -m, 0], [m, k, 0], [0, 0, 1]])
    height, width = shape
    return Camera(focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), transform(R, position))


def cast(camera: Camera, pixels: Array, things: Sequence[Thing]) -> Array:
    """Return the depth behind (n, 2) places in the image, infinite where there is nothing."""
    rays = np.column_stack(
        [(pixels[:, 0] - camera.cx) / camera.fx, (pixels[:, 1] - camera.cy) / camera.fy, np.ones(len(pixels))]
    )
    directions = rays @ camera.T_world_camera[:3, :3].T
    eye = camera.T_world_camera[:3, 3]
    lengths = np.linalg.norm(directions, axis=1)
    depth = np.full(len(pixels), np.inf)
    for thing in things:
        center, radius = thing.ball()
        # What passes the ball by needs no look at the thing.
        to_center = center - eye
        along = directions @ to_center / lengths
        beside = np.sqrt(np.maximum(0.0, float(to_center @ to_center) - along * along))
        near = beside <= radius
        if near.any():
            depth[near] = np.minimum(depth[near], thing.hit(eye, directions[near]))
    return depth


def depth_image(
    things: Sequence[Thing],
    camera: Camera,
    rng: np.random.Generator,
    noise: DepthNoise | None = None,
    shape: tuple[int, int] = (424, 512),
) -> Array:
    """Return the (h, w) depth image of things, NaN where nothing was measured [m]."""
    noise = noise or DepthNoise()
    height, width = shape
    columns, rows = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    pixels = np.column_stack([columns.ravel(), rows.ravel()])
    depth = cast(camera, pixels + noise.lateral * rng.standard_normal(pixels.shape), things).reshape(shape)
    depth = _mix_edges(depth, noise.mixed, rng)
    slant = _slant(things, camera, shape)
    far = np.maximum(0.0, np.where(np.isfinite(depth), depth, 0.0) - 1.15)
    deviation = noise.axial + noise.growth * far**2 + noise.slant * (slant / (0.5 * math.pi - slant)) ** 2
    depth = depth + np.minimum(deviation, 0.02) * rng.standard_normal(shape)
    depth = depth + noise.drift * _drift(shape, rng)
    depth = np.round(depth / noise.step) * noise.step
    lost = (rng.random(shape) < noise.lost) | ~np.isfinite(depth) | (slant > math.radians(84.0))
    return np.where(lost, np.nan, depth)


def _mix_edges(depth: Array, share: float, rng: np.random.Generator) -> Array:
    beside = np.roll(depth, 1, axis=1) if rng.random() < 0.5 else np.roll(depth, 1, axis=0)
    weight = rng.random(depth.shape)
    mixed = np.where(np.isfinite(beside) & np.isfinite(depth), weight, 1.0)
    with np.errstate(invalid="ignore"):
        mean = np.where(mixed < 1.0, mixed * depth + (1.0 - mixed) * beside, depth)
        edge = np.abs(np.where(np.isfinite(beside - depth), beside - depth, 0.0)) > 0.01
    return np.where(edge & (rng.random(depth.shape) < share), mean, depth)


def _drift(shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """Return a smooth field between -1 and 1: a wave across the image, about as long as the image."""
    direction, length, phase = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.6, 1.5) * shape[1], rng.uniform(0.0, 6.28)
    rows, columns = np.indices(shape)
    return np.sin(2.0 * math.pi / length * (columns * math.cos(direction) + rows * math.sin(direction)) + phase)


def _slant(things: Sequence[Thing], camera: Camera, shape: tuple[int, int]) -> Array:
    """Return the angle between each ray and the surface's normal, of every other pixel for its neighbours too; on an
    edge, that of the flatter side."""
    rows, columns = np.meshgrid(np.arange(0, shape[0], 2), np.arange(0, shape[1], 2), indexing="ij")
    pixels = np.column_stack([columns.ravel(), rows.ravel()]).astype(float)
    depth = cast(camera, pixels, things).reshape(rows.shape)
    rays = np.dstack([(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones(rows.shape)])
    points = rays * np.where(np.isfinite(depth), depth, np.nan)[..., None]
    cosines = []
    for step in (1, -1):
        with np.errstate(invalid="ignore", divide="ignore"):
            normal = np.cross(np.roll(points, step, axis=1) - points, np.roll(points, step, axis=0) - points)
            cosine = np.abs(np.sum(normal * rays, axis=2))
            cosines.append(cosine / (np.linalg.norm(normal, axis=2) * np.linalg.norm(rays, axis=2)))
    slant = np.arccos(np.clip(np.nan_to_num(np.fmax(*cosines), nan=1.0), 0.0, 1.0)) * 0.999
    return np.repeat(np.repeat(slant, 2, axis=0), 2, axis=1)[: shape[0], : shape[1]]
