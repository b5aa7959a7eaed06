"""What an examination of a plan has before it: the document, what is known besides, and what follows from both."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from planners.certify.motion.robot_surfaces import RobotSurfaces
from planners.certify.motion.segment_motion import BodyContacts, SegmentMotion, motions_of
from planners.certify.motion.solids import ConvexSolid, solids_of
from planners.certify.plan_view import MalformedDocument, PlanView
from planners.certify.settings import CertifySettings
from planners.contract.task_spec import CustomTool
from planners.geometry.pose import Array
from planners.plan.scenery import BodyDocument, CellDocument


@dataclass(frozen=True)
class LifterReference:
    """How large the vacuum lifter is."""

    cup_height: float
    """[m]"""
    cable_radius: float
    """[m]"""
    cable_length: float
    """[m]"""


@dataclass(frozen=True, eq=False)
class CellReference:
    """What is known about the cell without the document."""

    cell: CellDocument
    """As plans in this cell state it."""
    bodies: Mapping[str, BodyDocument]
    """Its static bodies, as plans state them."""
    home: Array
    """(12,) where the arms start when the task does not say [rad]."""
    lifter: LifterReference
    """Of plate lifts."""
    tool_pose: Sequence[float] | None = None
    """Where a suction tool stands in the cell's rest, if it has one."""
    tools: Mapping[str, CustomTool] = field(default_factory=dict)
    """Shipped suction tools by name, each as a task would describe it."""
    meshes: Mapping[str, Array] = field(default_factory=dict)
    """Meshes that are shipped for tasks by name, see `load_meshes`."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """One document, what is known of its robots and its cell, and how exact it has to be."""

    plan: PlanView
    surfaces: RobotSurfaces
    reference: CellReference | None = None
    """What the cell is known to be; None where the document's own cell is believed."""
    settings: CertifySettings = field(default_factory=CertifySettings)

    @cached_property
    def motions(self) -> list[SegmentMotion]:
        """The motion of every segment."""
        return motions_of(self.plan, self.surfaces)

    @cached_property
    def contacts(self) -> list[BodyContacts]:
        """Every contact set of the plan."""
        return [one for motion in self.motions for one in motion.contacts]

    @cached_property
    def solids(self) -> list[ConvexSolid]:
        """All that can be hit."""
        return solids_of(self.plan, self.surfaces)

    def require_bodies(self, names: Iterable[str]) -> None:
        """Refuse a document without bodies that its task needs.

        Raises:
            MalformedDocument: one is missing.
        """
        for name in names:
            if name not in self.plan.bodies:
                raise MalformedDocument(f"/bodies/{name}", "is missing")
