"""What changes of a task are about, in words."""

from __future__ import annotations

from types import MappingProxyType

KINDS = MappingProxyType(
    {
        "reserve": "more of every limit kept back",
        "cup_place": "another place of the cup",
        "cup_force": "a stronger cup",
        "cup_radius": "a cup of another size",
        "hand_limits": "more force of the hands",
        "lifter_model": "another kind of lifter",
        "tolerances": "mass and centre of mass known better",
        "plate_yaw": "the plate turned",
        "plate_place": "the plate elsewhere",
        "support": "a board under the plate",
        "holds": "holds that are not given",
        "obstacle": "obstacles moved or taken away",
        "object_place": "objects elsewhere",
        "object_yaw": "objects turned",
        "goal_place": "goals elsewhere",
        "goal_yaw": "goals turned",
        "object_aside": "an object put aside",
        "tool": "another tool",
        "mass": "lighter objects",
        "two_changes": "two of these at once",
    }
)
"""Words for what is changed, by the kind of a change."""
