"""Numbers and arrays as a plan document has them: SI units, world frame, finite."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, SkipValidation

Real = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Real, Real, Real]
PoseArray = tuple[Real, Real, Real, Real, Real, Real, Real]
"""[x, y, z, w, x, y, z]"""
SixJoints = tuple[Real, Real, Real, Real, Real, Real]
WrenchArray = tuple[Real, Real, Real, Real, Real, Real]
"""[fx, fy, fz, tx, ty, tz] in world axes, the torque about the stated point."""
Numbers = Annotated[list[float], SkipValidation]
"""One number a sample."""
Rows = Annotated[list[list[float]], SkipValidation]
"""One row a sample."""
ArmName = Literal["left", "right"]
