"""What an examination of a plan document has before it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from planners.certify.common.scene import CellReference, scene_checks
from planners.certify.motion.robot_surfaces import RobotSurfaces
from planners.certify.plan_view import MalformedDocument, PlanView
from planners.certify.settings import CertifySettings
from planners.geometry.pose import Array
from planners.plan.scenery import CellDocument
from planners.plan.verdicts import Check


@dataclass(frozen=True, eq=False)
class Evidence:
    """One document, what is known of its robots and its cell, and how exact it has to be."""

    plan: PlanView
    surfaces: RobotSurfaces
    reference: CellReference | None
    """What the cell is known to be; None where the document's own cell is believed."""
    settings: CertifySettings

    def require_bodies(self, names: Iterable[str]) -> None:
        """Refuse a document without bodies that its task needs.

        Raises:
            MalformedDocument: one is missing.
        """
        for name in names:
            if name not in self.plan.bodies:
                raise MalformedDocument(f"/bodies/{name}", "is missing")

    def cell_checks(self) -> list[Check]:
        """Check the cell and its hands."""
        return scene_checks(self.plan, self.reference, self.settings)

    @property
    def known_cell(self) -> CellDocument | None:
        """What plans in this cell state as `cell`; None where that is not known."""
        return None if self.reference is None else self.reference.cell

    def start_positions(self, stated: Array | None) -> Array | None:
        """Return where the joints (12,) have to start: as stated, or at home; None where neither is known [rad]."""
        home = None if self.reference is None else self.reference.home
        return home if stated is None else stated
