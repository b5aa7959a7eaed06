"""How much of a plate's mass its bearers accelerate when they go up together."""

from __future__ import annotations

import numpy as np

from planners.geometry.pose import Array


def felt_mass(points: Array, up: Array, mass: float, inertia: Array) -> float:
    """Return the force over the acceleration of points that all go up alike on a body that is otherwise free [kg].

    A body that turns about its bearers is lighter for them than its mass. What else holds it turns it less, or not at
    all, but takes a part of the force: hands feel no more than this of a plate that also hangs on a cup.

    Args:
        points: (n, 3) of the bearers from the centre of mass, body axes [m].
        up: (3,) unit vector, body axes.
        mass: [kg].
        inertia: (3,) principal moments about the body axes [kg m^2].
    """
    arms = np.cross(points, up)
    # Mobility: the acceleration upward of each point under a unit force upward at each.
    mobility = 1.0 / mass + arms @ (arms / inertia).T
    # Two bearers at one place share a force in any way.
    return float(np.linalg.pinv(mobility, rcond=1e-9).sum())


def box_inertia(sides: Array, mass: float) -> Array:
    """Return the (3,) principal moments of a homogeneous box with these sides (3,) [kg m^2]."""
    squares = np.asarray(sides) ** 2
    return mass / 12.0 * (squares.sum() - squares)
