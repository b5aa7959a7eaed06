"""URDFs for the tests: arms put together link by link, with frames wherever the seed throws them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from planners.geometry.pose import inverse, transform

UR5E_AXES = (
    ((0.0, 0.0, 1.0), (0.0, 0.0, 0.1625)),
    ((0.0, -1.0, 0.0), (0.0, 0.0, 0.1625)),
    ((0.0, -1.0, 0.0), (-0.425, 0.0, 0.1625)),
    ((0.0, -1.0, 0.0), (-0.8172, -0.1333, 0.1625)),
    ((0.0, 0.0, -1.0), (-0.8172, -0.1333, 0.1625)),
    ((0.0, -1.0, 0.0), (-0.8172, -0.1333, 0.0628)),
)
"""Direction and a point of each axis at zero, in the base [m]."""
UR5E_TIP = transform(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), [-0.8172, -0.2329, 0.0628])
INDUSTRIAL_AXES = (
    ((0.0, 0.0, -1.0), (0.0, 0.0, 0.2)),
    ((0.0, 1.0, 0.0), (0.025, 0.0, 0.4)),
    ((0.0, 1.0, 0.0), (0.48, 0.0, 0.4)),
    ((-1.0, 0.0, 0.0), (0.7, 0.0, 0.435)),
    ((0.0, 1.0, 0.0), (0.9, 0.0, 0.435)),
    ((-1.0, 0.0, 0.0), (0.95, 0.0, 0.435)),
)
"""As Kuka counts: axis 1 down, axes 4 and 6 towards the base."""
INDUSTRIAL_TIP = transform(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), [0.98, 0.0, 0.435])


@dataclass
class UrdfArm:
    """What a test writes, and may change before it does."""

    axes: tuple
    T_base_tip: np.ndarray
    T_root_base: np.ndarray = field(default_factory=lambda: np.eye(4))
    """Where the base of the axes is in the root link."""
    seed: int | None = 0
    """Of the frames between joints; None: they have the root's axes, each on its joint."""
    square: bool = False
    """Whether those frames have the root's axes, in any order and with any sign."""
    digits: int = 17
    """Of the angles."""
    shape: str = '<box size="0.1 0.08 0.06"/>'
    limit: str = 'lower="-2.9" upper="2.5" velocity="3.1" effort="120"'
    kinds: tuple[str, ...] = ("revolute",) * 6
    mass: float = 2.5
    more: str = ""
    link_more: str = ""
    joint_more: str = ""

    def write(self) -> bytes:
        rng = np.random.default_rng(self.seed)
        frames = [np.eye(4)]
        for axis, point in self.axes:
            along, turn = 0.0, np.eye(3)
            if self.square:
                turn = Rotation.create_group("O")[int(rng.integers(24))].as_matrix()
            elif self.seed is not None:
                along, turn = rng.uniform(-0.2, 0.2), Rotation.random(rng=rng).as_matrix()
            frames.append(self.T_root_base @ transform(turn, np.array(point) + along * np.array(axis)))
        text = "".join(self._link(i, rng) for i in range(len(frames)))
        for i, (axis, _) in enumerate(self.axes, start=1):
            direction = frames[i][:3, :3].T @ self.T_root_base[:3, :3] @ axis
            text += (
                f'<joint name="j{i}" type="{self.kinds[i - 1]}"><parent link="l{i - 1}"/><child link="l{i}"/>'
                f'{self._origin(inverse(frames[i - 1]) @ frames[i])}<axis xyz="{self._numbers(direction)}"/>'
                f"<limit {self.limit}/>{self.joint_more}</joint>"
            )
        last = len(self.axes)
        tip = inverse(frames[-1]) @ self.T_root_base @ self.T_base_tip
        text += (
            f'<link name="tip"/><joint name="flange" type="fixed"><parent link="l{last}"/><child link="tip"/>'
            f"{self._origin(tip)}</joint>{self.more}"
        )
        return f'<?xml version="1.0"?><robot name="arm">{text}</robot>'.encode()

    def _link(self, i: int, rng: np.random.Generator) -> str:
        place = transform(Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.1, 0.1, 3))
        inertial = (
            f'<inertial>{self._origin(place)}<mass value="{self.mass}"/>'
            '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
            if self.mass
            else ""
        )
        collision = (
            f"<collision>{self._origin(place)}<geometry>{self.shape}</geometry></collision>" if self.shape else ""
        )
        return f'<link name="l{i}">{inertial}{collision}{self.link_more if i == 3 else ""}</link>'

    def _origin(self, T: np.ndarray) -> str:
        turn = Rotation.from_matrix(T[:3, :3]).as_euler("xyz", suppress_warnings=True)
        return f'<origin xyz="{self._numbers(T[:3, 3])}" rpy="{self._numbers(turn, self.digits)}"/>'

    def _numbers(self, values: np.ndarray, digits: int = 17) -> str:
        return " ".join(f"{value:.{digits}f}" for value in values)


def ur5e(**changes) -> UrdfArm:
    return UrdfArm(UR5E_AXES, UR5E_TIP, **changes)


def industrial(**changes) -> UrdfArm:
    return UrdfArm(INDUSTRIAL_AXES, INDUSTRIAL_TIP, **changes)
