"""A small but complete plan, made without a planner: grip, push, tilt about an edge, lift.

The plate lies on a narrow block, so that a flat plate can be gripped at its rim. Arms follow straight Cartesian lines,
splined in joint space and run through by a minimum-jerk law; balances are stated in cvxpy, a little inside the
cones.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import coal
import cvxpy as cp
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from planners.cell.cell import Cell, load_cell
from planners.certify import CellReference, RobotSurfaces, load_surfaces
from planners.certify.motion.solids import ConvexSolid
from planners.geometry.pose import frame_from_z, inverse, rotation_y, skew, to_pose7, transform
from planners.kinematics.inverse import inverse_kinematics
from planners.planning import reference_of
from tests.support.documents import bodies_of, cell_of

Array = NDArray[np.float64]
STEP = 0.02
PLATE_SIZE = np.array([0.3, 0.3, 0.04])
SUPPORT_SIZE = np.array([0.3, 0.2, 0.15])
TABLE_TOP = 1.094
SUPPORT_TOP = TABLE_TOP + SUPPORT_SIZE[2]
PLATE_CENTRE = np.array([0.26, 0.0, SUPPORT_TOP + PLATE_SIZE[2] / 2])
MASS = 2.0
CUP = {"position": [0.0, 0.0], "radius": 0.0175, "max_force": 20.0, "mu": 0.5, "kappa": 0.005}
CUP_HEIGHT, CABLE_LENGTH = 0.04, 1.1
OPEN, GRIPPED = 0.085, float(PLATE_SIZE[2])
BRANCH = {"left": 2, "right": 5}
"""Inverse kinematics branches along which everything is reached without a collision."""


@dataclass
class _Builder:
    """Appends segments to a document."""

    cell: Cell
    q: dict[str, Array] = field(default_factory=dict)
    time: float = 0.0
    width: float = OPEN
    plate: Array = field(default_factory=lambda: transform(None, PLATE_CENTRE))
    segments: list[dict[str, Any]] = field(default_factory=list)

    def solve(self, arm: str, T_world_flange: Array, near: Array | None) -> Array:
        """The joint positions of one branch, wound to be near the ones before."""
        found = np.empty((8, 6))
        dh, T_world_base = self.cell.arms[arm].dh, self.cell.arms[arm].T_world_base
        mask = inverse_kinematics(dh, inverse(T_world_base) @ T_world_flange, 0.0, found)
        assert mask >> BRANCH[arm] & 1
        q = found[BRANCH[arm]]
        return q if near is None else q + 2 * np.pi * np.round((near - q) / (2 * np.pi))

    def follow(self, arm: str, path: Callable[[float], Array], duration: float) -> tuple[Array, Array, Array]:
        """Positions, velocities, accelerations along a path of flange poses over s in [0, 1]."""
        nodes = np.linspace(0.0, 1.0, 81)
        rows, near = [], self.q.get(arm)
        for s in nodes:
            near = self.solve(arm, path(float(s)), near)
            rows.append(near)
        spline = CubicSpline(nodes, np.array(rows))
        t = sample_times(duration) / duration
        s = t**3 * (10 - 15 * t + 6 * t * t)
        ds = (30 * t**2 - 60 * t**3 + 30 * t**4) / duration
        dds = (60 * t - 180 * t**2 + 120 * t**3) / duration**2
        q = spline(s)
        self.q[arm] = q[-1]
        return q, spline(s, 1) * ds[:, None], spline(s, 2) * ds[:, None] ** 2 + spline(s, 1) * dds[:, None]

    def add(
        self,
        kind: str,
        duration: float,
        paths: dict[str, Callable[[float], Array]],
        hold: dict[str, Any] | None,
        element: str,
        *,
        close_to: float | None = None,
    ) -> None:
        """Append one segment; the plate follows the right flange when it is gripped."""
        time = sample_times(duration)
        n = len(time)
        rest = {arm: np.tile(self.q[arm], (n, 1)) for arm in ("left", "right") if arm not in paths}
        moved = {arm: self.follow(arm, path, duration) for arm, path in paths.items()}
        arrays = [
            np.hstack(
                [
                    moved[arm][k] if arm in moved else (rest[arm] if k == 0 else 0 * rest[arm])
                    for arm in ("left", "right")
                ]
            )
            for k in range(3)
        ]
        widths = np.linspace(self.width, self.width if close_to is None else close_to, n)
        segment: dict[str, Any] = {
            "kind": kind,
            "movers": sorted(paths),
            "contact_state": contact_state(element),
            "hold": copy.deepcopy(hold),
            "time": (self.time + time).tolist(),
            "positions": arrays[0].tolist(),
            "velocities": arrays[1].tolist(),
            "accelerations": arrays[2].tolist(),
            "gripper_width": {"right": widths.tolist()},
            "attached": {},
            "body_poses": {},
            "contacts": [],
        }
        held = hold is not None and hold["grip"] is not None and kind not in ("grip", "release")
        plates = np.broadcast_to(self.plate, (n, 4, 4))
        if held:
            flanges = np.array([self.flange("right", q[6:]) for q in arrays[0]])
            T_flange_plate = inverse(flanges[0]) @ self.plate
            segment["attached"]["plate"] = [{"to": "right", "pose": to_pose7(T_flange_plate)}]
            if "right" in paths:
                plates = flanges @ T_flange_plate
                segment["body_poses"] = body_rows(plates)
            self.balance(segment, plates, hold, element, time)
        self.plate, self.width, self.time = plates[-1], float(widths[-1]), self.time + float(time[-1])
        self.segments.append(segment)

    def flange(self, arm: str, q: Array) -> Array:
        """Forward kinematics straight from the contract's formula."""
        T = self.cell.arms[arm].T_world_base
        for (a, alpha, d, theta0), angle in zip(self.cell.arms[arm].dh, q, strict=True):
            c, s = np.cos(angle + theta0), np.sin(angle + theta0)
            ca, sa = np.cos(alpha), np.sin(alpha)
            T = T @ np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])
        return T

    def balance(self, segment: dict[str, Any], plates: Array, hold: dict[str, Any], element: str, time: Array) -> None:
        """Write a contact set at the first and last sample and as often as the contract asks in between."""
        acceleration = np.zeros((len(time), 3))
        acceleration[1:-1] = np.diff(plates[:, :3, 3], 2, axis=0) / STEP**2 if len(time) > 2 else 0.0
        for sample in set_samples(plates, time):
            pushed = hold["push"] is not None and segment["kind"] != "approach"
            touching = element if 0 < sample < len(time) - 1 or element != "none" else "none"
            segment["contacts"] += contact_set(plates[sample], sample, pushed, touching, acceleration[sample])


