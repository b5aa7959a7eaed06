"""One cause of an explanation, in words: why there is no plan, and by how much."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

MILLIMETRES = 1e3
"""In a metre: lengths are told as on drawings."""


def reason_of(cause: Mapping[str, Any]) -> str:
    """Return the reason, without a full stop: figures may follow."""
    return str(cause["reason"]).rstrip(".")


def figures_of(cause: Mapping[str, Any]) -> str | None:
    """Return what was needed and what there was, or how much was missing; None without figures.

    Where nothing, or less than nothing, is said to be available, the figures are a shortfall: how far the nearest try
    was from a limit.
    """
    needed, available = cause["needed"], cause["available"]
    if needed is None or available is None:
        return None
    if available > 0.0:
        return f"needed {_measure(needed, cause['unit'])}, available {_measure(available, cause['unit'])}"
    return f"short by {_measure(needed - available, cause['unit'])}"


def _measure(value: float, unit: str | None) -> str:
    if unit == "m":
        value, unit = MILLIMETRES * value, "mm"
    return f"{value:.4g} {unit}" if unit else f"{value:.4g}"
