"""/v1/audit: who changed what."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Query

from app.access.audit_log import AuditEntry
from app.resources.schemas import Resource, moment
from app.routes.dependencies import Authentication

router = APIRouter(prefix="/v1/audit", tags=["access"])


class AuditItem(Resource):
    """One thing that somebody did or tried to do."""

    number: int
    at: datetime
    key_id: str | None
    """None: no keys were asked for, or it was done on the command line."""
    owner: str | None
    address: str | None
    action: str
    target: str
    status: int
    """How it was answered."""


class AuditPage(Resource):
    """One page of the log, newest first."""

    entries: list[AuditItem]
    next_before: int | None
    """Give it as `before` for the next page; None on the last one."""


@router.get("", summary="Read the audit log")
def list_audit(
    authenticator: Authentication,
    page_size: Annotated[int, Query(ge=1, le=200)] = 50,
    before: Annotated[int | None, Query(ge=1, le=2**31 - 1)] = None,
) -> AuditPage:
    """Return who changed what. Needs the scope `admin`."""
    entries = authenticator.audit.newest(page_size + 1, before)
    shown = entries[:page_size]
    return AuditPage(
        entries=[_item(entry) for entry in shown], next_before=shown[-1].number if len(entries) > page_size else None
    )


def _item(entry: AuditEntry) -> AuditItem:
    return AuditItem(
        number=entry.number,
        at=moment(entry.at_us),
        key_id=entry.key_id,
        owner=entry.owner,
        address=entry.address,
        action=entry.action,
        target=entry.target,
        status=entry.status,
    )