def sample_times(duration: float) -> Array:
    return np.arange(round(duration / STEP) + 1) * STEP


def set_samples(plates: Array, time: Array) -> list[int]:
    samples = [0]
    for k in range(1, len(time)):
        last = plates[samples[-1]]
        chord = np.linalg.norm(plates[k, :3, :3] - last[:3, :3]) / np.sqrt(2)
        far = chord > np.radians(1.6) or np.linalg.norm(plates[k, :3, 3] - last[:3, 3]) > 0.008
        if far or time[k] - time[samples[-1]] > 0.23 or k == len(time) - 1:
            samples.append(k)
    return samples


def bottom_corners() -> list[list[float]]:
    x, y, z = PLATE_SIZE / 2
    return [[-x, -y, -z], [x, -y, -z], [x, y, -z], [-x, y, -z]]


def contact_state(element: str) -> dict[str, Any]:
    corners = bottom_corners()
    vertices = {"face": corners, "edge": corners[1:3], "none": []}[element]
    index = None if element == "none" else 0
    return {"element": element, "index": index, "with": None if element == "none" else "support", "vertices": vertices}


def body_rows(plates: Array) -> dict[str, Any]:
    cup = transform(None, [*CUP["position"], PLATE_SIZE[2] / 2 + CUP_HEIGHT / 2])
    foot = np.array([*CUP["position"], PLATE_SIZE[2] / 2 + CUP_HEIGHT, 1.0])
    cables = [transform(None, np.add((T @ foot)[:3], [0, 0, CABLE_LENGTH / 2])) for T in plates]
    return {
        "plate": [to_pose7(T) for T in plates],
        "cup": [to_pose7(T @ cup) for T in plates],
        "cable": [to_pose7(T) for T in cables],
    }


GRIP_POINTS = ([0.0, -0.132, 0.02], [0.0, -0.132, -0.02])
"""Finger 1 is at the flange's +y, which is the plate's +z."""
PUSH_POINT = [0.0, 0.15, 0.0]


@dataclass
class _Entry:
    """One contact: its document, and the linear map (6, k) from its unknowns to the wrench at its point."""

    record: dict[str, Any]
    unknowns: Array
    guess: Array


