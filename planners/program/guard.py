"""Which documents may become programs: those of certified plans, unchanged, in the cell that is there."""

from __future__ import annotations

from pydantic import ValidationError

from planners.cell.cell import Cell
from planners.contract.strict_json import NotJson, parse_json
from planners.errors import LiftwrightError
from planners.plan.plan import Plan, digest_of
from planners.plan.simulation import failure_of
from planners.planning import certificate_of


class NotExportable(LiftwrightError):
    """A document must not become a program; says why, and what to do about it."""


def exportable(document: bytes, cell: Cell) -> Plan:
    """Return the plan of a document that may become a program, after everything about it was checked once more.

    Args:
        document: of the plan, as it was sent.
        cell: that is there, where the program is going to run.

    Raises:
        NotExportable: it is no plan; nothing was found; it is of another cell, or this cell has changed since; it is
            not what was certified, or does not pass when it is certified again from these bytes.
    """
    try:
        plan = Plan.read(document)
    except (NotJson, ValidationError) as error:
        first = error.errors()[0] if isinstance(error, ValidationError) else None
        where = "" if first is None else f" at /{'/'.join(map(str, first['loc']))}: {first['msg']}"
        raise NotExportable(f"this is not a plan{where or f': {error}'}") from error
    if plan.outcome != "solved":
        raise NotExportable(f"there is nothing to run: the outcome is {plan.outcome}")
    if plan.certificate is None or not plan.certificate.passed:
        raise NotExportable("it has no certificate that was passed")
    here = cell.document()
    if plan.cell.name != here.name:
        raise NotExportable(f"it is a plan for the cell {plan.cell.name}, not for {here.name}")
    if plan.cell.hash != here.hash:
        raise NotExportable(
            f"the cell {here.name} is not what it was planned in any more (hash {plan.cell.hash[:12]} then, "
            f"{here.hash[:12]} here): plan it again"
        )
    if plan.digest is None:
        raise NotExportable("it has no digest, as software before this wrote it: plan it again")
    if plan.digest != digest_of(parse_json(document)):
        raise NotExportable("it was changed after it was certified: its digest is that of another document")
    again = certificate_of(document, cell)
    if again is None or not again.passed:
        failed = [] if again is None else [f"{check.name} ({check.where})" for check in again.failures]
        raise NotExportable(f"it does not pass when it is certified again: {', '.join(failed)}")
    return plan


def physics_words(plan: Plan) -> str:
    """Say in a line how a plan fared in physics: a certificate says nothing of what swings or slides on its way."""
    if plan.simulation is None:
        return "It was not tried in physics."
    failure = failure_of(plan.simulation)
    if failure is None:
        return "It was carried out in physics."
    return f"IN PHYSICS IT FAILED: {failure.words()}. Change the task before a robot runs it."
