"""Segments of a suction-tool plan: what hands, tool and sucked object do in one stretch of motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from planners.geometry.pose import Array, Transform
from planners.motion.trajectory import Trajectory
from planners.plan.segment import SegmentKind


@dataclass(frozen=True, eq=False)
class ToolHold:
    """A gripper's grip of the tool."""

    arm: str
    T_tool_tcp: Transform
    width: float
    """Inner distance of the pads [m]."""
    T_flange_tool: Transform
    """How the tool sits on the arm's flange."""


@dataclass(frozen=True, eq=False)
class SuckedObject:
    """An object on the tool's cup."""

    name: str
    T_tool_object: Transform


@dataclass(frozen=True, eq=False)
class ExertedForce:
    """What one contact exerts on a body, in world axes."""

    by: str
    """An arm, "tool", or the body it touches."""
    kind: str
    """"soft_finger", "environment", "suction" or "inertia", as in the plan document."""
    point: Array
    """(3,) in the world [m]; the centre of mass for "inertia"."""
    normal: Array
    """(3,) into the body; zero for "inertia"."""
    wrench: Array
    """(6,), the torque about `point` [N, Nm]."""
    finger: int | None = None
    """0 is at the TCP's -y."""


@dataclass(frozen=True, eq=False)
class ToolContactSet:
    """All contacts on one body at one sample, in balance with its weight and its inertia."""

    sample: int
    body: str
    forces: tuple[ExertedForce, ...]


@dataclass(frozen=True, eq=False)
class HeldReserve:
    """What is left of the limits of cup and hands along a segment."""

    values: Array
    """(n,) the largest share of all force limits that could be missing with the load still borne [1]."""
    sample: int
    """At which least is left."""
    limited_by: str
    """What would give way there, in words."""
    body: str
    """What would be lost."""

    @property
    def least(self) -> float:
        """At the worst sample [1]."""
        return float(self.values[self.sample])


@dataclass(frozen=True, eq=False)
class ToolSegment:
    """One stretch of a plan; it starts where the last ended.

    What the kinds say of the tool and the object:

    - TRANSIT, APPROACH, RETREAT: a free hand moves; the tool rests, or is held still by the other hand.
    - GRIP, RELEASE: fingers of one hand close on the tool or open; no joint moves. Its hold is in `holds`, though it
      stands at the last or first sample only.
    - HANDOVER: both hands hold the tool, and nothing moves; after the receiver's GRIP, before the giver's RELEASE.
    - TRANSFER: the tool moves with the hand that holds it, and with it the object if one is sucked.
    - ATTACH, DETACH: the vacuum goes on or off; nothing moves, cup and object touch, and the object rests on something.
      The object is `sucked` in both kinds.

    Forces are shown at every 2 degrees and every 10 mm of a body's way, and only at samples: in a TRANSFER neither the
    tool nor the object may turn or travel farther than that from one sample to the next.
    """

    kind: SegmentKind
    movers: tuple[str, ...]
    """Arms whose joints change."""
    trajectory: Trajectory
    """Of all twelve joints; its time starts at 0."""
    widths: Mapping[str, Array]
    """(n,) inner distance of each gripper's pads, of both arms [m]."""
    holds: tuple[ToolHold, ...]
    """Hands on the tool; two while it is handed over. In GRIP and RELEASE the hand that closes or opens comes first."""
    sucked: SuckedObject | None
    body_poses: Mapping[str, Array]
    """{name: (n, 4, 4)} `T_world_body` of what moves here: the tool and a sucked object, in TRANSFER."""
    contact_sets: tuple[ToolContactSet, ...] = ()
    reserve: HeldReserve | None = None
    """None while nothing is held."""
