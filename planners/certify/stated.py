"""What tasks of both kinds state, as far as the certificate compares plans with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel

from planners.certify.body_shape import BodyShape
from planners.certify.plan_view import MalformedDocument, shape_of
from planners.contract.shapes import Box, Cylinder, InlineMesh, Mesh, Prism
from planners.contract.task_spec import PlateLiftTask, SuctionToolTask
from planners.geometry.pose import Array, Transform, from_pose7


@dataclass(frozen=True, eq=False)
class StatedBody:
    """A body as the task places it."""

    name: str
    shape: BodyShape | None
    """None for a mesh that the task names by asset or upload."""
    T_world_body: Transform
    mass: float | None = None
    com: Array | None = None


_OPTIONAL = frozenset(
    {
        *("contact_model", "mass_tolerance", "com_tolerance", "squeeze", "carry_force_limit"),
        *("cell", "scene_id", "external_id", "seed"),
        *("reserve", "minimise", "search", "simulate", "contact_density", "hold_density", "grips", "pushes"),
    }
)
"""Members that tasks of 0.1.0 do not have, or that say nothing about the plan."""


def require_stated(stated: Any, pointer: str = "/task") -> None:
    """Refuse a task that leaves a default to its reader: it has to hold whatever defaults there are later.

    Raises:
        MalformedDocument: a member is not stated.
    """
    if isinstance(stated, tuple):
        for index, each in enumerate(stated):
            require_stated(each, f"{pointer}/{index}")
    elif isinstance(stated, BaseModel):
        for name in type(stated).model_fields:
            if name in stated.model_fields_set:
                require_stated(getattr(stated, name), f"{pointer}/{name}")
            elif name not in _OPTIONAL:
                raise MalformedDocument(f"{pointer}/{name}", "is missing")


def stated_shape(shape: Box | Cylinder | Prism | Mesh | InlineMesh, pointer: str) -> BodyShape | None:
    """Return a shape; None for a mesh that is only named."""
    return None if isinstance(shape, Mesh) else shape_of(shape, pointer)


def stated_obstacles(task: PlateLiftTask | SuctionToolTask) -> list[StatedBody]:
    """Return the obstacles of a task."""
    return [
        StatedBody(each.name, stated_shape(each.shape, f"/task/obstacles/{i}/shape"), from_pose7(each.pose))
        for i, each in enumerate(task.obstacles)
    ]


def stated_start(task: PlateLiftTask | SuctionToolTask) -> Array | None:
    """Return where the joints start: (12,); None where the task leaves it to the cell."""
    return None if task.start_positions is None else np.array(task.start_positions)
