"""The rim of a support is that of its highest level face, however that is turned, and tilted as far as is level."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planners.certify.lift.rim import Rim
from planners.certify.motion.segment_motion import BodyContacts
from planners.certify.plan_view import BodyView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array, pose_row, rotation_x, rotation_z, transform
from planners.plan.contacts import EnvironmentContact
from planners.plan.scenery import BodyDocument

BOX = {"type": "box", "size": [0.4, 0.3, 0.05]}
CYLINDER = {"type": "cylinder", "radius": 0.2, "height": 0.05}


class Standing:
    """What is asked of a plan: its support."""

    support = "support"

    def __init__(self, shape: dict[str, object], T: Array) -> None:
        stated = {"shape": shape, "role": "support", "mass": None, "com": [0.0, 0.0, 0.0], "static": True}
        body = BodyDocument.model_validate({**stated, "pose": pose_row(T).tolist()})
        self.bodies = {"support": BodyView.of("support", body)}


def at_rim(standing: Standing, point: Array) -> bool:
    """Whether a contact at a point (3,) of the support's top, in its frame [m], is at the rim."""
    T = standing.bodies["support"].T_world_start
    place = T[:3, :3] @ point + T[:3, 3]
    up = np.array([0.0, 0.0, 1.0])
    contact = EnvironmentContact.model_construct(kind="environment", point=place, normal=up, by="support", body="plate")
    contact_set = BodyContacts(None, 0, "plate", np.eye(4), (contact,))  # type: ignore[arg-type]
    return 0 in Rim(standing, CertifySettings()).normals(contact_set)  # type: ignore[arg-type]


@pytest.mark.parametrize("tilt", [0.0, 0.001, 0.05, 0.09])
@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_what_is_within_a_millimetre_of_the_rim_is_at_it(tilt: float, yaw: float) -> None:
    T = transform(rotation_z(yaw) @ rotation_x(math.radians(tilt)), np.array([0.3, -0.1, 1.1]))
    for shape, half in ((BOX, 0.2), (CYLINDER, 0.2)):
        standing = Standing(shape, T)
        for inside, there in ((0.0, True), (0.0005, True), (-0.003, True), (0.002, False), (0.1, False)):
            assert at_rim(standing, np.array([half - inside, 0.0, 0.025])) is there, (shape, inside)
