"""What can be asked of the list of plans."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from app.page_token import read_page_token
from app.resources import Outcome, PlanState
from planners.contract.quantities import ExternalId
from workers.stores.jobs import JobState
from workers.stores.plan_store import PlanFilter


class PlanQuery(BaseModel):
    """The query of `GET /v1/plans`. What is given must hold for every plan that is listed."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    page_size: int = Field(default=50, ge=1, le=200)
    page_token: str | None = None
    """`next_page_token` of the page before; repeat the rest of the query with it."""
    external_id: ExternalId | None = None
    """Exactly the task's own."""
    work_master: ExternalId | None = None
    """Exactly the order's own."""
    kind: Literal["plate_lift", "suction_tool"] | None = None
    state: PlanState | None = None
    outcome: Outcome | None = None
    """Of jobs that have succeeded."""

    @property
    def position(self) -> tuple[int, str] | None:
        """Where the page begins: behind (created_us, id); None: with the newest.

        Raises:
            BadHeader: The token is none of ours.
        """
        return None if self.page_token is None else read_page_token(self.page_token)

    def filter(self, owner: str | None) -> PlanFilter:
        """Return which plans are asked for, of one owner or of all."""
        state = None if self.state is None else JobState(self.state)
        return PlanFilter(owner, self.kind, self.external_id, self.work_master, state, self.outcome)
