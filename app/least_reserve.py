"""Where along a plan least of its force limits is kept back, and when that is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from planners.plan.verdicts import LeastReserve


def least_reserve(document: Mapping[str, Any]) -> tuple[LeastReserve, float] | None:
    """Return what a plan document states of it, and the time [s] of that sample.

    None: nothing is held, or the document is of before there was any.
    """
    stated = document["statistics"].get("reserve")
    if stated is None:
        return None
    least = LeastReserve.model_validate(stated)
    return least, document["segments"][least.segment]["time"][least.sample]
