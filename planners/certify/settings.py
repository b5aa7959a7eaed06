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
    switching: float = 0.2
    """Least time in which fingers close or open, or vacuum goes on or off [s]; an engineering choice."""
    rest_velocity: float = 1e-6
    """Joint velocity that counts as none [rad/s]; a tenth of an encoder step a second."""
    limit_slack: float = 1e-3
    """Relative excess of joint limits that is accepted; contract."""
    velocity_consistency: float = 0.02
    """|dq/dt - mean v| between two samples [rad/s]; contract."""
    acceleration_consistency: float = 0.2
    """dv/dt outside the accelerations stated at both ends of a step [rad/s^2]; an engineering choice ..."""
    acceleration_fraction: float = 0.1
    """... to which this part of the segment's largest dv/dt is added: both together are three times what curved ways
    need, whose acceleration turns over within a step."""
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
    vertex_touch: float = 1e-4
    """Height above the support below which a vertex touches it [m]. Less than `element_height`: next to the vertex that
    an outline of many sides stands on there are others as near as that."""
    end_distance: float = 5e-3
    """A contact that a segment does not state may stand while no vertex is farther than this from its place at the
    nearer end of the segment [m]; an engineering choice ..."""
    end_fraction: float = 0.1
    """... nor farther than this part of the longest way of a vertex from that end, where that is more."""
    contact_slip: float = 5e-4
    """Drift of contact vertices along the support over a segment [m]; as `element_height`."""
    rim: float = 1e-3
    """Contacts that are nearer to their support's rim have to be possible beyond it, too [m]; twice `contact_slip`."""
    force_balance: float = 1e-3
    """|sum of forces| [N]; contract."""
    moment_balance: float = 1e-3
    """|sum of moments| about the centre of mass [Nm]; contract."""
    cone_slack: float = 1e-5
    """Excess of a cone or limit that is accepted [N, Nm]; ten times the accuracy asked of the balance solver."""
    torque_reserve: float = 0.05
    """Part of each joint's largest torque that is kept: for what is not published, as what turning the motors' rotors
    and the joints' friction take, and for what is not counted, turning links and hand about themselves; an engineering
    choice."""
    set_angle: float = math.radians(2.0)
    """Rotation between two contact sets [rad]; contract."""
    set_distance: float = 0.010
    """Motion of the centre of mass between two contact sets [m]; contract."""
    set_time: float = 0.25
    """Time between two contact sets while a body is held still [s]; contract."""
    inertia_fraction: float = 0.05
    """Part of a body's weight that its acceleration may need without being counted; an engineering choice."""
    stated_reserve: float = 1e-6
    """By how much a stated reserve may be more than what contacts leave [1]; rounding of what a document states."""
    second_opinion: float = 1e-4
    """Relative difference of what two solvers find; ten times the tolerance of either."""
    stated_bound: float = 1e-6
    """Relative difference of a stated bound from the one derived again; rounding of what a document states."""
    pad_slant: float = math.radians(15.0)
    """Angle between a rubber pad or a cup's lip and the curved surface it lies on [rad]; the authors' threshold for
    facets and for fingers that face one another."""
    seam: float = 1e-5
    """Gap within a body or its surface that pads and lips do not notice [m]; an engineering choice."""
    lip_give: float = 1e-3
    """Distance of the surface from the plane of a cup's lip [m]; an engineering choice."""
    settled_distance: float = 1e-3
    """How far a body may be placed from where its task says, onto what carries it [m]; contract, of plates."""
    settled_angle: float = math.radians(0.1)
    """The same for its orientation [rad]; contract, of plates."""
    goal_distance: float = 1e-3
    """Distance of an object from its goal [m]; contract."""
    goal_angle: float = math.radians(0.5)
    """Angle of an object from its goal [rad]; contract."""
    tool_shape: float = 2e-4
    """Distance of a tool's surface from the shapes it is described by [m]: round ones have chords."""
    goal_slack: float = 1e-4
    """Lowest vertex below the goal height [m]; contract."""
    touch_depth: float = 1e-3
    """Penetration of pairs that may touch [m]; contract."""
    smallest_motion: float = 2e-5
    """Motion below which two clear moments are taken as clear in between [m]; a fiftieth of `touch_depth`."""
    distances_per_step: int = 256
    """Distances that one pair of solids may take, for each step of a segment, before it is reported as not proven: what
    the check may cost grows with the motion. Plans need two in a hundred steps; two solids that pass a micrometre apart
    need some fifty a step."""