def contact_set(plate: Array, sample: int, pushed: bool, element: str, acceleration: Array) -> list[dict[str, Any]]:
    """The contacts of one balanced set, near a guess."""
    com = plate[:3, 3]
    entries = [*finger_entries(plate), cup_entry(plate)]
    if pushed:
        normal = -plate[:3, 1]
        point = plate[:3, :3] @ np.array(PUSH_POINT) + com
        entries.append(entry(point, normal, [0, 0, 2.0], kind="point", by="left", mu=0.5, limit=17.0))
    if element != "none":
        entries += environment_entries(plate, element)
    columns = []
    for item in entries:
        lever = np.array(item.record["point"]) - com
        columns.append(np.block([[np.eye(3), np.zeros((3, 3))], [skew(lever), np.eye(3)]]) @ item.unknowns)
    load = np.concatenate([MASS * (np.array([0, 0, -9.81]) - acceleration), np.zeros(3)])
    x = well_inside(entries, np.hstack(columns), load)
    records, first = [], 0
    for item in entries:
        wrench = item.unknowns @ x[first : first + len(item.guess)]
        first += len(item.guess)
        suction = {"suction_force": float(wrench[:3] @ plate[:3, 2])} if item.record["kind"] == "suction" else {}
        records.append(item.record | suction | {"wrench": wrench.tolist(), "sample": sample, "body": "plate"})
    if np.any(acceleration):
        inertia = {"kind": "inertia", "by": None, "finger": None, "point": com.tolist(), "normal": None}
        wrench = [*(-MASS * acceleration).tolist(), 0.0, 0.0, 0.0]
        records.append(inertia | {"wrench": wrench, "sample": sample, "body": "plate"})
    return records


