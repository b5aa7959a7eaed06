"""The fastest motion along a given path, and its smoothing (compiled)."""

from __future__ import annotations

import numpy as np
from numba import njit

NEGLIGIBLE_RATE = 1e-12
"""|dq/ds| below which a joint does not restrict d²s/dt² [rad per unit of s]."""

FASTEST_PASSAGE = 1e-3
"""A path that nothing restricts takes at least about this long [s]."""


@njit(cache=True, nogil=True)
def fastest_squared_speeds(s, first, second, velocity, acceleration):
    """Squared path speed x = (ds/dt)² at the grid's points for the fastest motion from rest to rest.

    Between grid points d²s/dt² is constant. Reachability analysis: Pham and Pham, "A new approach to time-optimal path
    parameterization based on reachability analysis", T-RO 2018; its two-variable linear programs have closed forms
    because x = 0 is always feasible.

    Args:
        s: (n,) rising.
        first: (n, k) dq/ds.
        second: (n, k) d²q/ds².
        velocity: (n, k) limits of |dq/dt|, > 0, inf for none.
        acceleration: (n, k) limits of |d²q/dt²|, > 0, inf for none.

    Returns:
        (n,) squared speeds, 0 at both ends.
    """
    controllable = _controllable_squared_speeds(s, first, second, velocity, acceleration)
    n, k = first.shape
    squared = np.zeros(n)
    for i in range(n - 1):
        step = 2.0 * (s[i + 1] - s[i])
        u = (controllable[i + 1] - squared[i]) / step
        for j in range(k):
            rate = abs(first[i, j])
            if rate > NEGLIGIBLE_RATE:
                u = min(
                    u,
                    acceleration[i, j] / rate - second[i, j] / first[i, j] * squared[i],
                )
        squared[i + 1] = max(0.0, squared[i] + step * u)
    squared[n - 1] = 0.0
    return squared


@njit(cache=True, nogil=True)
def _controllable_squared_speeds(s, first, second, velocity, acceleration):
    """Greatest x (n,) at each grid point from which the motion can still come to rest at the end."""
    n, k = first.shape
    slope = np.empty(k)
    reach = np.empty(k)
    controllable = np.zeros(n)
    unrestricted = ((s[n - 1] - s[0]) / FASTEST_PASSAGE) ** 2
    for i in range(n - 2, -1, -1):
        step = 2.0 * (s[i + 1] - s[i])
        x = unrestricted
        m = 0
        for j in range(k):
            rate = abs(first[i, j])
            if rate > NEGLIGIBLE_RATE:
                x = min(x, (velocity[i, j] / rate) ** 2)
                if acceleration[i, j] < np.inf:
                    # |q''x + q'u| <= a reads -reach - slope x <= u <= reach - slope x.
                    reach[m] = acceleration[i, j] / rate
                    slope[m] = second[i, j] / first[i, j]
                    m += 1
            elif abs(second[i, j]) > 0.0:
                x = min(x, acceleration[i, j] / abs(second[i, j]))
        for j in range(m):
            x = _cut(x, 1.0 / step - slope[j], controllable[i + 1] / step + reach[j])
            x = _cut(x, slope[j] - 1.0 / step, reach[j])
            for other in range(m):
                x = _cut(x, slope[j] - slope[other], reach[j] + reach[other])
        controllable[i] = x
    return controllable


@njit(cache=True, nogil=True)
def _cut(x, coefficient, bound):
    """The largest value not above x that satisfies coefficient · x <= bound, for bound >= 0."""
    if coefficient > 0.0:
        return min(x, bound / coefficient)
    return x


@njit(cache=True, nogil=True)
def node_times(s, squared):
    """Times (n,) at which the motion passes the grid's points, from squared speeds (n,)."""
    times = np.zeros(s.size)
    for i in range(s.size - 1):
        times[i + 1] = times[i] + 2.0 * (s[i + 1] - s[i]) / (np.sqrt(squared[i]) + np.sqrt(squared[i + 1]))
    return times


@njit(cache=True, nogil=True)
def smoothed_samples(s, squared, times, window, at):
    """The motion, averaged over the last `window` seconds, at rising times `at` (m,) from 0 to times[-1] + window.

    The average of s(t) over a moving window has the averages of ds/dt and d²s/dt² as derivatives, and d²s/dt² no
    longer jumps. All three are exact, by the integral of s over each cell.

    Returns:
        s, ds/dt, d²s/dt², each (m,).
    """
    integral = np.zeros(s.size)
    for i in range(s.size - 1):
        integral[i + 1] = _cell(s, squared, times, integral, i, times[i + 1])[0]
    out = np.empty((3, at.size))
    ahead = 0
    behind = 0
    for k in range(at.size):
        ahead, integral_a, s_a, speed_a = _state(s, squared, times, integral, ahead, at[k])
        behind, integral_b, s_b, speed_b = _state(s, squared, times, integral, behind, at[k] - window)
        out[0, k] = (integral_a - integral_b) / window
        out[1, k] = (s_a - s_b) / window
        out[2, k] = (speed_a - speed_b) / window
    return out[0], out[1], out[2]


@njit(cache=True, nogil=True)
def _state(s, squared, times, integral, cell, t):
    """Cell of time t, searched upwards from `cell`, and (integral of s, s, ds/dt) there; at rest before and after."""
    if t <= 0.0:
        return cell, s[0] * t, s[0], 0.0
    last = s.size - 1
    if t >= times[last]:
        return cell, integral[last] + s[last] * (t - times[last]), s[last], 0.0
    while times[cell + 1] < t:
        cell += 1
    area, position, speed = _cell(s, squared, times, integral, cell, t)
    return cell, area, position, speed


@njit(cache=True, nogil=True)
def _cell(s, squared, times, integral, i, t):
    """Integral of s, s and ds/dt at time t in cell i, where d²s/dt² is constant."""
    dt = t - times[i]
    speed = np.sqrt(squared[i])
    u = (squared[i + 1] - squared[i]) / (2.0 * (s[i + 1] - s[i]))
    area = integral[i] + s[i] * dt + 0.5 * speed * dt**2 + u * dt**3 / 6.0
    return area, s[i] + speed * dt + 0.5 * u * dt**2, speed + u * dt
