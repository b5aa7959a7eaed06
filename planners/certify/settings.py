"""Tolerances of the certificate; the contract's, unless said otherwise."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class CertifySettings:
    """What counts as equal, at rest, touching or free."""

    time_step: float = 0.020
    """Largest step between samples [s]; contract."""
    join: float = 1e-9
    """Largest jump of time, position, velocity, width or pose where segments meet [s, rad, rad/s, m]; contract."""
    rest_velocity: float = 1e-6
    """Joint velocity that counts as none [rad/s]; a tenth of an encoder step a second."""
    limit_slack: float = 1e-3
    """Relative excess of joint limits that is accepted; contract."""
    velocity_consistency: float = 0.02
    """|dq/dt - mean v| between two samples [rad/s]; contract."""
    attachment_distance: float = 2e-4
    """Drift of an attached body [m]; contract."""
    attachment_angle: float = math.radians(0.05)
    """Turn of an attached body [rad]; contract."""
    contact_distance: float = 5e-4
    """Distance of a contact from the surfaces it joins and the hand that makes it [m]; as for contact states."""
    contact_angle: float = math.radians(0.5)
    """Angle between a contact's normal and the surface's [rad]; twice what `contact_distance` turns a pad of 60 mm."""
    element_height: float = 5e-4
    """Distance of a contact element's vertices from the support's height [m]; contract."""
    force_balance: float = 1e-3
    """|sum of forces| [N]; contract."""
    moment_balance: float = 1e-3
    """|sum of moments| about the centre of mass [Nm]; contract."""
    cone_slack: float = 1e-5
    """Excess of a cone or limit that is accepted [N, Nm]; ten times the accuracy asked of the balance solver."""
    set_angle: float = math.radians(2.0)
    """Rotation between two contact sets [rad]; contract."""
    set_distance: float = 0.010
    """Motion of the centre of mass between two contact sets [m]; contract."""
    set_time: float = 0.25
    """Time between two contact sets while a body is held still [s]; contract."""
    inertia_fraction: float = 0.05
    """Part of a body's weight that its acceleration may need without being counted; an engineering choice."""
    stated_bound: float = 1e-6
    """Relative difference of a stated bound from the one derived again; rounding of what a document states."""
    goal_slack: float = 1e-4
    """Lowest vertex below the goal height [m]; contract."""
    touch_depth: float = 1e-3
    """Penetration of pairs that may touch [m]; contract."""
    smallest_motion: float = 2e-5
    """Motion below which two clear moments are taken as clear in between [m]; a fiftieth of `touch_depth`."""
    distance_budget: int = 20_000
    """Distances computed before the rest is reported as not proven; a plan of a minute needs some hundreds."""