def entry(point: Array, normal: Array, guess: list[float], **record: Any) -> _Entry:
    """A contact with two shears, a normal force and, with four unknowns, a torque about the normal."""
    frame = frame_from_z(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    unknowns = np.zeros((6, len(guess)))
    unknowns[:3, :3] = frame
    unknowns[3:, 3:] = normal[:, None]
    record = {"finger": None} | record | {"point": point.tolist(), "normal": normal.tolist()}
    return _Entry(record, unknowns, np.array(guess))


def finger_entries(plate: Array) -> list[_Entry]:
    R, p = plate[:3, :3], plate[:3, 3]
    values = {"kind": "soft_finger", "by": "right", "mu": 0.5, "eps": 0.0075, "limit": 17.0}
    return [
        entry(R @ np.array(GRIP_POINTS[1 - finger]) + p, sign * R[:, 2], [0, 0, 8.0, 0], finger=finger, **values)
        for finger, sign in ((0, 1.0), (1, -1.0))
    ]


def environment_entries(plate: Array, element: str) -> list[_Entry]:
    """The ends of the edge or the corners of the face, where the narrower support ends."""
    corners = np.array(bottom_corners())[1:3] if element == "edge" else np.array(bottom_corners())
    corners = corners * [1.0, SUPPORT_SIZE[1] / PLATE_SIZE[1], 1.0] @ plate[:3, :3].T + plate[:3, 3]
    up, guess = np.array([0.0, 0.0, 1.0]), [0, 0, 4.0 / len(corners)]
    return [entry(corner, up, guess, kind="environment", by="support", mu=0.4, limit=None) for corner in corners]


def cup_entry(plate: Array) -> _Entry:
    """Forces only, along the plate's axes, the third one the pull."""
    pad = plate[:3, :3] @ [*CUP["position"], PLATE_SIZE[2] / 2] + plate[:3, 3]
    values = {"mu": CUP["mu"], "radius": CUP["radius"], "kappa": CUP["kappa"], "limit": CUP["max_force"]}
    item = entry(pad, -plate[:3, 2], [0, 0, 15.0], kind="suction", by="cup", x_axis=plate[:3, 0].tolist(), **values)
    item.unknowns[:3] = plate[:3, :3]
    return item


def well_inside(entries: list[_Entry], matrix: Array, load: Array) -> Array:
    """The balanced unknowns nearest to the guess that keep 0.1 N from every cone and limit."""
    guess = np.concatenate([item.guess for item in entries])
    x = cp.Variable(len(guess))
    constraints, first = [matrix @ x + load == 0], 0
    for item in entries:
        record, k = item.record, len(item.guess)
        shear, normal = x[first : first + 2], x[first + 2]
        if record["kind"] == "suction":
            constraints += [np.sqrt(3) * cp.abs(shear) <= record["mu"] * normal - 0.1, normal <= record["limit"] - 0.1]
        else:
            twist = cp.hstack([shear, x[first + 3] / record["eps"]]) if k == 4 else shear
            constraints += [cp.norm(twist) <= record["mu"] * normal - 0.1, normal <= (record["limit"] or 100.0) - 0.1]
        first += k
    problem = cp.Problem(cp.Minimize(cp.sum_squares(x - guess)), constraints)
    problem.solve(solver=cp.CLARABEL)
    assert problem.status == cp.OPTIMAL
    # What the solver leaves of the balance, a few micronewtons, goes to the contacts as one shift.
    return x.value - np.linalg.lstsq(matrix, matrix @ x.value + load, rcond=None)[0]


def build_document(cell: Cell, surfaces: RobotSurfaces, slide: float = 0.0) -> dict[str, Any]:
    """The whole plan. The plate is pulled along by `slide` while it tilts [m]."""
    builder = _Builder(cell)
    down = np.array([0.0, -np.cos(np.radians(35)), -np.sin(np.radians(35))])
    R_stick = frame_from_z(down, [1.0, 0.0, 0.0])
    R_grip = np.column_stack([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    table = cell_of(cell)["hands"]["right"]["tcp"]
    z_tcp = float(np.interp(GRIPPED, *np.array(table).T))
    T_plate_tcp = transform(R_grip, [0.0, -0.132, 0.0])
    T_plate_right = T_plate_tcp @ inverse(transform(None, [0.0, 0.0, z_tcp]))
    T_plate_left = transform(R_stick, np.add(PUSH_POINT, [0.0, 0.01, 0.0]) - 0.2944 * down)

    def right(plate: Array, back: float = 0.0) -> Array:
        return plate @ T_plate_right @ transform(None, [0.0, 0.0, -back])

    def left(plate: Array, back: float = 0.0) -> Array:
        return transform(None, plate[:3, :3] @ [0.0, back, back]) @ plate @ T_plate_left

    start = builder.plate
    edge = start @ np.array([PLATE_SIZE[0] / 2, 0.0, -PLATE_SIZE[2] / 2, 1.0])

    def tilted(angle: float) -> Array:
        # Negative about y lifts the plate's near side (-x) about its far edge.
        aside = edge[:3] - [slide * angle / TILT, 0.0, 0.0]
        return transform(None, aside) @ transform(rotation_y(angle)) @ transform(None, -edge[:3]) @ start

    def raised(height: float) -> Array:
        return transform(None, [0.0, 0.0, height]) @ tilted(TILT)

    builder.q = {
        "left": builder.solve("left", left(start, 0.05), None),
        "right": builder.solve("right", right(start, 0.2), None),
    }
    grip = {"arm": "right", "body": "plate", "pose": to_pose7(T_plate_tcp), "width": GRIPPED}
    push = {"arm": "left", "body": "plate", "point": PUSH_POINT, "normal": [0.0, -1.0, 0.0]}
    q_start = np.concatenate([builder.q["left"], builder.q["right"]])
    builder.add("transit", 1.2, {"right": lambda s: right(start, 0.2 - 0.1 * s)}, None, "face")
    builder.add("approach", 1.2, {"right": lambda s: right(start, 0.1 - 0.1 * s)}, None, "face")
    builder.add("grip", 0.6, {}, {"grip": grip, "push": None}, "face", close_to=GRIPPED)
    builder.add("approach", 1.0, {"left": lambda s: left(start, 0.05 - 0.05 * s)}, {"grip": grip, "push": None}, "face")
    both = {"grip": grip, "push": push}
    for element, path in (("edge", lambda s: tilted(TILT * s)), ("none", lambda s: raised(LIFT * s))):
        paths = {"left": lambda s, p=path: left(p(s)), "right": lambda s, p=path: right(p(s))}
        builder.add("transfer", 1.4, paths, both, element)
    return {
        "schema_version": "1.0",
        "id": "synthetic",
        "task": task_document(q_start),
        "seed": 0,
        "software": {"name": "liftwright", "version": "0", "commit": None},
        "outcome": "solved",
        "explanation": {"summary": "made by hand", "causes": []},
        "cell": cell_of(cell),
        "joint_names": list(cell.joint_names),
        "bodies": bodies_document(cell, start),
        "segments": builder.segments,
        "certificate": None,
        "simulation": None,
        "statistics": {"total_seconds": 0.0, "stages": [], "graph": {}, "search": {}, "rejections": {}},
    }


TILT, LIFT = float(np.radians(6.0)), 0.035


def task_document(q_start: Array) -> dict[str, Any]:
    support = [*PLATE_CENTRE[:2], TABLE_TOP + SUPPORT_SIZE[2] / 2, 1.0, 0.0, 0.0, 0.0]
    return {
        "kind": "plate_lift",
        "cell": "dual_ur3e_lift",
        "plate": {"shape": {"type": "box", "size": PLATE_SIZE.tolist()}, "mass": MASS, "com": [0.0, 0.0, 0.0]},
        "plate_pose": [*PLATE_CENTRE.tolist(), 1.0, 0.0, 0.0, 0.0],
        "support": {"shape": {"type": "box", "size": SUPPORT_SIZE.tolist()}, "pose": support},
        "cup": CUP,
        "lifter_model": "paper",
        "friction": {"grip": 0.5, "push": 0.5, "environment": 0.4, "eps": 0.0075},
        "hand_force_limit": {"normal": 17.0, "net": 19.0},
        "obstacles": [
            {"name": "post", "shape": {"type": "cylinder", "radius": 0.02, "height": 0.3},
             "pose": [0.62, 0.3, TABLE_TOP + 0.15, 1.0, 0.0, 0.0, 0.0]}
        ],
        "start_positions": q_start.tolist(),
        "seed": 0,
        "external_id": None,
        "options": {"goal_height": 0.03},
    }  # fmt: skip


def bodies_document(cell: Cell, plate: Array) -> dict[str, Any]:
    task = task_document(np.zeros(12))
    rows = body_rows(plate[None])

    def body(role: str, shape: dict[str, Any], pose: list[float], mass: float | None = None) -> dict[str, Any]:
        static = role in ("support", "obstacle")
        return {"role": role, "shape": shape, "mass": mass, "com": [0.0] * 3, "pose": pose, "static": static}

    post = task["obstacles"][0]
    return bodies_of(cell) | {
        "plate": body("plate", task["plate"]["shape"], rows["plate"][0], MASS),
        "support": body("support", task["support"]["shape"], task["support"]["pose"]),
        "cup": body("cup", {"type": "cylinder", "radius": CUP["radius"], "height": CUP_HEIGHT}, rows["cup"][0]),
        "cable": body("cable", {"type": "cylinder", "radius": 0.01, "height": CABLE_LENGTH}, rows["cable"][0]),
        "post": body("obstacle", post["shape"], post["pose"]),
    }


@pytest.fixture(scope="session")
def surfaces() -> RobotSurfaces:
    return load_surfaces()


@pytest.fixture(scope="session")
def cell() -> Cell:
    return load_cell("dual_ur3e_lift")


@pytest.fixture(scope="session")
def reference(cell: Cell) -> CellReference:
    return reference_of(cell)


@pytest.fixture(scope="session")
def honest_document(cell: Cell, surfaces: RobotSurfaces) -> dict[str, Any]:
    return build_document(cell, surfaces)


@pytest.fixture(scope="session")
def sliding_document(cell: Cell, surfaces: RobotSurfaces) -> Callable[[float], dict[str, Any]]:
    """The same plan with a plate that slides on its edge by so much [m]."""
    return lambda slide: build_document(cell, surfaces, slide)


@pytest.fixture
def document(honest_document: dict[str, Any]) -> dict[str, Any]:
    return copy.deepcopy(honest_document)


@pytest.fixture(scope="session")
def true_distance() -> Callable[[ConvexSolid, Array, ConvexSolid, Array], float]:
    """Distances by coal, which is exact; each solid's shape is made once."""
    shapes: dict[ConvexSolid, coal.CollisionGeometry] = {}

    def shape_of(solid: ConvexSolid) -> coal.CollisionGeometry:
        if solid not in shapes:
            points = coal.StdVec_Vec3s()
            for point in solid.points:
                points.append(point)
            length = float(np.linalg.norm(solid.points[-1] - solid.points[0]))
            hull = solid.part is not None
            shapes[solid] = coal.Convex.convexHull(points, False, None) if hull else coal.Capsule(solid.radius, length)
        return shapes[solid]

    def placed(T: Array) -> coal.Transform3s:
        return coal.Transform3s(T[:3, :3], T[:3, 3])

    def distance(a: ConvexSolid, T_a: Array, b: ConvexSolid, T_b: Array) -> float:
        at_a, at_b = placed(T_a @ a.T_frame_shape), placed(T_b @ b.T_frame_shape)
        return coal.distance(shape_of(a), at_a, shape_of(b), at_b, coal.DistanceRequest(), coal.DistanceResult())

    return distance
