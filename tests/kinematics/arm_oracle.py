"""Arms for the kinematics tests, and pinocchio models of them that share no code with ours."""

from __future__ import annotations

import math
import re
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pinocchio as pin

MODELS = Path(find_spec("airo_models").submodule_search_locations[0])
RIGHT_ANGLE = math.pi / 2


def dh_table(a2: float, a3: float, d1: float, d4: float, d5: float, d6: float) -> np.ndarray:
    """Return the (6, 4) table of a UR arm."""
    rows = [
        [0.0, RIGHT_ANGLE, d1, 0.0],
        [a2, 0.0, 0.0, 0.0],
        [a3, 0.0, 0.0, 0.0],
        [0.0, RIGHT_ANGLE, d4, 0.0],
        [0.0, -RIGHT_ANGLE, d5, 0.0],
        [0.0, 0.0, d6, 0.0],
    ]
    return np.array(rows)


UR3E = dh_table(-0.24355, -0.2132, 0.15185, 0.13105, 0.08535, 0.0921)
UR3 = dh_table(-0.24365, -0.21325, 0.1519, 0.11235, 0.08535, 0.0819)
OFFSET = UR3E.copy()
OFFSET[:, 3] = [0.3, -1.2, 2.5, 0.7, -0.4, 1.9]
OFFSET[1:3, 2] = [0.01, -0.02]
TURNED_ROUND = OFFSET.copy()
"""Three parallel axes, one of them turned round, and other signs at the right angles."""
TURNED_ROUND[:, 1] = np.radians([-90.0, 180.0, 0.0, -90.0, -90.0, 180.0])
INDUSTRIAL = np.array(
    [
        [0.15, -RIGHT_ANGLE, 0.445, 0.0],
        [0.7, 0.0, 0.0, -RIGHT_ANGLE],
        [0.115, -RIGHT_ANGLE, 0.0, 0.0],
        [0.0, RIGHT_ANGLE, 0.795, 0.0],
        [0.0, -RIGHT_ANGLE, 0.0, 0.0],
        [0.0, 0.0, 0.085, math.pi],
    ]
)
"""A spherical wrist, as industrial arms of middle size have it."""
PUMA = np.array(
    [
        [-0.05, RIGHT_ANGLE, 0.3, 0.2],
        [-0.43, math.pi, 0.15, 0.4],
        [0.02, RIGHT_ANGLE, -0.07, -1.3],
        [0.0, RIGHT_ANGLE, -0.43, 0.6],
        [0.0, RIGHT_ANGLE, 0.0, -0.9],
        [0.03, 2.2, -0.06, 1.1],
    ]
)
"""A spherical wrist with an arm beside its first axis, axes turned round, and a flange aslant."""
ARMS = {
    "ur3e": UR3E,
    "ur3": UR3,
    "ur3e with joint offsets": OFFSET,
    "parallel axes turned round": TURNED_ROUND,
    "industrial": INDUSTRIAL,
    "puma": PUMA,
}


class PinocchioArm:
    """An arm on its base, built joint by joint from the table."""

    def __init__(self, dh: np.ndarray) -> None:
        self.model = pin.Model()
        parent, placement = 0, pin.SE3.Identity()
        for i, (a, alpha, d, theta0) in enumerate(dh):
            offset = pin.SE3(pin.utils.rotate("z", theta0), np.zeros(3))
            parent = self.model.addJoint(parent, pin.JointModelRZ(), placement * offset, f"joint_{i + 1}")
            placement = pin.SE3(pin.utils.rotate("x", alpha), np.array([a, 0.0, d]))
        self.flange = self.model.addFrame(pin.Frame("flange", parent, 0, placement, pin.FrameType.OP_FRAME))
        self.data = self.model.createData()

    def flange_pose(self, q: np.ndarray) -> np.ndarray:
        """Return `T_base_flange`."""
        pin.forwardKinematics(self.model, self.data, q)
        return pin.updateFramePlacement(self.model, self.data, self.flange).homogeneous

    def flange_poses(self, Q: np.ndarray) -> np.ndarray:
        """Return `T_base_flange` (n, 4, 4)."""
        return np.array([self.flange_pose(q) for q in Q]).reshape(-1, 4, 4)

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return [v; w] of the flange's origin in the base's axes."""
        return pin.computeFrameJacobian(self.model, self.data, q, self.flange, pin.LOCAL_WORLD_ALIGNED)


def published_urdf(path: str) -> str:
    """Read a URDF of airo-models without what makes it invalid XML."""
    text = (MODELS / path).read_text()
    text = re.sub(r"<drake:.*?</drake:collision_filter_group>", "", text, flags=re.DOTALL)
    return re.sub(r'drake:\w+="[^"]*"', "", text)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    """Return any rigid transform within a metre."""
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, rng.uniform(-1.0, 1.0, 3)
    return pose
