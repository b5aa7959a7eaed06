"""Table I of paper A, as printed, and what it says of Table II."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PaperObject:
    """One object of the paper's simulations: seconds, mean of ten."""

    suction: float
    first_regrasp: float
    first_motion: float
    second_regrasp: float
    second_motion: float
    total: float
    """As printed."""


TABLE_I = {
    "domino": (
        PaperObject(0.06, 14.67, 9.12, 7.71, 5.38, 36.94),
        PaperObject(0.06, 8.01, 9.84, 7.96, 6.29, 32.16),
        PaperObject(0.05, 8.41, 17.28, 7.77, 13.15, 46.66),
    ),
    "can": (
        PaperObject(0.06, 13.92, 4.95, 8.21, 3.67, 30.81),
        PaperObject(0.06, 7.98, 11.65, 9.12, 13.33, 42.14),
    ),
    "tissue": (
        PaperObject(0.07, 13.81, 4.79, 7.97, 10.71, 37.35),
        PaperObject(0.06, 8.49, 12.38, 8.46, 4.86, 34.25),
        PaperObject(0.07, 7.74, 16.33, 8.60, 5.30, 38.04),
    ),
}
"""By pile, objects as they are moved."""
