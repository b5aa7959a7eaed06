"""Where a plate stands at the rim of its support nobody knows which edge bears: forces have to be possible with either.

A plate that is a little off stands inside the rim on its own edge, and the support's face gives the normal; or beyond
it, and the support's edge bears the plate's bottom face, whose normal it is then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import ConvexHull

from planners.certify.geometry.level_contacts import LEVEL
from planners.certify.motion.segment_motion import BodyContacts
from planners.certify.plan_view import BodyView, PlanView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array

_ON_IT = 1e-6
"""Vertices so near to the plane of a face are of it [m]."""


class Rim:
    """The rim of what the plate of a lift rests on."""

    def __init__(self, plan: PlanView, settings: CertifySettings) -> None:
        self._sides, self._near = _sides(plan.bodies[plan.support]), settings.rim

    def normals(self, contact_set: BodyContacts) -> dict[int, Array]:
        """Return the normals (3,) that contacts have if the plate stands beyond the rim, by number among the bearing.

        World axes, into the plate; contacts that are not at the rim have none.
        """
        bottom = contact_set.T_world_body[:3, 2]
        return {
            number: bottom
            for number, contact in enumerate(contact_set.bearing)
            if contact.kind == "environment"
            and float((self._sides[:, :2] @ contact.point[:2] + self._sides[:, 2]).max()) >= -self._near
        }

    def either_way(self, contact_sets: Sequence[BodyContacts]) -> list[BodyContacts]:
        """Return contact sets in which each contact at the rim is there once more, as it is beyond it.

        For what is asked of each contact alone: the sum of their forces is no longer that of the set.
        """
        result = []
        for contact_set in contact_sets:
            bearing = contact_set.bearing
            beyond = [
                bearing[number].model_copy(update={"normal": normal})
                for number, normal in self.normals(contact_set).items()
            ]
            result.append(replace(contact_set, contacts=(*contact_set.contacts, *beyond)) if beyond else contact_set)
        return result


def _sides(support: BodyView) -> Array:
    """Return the sides of a support's top: (n, 3) outward normals and offsets, of points [x, y, 1] in the world [m]."""
    T, vertices = support.T_world_start, support.shape.vertices
    planes = np.vstack([part.planes for part in support.shape.parts])
    rises = planes[:, :3] @ T[2, :3]
    # Of the highest of its level faces, which may be tilted by as much as still counts as level.
    top = (rises >= LEVEL) & (-planes[:, 3] * rises + T[2, 3] >= support.top - _ON_IT)
    on_top = (np.abs(vertices @ planes[top, :3].T + planes[top, 3]) <= _ON_IT).any(axis=1)
    return ConvexHull(vertices[on_top] @ T[:2, :3].T + T[:2, 3]).equations
