"""What a suction-tool planner looked at, as the document lists it for drawing: cup, grasps, regrasp graphs."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from planners.contract.arrays import ArmName, OneOf, Poses, SampledPose, Samples, Vector
from planners.contract.strict_model import StrictModel

Node = Annotated[int, Field(ge=0)]
"""A grasp of the tool by an arm: index of the arm * number of grasps + number of the grasp."""
Round = Annotated[int, Field(ge=0, le=1)]
"""0: the tool alone; 1: with the object."""


class ConsideredPlace(StrictModel):
    """A place of the cup on an object, in the object's frame."""

    point: Vector
    normal: Vector
    """Of the surface, outward."""
    reason: str | None
    """Why the cup cannot sit there; null: it can."""


class ConsideredSuctionPose(StrictModel):
    """A pose of the tool on an object that was tried."""

    object: str
    pose: SampledPose
    """`T_object_tool`"""
    reason: str | None
    """Why it was given up; null: it is used."""


class RegraspStep(StrictModel):
    """One grasp of the sequence that is moved."""

    object: str
    round: Round
    arm: ArmName
    grasp: Annotated[int, Field(ge=0)]
    by: Annotated[str, OneOf("held", "picked up", "handover")]
    """How the grasp came about."""


class GraspList(StrictModel):
    """All grasps of the tool that are free of collision with it, alike for both arms."""

    poses: Poses
    """`T_tool_tcp`, by number of the grasp."""
    widths: Samples
    """Inner distance of the pads [m]."""


class RegraspLayer(StrictModel):
    """Grasps of the tool at one of its poses. A node in neither list was not asked: no sequence needed it."""

    layer: Literal["initial", "suction", "goal"]
    """The tool where the plan takes it up, on the object at its start, or on the object at a goal."""
    goal: int | None
    """Which of the goals that the object's symmetry allows."""
    tool_pose: SampledPose
    """`T_world_tool`"""
    possible: list[Node]
    rejected: dict[str, list[Node]]
    """By reason."""


class RegraspEdge(StrictModel):
    """An edge whose motion was tried.

    A transfer of round 0 leads to the suction layer, one of round 1 to a goal, with the same grasp; a handover leads
    from the giver's node to the receiver's; a pick leads from none.
    """

    kind: Literal["pick", "transfer", "handover"]
    round: Round
    from_: Annotated[Node | None, Field(alias="from")]
    to: Node
    goal: int | None
    state: Literal["chosen", "moved", "deleted"]
    """moved: it could be moved, and an edge after it could not."""
    reason: str | None
    """Why it was deleted."""


class RegraspGraph(StrictModel):
    """The regrasp graph of one planned move, with the suction pose that was used or else tried most."""

    object: str
    moved: bool
    suction_pose: SampledPose
    """`T_object_tool`"""
    arms: Annotated[list[ArmName], Field(min_length=2, max_length=2)]
    """By index, as nodes count them."""
    layers: list[RegraspLayer]
    handover_pairs: tuple[int, int]
    """Edges between the arms, by round."""
    edges: list[RegraspEdge]
    sequence: list[int]
    """Numbers of the chosen edges, in order; none where nothing was moved."""


class Considered(StrictModel):
    """What was looked at, and why what was not used fell."""

    order: list[str]
    """Objects as they are moved; one that makes a stopover comes twice."""
    steps: list[RegraspStep]
    places: dict[str, list[ConsideredPlace]]
    """By object."""
    suction_poses: list[ConsideredSuctionPose]
    tool_grasps: GraspList
    regrasp_graphs: list[RegraspGraph]
    """Of every move that was planned, those first for which no sequence was found."""
