"""Motion: one posture of each hand all along a path, and the segments that follow."""
