"""The regrasp graph: its layers of grasps, its handovers, and what its edges cost."""
