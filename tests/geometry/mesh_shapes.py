"""Meshes with a known inside."""

import numpy as np
import trimesh

ANGLE = np.array([[0, 0], [0.1, 0], [0.1, 0.02], [0.02, 0.02], [0.02, 0.08], [0, 0.08]])
"""Outline of an L [m]."""


def angle(height=0.05):
    """An L-shaped bar: its outline from z = 0 to `height`."""
    n = len(ANGLE)
    low, high = np.c_[ANGLE, np.zeros(n)], np.c_[ANGLE, np.full(n, height)]
    cap = [(0, 1, 2), (0, 2, 3), (0, 3, 5), (3, 4, 5)]
    faces = [(a, c, b) for a, b, c in cap] + [(a + n, b + n, c + n) for a, b, c in cap]
    faces += [face for i in range(n) for j in [(i + 1) % n] for face in ((i, j, n + j), (i, n + j, n + i))]
    return trimesh.Trimesh(np.vstack([low, high]), faces, process=False)


def in_angle(points, height=0.05):
    """Whether (n, 3) points are inside the bar."""
    x, y, z = points.T
    foot, leg = (x < 0.1) & (y < 0.02), (x < 0.02) & (y < 0.08)
    return (x > 0) & (y > 0) & (foot | leg) & (z > 0) & (z < height)


def ring(major=0.05, minor=0.015):
    """A ring round z; its circles are polygons."""
    return trimesh.creation.torus(major, minor, major_sections=48, minor_sections=24)


def ring_depth(points, major=0.05, minor=0.015):
    """How deep (n, 3) points are inside the round ring [m]."""
    return minor - np.hypot(np.hypot(points[:, 0], points[:, 1]) - major, points[:, 2])


def file_of(mesh, kind):
    content = mesh.export(file_type=kind)
    return content if isinstance(content, bytes) else content.encode()
